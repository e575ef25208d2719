"""The bench writes what its readers expect."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console

from tissue_sim import bench

KEYS = {
    "model", "geometry", "nodes", "elements", "active_nodes", "threads", "steps_per_second",
    "ms_per_step", "bytes_per_step", "limit", "limit_share", "thesis_fps",
}  # fmt: skip


def test_every_row_has_every_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "TRIAD_NUMBERS", 1 << 20)
    out = tmp_path / "deep" / "bench.json"
    result = bench.run_bench(out, seconds=0.05)
    assert json.loads(out.read_text()) == json.loads(json.dumps(result))
    assert result["triad_GBps"] > 0.1
    assert {"processor", "cores", "python", "numba"} <= set(result["machine"])
    figures = {(row["geometry"], row["model"]): row for row in result["rows"]}
    assert len(figures) == len(bench.CASES)
    for row in result["rows"]:
        assert set(row) >= KEYS
        assert row["steps_per_second"] * row["ms_per_step"] == pytest.approx(1000)
        assert row["limit"] in ("memory", "arithmetic")
        assert 0 < row["limit_share"] < 3
        assert 0 < row["active_nodes"] <= row["nodes"]
    assert figures["wall", "spring_mass"]["thesis_fps"] == 86
    assert figures["heart", "lr, L = 4, one pass"]["thesis_fps"] == 20
    assert figures["wall", "quasi_static, all nodes"]["nodes"] == 884
    assert 30_000 < figures["heart", "lr, L = 4, one pass"]["nodes"] < 40_000

    console = Console(record=True, width=160)
    bench.print_table(result, console)
    text = console.export_text()
    assert "lr, L = 4, one pass" in text
    assert "106/s" in text
