"""The committed study of haptics says what its page says, and what it was made to show."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tissue_sim.geometry import scene_geometry
from tool_input.haptic_study import (
    DAMPING,
    DELAY,
    STIFFNESS,
    cost_table,
    live_table,
    stability_table,
)
from tool_input.haptics.bounce import HELD, MODELS, PASSIVE, RENDERINGS, Wall, restitution
from tool_input.haptics.model_cost import outermost


def test_the_study_is_shown_as_it_came_out(repository: Path) -> None:
    result = json.loads((repository / "docs/results/haptics.json").read_text(encoding="utf-8"))
    page = (repository / "docs/haptics.md").read_text(encoding="utf-8")
    for table in (live_table, cost_table, stability_table):
        assert table(result) in page
    # What was to be shown, and is.
    rows = result["stability"]
    assert len(rows) == len(STIFFNESS) * len(DAMPING) * len(DELAY)
    assert max(row[PASSIVE] for row in rows) <= 1.0
    assert min(row[HELD] - row[PASSIVE] for row in rows) > 0.0
    undamped = [row for row in rows if row["damping"] == 0.0]
    assert min(row[MODELS] for row in undamped) > 1.0
    for row in result["live"]:
        assert 0.1 < row["largest_force"] <= 3.0 + 1e-9
    assert (
        min(row["forces_per_second"] for row in result["live"] if row["realtime_priority"]) > 900.0
    )


def test_a_bounce_of_the_study_comes_out_again(repository: Path) -> None:
    result = json.loads((repository / "docs/results/haptics.json").read_text(encoding="utf-8"))
    row = result["stability"][-1]
    wall = Wall(row["stiffness"], row["damping"], row["delay"])
    for rendering in RENDERINGS:
        assert restitution(wall, rendering) == pytest.approx(row[rendering], abs=0.02)


def test_a_probe_meets_the_outermost_node_first() -> None:
    mesh = scene_geometry.load("block", parameters={"size_x": 0.05, "size_z": 0.02}).mesh
    towards = np.array([0.0, 0.0, -1.0])
    place = outermost(mesh, towards)
    assert place[2] > mesh.rest[: mesh.node_rows, 2].max() - 0.002
    across = mesh.rest[: mesh.node_rows, 0]
    assert abs(place[0] - across.mean()) <= np.diff(np.unique(across)).max()
