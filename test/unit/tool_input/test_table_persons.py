"""Persons at the operating table: their tools, their requests, and those who only watch."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from tissue_interfaces.msg import Playback, Tool, ToolList
from tissue_interfaces.srv import Cut, SetTool, Undo

from support.fake_node import FakeNode
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tool_input.table.desk import Desk
from tool_input.table.person import Person
from tool_input.table.requests import OBSERVERS_MAY, SERVICES


@pytest.fixture
def node() -> FakeNode:
    return FakeNode()


@pytest.fixture
def desk(node: FakeNode) -> Desk:
    return Desk(node, "organ")


def person(desk: Desk, name: str = "anna-1", observer: bool = False) -> tuple[Person, list[str]]:
    told: list[str] = []
    return Person(name, desk, told.append, observer), told


def uses(node: FakeNode, tool: str) -> list[bool]:
    return [message.data for message in node.published_on(f"tools/{tool}/use")]


def test_persons_have_tools_of_their_own(node: FakeNode, desk: Desk) -> None:
    anna, bert = person(desk)[0], person(desk, "bert-1")[0]
    for one in (anna, bert):
        one.tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005]).move([0.1, 0.2, 0.3])
    made = [request.tool for request in node.asked_for("tissue/set_tool")]
    assert [(tool.id, tool.owner) for tool in made] == [
        ("anna_1_grab", "anna-1"),
        ("bert_1_grab", "bert-1"),
    ]
    anna.tools.clear()
    assert [request.tool for request in node.asked_for("tissue/remove_tool")] == ["anna_1_grab"]
    bert.tools.repeat()
    assert len(node.published_on("tools/bert_1_grab/servo_cp")) == 2
    pose = node.published_on("tools/bert_1_grab/servo_cp")[-1]
    assert pose.header.frame_id == "organ"
    assert (pose.pose.position.x, pose.pose.orientation.w) == (0.1, 1.0)


def places(node: FakeNode, tool: str) -> list[float]:
    """Where along x a tool was wanted [m], one after the other."""
    return [pose.pose.position.x for pose in node.published_on(f"tools/{tool}/servo_cp")]


@pytest.mark.usefixtures("anywhere")
def test_a_press_is_an_edge_for_who_listens_however_late(node: FakeNode, desk: Desk) -> None:
    """The first level a simulation hears makes no edge."""
    node.listeners = 0
    tool = person(desk)[0].tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    tool.move([0, 0, 0])
    tool.use(True)
    assert uses(node, tool.id) == []
    node.listeners = 1
    for _ in range(2):
        tool.repeat()
        assert uses(node, tool.id) == [False, True]
    node.listeners = 2  # A recorder: the simulation has heard of the press.
    tool.repeat()
    assert uses(node, tool.id) == [False, True, True]
    node.listeners = 0
    tool.repeat()
    node.listeners = 1  # Another simulation.
    tool.repeat()
    assert uses(node, tool.id)[3:] == [False, True]


@pytest.mark.usefixtures("anywhere")
def test_a_press_that_nobody_hears_yet_waits_where_it_was_made(node: FakeNode, desk: Desk) -> None:
    """The hand goes on meanwhile, and the tool follows it once it was pressed."""
    node.listeners = 0
    tool = person(desk)[0].tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    tool.move([0.1, 0, 0])
    tool.use(True)
    tool.move([0.2, 0, 0])
    node.listeners = 1
    tool.repeat()
    assert set(places(node, tool.id)) == {0.1}
    topics = [topic.rpartition("/")[2] for topic, _ in node.published]
    assert topics[-3:] == ["servo_cp", "use", "use"]
    tool.repeat()
    assert places(node, tool.id)[-1] == 0.2


@pytest.mark.usefixtures("anywhere")
def test_a_press_that_is_over_before_anybody_hears_is_never_sent(
    node: FakeNode, desk: Desk
) -> None:
    """Late, it would hold what lies where the hand was, and nobody would see why."""
    node.listeners = 0
    tool = person(desk)[0].tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    tool.move([0.1, 0, 0])
    tool.use(True)
    tool.move([0.2, 0, 0])
    tool.use(False)
    node.listeners = 1
    tool.repeat()
    assert uses(node, tool.id) == [False]
    assert places(node, tool.id)[-1] == 0.2
    tool.use(True)
    assert uses(node, tool.id) == [False, True]


@pytest.mark.usefixtures("anywhere")
def test_a_pose_comes_before_the_press_that_belongs_to_it(node: FakeNode, desk: Desk) -> None:
    tool = person(desk)[0].tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    tool.move([0.1, 0, 0], [0, 0, 1, 0])
    tool.use(True)
    topics = [topic.rpartition("/")[2] for topic, _ in node.published]
    # The first level makes no edge, the second is the press.
    assert topics == ["servo_cp", "servo_cp", "use", "use"]
    tool.move([0.2, 0, 0])
    assert node.published[-1][1].pose.orientation.z == 1.0


def test_a_press_waits_until_the_tool_is_there(node: FakeNode, desk: Desk) -> None:
    """Of two topics the later message may come first."""
    tool = person(desk)[0].tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    tool.move([0.1, 0, 0])
    desk.tools[tool.id] = tool.message
    for x, pressed in ((0.0, False), (0.0999, False), (0.10001, True)):
        desk._poses[tool.id] = np.array([x, 0, 0, 0, 0, 0, 1])
        if not tool.pressed:
            tool.use(True)
        tool.move([0.2, 0, 0])
        assert places(node, tool.id)[-1] == 0.1
        tool.repeat()
        assert uses(node, tool.id)[-1] is pressed
    tool.repeat()
    assert places(node, tool.id)[-1] == 0.2


def test_a_release_waits_for_its_press(node: FakeNode, desk: Desk) -> None:
    """As of a blade that cuts once, where a drag ends."""
    tool = person(desk)[0].tools.make("blade", Tool.CUT, Tool.TRIANGLE, [0.01, 0.01])
    tool.move([0.1, 0, 0])
    tool.repeat()
    desk.tools[tool.id] = tool.message
    desk._poses[tool.id] = np.zeros(7)
    tool.use(True)
    tool.use(False)
    tool.move([0.2, 0, 0])
    assert uses(node, tool.id) == [False]
    desk._poses[tool.id][0] = 0.1
    tool.repeat()
    assert uses(node, tool.id) == [False, True, False]
    tool.repeat()
    assert places(node, tool.id)[-2:] == [0.1, 0.2]


def test_a_press_does_not_wait_for_ever(
    node: FakeNode, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tool may be kept from where it is wanted, as by a limit of its speed."""
    now = 100.0
    monkeypatch.setattr("tool_input.table.person.time.monotonic", lambda: now)
    tool = person(desk)[0].tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    tool.move([0.1, 0, 0])
    tool.use(True)
    assert uses(node, tool.id) == [False]
    now += 1.0
    tool.repeat()
    assert uses(node, tool.id) == [False, True]


def test_what_is_held_is_let_go_when_a_person_leaves(node: FakeNode, desk: Desk) -> None:
    anna, _ = person(desk)
    for name in ("grab", "grab_2"):
        tool = anna.tools.make(name, Tool.GRAB, Tool.SPHERE, [0.005])
        tool.move([0, 0, 0])
        tool.use(True)
    anna.leave()
    for name in ("anna_1_grab", "anna_1_grab_2"):
        assert uses(node, name)[-1] is False
        assert {f"tools/{name}/servo_cp", f"tools/{name}/use"} <= set(node.closed)
    assert len(node.asked_for("tissue/remove_tool")) == 2
    assert anna.tools.names == ()


def test_requests_say_who_asks_and_are_never_taken_for_one_another(
    node: FakeNode, desk: Desk
) -> None:
    anna, _ = person(desk)
    for _ in range(3):
        anna.request("undo", Undo.Request())
        anna.request("cut", Cut.Request())
    undone, cut = node.asked_for("tissue/undo"), node.asked_for("tissue/cut")
    assert {request.author for request in undone} == {"anna-1"}
    ids = [request.request_id for request in undone + cut]
    assert len(set(ids)) == 6
    assert all(one.startswith("anna-1-") for one in ids)


def test_answers_come_to_who_asked_and_refusals_are_told(node: FakeNode, desk: Desk) -> None:
    anna, told = person(desk)
    answers: list[Any] = []
    anna.request("cut", Cut.Request(), answers.append)
    assert len(answers) == 1
    node.answers["tissue/cut"] = Cut.Response(success=False, message="the sweep crosses nothing")
    anna.request("cut", Cut.Request(), answers.append)
    assert len(answers) == 1
    assert told == ["cut: the sweep crosses nothing"]
    reason = SimpleNamespace(successful=False, reason="scalar = 'x' is not allowed")
    node.answers["readings/set_parameters"] = SimpleNamespace(results=[reason])
    anna.request("set_readings", SimpleNamespace())
    assert "not allowed" in told[-1]


def test_requests_wait_for_their_own_service_but_not_for_ever(
    node: FakeNode, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("tool_input.table.requests.time.monotonic", lambda: now)
    node.missing = {"tissue/cut", "tissue/undo"}
    anna, told = person(desk)
    anna.request("cut", Cut.Request())
    anna.request("undo", Undo.Request())
    anna.request("set_tool", SetTool.Request())
    assert [service for service, _ in node.asked] == ["tissue/set_tool"]
    node.missing = {"tissue/undo"}
    desk.hear()
    assert [service for service, _ in node.asked] == ["tissue/set_tool", "tissue/cut"]
    assert told == []
    now += 60.0
    desk.hear()
    assert told == ["tissue/undo is not there: is its node running?"]
    node.missing = set()
    desk.hear()
    assert len(node.asked) == 2


def test_requests_for_one_tool_go_one_after_the_other(node: FakeNode, desk: Desk) -> None:
    """A tool that is taken away and made again is there in the end."""
    anna, bert = person(desk)[0], person(desk, "bert-1")[0]
    node.thinks = True
    for _ in range(2):
        anna.tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
        anna.tools.remove("grab")
    anna.tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    bert.tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    set_one, remove = "tissue/set_tool", "tissue/remove_tool"
    # Others need not wait for it.
    assert [service for service, _ in node.asked] == [set_one, set_one]
    while node.unanswered:
        assert len(node.unanswered) <= 2
        node.unanswered.pop(0)()
    asked = [service for service, request in node.asked if "bert" not in str(request)]
    assert asked == [set_one, remove, set_one, remove, set_one]


def test_only_the_newest_of_the_changes_that_wait_is_asked_for(node: FakeNode, desk: Desk) -> None:
    """A slider that is dragged sends many more than are answered meanwhile."""
    anna, _ = person(desk)
    node.thinks = True
    for size in (0.005, 0.006, 0.007, 0.008):
        anna.tools.make("grab", Tool.GRAB, Tool.SPHERE, [size])
    anna.tools.remove("grab")
    anna.tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.009])
    while node.unanswered:
        node.unanswered.pop(0)()
    sizes = [request.tool.size[0] for request in node.asked_for("tissue/set_tool")]
    assert len(sizes) == 3
    assert sizes[1:] == [0.008, 0.009]
    assert len(node.asked_for("tissue/remove_tool")) == 1


def test_a_tool_does_not_wait_for_ever_for_an_answer(
    node: FakeNode, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("tool_input.table.requests.time.monotonic", lambda: now)
    node.thinks = True
    anna, told = person(desk)
    anna.tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    anna.tools.remove("grab")
    desk.hear()
    assert len(node.asked) == 1
    now += 60.0
    desk.hear()
    assert [service for service, _ in node.asked] == ["tissue/set_tool", "tissue/remove_tool"]
    assert told == ["set_tool: no answer yet; it is still waited for."]


def test_an_answer_that_does_not_come_is_told_once(
    node: FakeNode, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("tool_input.table.requests.time.monotonic", lambda: now)
    anna, told = person(desk)
    node.thinks = True
    anna.request("cut", Cut.Request())
    node.thinks = False
    anna.request("undo", Undo.Request())
    desk.hear()
    assert told == []
    now += 60.0
    for _ in range(2):
        desk.hear()
    assert told == ["cut: no answer yet; it is still waited for."]


@pytest.mark.parametrize("service", sorted(set(SERVICES) - OBSERVERS_MAY))
def test_observers_can_ask_for_nothing_that_changes_the_tissue(
    node: FakeNode, desk: Desk, service: str
) -> None:
    observer, told = person(desk, "observer-1", observer=True)
    kind: Any = SERVICES[service][0]
    observer.request(service, kind.Request())
    desk.hear()
    assert node.asked == []
    assert len(told) == 1
    assert "watch" in told[0]


def test_observers_have_no_tools(node: FakeNode, desk: Desk) -> None:
    observer, _ = person(desk, "observer-1", observer=True)
    with pytest.raises(ValueError, match="observers cannot"):
        observer.tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005])
    observer.leave()
    assert node.asked == []
    assert node.published == []


def test_what_cannot_be_done_is_told(desk: Desk) -> None:
    anna, told = person(desk)

    def refuse(event: Any) -> None:
        raise ValueError(f"a {event} is too short")

    asyncio.run(anna.in_turn(refuse)("line"))
    assert told == ["a line is too short"]
    seen: list[Any] = []
    asyncio.run(anna.in_turn(lambda by=7: seen.append(by))("line"))
    assert seen == [7]


def test_tools_are_shown_where_they_were_measured_last(node: FakeNode, desk: Desk) -> None:
    tool = Tool(id="a", kind=Tool.GRAB, shape=Tool.SPHERE, size=[0.01], state=Tool.FREE)
    node.hears("tissue/tools", ToolList(tools=[tool]))
    desk.hear()
    assert list(desk.tools) == ["a"]
    pose = PoseStamped()
    pose.pose.position.x = 0.25
    node.hears("tools/a/measured_cp", pose)
    desk.hear()
    np.testing.assert_array_equal(desk.pose("a")[:3], [0.25, 0, 0])
    node.hears("tissue/tools", ToolList())
    desk.hear()
    assert desk.tools == {}


def test_tools_that_only_a_recording_moves_are_shown_as_in_use(node: FakeNode, desk: Desk) -> None:
    mesh = Mesh(block(2, 2, 2, 0.1, 0.1, 0.1))
    desk.replica.take_keyframe(b"e", mesh)
    desk.replica.take_state(b"e", mesh.version, 1, mesh.rest[: mesh.node_rows].astype(np.float32))
    tools = [
        Tool(id=name, kind=Tool.GRAB, shape=Tool.SPHERE, size=[0.01], state=Tool.FREE)
        for name in ("moved", "resting")
    ]
    node.hears("tissue/tools", ToolList(tools=tools))
    desk.hear()
    pose = PoseStamped()
    pose.pose.position.x = 0.25
    node.hears("tools/moved/measured_cp", pose)

    def states() -> list[str]:
        desk.hear()
        frame = desk.frame()
        assert frame is not None
        return [frame.tools[name].state for name in ("moved", "resting")]

    assert states() == [Tool.FREE, Tool.FREE]
    node.hears("tissue/playback", Playback())
    assert states() == [Tool.ACTIVE, Tool.FREE]
