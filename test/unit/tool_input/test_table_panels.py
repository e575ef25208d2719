"""The panels of the operating table: what they ask for, and what they tell."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tissue_interfaces.msg import (
    Hole,
    Holes,
    Playback,
    Reading,
    Readings,
    RiskWarning,
    Status,
    Tool,
)
from tissue_interfaces.srv import SetPlayback

from support.fake_gui import FakeGui, FakeScene
from support.fake_node import FakeNode
from tissue_sim.elastic import registry
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tool_input.table.blade_mode import TURNS
from tool_input.table.desk import Desk
from tool_input.table.edit_stack import made_by, next_edits
from tool_input.table.help_panel import help_text
from tool_input.table.model_panel import ModelPanel, parameter_control
from tool_input.table.page_scene import PageScene, Placement
from tool_input.table.panel import Panel
from tool_input.table.person import Person
from tool_input.table.playback_panel import PlaybackPanel
from tool_input.table.readout import Readout, quantity, told
from tool_input.table.views import VIEWS
from tool_input.table.window import MODES


class Table:
    """One person with controls, and what they are told."""

    def __init__(self) -> None:
        self.node, self.gui, self.told = FakeNode(), FakeGui(), list[str]()
        self.desk = Desk(self.node, "organ")
        self.person = Person("anna-1", self.desk, self.told.append)
        self.mesh = Mesh(block(3, 3, 3))
        self.desk.replica.take_keyframe(b"e" * 16, self.mesh)

    def heard(self, *edits: TopologyEdit) -> None:
        """Let edits have been made."""
        for edit in edits:
            self.mesh.changes.append(SimpleNamespace(edit=edit))  # type: ignore[arg-type]

    def asked(self, service: str) -> list[Any]:
        return self.node.asked_for(f"tissue/{service}")

    def reverted(self, now: str = "", following: str = "") -> None:
        """What undo and redo are answered with."""
        for service in ("tissue/undo", "tissue/redo"):
            self.node.answers[service] = SimpleNamespace(
                success=True, message="undone: split", can_undo=2, can_redo=1,
                reverted_request_id=now, next_request_id=following,
            )  # fmt: skip


@pytest.fixture
def table() -> Table:
    return Table()


def edit(version: int, kind: str = "split", author: str = "", request: str = "") -> TopologyEdit:
    return TopologyEdit(version - 1, kind=kind, author=author, request_id=request, version=version)


# Undo and redo


def test_undo_and_redo_go_through_one_stack_as_the_simulation_does() -> None:
    """Against a plain model of two stacks, over random edits."""
    random = np.random.default_rng(4)
    for _ in range(50):
        done, undone, heard = list[int](), list[int](), list[TopologyEdit]()
        for version in range(1, 30):
            kind = random.choice(["split", "undo", "redo"])
            if kind == "undo" and done:
                undone.append(done.pop())
            elif kind == "redo" and undone:
                done.append(undone.pop())
            else:
                kind = "split"
                done.append(version)
                undone.clear()
            heard.append(edit(version, kind))
        found = next_edits(heard)
        versions = [None if one is None else one.version for one in found]
        assert versions == [done[-1] if done else None, undone[-1] if undone else None]


def test_edits_before_the_first_that_was_heard_are_not_known() -> None:
    assert next_edits([]) == (None, None)
    assert next_edits([edit(8, "undo")]) == (None, None)
    assert next_edits([edit(8, "undo"), edit(9, "redo")]) == (None, None)


@pytest.mark.parametrize(
    ("author", "request_id", "mine"),
    [
        ("anna-1", "", True),
        ("cut_service", "anna-1-18a-7", True),
        ("anna_1_blade", "0f0f-12-0", True),
        ("anna-12", "anna-12-18a-7", False),
        ("anna_12_blade", "", False),
        ("bert-1", "bert-1-18a-7", False),
        ("scalpel", "0f0f-12-0", False),
    ],
)
def test_whose_an_edit_is(author: str, request_id: str, mine: bool) -> None:
    assert made_by(author, request_id, "anna-1", "anna_1") == mine


def test_ones_own_edit_is_undone_at_once_and_anothers_when_asked_twice(table: Table) -> None:
    table.reverted()
    Panel(table.person, table.gui)
    table.heard(edit(1, author="anna-1"))
    table.gui["Session"].set("Undo")
    assert [request.author for request in table.asked("undo")] == ["anna-1"]
    assert table.told == ["Undone: split. 2 more to undo."]
    table.heard(edit(2, "suture", author="bert-1"))
    table.gui["/Undo"].click()
    assert len(table.asked("undo")) == 1
    assert "is a suture by bert-1" in table.told[-1]
    table.gui["/Undo"].click()
    assert len(table.asked("undo")) == 2
    table.heard(edit(3, "undo", author="bert-1"))
    table.gui["Session"].set("Redo")
    assert table.asked("redo") == []
    assert "To redo it nevertheless" in table.told[-1]


def test_a_stroke_of_a_blade_is_undone_as_one(table: Table) -> None:
    answers = iter([("s/1", "s/2"), ("s/2", "s/3"), ("s/3", "other/4")])

    class Answers(dict[str, Any]):
        def get(self, *_: Any) -> Any:
            now, following = next(answers)
            return SimpleNamespace(
                success=True, message="undone: split", can_undo=1, can_redo=3,
                reverted_request_id=now, next_request_id=following,
            )  # fmt: skip

    table.node.answers = Answers()
    Panel(table.person, table.gui)
    table.gui["Session"].set("Undo")
    assert len(table.asked("undo")) == 3
    assert table.told == ["Undone: edit. 1 more to undo."]


# Let go, pause, reset


def test_reset_is_asked_for_once_more_confirmed(table: Table) -> None:
    Panel(table.person, table.gui)
    table.gui["Session"].set("Reset")
    table.gui["Keep on"].click()
    assert table.asked("reset") == []
    table.gui["Session"].set("Reset")
    table.gui["Reset"].click()
    assert len(table.asked("reset")) == 1


def test_pause_goes_on_when_it_is_paused(table: Table) -> None:
    Panel(table.person, table.gui)
    for state in (Status.READY, Status.PAUSED):
        table.desk.status = Status(state=state)
        table.gui["Session"].set("Pause")
    assert [request.data for request in table.asked("pause")] == [True, False]


def test_let_go_releases_ones_own_tools_only(table: Table) -> None:
    Panel(table.person, table.gui)
    other = Person("bert-1", table.desk, table.told.append)
    for person in (table.person, other):
        person.tools.make("grab", Tool.GRAB, Tool.SPHERE, [0.005]).move([0, 0, 0])
    table.gui["Session"].set("Let go")
    assert [request.tool for request in table.asked("release")] == ["anna_1_grab"]


# Models


def test_every_parameter_of_every_model_has_a_control_that_gives_its_default() -> None:
    for name in registry.names():
        for parameter in registry.parameters_of(name):
            _, value = parameter_control(FakeGui(), parameter)
            assert value() == pytest.approx(parameter.default)
            assert parameter.checked(value()) == value()


def test_only_what_was_changed_is_asked_for(table: Table) -> None:
    panel = ModelPanel(table.person, table.gui)
    table.desk.status = Status(model="lr")
    panel.update()
    assert table.gui["Model"].value == "lr"
    table.gui["sweeps"].set(3)
    table.gui["keep until rest"].set(False)
    table.gui["Apply"].click()
    (request,) = table.asked("set_model")
    named = dict(zip(request.parameter_names, request.parameter_values, strict=True))
    assert (request.model, named) == ("lr", {"sweeps": 3.0, "keep_until_rest": 0.0})
    assert table.told == ["The model is lr now."]


def test_another_model_has_its_own_parameters(table: Table) -> None:
    ModelPanel(table.person, table.gui)
    table.gui["Model"].set("chain_mail")
    names = [p.name.replace("_", " ") for p in registry.parameters_of("chain_mail")]
    there = [c.label.partition(" [")[0] for c in table.gui.controls if not c.removed]
    assert [label for label in there if label not in ("Model", "Apply")] == names
    table.gui["Apply"].click()
    assert list(table.asked("set_model")[0].parameter_names) == []


def test_a_wrong_parameter_is_told_with_its_limits(table: Table) -> None:
    ModelPanel(table.person, table.gui)
    table.gui["Model"].set("relaxation")
    for wrong, why in (("much", "'much' is no number"), ("2", "allowed: 0 to 0.9")):
        table.gui["linear factor"].set(wrong)
        table.gui["Apply"].click()
        assert why in table.told[-1]
    assert table.asked("set_model") == []


# A recording that is played


def playback(**fields: Any) -> Playback:
    return Playback(**({"bag": "expert", "duration": 20.0, "rate": 1.0} | fields))


def test_the_bar_follows_the_recording_without_asking_for_anything(table: Table) -> None:
    panel = PlaybackPanel(table.person, table.gui)
    panel.update()
    assert table.gui.controls == []
    for time in (0.0, 5.0, 12.5):
        table.desk.playback = playback(time=time, paused=time > 10, looping=True)
        panel.update()
    assert table.gui["Time [s]"].value == 12.5
    assert table.gui["Paused"].value
    assert table.gui["text"].content == "**expert**  \n12.5 of 20.0 s"
    assert table.asked("set_playback") == []


def test_a_person_moves_the_bar(table: Table) -> None:
    now = [0.0]
    panel = PlaybackPanel(table.person, table.gui, lambda: now[0])
    table.desk.tools = {"grasper": Tool(), "scalpel": Tool()}
    table.desk.playback = playback(taken_over=["scalpel"])
    panel.update()
    assert table.gui["Tools"].options == ("all tools", "grasper")
    for now[0], value in ((1.0, 5.0), (1.2, 6.0), (1.4, 7.0)):
        table.gui["Time [s]"].set(value)
        panel.update()
    assert table.asked("set_playback") == [], "the slider still moves"
    table.desk.playback = playback(taken_over=["scalpel"], time=1.0)
    panel.update()
    assert table.gui["Time [s]"].value == 7.0
    now[0] = 2.0
    panel.update()
    table.gui["Paused"].set(True)
    table.gui["Paused"].set(False)
    table.gui["Rate"].set("1/2")
    table.gui["Loop"].set(True)
    table.gui["Tools"].set("grasper")
    table.gui["Take over"].click()
    what = SetPlayback.Request
    asked = [(one.what, one.value, list(one.tools)) for one in table.asked("set_playback")]
    assert asked == [
        (what.SEEK, 7.0, []), (what.PAUSE, 0.0, []), (what.RESUME, 0.0, []),
        (what.RATE, 0.5, []), (what.LOOP, 1.0, []), (what.TAKE_OVER, 0.0, ["grasper"]),
    ]  # fmt: skip


def test_after_a_take_over_there_is_no_way_back(table: Table) -> None:
    panel = PlaybackPanel(table.person, table.gui)
    table.desk.playback = playback(time=3.0)
    panel.update()
    before = table.gui["Time [s]"]
    table.desk.playback = playback(time=3.0, branch="b", branch_frame=180, taken_over=["grasper"])
    panel.update()
    assert table.gui["Time [s]"] is not before
    assert table.gui["Time [s]"].disabled
    assert "Branch after frame 180; taken over: grasper" in table.gui["text"].content


# What is told


def test_readings_warnings_and_holes_are_told_in_units() -> None:
    status = Status(organ="heart", model="lr", state=Status.PAUSED, message="as asked")
    readings = Readings(
        readings=[Reading(name="von_mises_stress", unit="Pa", peak=12345.0, highest=2.1e4)],
        warnings=[
            RiskWarning(
                region="septum", what=RiskWarning.NEAR, tool="probe", value=0.0021, begins=True
            ),
            RiskWarning(region="septum", what=RiskWarning.CUT, begins=False),
        ],
    )
    holes = Holes(holes=[Hole(name="defect", covered=0.5, gap=0.0032), Hole(name="x", problem="?")])
    assert told(status, readings, holes).split("  \n") == [
        "**heart**, lr, paused",
        "as asked",
        "⚠ **septum**: 2.1 mm away (probe)",
        "von Mises stress: 12.3 kPa, max 21 kPa",
        "defect: 50% closed, gap 3.2 mm",
        "x: ?",
    ]
    assert told(None, None, None) == "Waiting for the simulation ..."


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0, "Pa", "0 Pa"),
        (-2500.0, "Pa", "-2.5 kPa"),
        (1e-7, "m", "0.1 µm"),
        (0.02, "Pa", "0.02 Pa"),
        (0.25, "", "0.25"),
    ],
)
def test_quantities_have_prefixes(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


def test_the_text_changes_no_more_often_than_people_read(table: Table) -> None:
    now = [0.0]
    readout = Readout(table.desk, table.gui, lambda: now[0])
    readout.update()
    table.desk.status = Status(organ="wall", model="lr", state=Status.READY)
    now[0] = 0.1
    readout.update()
    assert table.gui["text"].content == "Waiting for the simulation ..."
    now[0] = 0.3
    readout.update()
    assert table.gui["text"].content == "**wall**, lr, running"


# Keys and help


def test_every_key_does_one_thing_and_is_in_the_help(table: Table) -> None:
    panel = Panel(table.person, table.gui)
    scene = PageScene(FakeScene(), Placement(np.zeros(3), 1.0))
    modes = [make(table.person, scene) for make in MODES]
    keys = [mode.key for mode in modes] + [view.key for view in VIEWS.values() if view.key]
    keys += [command.keys for command in panel.commands if command.key] + list(TURNS)
    assert len(set(keys)) == len(keys)
    assert not set(keys) & set("WASDQE"), "these move viser's camera"
    text = help_text(modes, VIEWS.values(), panel.commands)
    for key in set(keys) - set(TURNS):
        assert f"`{key}`" in text
    sentences = [mode.help for mode in modes] + [view.help for view in VIEWS.values()]
    for sentence in sentences + [command.help for command in panel.commands]:
        assert sentence in text
