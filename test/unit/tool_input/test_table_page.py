"""The page over its real connections: several windows, those who only watch, and slow ones."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from tissue_interfaces.msg import TissueState

from support.fake_node import FakeNode
from support.page_client import PageClient
from tissue_sim import conversions
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tool_input.page_guard import PageGuard
from tool_input.table import page
from tool_input.table.desk import Desk
from tool_input.table.grab_mode import GrabMode
from tool_input.table.page import TablePage
from tool_input.table.page_scene import ORGAN_SIZE

EPOCH = bytes(range(16))
PATIENCE = 60.0
WITHIN = (0.1, 0.1, 1.0)
"""A point of the block's upper side in the page's units."""


class Table:
    """A page whose simulation is the test."""

    def __init__(self, mesh: Mesh) -> None:
        self.node = FakeNode(acts_at_once=False)
        self.mesh = mesh
        self.frame = 0
        self.desk = Desk(self.node, "organ")
        self.page = TablePage(self.desk, port=0, guard=PageGuard(token="act", observer_token="see"))
        self._clients: list[PageClient] = []
        self.node.hears(
            "tissue/topology", conversions.mesh_to_topology(mesh, EPOCH, "organ", Time())
        )
        self.rest = mesh.rest[: mesh.node_rows].astype(np.float32)
        self.moves(self.rest)

    def moves(self, positions: NDArray[np.float32]) -> None:
        """The tissue has another shape."""
        self.frame += 1
        state = TissueState(version=self.mesh.version, frame=self.frame)
        state.epoch = conversions.epoch_field(EPOCH)
        conversions.fill_state(state, positions)
        self.node.hears("tissue/state", state)

    def turn(self) -> None:
        """What the node does again and again."""
        self.node.act()
        self.desk.hear()
        self.page.draw()
        self.page.repeat_poses()

    def until(self, holds: Callable[[], Any], what: str) -> None:
        """Go on until something holds."""
        deadline = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < deadline, f"waited for {what}"
            self.turn()
            for client in self._clients:
                client.receive(0.005)

    def opens(self, path: str = "/?token=act", **options: Any) -> PageClient:
        """Somebody opens a window and sees the tissue."""
        base = self.page.addresses[0].partition("/?")[0]
        client = PageClient(base + path, **options)
        self._clients.append(client)
        self.until(lambda: tissue_node(client), "the organ in a window")
        return client

    def leaves(self, client: PageClient) -> None:
        self._clients.remove(client)

    def pressed(self, tool: str) -> bool:
        heard = self.node.published_on(f"tools/{tool}/use")
        return bool(heard) and heard[-1].data

    def place(self, tool: str) -> float:
        """Where a tool was wanted last, along x [m]."""
        heard = self.node.published_on(f"tools/{tool}/servo_cp")
        return float(heard[-1].pose.position.x)

    def close(self) -> None:
        for client in self._clients:
            client.close()
        self.page.close()


def tissue_node(client: PageClient) -> str:
    """The scene's node that shows tissue; empty: none yet."""
    shown = [
        name
        for name, node in client.nodes.items()
        if name.startswith("/organ") and len(node.get("faces", b"")) > 12
    ]
    return shown[0] if shown else ""


def vertices(client: PageClient) -> NDArray[np.float32]:
    """Where the tissue is in a window, shape (n, 3)."""
    given = client.nodes[tissue_node(client)]["vertices"]
    return np.frombuffer(given, dtype=np.float32).reshape(-1, 3)


@pytest.fixture
def table() -> Iterator[Table]:
    made = Table(Mesh(block(4, 4, 4)))
    yield made
    made.close()


def grab(client: PageClient) -> None:
    client.drag("start", tissue_node(client), WITHIN, WITHIN)


def test_windows_are_persons_and_one_that_is_lost_lets_go_of_its_own(table: Table) -> None:
    anna, bert = table.opens("/as/anna?token=act"), table.opens()
    assert [person.name for person in table.page.persons] == ["anna-1", "person-1"]
    grab(anna)
    grab(bert)
    table.until(lambda: table.pressed("anna_1_grab"), "a grab")
    table.until(lambda: table.pressed("person_1_grab"), "another grab")
    table.opens("/as/anna?token=act")
    assert table.page.persons[-1].name == "anna-2"
    table.leaves(anna)
    anna.drop()
    table.until(lambda: not table.pressed("anna_1_grab"), "the release of what was held")
    table.until(lambda: len(table.page.persons) == 2, "the end of a person")
    gone = {request.tool for request in table.node.asked_for("tissue/remove_tool")}
    assert gone == {"anna_1_grab"}
    assert table.pressed("person_1_grab")
    bert.drag("update", tissue_node(bert), WITHIN, (0.3, 0.1, 1.0))
    before = table.place("person_1_grab")
    table.until(lambda: table.place("person_1_grab") > before + 1e-3, "a tool that goes on")


def test_a_window_that_falls_silent_is_let_go_of(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its connection is open for the system: only the pings tell."""
    monkeypatch.setattr(page, "PING_SECONDS", 0.2)
    monkeypatch.setattr(page, "PONG_SECONDS", 4.0)
    table = Table(Mesh(block(4, 4, 4)))
    try:
        anna = table.opens("/as/anna?token=act")
        grab(anna)
        table.until(lambda: table.pressed("anna_1_grab"), "a grab")
        table.leaves(anna)
        anna.fall_silent()
        table.until(lambda: not table.page.persons, "the end of a person")
        assert not table.pressed("anna_1_grab")
        gone = [request.tool for request in table.node.asked_for("tissue/remove_tool")]
        assert gone == ["anna_1_grab"]
    finally:
        table.close()


def test_a_mode_that_fails_when_a_window_is_lost_holds_nothing_back(
    table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    anna, bert = table.opens("/as/anna?token=act"), table.opens()
    grab(anna)
    grab(bert)
    table.until(lambda: table.pressed("anna_1_grab"), "a grab")
    table.until(lambda: table.pressed("person_1_grab"), "another grab")
    monkeypatch.setattr(GrabMode, "leave", lambda mode: 1 / 0)
    table.leaves(anna)
    anna.drop()
    table.until(lambda: not table.pressed("anna_1_grab"), "the release of what was held")
    assert {request.tool for request in table.node.asked_for("tissue/remove_tool")} == {
        "anna_1_grab"
    }
    assert table.pressed("person_1_grab")


def test_observers_see_and_can_do_nothing_whatever_their_window_sends(table: Table) -> None:
    anna = table.opens("/as/anna?token=act")
    watcher = table.opens("/observe?token=see")
    assert [person.observer for person in table.page.persons] == [False, True]
    assert (
        watcher.nodes[tissue_node(watcher)]["vertices"] == anna.nodes[tissue_node(anna)]["vertices"]
    )
    assert "Grab" in anna.labels
    assert not {"Grab", "Cut", "Undo", "Reset", "Pause"} & set(watcher.labels)
    table.node.published.clear()
    table.node.asked.clear()
    grab(watcher)
    # As if it were dragged in the other's window.
    watcher.nodes["/organ/0"] = {"owner": anna.nodes[tissue_node(anna)].get("owner", "")}
    watcher.drag("start", "/organ/0", WITHIN, WITHIN)
    watcher.drag("end", "/organ/0", WITHIN, (0.5, 0.5, 1.0))
    grab(anna)  # It comes later, so what the observer sent has been dealt with.
    table.until(lambda: table.pressed("anna_1_grab"), "a grab")
    acted = {topic.split("/")[1] for topic, _ in table.node.published}
    assert acted == {"anna_1_grab"}
    assert {request.tool.owner for _, request in table.node.asked} <= {"anna-1"}


def test_a_slow_window_gets_the_newest_shape_and_not_all_of_them() -> None:
    table = Table(Mesh(block(90, 60, 2)))
    try:
        client = table.opens(receive_buffer=1 << 16)
        frames, before, start = 80, client.received, vertices(client)
        assert frames * start.nbytes > 5e6  # More than can lie anywhere on the way.
        for count in range(frames):
            table.moves(table.rest + np.float32(1e-4 * (count + 1)))
            table.turn()
            time.sleep(0.02)  # The server sends what it can.
        last = start + 1e-4 * frames * ORGAN_SIZE / float(np.ptp(table.rest, axis=0).max())
        table.until(lambda: np.allclose(vertices(client), last, atol=1e-4), "the newest shape")
        assert client.received - before < frames / 2
    finally:
        table.close()
