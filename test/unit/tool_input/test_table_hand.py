"""Taking tools that are there: of the scene, or of a recording that was taken over."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from std_msgs.msg import Bool
from tissue_interfaces.msg import Playback, Tool, ToolList

from support.fake_gui import FakeGui, FakeScene
from support.fake_node import FakeNode
from tool_input.table.desk import Desk
from tool_input.table.hand_mode import NONE, HandMode
from tool_input.table.modes import MOVE, START, Drag
from tool_input.table.page_scene import PageScene, Placement
from tool_input.table.person import Person

SERVO, USE = "tools/forceps/servo_cp", "tools/forceps/use"


class Hand:
    """A person whose hand is empty, beside a forceps of the scene at (1, 2, 3) cm."""

    def __init__(self, pressed: bool = False) -> None:
        self.node, self.gui = FakeNode(), FakeGui()
        self.told: list[str] = []
        self.desk = Desk(self.node, "organ")
        self.person = Person("anna-1", self.desk, self.told.append)
        forceps = Tool(id="forceps", kind=Tool.GRAB, owner="scene", pressed=pressed)
        forceps.pose.position.x, forceps.pose.position.y = 0.01, 0.02
        forceps.pose.position.z, forceps.pose.orientation.x = 0.03, 1.0
        forceps.pose.orientation.w = 0.0
        self.node.hears("tissue/tools", ToolList(tools=[forceps]))
        self.desk.hear()
        scene = PageScene(FakeScene(), Placement.around(np.eye(3)))
        self.mode = HandMode(self.person, scene)
        self.mode.settings(self.gui)

    def take(self) -> None:
        self.gui["Tool"].set("forceps")

    def drag(self, by: tuple[float, float, float]) -> None:
        start, down = np.array([0.05, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])
        for phase, point in ((START, start), (MOVE, start + by)):
            self.mode.drag(Drag(phase, start, point, -down, down, None, -down))

    def uses(self) -> list[bool]:
        return [message.data for message in self.node.published_on(USE)]


def test_a_taken_tool_is_carried_as_far_as_the_drag_and_stays_turned_as_it_was() -> None:
    hand = Hand()
    hand.take()
    assert not hand.node.published
    hand.drag((0.002, 0.0, -0.001))
    pose = hand.node.published_on(SERVO)[-1].pose
    at = pose.position
    np.testing.assert_allclose([at.x, at.y, at.z], [0.012, 0.02, 0.029], atol=1e-12)
    assert pose.orientation.x == 1.0


def test_nothing_is_published_of_a_taken_tool_before_somebody_does_something() -> None:
    hand = Hand(pressed=True)
    hand.take()
    assert hand.gui["Pressed"].value
    for _ in range(3):
        hand.person.tools.repeat()
    assert not hand.node.published


@pytest.mark.parametrize("pressed", [False, True])
def test_the_first_change_of_use_is_an_edge_whatever_was_heard_before(pressed: bool) -> None:
    hand = Hand(pressed)
    hand.take()
    hand.gui["Pressed"].set(not pressed)
    assert hand.uses() == [pressed, not pressed]
    hand.gui["Pressed"].set(pressed)
    assert hand.uses() == [pressed, not pressed, pressed]


def test_who_leaves_lets_go_and_the_tool_stays_for_others() -> None:
    hand = Hand(pressed=True)
    hand.take()
    hand.person.leave()
    assert hand.uses() == [True, False]
    assert not hand.node.asked_for("tissue/remove_tool")
    assert hand.node.closed == [SERVO, USE]


def test_letting_it_be_gives_it_back() -> None:
    hand = Hand()
    hand.take()
    hand.gui["Let it be"].click()
    assert hand.gui["Tool"].value == NONE
    assert hand.node.closed == [SERVO, USE]
    with pytest.raises(ValueError, match="choose the tool"):
        hand.drag((0.0, 0.0, 0.01))
    assert not hand.node.published


def test_a_tool_that_somebody_or_a_recording_moves_is_refused() -> None:
    hand = Hand()
    hand.node.rivals[SERVO] = 1
    hand.take()
    assert "is moved by somebody" in hand.told[-1]
    hand.node.rivals.clear()
    playback = Playback(bag="expert")
    hand.node.hears("tissue/playback", playback)
    hand.desk.hear()
    hand.take()
    assert "take it over first" in hand.told[-1]
    playback.taken_over = ["forceps"]
    hand.take()
    hand.drag((0.0, 0.0, 0.01))
    assert hand.node.published_on(SERVO)


def test_a_tool_that_has_gone_is_no_longer_in_the_hand() -> None:
    hand = Hand()
    hand.take()
    hand.node.hears("tissue/tools", ToolList())
    hand.desk.hear()
    with pytest.raises(ValueError, match="choose the tool"):
        hand.drag((0.0, 0.0, 0.01))


def test_observers_take_nothing() -> None:
    hand = Hand()
    hand.person.observer = True
    hand.take()
    assert "observers cannot move tools" in hand.told[-1]


def test_a_mistake_of_the_page_is_told_once_and_ends_nothing() -> None:
    hand = Hand()

    def fail(_: Any) -> None:
        raise KeyError("nothing of this name")

    for _ in range(3):
        hand.person.attempt(fail, Bool())
    assert [text.startswith("The page failed: KeyError") for text in hand.told] == [True]
    assert sum("Traceback" in line for line in hand.node.said) == 1
