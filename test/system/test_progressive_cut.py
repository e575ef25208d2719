"""A script moves a pressed blade through tissue: simulation, cutting service and script at once."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tissue_interfaces.srv import Undo

from support.processes import Processes, processes
from support.simulation_process import Client, client, eventually
from support.valid_mesh import check_valid
from tissue_sim import conversions, edit_messages, journal_messages
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.journal import epochs_of, replay
from tissue_sim.undo_client import ask, stroke_of

SIZE = 0.06
PROCEDURE = """
title: a progressive cut
units: mm
tools:
  knife:
    kind: cut
    shape: rectangle
    size: [20, 90]
    cutting: progressive
    response: {toughness: 164.0}
    start: {position: [31, -20, 30], orientation: {axis: [0, 0, 1], angle_deg: 90}}
timeline:
  - {at: 0.4, press: knife}
  - {at: 0.8, move: knife, to: [31, 80, 30], for: 2.0}
  - {at: 3.2, release: knife}
end: 3.4
"""


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[Processes]:
    assert ros_domain
    with processes(tmp_path) as made:
        yield made


def start(world: Processes, repository: Path, folder: Path) -> None:
    world.start(
        "simulation", "tissue_sim.simulation_node", "--ros-args",
        "--params-file", str(repository / "config" / "block.yaml"),
        *(word for axis in "xyz" for word in ("-p", f"shape.nodes_{axis}:=7")),
        "-p", "steps_per_frame:=2", "-p", "wait_for:=['tissue/journal:2','tissue/edits:2']",
        "-p", "wait_timeout:=200.0",
    )  # fmt: skip
    world.start("cut", "cut_service.cut_node")
    (folder / "procedure.yaml").write_text(PROCEDURE)
    world.start(
        "script", "tool_input.script_node", "--ros-args", "-p", "procedure:=procedure.yaml",
        "-p", "clock:=simulation", "-p", "report:=report.json",
    )  # fmt: skip


def strokes_of(heard: Client) -> list[str]:
    return [stroke_of(edit.request_id) for edit in heard.heard["tissue/edits"]]


def test_a_script_cuts_as_it_moves_and_all_of_it_is_undone_and_replayed(
    world: Processes, repository: Path, tmp_path: Path
) -> None:
    with client() as heard:
        heard.hear("tissue/topology", "tissue/edits", "tissue/journal", "tissue/cut_request",
                   "tools/knife/measured_cf")  # fmt: skip
        start(world, repository, tmp_path)
        report = tmp_path / "report.json"
        eventually(lambda: report.exists() or not world.runs("simulation"), 300.0)
        assert json.loads(report.read_text())["exit_code"] == 0
        said = eventually(lambda: re.findall(r"stroke by knife: .*", world.log("cut")))[0]
        strips = [m for m in heard.heard["tissue/cut_request"] if m.stroke]
        assert len({m.stroke for m in strips}) == 1
        assert [m.strip for m in strips] == list(range(len(strips)))
        assert strips[-1].ends
        assert f"{len(strips)} strips in" in said
        assert "failed" not in said
        assert "lost" not in said

        edits = len(heard.heard["tissue/edits"])
        assert edits >= 3
        assert set(strokes_of(heard)) == {strips[0].stroke}
        forces = [m.wrench.force.y for m in heard.heard["tools/knife/measured_cf"]]
        assert min(forces) < -1.0
        mesh = eventually(lambda: keyframe(heard))
        follow(mesh, heard)
        assert check_valid(mesh).components == 2

        answers = list(ask("undo", "", 1, 30.0, strokes=True))
        assert len(answers) == edits
        eventually(lambda: len(heard.heard["tissue/edits"]) == 2 * edits)
        follow(mesh, heard)
        assert check_valid(mesh).components == 1
        nothing = heard.call(Undo, "tissue/undo", request_id="more")
        assert nothing.error_code == Undo.Response.NOTHING_THERE

        entries = [journal_messages.entry_from_msg(m) for m in list(heard.heard["tissue/journal"])]
        (epoch,) = epochs_of(entries).values()
        again = replay(epoch, keyframe(heard))
        assert again.mismatches == ()
        assert again.simulation.mesh.version == 1 + 2 * edits


def keyframe(heard: Client) -> Mesh:
    """The mesh before anything was cut."""
    first = heard.first("tissue/topology", lambda m: m.version == 1)
    return copy.deepcopy(conversions.topology_to_mesh(first))


def follow(mesh: Mesh, heard: Client) -> None:
    for message in list(heard.heard["tissue/edits"]):
        if message.version > mesh.version:
            mesh.apply(edit_messages.edit_from_msg(message))
    assert np.isfinite(mesh.rest[: mesh.node_rows]).all()
