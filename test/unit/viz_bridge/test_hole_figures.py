"""Holes in a session's figures: from the messages of a bag, and measured on what a replay gives."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from tissue_interfaces.msg import Holes, TissueState

from support.bags import EPOCH, session_bag
from support.holed_wall import HOLE, TOP, add_patch, edge, holed_wall
from tissue_sim import conversions
from tissue_sim.geometry.holes import Hole, name_hole
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.hole_messages import hole_from_msg, hole_to_msg
from tissue_sim.hole_report import measured
from tissue_sim.session_bag import read_epochs
from viz_bridge.hole_figures import HoleFigures, take_holes
from viz_bridge.recording import Recording, file_stream
from viz_bridge.summary import summarise


def scene() -> tuple[Mesh, Hole, Holes, Holes]:
    """A wall with a named hole, and what is said of it before and after a patch is laid over it."""
    mesh = holed_wall()
    hole = name_hole(mesh, mesh.rest[: mesh.node_rows], "window", edge(TOP))
    said = []
    for patched in (False, True):
        if patched:
            add_patch(mesh)
        closure = hole.closure(mesh, mesh.rest[: mesh.node_rows])
        message = Holes(version=mesh.version, holes=[hole_to_msg(hole, closure, 0, "")])
        message.epoch = conversions.epoch_field(EPOCH)
        said.append(message)
    return mesh, hole, said[0], said[1]


def test_a_hole_is_the_same_after_it_was_a_message() -> None:
    _, hole, message, _ = scene()
    again = hole_from_msg(message.holes[0])
    np.testing.assert_array_equal(again.nodes, hole.nodes)
    np.testing.assert_array_equal(again.weights, hole.weights)
    assert replace(again, nodes=hole.nodes, weights=hole.weights) == hole


def test_the_summary_tells_how_holes_were_named_and_how_they_are_now(tmp_path: Path) -> None:
    _, hole, before, after = scene()
    bag = session_bag(tmp_path / "session", frames=4, cut_at=2, holes=[before, after])
    told = summarise(bag)["holes"]
    json.dumps(told)
    (one,) = told
    assert (one["name"], one["first_covered"], one["problem"]) == ("window", 0.0, "")
    assert one["area_mm2"] == one["first_area_mm2"] == pytest.approx(1e6 * HOLE**2, rel=3e-3)
    assert (one["covered"], one["gap_mm"], one["patches"]) == (1.0, 0.0, [1])
    assert one["edge_gap_mm"] == pytest.approx(0.5)
    (epoch,) = read_epochs(bag)
    np.testing.assert_array_equal(epoch.holes["window"].nodes, hole.nodes)


def test_what_cannot_be_measured_keeps_the_last_figures() -> None:
    _, hole, before, after = scene()
    figures: dict[str, HoleFigures] = {}
    take_holes(figures, before, 1.0)
    assert figures["window"].document()["edge_gap_mm"] is None
    take_holes(figures, after, 2.0)
    take_holes(figures, Holes(holes=[hole_to_msg(hole, None, 8, "burnt")]), 3.0)
    told = figures["window"].document()
    assert (told["problem"], told["covered"], told["sim_time"]) == ("burnt", 1.0, 1.0)
    # Named anew, it begins anew.
    again = replace(hole, first_area=2.0 * hole.first_area)
    take_holes(figures, Holes(holes=[hole_to_msg(again, None, 8, "burnt")]), 4.0)
    told = figures["window"].document()
    assert told["sim_time"] == 4.0
    assert "covered" not in told


def test_holes_are_measured_at_the_end() -> None:
    mesh, hole, _, _ = scene()
    report = measured(hole, mesh, mesh.rest[: mesh.node_rows].astype(np.float32))
    told = report.document()
    json.dumps(told)
    assert told["covered"] == pytest.approx(1.0)
    assert "100.0 % of 100 mm^2" in str(report)
    nobody = replace(hole, nodes=np.full_like(hole.nodes, 10**6))
    lost = measured(nobody, mesh, mesh.rest[: mesh.node_rows])
    assert lost.closure is None
    assert str(lost) == lost.document()["problem"]


def test_holes_are_drawn_on_the_organ_as_it_is(tmp_path: Path) -> None:
    mesh, hole, _, after = scene()
    recording = Recording(file_stream(str(tmp_path / "holes.rrd")))
    drawn: dict[str, object] = {}
    recording.stream.log = lambda path, what, **_: drawn.update({path: what})
    take_state(recording, mesh)
    recording.take("tissue/holes", after, 1)
    assert {
        "organ/holes/window",
        "plots/closure/window/covered",
        "plots/closure/window/gap",
    } <= set(drawn)
    gone = Holes(holes=[hole_to_msg(replace(hole, nodes=hole.nodes + 10**6), None, 8, "burnt")])
    recording.take("tissue/holes", gone, 2)
    assert isinstance(drawn["organ/holes/window"], rr.Clear)


def take_state(recording: Recording, mesh: Mesh) -> None:
    """Let a recording have a keyframe and a state of a mesh at rest."""
    stamp = conversions.stamp_of(1)
    recording.take("tissue/topology", conversions.mesh_to_topology(mesh, EPOCH, "organ", stamp), 1)
    state = TissueState(version=mesh.version, frame=1)
    state.epoch = conversions.epoch_field(EPOCH)
    conversions.fill_state(state, mesh.rest[: mesh.node_rows].astype(np.float32))
    recording.take("tissue/state", state, 1)
