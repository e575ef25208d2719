"""Patches by script, by tool and by service, in a simulation that runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tissue_interfaces.srv import AddPatch

from support.processes import play_on_block, processes
from support.simulation_process import Client, client
from tissue_sim import conversions, journal_messages
from tissue_sim.journal import epochs_of, replay

CODES = AddPatch.Response
PROCEDURE = """
title: patches
units: mm
tools:
  forceps: {kind: grab, shape: sphere, size: [5], start: {position: [30, 30, 80]}}
  layer: {kind: patch, shape: rectangle, size: [20, 10], start: {position: [30, 30, 110]}}
timeline:
  - at: 0.3
    patch:
      ellipse: [12, 8]
      at: [30, 30, 70]
      normal: [0, 0, 1]
      edge: 4
      carried_by: forceps
      name: pericardium
  - {at: 2.5, move: forceps, by: [0, 0, 20], for: 1}
  - {at: 3.8, let_go: forceps}
  - {at: 4.0, press: layer}
  - {at: 6.0, move: layer, by: [10, 0, 0], for: 0.5}
  - {at: 6.8, release: layer}
  - {at: 7.2, undo: true}
end: 7.6
"""


def test_a_script_and_a_tool_lay_patches_and_the_session_replays(
    ros_domain: int, repository: Path, tmp_path: Path
) -> None:
    assert ros_domain
    with processes(tmp_path) as world, client() as heard:
        heard.hear("tissue/topology", "tissue/edits", "tissue/journal")
        played = play_on_block(world, PROCEDURE, nodes=5)
        _refuse(heard)
        edits = list(heard.heard["tissue/edits"])
        entries = [journal_messages.entry_from_msg(m) for m in list(heard.heard["tissue/journal"])]
        (epoch,) = epochs_of(entries).values()
        first = heard.first("tissue/topology", lambda m: m.version == 1)
        again = replay(epoch, conversions.topology_to_mesh(first))
    added = next(r for r in played["requests"] if r["action"] == "patch")
    assert (added["patch_id"], added["patch_name"]) == (1, "pericardium")
    assert added["hold_id"] > 0
    assert "carried by forceps" in added["message"]
    np.testing.assert_allclose(added["area"], np.pi * 0.012 * 0.008, rtol=0.025)
    assert [edit.kind for edit in edits] == ["patch", "patch", "undo", "patch"]
    assert [edit.held_by for edit in edits] == ["forceps", "layer", "", ""]
    assert again.mismatches == ()
    mesh = again.simulation.mesh
    assert [patch.name for patch in mesh.patches] == ["pericardium", "by service"]
    own = mesh.regions[: mesh.element_rows] == next(iter(mesh.patches)).label
    heights = again.positions[np.unique(mesh.tets[: mesh.element_rows][own]), 2]
    # It was carried up by 20 mm and stays where it was let go of.
    np.testing.assert_allclose(heights.mean(), 0.09, atol=1e-4)


def _refuse(heard: Client) -> None:
    square = [0.0, 0.0, 0.02, 0.0, 0.02, 0.02, 0.0, 0.02]

    def ask(**fields: Any) -> AddPatch.Response:
        fields.setdefault("outline", square)
        return heard.call(AddPatch, "tissue/add_patch", **fields)

    made = ask(name="by service", edge_length=0.01, request_id="once")
    assert made.success, made.message
    assert made.nodes == 18
    assert len(made.rim_nodes) == 16
    again = ask(name="by service", edge_length=0.01, request_id="once")
    assert (again.patch_id, again.version) == (made.patch_id, made.version)
    bad_pose = AddPatch.Request().pose
    bad_pose.orientation.w = 3.0
    bow = [0.0, 0.0, 0.02, 0.02, 0.02, 0.0, 0.0, 0.02]
    bent = [0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.02, 0.02, 0.0, 0.0, 0.02, 0.01]
    refused: dict[str, tuple[int, dict[str, Any]]] = {
        "camera": (CODES.UNKNOWN_FRAME, {}),
        "bow": (CODES.CROSSES, {"outline": bow}),
        "bent": (CODES.NOT_FLAT, {"outline": [], "corners": bent}),
        "nothing": (CODES.INVALID, {"outline": []}),
        "both": (CODES.INVALID, {"corners": bent}),
        "odd": (CODES.INVALID, {"outline": square[:7]}),
        "nan": (CODES.INVALID, {"outline": [float("nan"), *square[1:]]}),
        "pose": (CODES.INVALID, {"pose": bad_pose}),
        "fine": (CODES.TOO_LARGE, {"edge_length": 1e-4}),
        "name": (CODES.INVALID, {"name": "pericardium"}),
        "tool": (CODES.UNKNOWN_TOOL, {"tool": "tweezers"}),
        "frame": (CODES.STATE_FRAME_GONE, {"state_frame": 10**9}),
    }
    for what, (code, fields) in refused.items():
        request: dict[str, Any] = dict(fields)
        if what == "camera":
            request["header"] = AddPatch.Request().header
            request["header"].frame_id = "camera"
        answer = ask(**request)
        assert not answer.success
        assert answer.error_code == code, (what, answer.message)
        assert answer.message
    assert len(heard.heard["tissue/edits"]) == 4
