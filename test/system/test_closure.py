"""The service tissue/closure, sewing a rim, and what is published, with a simulation at rest."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from tissue_interfaces.msg import Holes
from tissue_interfaces.srv import Closure, Suture

from cut_service.hole_book import ClosureCode
from support.fake_simulation import FRAME, FakeSimulation, spinning, wait_for
from support.holed_wall import HOLE, add_patch, edge, holed_wall
from tissue_sim import edit_messages, qos
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.hole_messages import hole_from_msg

CODES, SEWING = Closure.Response, Suture.Response


class Observer:
    """Asks the services, and hears what is said about holes."""

    def __init__(self, simulation: FakeSimulation) -> None:
        self.closure_client: Client = simulation.create_client(Closure, "tissue/closure")
        self.suture_client: Client = simulation.create_client(Suture, "tissue/suture")
        self.heard: list[Holes] = []
        self.diagnostics: dict[str, str] = {}
        simulation.create_subscription(Holes, "tissue/holes", self.heard.append, qos.LATCHED)
        simulation.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.DIAGNOSTICS
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith("closure"):
                self.diagnostics = {item.key: item.value for item in status.values}

    def ask(self, name: str = "", loop: Any = (), **fields: Any) -> Closure.Response:
        request = Closure.Request(name=name, **fields)
        request.header.frame_id = FRAME if not request.header.frame_id else ""
        return self._answer(self.closure_client, request, loop)

    def sew_rim(self, loop: Any = (), **fields: Any) -> Suture.Response:
        request = Suture.Request(action=Suture.Request.SEW_RIM, **fields)
        return self._answer(self.suture_client, request, loop)

    @staticmethod
    def _answer(client: Client, request: Any, loop: Any) -> Any:
        request.positions = [float(value) for value in np.ravel(loop)]
        future = client.call_async(request)
        wait_for(future.done, 30.0, "an answer")
        return future.result()


def test_the_codes_are_those_of_the_service() -> None:
    for code in ClosureCode:
        assert getattr(CODES, code.name) == code


def test_holes_are_named_measured_sewn_and_published(ros_domain: int, tmp_path: Path) -> None:
    with (
        (tmp_path / "node.log").open("wb") as log,
        spinning(ros_domain, lambda context: FakeSimulation(holed_wall(), context)) as simulation,
    ):
        observer = Observer(simulation)
        process = subprocess.Popen(
            [sys.executable, "-m", "cut_service.cut_node"], stdout=log, stderr=subprocess.STDOUT
        )
        try:
            wait_for(observer.closure_client.service_is_ready, 120.0, "tissue/closure")
            _name(observer)
            _refuse(observer)
            _cover(simulation, observer)
            _sew(simulation, observer)
            _lose(simulation, observer)
            _restart(simulation, observer)
        finally:
            process.kill()
            process.wait()


def _name(observer: Observer) -> None:
    nobody = observer.ask()
    assert nobody.success, nobody.message
    assert list(nobody.holes) == []
    named = observer.ask("window", edge())
    assert named.success, named.message
    (hole,) = named.holes
    assert hole.first_area == hole.area == pytest.approx(HOLE**2, rel=3e-3)
    assert (hole.covered, hole.edge_gap, hole.problem, hole.lost) == (0.0, -1.0, "", 0)
    assert hole.gap == pytest.approx(HOLE, abs=hole.sampling)
    np.testing.assert_allclose(hole_from_msg(hole).weights.sum(axis=1), 1.0)
    wait_for(lambda: bool(observer.heard), 10.0, "tissue/holes")
    assert [one.name for one in observer.heard[-1].holes] == ["window"]


def _refuse(observer: Observer) -> None:
    for code, answer in (
        (CODES.UNKNOWN_HOLE, observer.ask("door")),
        (CODES.INVALID, observer.ask("", edge())),
        (CODES.INVALID, observer.ask("window", edge()[:2])),
        (CODES.INVALID, observer.ask("window", edge()[[0, 4, 2, 6]])),
        (CODES.INVALID, observer.ask("window", np.full((4, 3), np.nan))),
        (CODES.INVALID, observer.ask("window", [1.0, 2.0])),
        (CODES.INVALID, observer.ask("window", edge(), reach=-1.0)),
        (CODES.INVALID, observer.ask("window", edge(), depth=np.inf)),
        (CODES.NOTHING_THERE, observer.ask("window", edge() + 1.0)),
        (CODES.STATE_FRAME_GONE, observer.ask("window", state_frame=10**9)),
    ):
        assert not answer.success
        assert answer.error_code == code, answer.message
        assert answer.message
        assert list(answer.holes) == []
    request = Closure.Request(name="door")
    request.header.frame_id = "camera"
    answer = Observer._answer(observer.closure_client, request, edge())
    assert answer.error_code == CODES.UNKNOWN_FRAME, answer.message
    assert [hole.name for hole in observer.ask().holes] == ["window"]


def _cover(simulation: FakeSimulation, observer: Observer) -> None:
    assert observer.sew_rim(spacing=0.002).error_code == SEWING.UNKNOWN_PATCH
    version = simulation.mesh.version
    add_patch(simulation.mesh)
    applied = simulation.mesh.changes[-1].edit
    stamp = simulation.get_clock().now().to_msg()
    message = edit_messages.edit_to_msg(applied, simulation.epoch, FRAME, stamp)
    simulation._edits.publish(message)
    wait_for(lambda: observer.ask("window").version > version, 20.0, "the patch")
    (hole,) = observer.ask("window").holes
    assert hole.covered == hole.by_patches == pytest.approx(1.0)
    assert (hole.gap, list(hole.patches)) == (0.0, [1])
    assert hole.edge_gap == pytest.approx(0.0005, rel=1e-3)
    wait_for(lambda: observer.heard[-1].holes[0].covered > 0.99, 10.0, "what is published")
    wait_for(
        lambda: observer.diagnostics.get("window: covered [%]") == "100.0", 10.0, "diagnostics"
    )


def _sew(simulation: FakeSimulation, observer: Observer) -> None:
    for code, answer in (
        (SEWING.UNKNOWN_HOLE, observer.sew_rim(hole="door", spacing=0.002)),
        (SEWING.UNKNOWN_PATCH, observer.sew_rim(patch=7, spacing=0.002)),
        (SEWING.INVALID, observer.sew_rim(edge(), hole="window", spacing=0.002)),
        (SEWING.INVALID, observer.sew_rim(hole="window")),
        (SEWING.INVALID, observer.sew_rim(hole="window", spacing=float("nan"))),
        (SEWING.INVALID, observer.sew_rim(edge()[:2], spacing=0.002)),
        (SEWING.NOTHING_THERE, observer.sew_rim(spacing=0.002, reach=0.0001)),
    ):
        assert not answer.success
        assert answer.error_code == code, answer.message
    assert len(simulation.applied) == 0
    made = observer.sew_rim(hole="window", patch_name="patch 1", spacing=0.0025, length=0.0002)
    assert made.success, made.message
    assert len(made.made) == len(simulation.mesh.sutures) == 16
    assert simulation.applied[-1].kind == "suture"
    around = observer.sew_rim(edge(), spacing=0.0025, running=True, length=-1.0)
    assert around.success, around.message
    assert (len(around.made), around.made_group) == (32, 17)


def _lose(simulation: FakeSimulation, observer: Observer) -> None:
    """Everything but the patch is burnt away."""
    mesh = simulation.mesh
    rows = np.flatnonzero(mesh.element_alive[: mesh.element_rows])
    tissue = rows[mesh.regions[rows] != mesh.patches.items[0].label]
    simulation.apply(TopologyEdit(mesh.version, removed_elements=tissue.astype(np.uint32)))
    wait_for(lambda: not observer.ask("window").success, 20.0, "the loss")
    lost = observer.ask("window")
    assert lost.error_code == CODES.HOLE_LOST
    assert lost.holes[0].lost == 8
    listed = observer.ask()
    assert listed.success
    assert listed.holes[0].problem == lost.message
    assert observer.sew_rim(hole="window", spacing=0.002).error_code == SEWING.UNKNOWN_HOLE


def _restart(simulation: FakeSimulation, observer: Observer) -> None:
    """Another epoch has other nodes: its holes must be named anew."""
    simulation.restart(holed_wall())
    wait_for(lambda: not list(observer.ask().holes), 20.0, "the restart")
    assert observer.ask("window").error_code in (CODES.UNKNOWN_HOLE, CODES.NO_TISSUE)
