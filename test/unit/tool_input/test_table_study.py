"""The study of the operating table: its tables, and what the documentation shows of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tissue_sim.compare.models.table import END, into_page
from tool_input import table_study
from tool_input.table_latency import PARTS

RESULT = "docs/results/table.json"
PAGE = "docs/operating_table.md"


def row(scene: str) -> dict[str, Any]:
    latency = {name: {"p50": 10.0 * n, "p95": 20.0 * n} for n, name in enumerate(PARTS, 1)}
    rates = {"received_hz": 23.3, "drawn_hz": 6.9, "kb_per_frame": 10.8}
    return {
        "scene": scene,
        "load_before": 0.2,
        "window": [960, 540],
        "triangles": 1764,
        "simulated_hz": 60.0,
        "drawn": rates,
        "without_drawing": {**rates, "drawn_hz": 30.1},
        "moves": 12,
        "seen": 11,
        "latency_ms": {"whole": {"p50": 150.0, "p95": 300.0}, **latency},
    }


def test_every_figure_of_a_scene_stands_in_its_row_or_its_column() -> None:
    tables = table_study.as_markdown({"rows": [row("wall"), row("heart")]})
    assert "| wall | 0.2 | 960 x 540 | 1,764 | 11 | 60 | 23.3 | 6.9 | 23.3 | 30.1 |" in tables
    assert f"| {PARTS['drawing']} | 50 (100) | 50 (100) |" in tables
    assert "| moves seen | 11 of 12 | 11 of 12 |" in tables


def test_the_page_has_a_place_for_the_tables(repository: Path) -> None:
    page = (repository / PAGE).read_text(encoding="utf-8")
    replaced = into_page(page, "the tables", table_study.BEGIN)
    assert f"{table_study.BEGIN}\nthe tables\n{END}" in replaced


def test_the_study_is_shown_as_it_came_out(repository: Path) -> None:
    result = json.loads((repository / RESULT).read_text(encoding="utf-8"))
    page = (repository / PAGE).read_text(encoding="utf-8")
    assert into_page(page, table_study.as_markdown(result), table_study.BEGIN) == page
    assert [row["scene"] for row in result["rows"]] == list(table_study.SCENES)
    for row in result["rows"]:
        latency = row["latency_ms"]
        # Medians of parts need not add up to that of the whole, but nearly do.
        parts = sum(latency[name]["p50"] for name in PARTS)
        assert parts == pytest.approx(latency["whole"]["p50"], rel=0.3)
        assert row["seen"] >= 0.75 * row["moves"]
