"""Whatever cannot be done is refused with an error code and a reason, and changes no bit.

The table is in support/refused_requests.py; docs/cutting.md shows it.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from tissue_interfaces.msg import CutRequest, HeldNodes
from tissue_interfaces.srv import AddPatch, Cut, Suture

from cut_service.trial import remembered
from support.fake_simulation import FakeSimulation, spinning, wait_for
from support.refused_requests import (
    GAP,
    LIST,
    MIDDLE,
    REMOVE,
    SERVICES,
    TIGHTEN,
    WITH_PATCHES,
    cut,
    patch,
    square,
    suture,
    with_value,
)
from support.sewn_blocks import sew_edit, two_blocks
from tissue_sim import conversions, qos
from tissue_sim.geometry.edit import TopologyEdit


@dataclass
class World:
    """A simulation that does not move, and the cutting node as a process."""

    simulation: FakeSimulation
    log: Path
    clients: dict[str, Client] = field(default_factory=dict)

    def ask(self, service: str, request: Any) -> Any:
        return self.answers(service, [request])[0]

    def answers(self, service: str, requests: list[Any]) -> list[Any]:
        futures = [self.clients[service].call_async(request) for request in requests]
        wait_for(lambda: all(future.done() for future in futures), 60.0, "answers")
        return [future.result() for future in futures]


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[World]:
    mesh, left, right = two_blocks(GAP)
    mesh.apply(sew_edit(mesh, left[:1], right[:1], length=GAP))
    path = tmp_path / "node.log"
    with (
        path.open("wb") as log,
        spinning(ros_domain, lambda context: FakeSimulation(mesh, context)) as simulation,
    ):
        made = World(simulation, path)
        for name, (kind, _) in SERVICES.items():
            made.clients[name] = simulation.create_client(kind, name)
        process = subprocess.Popen(
            [sys.executable, "-m", "cut_service.cut_node", "--ros-args",
             "-p", "tissue_timeout:=0.5"], stdout=log, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            for client in made.clients.values():
                wait_for(client.service_is_ready, 120.0, "the services")
            wait_for(lambda: simulation.frame > 60, what="frames to pass")
            yield made
        finally:
            process.kill()
            process.wait()
            print(path.read_text())


def test_requests_that_cannot_be_met_are_refused_with_a_code_and_change_nothing(
    world: World,
) -> None:
    mesh = world.simulation.mesh
    # An answer: the node knows the tissue by now.
    wait_for(lambda: world.ask("tissue/suture", suture(LIST)).success, what="the tissue")
    before, version, unlike = remembered(mesh), mesh.version, []
    for service, (_, table) in SERVICES.items():
        for what, (code, request) in table.items():
            answer = world.ask(service, request())
            wanted = getattr(type(answer), code)
            if answer.success or answer.error_code != wanted or not answer.message:
                unlike.append(f"{service}, {what}: {answer.error_code}, not {code}: {answer}")
    assert unlike == []
    _held(world)
    _strips(world)
    assert (mesh.version, world.simulation.applied) == (version, [])
    assert remembered(mesh) == before
    _with_patches(world)


def _held(world: World) -> None:
    """A cut through nodes that tools hold, all of them."""
    simulation, reported = world.simulation, set[str]()

    def on_diagnostics(message: DiagnosticArray) -> None:
        pairs = [pair for status in message.status for pair in status.values]
        reported.update(pair.value for pair in pairs if pair.key == "held nodes")

    simulation.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    publisher = simulation.create_publisher(HeldNodes, "tissue/held_nodes", qos.LATCHED)
    nodes = simulation.mesh.node_ids[: simulation.mesh.node_rows]
    message = HeldNodes(epoch=conversions.epoch_field(simulation.epoch), nodes=nodes.tolist())
    publisher.publish(message)
    wait_for(lambda: str(len(nodes)) in reported, what="the nodes held to be known")
    answer = world.ask("tissue/cut", cut())
    assert answer.error_code == Cut.Response.HELD, answer
    message.nodes = []
    publisher.publish(message)
    wait_for(lambda: "0" in reported, what="their release to be known")


def _with_patches(world: World) -> None:
    """Sewing in of patches: there are two, and nothing is left of the second."""
    simulation = world.simulation
    mesh = simulation.mesh
    for _ in range(2):
        answer = world.ask("tissue/add_patch", patch())
        assert answer.success, answer.message
    rows = np.flatnonzero(mesh.regions[: mesh.element_rows] == mesh.patches.items[1].label)
    nothing_left = TopologyEdit(mesh.version, removed_elements=mesh.element_ids[rows])
    simulation.apply(nothing_left)
    before, unlike = remembered(mesh), []
    known = mesh.version
    wait_for(
        lambda: world.ask("tissue/suture", suture(LIST)).version == known, what="the last edit"
    )
    for what, (code, request) in WITH_PATCHES.items():
        answer = world.ask("tissue/suture", request())
        if answer.success or answer.error_code != getattr(Suture.Response, code):
            unlike.append(f"{what}: {answer.error_code}, not {code}: {answer}")
    assert unlike == []
    assert remembered(mesh) == before


def _strips(world: World) -> None:
    """Strips of a moving blade that are no surface, or of another epoch."""
    simulation = world.simulation
    publisher = simulation.create_publisher(CutRequest, "tissue/cut_request", qos.CUT_REQUEST)
    wait_for(lambda: publisher.get_subscription_count() == 1)
    bad = {
        "not finite": cut(with_value(np.nan)), "names a vertex": cut(triangles=[0, 1, 9]),
        "degenerate": cut(triangles=[0, 1, 1]), "times the organ": cut(square(1e3)[0]),
        "crosses no tissue": cut(square(0.01, MIDDLE + 1.0)[0]),
    }  # fmt: skip

    def said(words: str) -> None:
        wait_for(lambda: words in world.log.read_text(), what=words)

    for number, (words, request) in enumerate(bad.items()):
        for stroke in ("", f"stroke {number}"):
            message = CutRequest(tool=f"blade {number}", stroke=stroke, ends=True)
            message.request_id = f"bad {number} {stroke}"
            message.epoch = conversions.epoch_field(simulation.epoch)
            message.sweep = request.sweep
            publisher.publish(message)
        said(words)
    message.epoch = np.zeros(16, dtype=np.uint8)
    message.request_id = "of another epoch"
    publisher.publish(message)
    said("dropped a cut by")


def test_of_two_requests_at_once_each_is_answered_for_the_tissue_as_it_is_then(
    world: World,
) -> None:
    simulation = world.simulation
    wait_for(lambda: world.ask("tissue/suture", suture(LIST)).success, what="the tissue")
    one, other = world.answers("tissue/cut", [cut(), cut()])
    codes = sorted([one.error_code, other.error_code])
    # The same cut twice: the second is planned again, and there is nothing left to part.
    assert codes in ([0, Cut.Response.MISSED], [0, Cut.Response.STALE]), (one, other)
    assert len(simulation.applied) == 1
    first, second = world.answers("tissue/suture", [suture(REMOVE), suture(REMOVE)])
    assert sorted([first.error_code, second.error_code])[0] == 0
    assert len(simulation.mesh.sutures) == 0
    assert max(first.error_code, second.error_code) in (
        Suture.Response.UNKNOWN_SUTURE, Suture.Response.REFUSED, Suture.Response.STALE
    )  # fmt: skip


def test_while_the_simulation_is_busy_or_has_begun_anew_nothing_is_changed(world: World) -> None:
    simulation = world.simulation
    wait_for(lambda: world.ask("tissue/suture", suture(LIST)).success, what="the tissue")
    simulation.refuse_with = 3  # BUSY: a load or a reset is under way.
    before = remembered(simulation.mesh)
    for service, request, code in (
        ("tissue/cut", cut(), Cut.Response.STALE),
        ("tissue/suture", suture(TIGHTEN, length=0.0), Suture.Response.STALE),
        ("tissue/add_patch", patch(), AddPatch.Response.STALE),
    ):
        answer = world.ask(service, request)
        assert (answer.success, answer.error_code) == (False, code), answer.message
    simulation.refuse_with = 0
    assert remembered(simulation.mesh) == before
    assert not simulation.applied

    fresh, _, _ = two_blocks(GAP)

    def restart() -> None:
        simulation.before_apply = lambda: None
        simulation.restart(fresh)

    simulation.before_apply = restart
    answer = world.ask("tissue/cut", cut())
    assert answer.error_code == Cut.Response.SIMULATION_LOST, answer.message
    assert fresh.version == 1
    assert not simulation.applied
