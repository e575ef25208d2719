"""The service tissue/suture, with a simulation that does not move and with one that does."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.client import Client
from tissue_interfaces.srv import ApplyEdit, Suture

from support.fake_simulation import FRAME, FakeSimulation, spinning, wait_for
from support.processes import play_on_block, processes
from support.sewn_blocks import SIZE, two_blocks
from support.simulation_process import client
from tissue_sim import conversions, journal_messages
from tissue_sim.journal import epochs_of, replay

SEW, TIGHTEN, REMOVE, LIST = (
    Suture.Request.SEW, Suture.Request.TIGHTEN, Suture.Request.REMOVE, Suture.Request.LIST
)  # fmt: skip
CODES = Suture.Response
GAP = 0.001
EDGES = [
    [SIZE, 0.0, 0.006], [SIZE, 0.009, 0.006], [SIZE + GAP, 0.0, 0.006], [SIZE + GAP, 0.009, 0.006],
]  # fmt: skip


class Surgeon:
    """Asks the service and waits for its answer."""

    def __init__(self, simulation: FakeSimulation) -> None:
        self.client: Client = simulation.create_client(Suture, "tissue/suture")

    def ask(self, action: int = SEW, **fields: Any) -> Suture.Response:
        request = Suture.Request(action=action)
        request.header.frame_id = fields.pop("frame", FRAME)
        points = np.ravel(fields.pop("positions", EDGES)).tolist() if action == SEW else []
        request.positions = [float(value) for value in points]
        for name, value in fields.items():
            setattr(request, name, value)
        future = self.client.call_async(request)
        wait_for(future.done, 30.0, "an answer")
        return future.result()


def test_threads_are_made_tightened_listed_and_taken_out(ros_domain: int, tmp_path: Path) -> None:
    mesh, _, _ = two_blocks(GAP)
    with (
        (tmp_path / "node.log").open("wb") as log,
        spinning(ros_domain, lambda context: FakeSimulation(mesh, context)) as simulation,
    ):
        surgeon = Surgeon(simulation)
        process = subprocess.Popen(
            [sys.executable, "-m", "cut_service.cut_node"], stdout=log, stderr=subprocess.STDOUT
        )
        try:
            wait_for(surgeon.client.service_is_ready, 120.0, "tissue/suture")
            _sew(simulation, surgeon)
            _refuse(simulation, surgeon)
            _replan(simulation, surgeon)
        finally:
            process.kill()
            process.wait()


def _sew(simulation: FakeSimulation, surgeon: Surgeon) -> None:
    made = surgeon.ask(
        spacing=0.003, running=True, length=0.0002, author="surgeon", request_id="first"
    )
    assert made.success, made.message
    assert list(made.made) == list(range(1, 8))
    assert made.made_group == 1
    np.testing.assert_allclose(made.lengths[::2], 0.0002)
    # A thread of 0.2 mm across a gap of 1 mm, 1000 N/m.
    np.testing.assert_allclose(made.forces[::2], 0.8, rtol=1e-4)
    edit = simulation.applied[-1]
    assert (edit.kind, edit.author, edit.request_id) == ("suture", "surgeon", "first")
    again = surgeon.ask(spacing=0.003, running=True, length=0.0002, request_id="first")
    assert list(again.made) == list(made.made)
    assert len(simulation.applied) == 1
    single = surgeon.ask(positions=EDGES[::2], length=-1.0)
    assert (list(single.made), single.made_group) == ([8], 0)
    tight = surgeon.ask(TIGHTEN, group=1, length=0.0)
    assert tight.success, tight.message
    np.testing.assert_allclose(tight.forces[::2], 1.0, rtol=1e-4)
    listed = surgeon.ask(LIST)
    assert list(listed.made) == list(range(1, 9))
    np.testing.assert_allclose(listed.forces[:7:2], 1.0, rtol=1e-4)
    assert listed.forces[7] < 1e-3
    assert surgeon.ask(REMOVE, sutures=[2, 8]).success
    assert simulation.mesh.sutures.ids.tolist() == [1, 3, 4, 5, 6, 7]


def _refuse(simulation: FakeSimulation, surgeon: Surgeon) -> None:
    before = simulation.mesh.version
    for code, answer in (
        (CODES.INVALID, surgeon.ask(positions=EDGES[:1])),
        (CODES.INVALID, surgeon.ask(positions=[[np.nan] * 3] * 2)),
        (CODES.INVALID, surgeon.ask(7)),
        (CODES.UNKNOWN_FRAME, surgeon.ask(frame="camera")),
        (CODES.NOTHING_THERE, surgeon.ask(positions=[[1.0, 1.0, 1.0]] * 2)),
        (CODES.UNKNOWN_SUTURE, surgeon.ask(TIGHTEN, sutures=[2])),
        (CODES.INVALID, surgeon.ask(TIGHTEN, group=1, length=99.0)),
        (CODES.STATE_FRAME_GONE, surgeon.ask(state_frame=10**9)),
    ):
        assert not answer.success
        assert answer.error_code == code, answer.message
        assert answer.message
    simulation.refuse_with = ApplyEdit.Response.INVALID
    assert surgeon.ask(length=0.0).error_code == CODES.REFUSED
    simulation.refuse_with = 0
    assert simulation.mesh.version == before


def _replan(simulation: FakeSimulation, surgeon: Surgeon) -> None:
    """An edit at its nodes comes while a request is planned: it is planned again."""

    def meanwhile() -> None:
        simulation.before_apply = lambda: None
        mesh = simulation.mesh
        node = int(np.linalg.norm(mesh.rest[: mesh.node_rows] - EDGES[0], axis=1).argmin())
        one = mesh.incident.of(node)[:1].astype(np.uint32)
        edit = type(simulation.applied[-1])(mesh.version, removed_elements=one)
        simulation.apply(edit)

    simulation.before_apply = meanwhile
    answer = surgeon.ask(positions=EDGES[::2], length=0.0, request_id="late")
    assert answer.success, answer.message
    assert simulation.applied[-1].request_id == "late~2"


PROCEDURE = """
title: cut and sewn
units: mm
tools: {}
timeline:
  - {at: 0.3, cut: {rectangle: {center: [31, 30, 45], along: [0, 90, 0], depth: [0, 0, 40]}}}
  - at: 2.5
    suture: {from: [[31, 10, 60], [31, 50, 60]], to: [[31, 10, 60], [31, 50, 60]]}
    spacing: 10
    running: true
    reach: 6
    length: 0
    name: wound
  - {at: 4.0, tighten: wound, share: 0.5}
  - {at: 5.0, undo: true}
  - {at: 6.0, unsuture: wound}
  - {at: 7.0, undo: true}
end: 7.5
"""


def test_a_script_cuts_and_sews_and_the_session_replays(
    ros_domain: int, repository: Path, tmp_path: Path
) -> None:
    assert ros_domain
    with processes(tmp_path) as world, client() as heard:
        heard.hear("tissue/topology", "tissue/edits", "tissue/journal")
        played = play_on_block(world, PROCEDURE, nodes=7)
        sewn, tight = (r for r in played["requests"] if r["action"] in ("suture", "tighten"))
        assert len(sewn["sutures"]) == 9
        assert tight["sutures"] == sewn["sutures"]
        kinds = [message.kind for message in heard.heard["tissue/edits"]]
        assert kinds == ["split", "suture", "tighten", "undo", "unsuture", "undo"]
        entries = [journal_messages.entry_from_msg(m) for m in list(heard.heard["tissue/journal"])]
        (epoch,) = epochs_of(entries).values()
        first = heard.first("tissue/topology", lambda m: m.version == 1)
        again = replay(epoch, conversions.topology_to_mesh(first))
    assert again.mismatches == ()
    table = again.simulation.mesh.sutures
    assert table.ids.tolist() == sewn["sutures"]
    np.testing.assert_allclose(table.lengths, sewn["lengths"])
