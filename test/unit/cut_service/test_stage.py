"""A procedure with cuts, stitches, a patch and undos, rehearsed in one process."""

from __future__ import annotations

import numpy as np
import pytest

from cut_service.stage import Stage, StageError
from cut_service.trial import remembered
from cut_service.validity import look_at
from support.sewn_blocks import two_blocks
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.journal import replay
from tissue_sim.scene import Scene
from tool_input.player import Player
from tool_input.procedure import parse_procedure

TEXT = """\
units: mm
tools:
  carrier: {kind: grab, shape: sphere, size: [2], start: {position: [0, 0, 30]}}
timeline:
  - at: 0.1
    suture: {from: [[12, 0, 6], [12, 9, 6]], to: [[13, 0, 6], [13, 9, 6]]}
    spacing: 3
    name: wound
  - {at: 0.2, tighten: wound, length: 0.2}
  - at: 0.3
    patch: {name: felt, ellipse: [3, 3], at: [12.5, 4.5, 12], normal: [0, 0, 1],
            thickness: 0.8, edge: 1.5, carried_by: carrier}
  - {at: 0.35, move: carrier, by: [0, 0, -5], for: 0.2}
  - {at: 0.6, sew_rim: {patch: felt}, spacing: 2, name: rim}
  - {at: 0.7, let_go: carrier}
  - at: 0.8
    cut: {rectangle: {center: [6, 4, 3], along: [0, 16, 0], depth: [0, 0, 16]}}
  - {at: 0.9, unsuture: wound}
"""
EDITS = 6


def _stage(model: str) -> Stage:
    mesh, _, _ = two_blocks()
    tool = ToolSpec("carrier", size=(0.002,), pose=(0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 1.0)).checked()
    return Stage(mesh, Scene(model=model, tools=(tool,)), steps=3)


@pytest.mark.parametrize("model", ["lr", "vertex_block_descent", "finite_element"])
def test_what_a_procedure_asks_for_is_done_and_undone(model: str) -> None:
    stage = _stage(model)
    mesh = stage.simulation.mesh
    first, untouched = remembered(mesh), two_blocks()[0]
    kinds = []

    def look(frame: object) -> None:
        for edit in frame.edits:  # type: ignore[attr-defined]
            kinds.append(edit.change.edit.kind)
            assert look_at(mesh).faults == ()

    stage.play(Player(parse_procedure(TEXT), stage), look)
    assert kinds == ["suture", "tighten", "patch", "suture", "split", "unsuture"]
    assert len(mesh.patches) == 1
    assert len(mesh.sutures) > 3
    assert np.isfinite(stage.shape[mesh.node_alive[: mesh.node_rows]]).all()
    assert replay(stage.entries, untouched).mismatches == ()
    undos = "".join(f"  - {{at: {k / 60}, undo: true}}\n" for k in range(1, EDITS + 1))
    stage.play(Player(parse_procedure(TEXT.split("  - at: 0.1")[0] + undos), stage))
    assert remembered(mesh) == first


def test_what_cannot_be_done_ends_the_rehearsal_with_the_line() -> None:
    stage = _stage("lr")
    far = TEXT.replace("center: [6, 4, 3]", "center: [6, 4, 66]")
    with pytest.raises(StageError, match=r"procedure:16: cut failed: .*crosses"):
        stage.play(Player(parse_procedure(far), stage))
