"""The cutting node as a process of its own, with a simulation in the test's process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from rclpy.context import Context
from tissue_interfaces.msg import CutRequest
from tissue_interfaces.srv import ApplyEdit, Cut

from cut_service.sweep import Sweep
from support.cut_sheets import plane_x
from support.fake_simulation import FRAME, FakeSimulation, spinning, wait_for
from support.sheets import connected
from tissue_sim import conversions, qos
from tissue_sim.geometry.components import connected_components, parts_of
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block

SIZE = 0.1


def organ() -> Mesh:
    return Mesh(block(9, 9, 9, SIZE, SIZE, SIZE))


def slab(x: float, depth: float = 2.0) -> Sweep:
    """A plane x = const, from the top down to `depth` times the block's height."""
    mesh = organ()
    lower = mesh.rest[: mesh.node_rows].min(axis=0)
    at = lower[0] + x * SIZE
    y = lower[1] + SIZE * np.array([-1.0, 2.0])
    top = lower[2] + 1.5 * SIZE
    bottom = lower[2] + (1.0 - depth) * SIZE
    return Sweep.between(
        np.array([[at, y[0], top], [at, y[1], top]]),
        np.array([[at, y[0], bottom], [at, y[1], bottom]]),
    )


class World:
    """The simulation, a client of the service, and the process under test."""

    def __init__(self, simulation: FakeSimulation, log: Path) -> None:
        self.simulation = simulation
        self.client: Client = simulation.create_client(Cut, "tissue/cut")
        self.requests = simulation.create_publisher(
            CutRequest, "tissue/cut_request", qos.CUT_REQUEST
        )
        self.diagnostics: list[dict[str, str]] = []
        simulation.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.DIAGNOSTICS
        )
        self._log = log
        self._starts = 0
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, *arguments: str) -> None:
        self._starts += 1
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "cut_service.cut_node", *arguments],
                stdout=log, stderr=subprocess.STDOUT,
            )  # fmt: skip
        # The service of a killed process still looks ready for a while.
        wait_for(lambda: self.log.count(": ready (") == self._starts, 120.0, "the node")
        wait_for(self.client.service_is_ready, 120.0, "tissue/cut")

    def stop(self, how: signal.Signals) -> int:
        assert self._process is not None
        self._process.send_signal(how)
        code = self._process.wait(timeout=20.0)
        self._process = None
        return code

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    @property
    def log(self) -> str:
        return self._log.read_text()

    def reports(self, key: str, value: str) -> bool:
        return bool(self.diagnostics) and self.diagnostics[-1].get(key) == value

    def cut(self, sweep: Sweep | None = None, **fields: Any) -> Cut.Response:
        future = self.client.call_async(self.request(sweep or slab(0.5), **fields))
        wait_for(future.done, 30.0, "an answer")
        return future.result()

    def insist(self, sweep: Sweep, request_id: str) -> Cut.Response:
        """Ask until there is an answer: a request can be lost with a service that was killed."""
        request = self.request(sweep, request_id=request_id)
        futures = []
        for _ in range(30):
            futures.append(self.client.call_async(request))
            with suppress(TimeoutError):
                wait_for(lambda: any(f.done() for f in futures), 1.0)
                return next(f for f in futures if f.done()).result()
        raise TimeoutError("no answer")

    def request(
        self,
        sweep: Sweep,
        *,
        frame: str = FRAME,
        state: int = 0,
        method: str = "",
        request_id: str = "",
    ) -> Cut.Request:
        stamp = self.simulation.get_clock().now().to_msg()
        message = conversions.sweep_message(sweep.vertices, sweep.triangles, state, frame, stamp)
        return Cut.Request(sweep=message, method=method, request_id=request_id)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {value.key: value.value for value in status.values}
            self.diagnostics.append({"message": status.message, **values})


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[World]:
    with new_world(ros_domain, tmp_path) as made:
        yield made


@contextmanager
def new_world(domain: int, folder: Path, make: Callable[[], Mesh] = organ) -> Iterator[World]:
    def factory(context: Context) -> FakeSimulation:
        return FakeSimulation(make(), context)

    with spinning(domain, factory) as simulation:
        made = World(simulation, folder / "cut_node.log")
        try:
            yield made
        finally:
            made.close()
            print(made.log)


def parts(mesh: Mesh) -> int:
    rows = mesh.element_rows
    return connected_components(mesh.tets[:rows], mesh.element_alive[:rows], mesh.node_rows)[0]


def test_answers_every_request_once_and_says_what_is_wrong(world: World) -> None:
    world.start("--ros-args", "-p", "frames.table.parent:=organ",
                "-p", f"frames.table.translation:=[{-0.25 * SIZE}, 0.0, 0.0]")  # fmt: skip
    simulation = world.simulation

    first = world.cut(request_id="one")
    assert first.success, first.message
    assert first.report.components == parts(simulation.mesh) == 2
    assert first.report.faces_split >= 64
    assert first.report.plan_ms > 0
    assert first.report.apply_ms == 1.0
    assert first.version == simulation.mesh.version == 2

    again = world.cut(slab(0.2), request_id="one")
    assert (again.success, again.version, len(simulation.applied)) == (True, 2, 1)

    beside = world.cut(slab(0.5), frame="table", request_id="two")
    assert beside.success, beside.message
    assert parts(simulation.mesh) == 3

    unknown = world.cut(frame="moon")
    assert unknown.error_code == Cut.Response.UNKNOWN_FRAME
    assert "organ, table" in unknown.message
    assert "frames.moon.parent" in unknown.message

    broken = Sweep(np.full((3, 3), np.nan), np.array([[0, 1, 2]], dtype=np.int32))
    assert world.cut(broken).error_code == Cut.Response.INVALID_SWEEP
    assert world.cut(slab(5.0)).error_code == Cut.Response.MISSED
    assert world.cut(method="melt").error_code == Cut.Response.UNKNOWN_METHOD
    assert len(simulation.applied) == 2

    simulation.refuse_with = ApplyEdit.Response.INVALID
    refused = world.cut(slab(0.8))
    assert (refused.error_code, refused.success) == (Cut.Response.REFUSED, False)
    assert "refused by the test" in refused.message
    simulation.refuse_with = 0

    gone = world.cut(slab(0.8), state=1)
    assert gone.error_code == Cut.Response.STATE_FRAME_GONE
    assert world.cut(slab(0.8), state=simulation.frame).success

    wait_for(lambda: world.reports("cuts applied", "3"), what="diagnostics")
    assert world.stop(signal.SIGINT) == 0


def test_plans_again_when_the_tissue_changed_and_gives_up_after_three(world: World) -> None:
    world.start()
    simulation = world.simulation
    wait_for(lambda: world.reports("version", "1"), what="the topology")

    def meddle() -> None:
        # Somebody else moves a node in the middle of every plan's read set.
        mesh = simulation.mesh
        middle = np.linalg.norm(
            mesh.rest[: mesh.node_rows] - mesh.rest[: mesh.node_rows].mean(axis=0), axis=1
        ).argmin()
        nodes = mesh.tets[mesh.incident.of(int(middle))[0]]
        simulation.apply(
            TopologyEdit(
                base_version=mesh.version,
                moved_nodes=mesh.node_ids[[middle]],
                moved_rest=mesh.rest[[middle]],
                moved_anchors=mesh.node_ids[nodes][None],
                moved_weights=(nodes == middle).astype(np.float64)[None],
            )
        )
        if len(simulation.applied) == meddled[0]:
            simulation.before_apply = lambda: None

    meddled = [1]
    simulation.before_apply = meddle
    once = world.cut()
    assert once.success, once.message
    assert simulation.applied[-1].request_id.endswith("~2")

    simulation.restart(organ())
    simulation.applied.clear()
    meddled[0] = 100
    simulation.before_apply = meddle
    epoch = simulation.epoch.hex()
    wait_for(lambda: world.reports("epoch", epoch), what="the new epoch")
    never = world.cut()
    assert never.error_code == Cut.Response.STALE
    assert len(simulation.applied) == 3
    assert parts(simulation.mesh) == 1


def test_cuts_when_a_tool_is_used_and_ignores_those_of_an_old_epoch(world: World) -> None:
    world.start("--ros-args", "-p", "tissue_timeout:=0.5")
    simulation = world.simulation
    wait_for(lambda: world.requests.get_subscription_count() == 1)
    wait_for(lambda: world.reports("version", "1"), what="the topology")
    message = CutRequest(request_id="tool-1", tool="scalpel", version=1)
    message.sweep = world.request(slab(0.5), state=simulation.frame).sweep
    message.epoch = conversions.epoch_field(simulation.epoch)
    world.requests.publish(message)
    wait_for(lambda: len(simulation.applied) == 1, what="the cut")
    assert simulation.applied[0].author == "scalpel"
    assert simulation.applied[0].request_id == "tool-1"

    message.request_id = "tool-2"
    message.epoch = np.zeros(16, dtype=np.uint8)
    world.requests.publish(message)
    wait_for(lambda: "dropped a cut by scalpel" in world.log, what="the refusal")
    assert len(simulation.applied) == 1


def test_dies_and_comes_back_and_follows_a_simulation_that_does(
    ros_domain: int, tmp_path: Path
) -> None:
    with new_world(ros_domain, tmp_path) as world:
        world.start()
        assert world.cut(slab(0.5)).success
        # Killed; the restarted one takes the old keyframe and the edit made since.
        assert world.stop(signal.SIGKILL) == -signal.SIGKILL
        world.start("--ros-args", "-p", "tissue_timeout:=25.0")
        late = world.insist(slab(0.25), "late")
        assert late.success, late.message
        assert late.version == 3
        assert late.report.components == 3

        # The simulation begins anew while a cut is planned: no plan of the old epoch is accepted.
        simulation = world.simulation
        restarts = [0]

        def restart() -> None:
            restarts[0] += 1
            simulation.before_apply = lambda: None
            simulation.restart(organ())

        simulation.before_apply = restart
        during = world.cut(slab(0.75))
        assert during.error_code == Cut.Response.SIMULATION_LOST
        assert "restarted" in during.message
        assert parts(simulation.mesh) == 1
        after = world.cut(slab(0.75))
        assert after.success, after.message
        assert (after.version, parts(simulation.mesh)) == (2, 2)


def test_says_so_when_no_simulation_is_there(ros_domain: int, tmp_path: Path) -> None:
    with new_world(ros_domain, tmp_path) as world:
        world.start("--ros-args", "-p", "tissue_timeout:=0.5", "-r", "__ns:=/elsewhere",
                    "-r", "/elsewhere/tissue/cut:=/tissue/cut")  # fmt: skip
        answer = world.cut()
        assert answer.error_code == Cut.Response.NO_TISSUE
        assert not world.simulation.applied


def test_a_misspelt_parameter_is_refused_at_start(ros_domain: int) -> None:
    run = subprocess.run(
        [sys.executable, "-m", "cut_service.cut_node", "--ros-args", "-p", "qualty_floor:=0.2"],
        capture_output=True, text=True, timeout=60.0, check=False, env=dict(os.environ),
    )  # fmt: skip
    assert run.returncode == 2
    assert "did you mean quality_floor" in run.stderr


def test_cuts_connected_surfaces_and_shows_the_wall_to_who_comes_late(
    ros_domain: int, tmp_path: Path
) -> None:
    with new_world(ros_domain, tmp_path, connected) as world:
        # The default of the service is for tetrahedra; tissue made of triangles is split anyway.
        world.start("--ros-args", "-p", "method:=subdivide")
        simulation = world.simulation
        cut = world.cut(plane_x(0.0013))
        assert cut.success, cut.message
        assert cut.report.components == parts_of(simulation.mesh) == 2
        # Its edges are 5 mm long, and snapping stops where it would change the tissue too much.
        assert cut.report.sweep_distance_max < 0.002
        sheet = simulation.mesh.sheet
        assert sheet is not None
        assert len(sheet.walls) > 0
        assert world.cut(plane_x(-0.006), method="remove").error_code == Cut.Response.REFUSED
        # The edit as it was published is what the service follows, and the next cut fits.
        second = world.cut(plane_x(-0.006))
        assert second.success, second.message
        assert second.report.components == parts_of(simulation.mesh) == 3
