"""The bench writes what its readers expect."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from tissue_sim import bench
from tissue_sim.bench_table import print_table
from tissue_sim.geometry.scene_geometry import load

AXES = ("nodes_x", "nodes_y", "nodes_z")
KEYS = {
    "model", "geometry", "nodes", "elements", "active_nodes", "threads", "steps_per_second",
    "ms_per_step", "bytes_per_step", "limit", "limit_share", "thesis_fps",
}  # fmt: skip


def test_every_row_has_every_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "TRIAD_NUMBERS", 1 << 20)
    small, made = load("block", parameters=dict.fromkeys(AXES, 10)).mesh, bench.geometry
    monkeypatch.setattr(
        bench, "geometry", lambda name: small if name == bench.FINE_HEART else made(name)
    )
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
    visited = [
        figures["heart", f"lr, L = 4, one pass{text}"]["springs_visited"]
        for text in ("", ", no sleeping")
    ]
    assert 0 < visited[0] < visited[1]
    assert 30_000 < figures["heart", "lr, L = 4, one pass"]["nodes"] < 40_000

    narrow, wide = (_printed(result, width) for width in (80, 140))
    for lines in (narrow, wide):
        assert sum("106/s" in line for line in lines) == 1
        for row in result["rows"]:
            steps = f"{row['steps_per_second']:,.0f}"
            assert any(line.startswith(row["model"]) and steps in line for line in lines)
    assert any("springs" in line for line in wide)
    assert len(narrow) == len(wide) + 1  # it says what is left out; no cell takes a second line


def _printed(result: dict[str, Any], width: int) -> list[str]:
    console = Console(record=True, width=width)
    print_table(result, console)
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= width
    return lines


def test_the_hold_goes_to_and_fro_at_constant_speed() -> None:
    travel = np.linspace(0.0, 0.2, 2001)
    z = np.array([bench.height(way) for way in travel])
    assert z[0] == 0.0
    assert z.max() == pytest.approx(0.01)
    assert z.min() == pytest.approx(-0.01)
    assert np.abs(np.diff(z)) == pytest.approx(np.diff(travel))
