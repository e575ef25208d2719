"""A journal repeats its session bit by bit."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from support.small_block import CORNER, block_mesh, block_simulation, pose_of, tool_at
from support.split_edit import split_at
from tissue_sim.elastic import registry
from tissue_sim.frame import (
    Answer,
    Budget,
    Command,
    FrameInputs,
    JournalEntry,
    ToolSample,
)
from tissue_sim.journal import JournalError, epochs_of, replay
from tissue_sim.simulation import Simulation

TOOLS = (
    tool_at(CORNER, "left"),
    tool_at((0.0, 0.06, 0.0), "right"),
    tool_at((0.03, 0.03, 0.03), "knife", kind="cut", shape="rectangle", size=(0.05, 0.05)),
)


@dataclass
class Session:
    """A session of random interaction with steps as a clock would give them."""

    seed: int
    entries: list[JournalEntry] = field(default_factory=list)
    answers: list[Answer] = field(default_factory=list)
    cuts: int = 0

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)
        self.simulation = block_simulation(*TOOLS)
        self.level = dict.fromkeys(("left", "right", "knife"), False)
        self.place = {tool.id: np.array(tool.pose[:3]) for tool in TOOLS}
        self.splits = [0.03, 0.015, 0.045]

    def run(self, frames: int) -> Session:
        for number in range(1, frames + 1):
            inputs = FrameInputs(
                tuple(self.commands(number)),
                tuple(self.edits(number)),
                tuple(self.sample(tool) for tool in self.level),
            )
            time_budget = Budget(seconds=float(self.random.uniform(0, 3e-4)))
            frame = self.simulation.advance(inputs, time_budget)
            self.entries.append(frame.journal)
            self.answers += frame.answers
            self.cuts += len(frame.cuts)
        self.positions = frame.positions.copy()
        return self

    def commands(self, number: int) -> list[Command]:
        chance = self.random.random()
        if number == 20:
            return [Command("grab", {"tool": "left", "radius": 0.03}, "g")]
        if number % 17 == 0:
            model = str(self.random.choice(registry.names()))
            return [Command("set_model", {"model": model, "parameters": {}}, f"m{number}")]
        if number == 33 or number == 36:
            return [Command("pause", {"on": number == 33})]
        if chance < 0.05:
            return [Command("release", {"hold_id": 0, "tool": "right"})]
        if number == 7:
            return [Command("grab", {"tool": "nobody", "radius": 0.03})]
        return []

    def edits(self, number: int) -> list:
        if number in (10, 25, 50):
            plan = split_at(self.simulation.mesh, self.splits.pop(), top=0.05)
            # The second is stale by then.
            return [plan, plan]
        return []

    def sample(self, tool: str) -> ToolSample:
        self.place[tool] += self.random.normal(scale=5e-4, size=3)
        edge = 0
        if self.random.random() < 0.08:
            self.level[tool] = not self.level[tool]
            edge = 1 if self.level[tool] else -1
        turn = self.random.normal(scale=0.02, size=4) + np.array([0, 0, 0, 1])
        pose = pose_of(self.place[tool], turn / np.linalg.norm(turn))
        return ToolSample(tool, pose, 1, self.level[tool], edge)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def session() -> Session:
    return Session(seed=3).run(80)


def through_json(entry: JournalEntry) -> JournalEntry:
    """The entry as its commands come out of a message."""
    commands = tuple(
        replace(command, arguments=json.loads(json.dumps(command.arguments)))
        for command in entry.inputs.commands
    )
    return replace(entry, inputs=replace(entry.inputs, commands=commands))


def test_the_session_is_worth_repeating(session: Session) -> None:
    errors = {answer.error for answer in session.answers}
    assert {"NONE", "STALE", "UNKNOWN_TOOL"} <= errors
    assert session.simulation.mesh.version == 4
    assert session.cuts > 0
    assert len({entry.steps for entry in session.entries}) > 5
    assert np.abs(session.simulation.state.displacement).max() > 1e-3


def test_a_replay_is_bit_exact(session: Session) -> None:
    result = replay([through_json(entry) for entry in session.entries], block_mesh())
    assert result.mismatches == ()
    assert result.frames == 80
    np.testing.assert_array_equal(result.positions, session.positions)
    again, first = result.simulation, session.simulation
    np.testing.assert_array_equal(again.state.displacement, first.state.displacement)
    np.testing.assert_array_equal(again.state.previous, first.state.previous)
    assert again.mesh.version == first.mesh.version
    assert again.model.name == first.model.name
    assert again.sim_time == first.sim_time
    assert list(again.holds.by_id) == list(first.holds.by_id)


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_other_sessions_are_repeated_as_well(seed: int) -> None:
    session = Session(seed).run(60)
    result = replay(session.entries, block_mesh())
    assert result.mismatches == ()
    np.testing.assert_array_equal(result.positions, session.positions)


def test_one_step_more_is_noticed(session: Session) -> None:
    entries = list(session.entries)
    entries[40] = replace(entries[40], steps=entries[40].steps + 5)
    result = replay(entries, block_mesh())
    assert 41 in result.mismatches


def test_another_model_gives_that_models_run(session: Session) -> None:
    result = replay(session.entries, block_mesh(), model="relaxation")
    assert result.simulation.model.name == "relaxation"
    assert result.mismatches == ()
    assert result.simulation.mesh.version == session.simulation.mesh.version
    assert not np.array_equal(result.positions, session.positions)
    assert np.isfinite(result.positions).all()


def test_a_model_prepared_beside_the_loop_is_the_one_a_replay_builds() -> None:
    simulation = block_simulation()
    entries = []

    def advance(*commands: Command, pull: float = 0.0) -> None:
        pose = pose_of(np.add(CORNER, [0, pull, 0]))
        inputs = FrameInputs(commands, tools=(ToolSample("grasper", pose),))
        entries.append(simulation.advance(inputs, Budget(steps=4)).journal)

    advance(Command("grab", {"tool": "grasper", "radius": 0.02}))
    plan = FrameInputs(edits=(split_at(simulation.mesh, 0.03, top=0.05),))
    entries.append(simulation.advance(plan, Budget(steps=4)).journal)
    prepared = simulation.build_model("quasi_static", {})
    advance(pull=0.004)
    simulation.offer_model("r", simulation.mesh.version, prepared)
    advance(Command("set_model", {"model": "quasi_static", "parameters": {}}, "r"), pull=0.008)
    assert simulation.model is prepared
    for number in range(5):
        advance(pull=0.008 + 0.001 * number)
    result = replay(entries, block_mesh())
    assert result.mismatches == ()


def test_a_deformed_start_is_in_the_journal() -> None:
    mesh = block_mesh()
    generator = np.random.default_rng(0)
    displacement = generator.normal(scale=1e-3, size=(mesh.node_rows, 3)).astype(np.float32)
    displacement[mesh.fixed[: mesh.node_rows]] = 0
    base = block_simulation(model="quasi_static").scene
    simulation = Simulation(mesh, replace(base, displacement=displacement))
    entries = [simulation.advance(FrameInputs(), Budget(steps=2)).journal for _ in range(3)]
    result = replay([through_json(entry) for entry in entries], block_mesh())
    assert result.mismatches == ()
    with pytest.raises(JournalError, match="not the first keyframe"):
        replay(entries, block_mesh(4))


def test_a_journal_without_its_beginning_is_refused(session: Session) -> None:
    with pytest.raises(JournalError, match="begins at frame 5"):
        replay(session.entries[4:], block_mesh())
    with pytest.raises(JournalError, match="empty"):
        replay([], block_mesh())


def test_a_gap_is_refused(session: Session) -> None:
    with pytest.raises(JournalError, match="frame 4 follows frame 2"):
        replay([*session.entries[:2], *session.entries[3:]], block_mesh())


def test_epochs_are_replayed_one_at_a_time(session: Session) -> None:
    other = Session(seed=9).run(3)
    mixed = [*session.entries[:3], *other.entries]
    with pytest.raises(JournalError, match="one epoch at a time"):
        replay(mixed, block_mesh())
    epochs = epochs_of(reversed(mixed))
    assert [len(entries) for entries in epochs.values()] == [3, 3]
    for entries in epochs.values():
        assert replay(entries, block_mesh()).mismatches == ()


def test_a_later_keyframe_is_refused(session: Session) -> None:
    mesh = block_mesh()
    mesh.apply(split_at(mesh, 0.03))
    with pytest.raises(JournalError, match="version 2"):
        replay(session.entries, mesh)
