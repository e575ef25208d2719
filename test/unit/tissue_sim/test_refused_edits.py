"""Edits, undos and redos that cannot be: refused with a code, and no bit is changed."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cut_service.cut_parameters import SPECS
from cut_service.trial import remembered
from cut_service.watch_parameters import WATCH_SPECS
from support.refused_requests import ALONGSIDE, EDITS, as_markdown
from support.small_block import block_simulation
from support.split_edit import split_at
from tissue_sim.frame import Answer
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.interaction.tracker import ToolLimits
from tissue_sim.live import LiveSimulation
from tissue_sim.parameters import ParameterError, Spec
from tissue_sim.requests import PlannedEdit, Request

PATIENCE = 60.0
OTHERS = "while an organ is loaded or reset"


class Loop:
    """A live simulation of a block that is cut half through, and its frames."""

    def __init__(self, folder: Path) -> None:
        simulation = block_simulation(model="quasi_static")
        self.live = LiveSimulation(simulation, ToolLimits(), folder, steps_per_frame=2)
        self.now = 0.0

    @property
    def mesh(self) -> Any:
        return self.live.simulation.mesh

    def frame(self) -> None:
        self.now += 1 / 60
        self.live.next_frame(self.now)[1]()

    def post(self, kind: str, **arguments: Any) -> list[Answer]:
        answers: list[Answer] = []
        self.live.post(Request(kind, arguments, "", answers.append))
        return answers

    def post_edit(self, edit: TopologyEdit, epoch: bytes | None = None) -> list[Answer]:
        planned = PlannedEdit(edit, epoch or self.live.simulation.epoch)
        return self.post("edit", planned=planned)

    def until(self, answers: list[Answer]) -> Answer:
        deadline = time.monotonic() + PATIENCE
        while not answers:
            assert time.monotonic() < deadline
            self.frame()
            time.sleep(0.001)
        return answers[0]

    def bits(self) -> tuple[dict[str, str], int, bytes]:
        """All that a refusal must not change."""
        state = self.live.simulation.state.displacement
        return remembered(self.mesh), self.mesh.version, state.tobytes()


@pytest.fixture
def loop(tmp_path: Path) -> Loop:
    made = Loop(tmp_path)
    assert made.until(made.post_edit(split_at(made.mesh, 0.015, 0.03))).success
    return made


def test_edits_that_cannot_be_applied_are_refused_and_change_nothing(loop: Loop) -> None:
    before, unlike = loop.bits(), []
    for what, (code, edit) in EDITS.items():
        answer = loop.until(loop.post_edit(edit(loop.mesh)))
        if answer.success or answer.error != code or not answer.message:
            unlike.append(f"{what}: {answer.error} instead of {code}: {answer.message}")
        assert loop.bits() == before, what
    assert unlike == []
    # It was not the mesh: a sound one is applied.
    assert loop.until(loop.post_edit(split_at(loop.mesh, 0.03))).success


def test_an_edit_of_another_epoch_and_the_second_of_two_at_once_are_stale(loop: Loop) -> None:
    codes = ALONGSIDE["tissue/apply_edit"]
    before = loop.bits()
    other = loop.until(loop.post_edit(split_at(loop.mesh, 0.03), b"x" * 16))
    assert other.error == codes["planned in another epoch"]
    assert loop.bits() == before
    # Both come before the frame, planned on the same tissue.
    one, two = (loop.post_edit(split_at(loop.mesh, 0.03)) for _ in range(2))
    loop.frame()
    assert one[0].success
    assert two[0].error == codes["the second of two that part the same tissue"]
    assert loop.mesh.version == before[1] + 1


def test_there_is_nothing_to_undo_or_redo_twice(loop: Loop) -> None:
    undo, redo = ALONGSIDE["tissue/undo"], ALONGSIDE["tissue/redo"]
    before = loop.bits()
    assert loop.until(loop.post("redo")).error == redo["no edit was undone"]
    assert loop.bits() == before
    assert loop.until(loop.post("undo")).success
    before = loop.bits()
    assert loop.until(loop.post("undo")).error == undo["all are undone"]
    assert loop.bits() == before
    assert loop.until(loop.post_edit(split_at(loop.mesh, 0.045))).success
    before = loop.bits()
    assert loop.until(loop.post("redo")).error == redo["another edit was made since"]
    assert loop.bits() == before


def test_what_the_model_will_not_have_is_neither_undone_nor_redone(
    loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in ("undo", "redo"):
        before = loop.bits()
        with monkeypatch.context() as patched:
            patched.setattr(loop.live.simulation.model, "refusal", lambda _: "not now")
            refused = loop.until(loop.post(kind))
        code = ALONGSIDE[f"tissue/{kind}"]["the model will not have it"]
        assert (refused.success, refused.error) == (False, code)
        assert "not now" in refused.message
        assert loop.bits() == before
        assert loop.until(loop.post(kind)).success


@pytest.mark.parametrize("job", ["reset", "set_model"])
def test_while_something_else_is_under_way_requests_are_busy(
    loop: Loop, job: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    live, hurry = loop.live, [False]
    held_up = {"reset": "_epoch", "set_model": "build_model"}[job]
    owner: Any = live if job == "reset" else live.simulation
    work: Callable[..., Any] = getattr(owner, held_up)

    def slowly(*given: Any) -> Any:
        deadline = time.monotonic() + PATIENCE
        while not hurry[0] and time.monotonic() < deadline:
            time.sleep(0.001)
        return work(*given)

    monkeypatch.setattr(owner, held_up, slowly)
    finished = loop.post(job, **({"model": "lr", "parameters": {}} if job == "set_model" else {}))
    loop.frame()
    before = loop.bits()
    for kind in ("undo", "redo"):
        table = ALONGSIDE[f"tissue/{kind}"]
        code = table[OTHERS if job == "reset" else "while a model is built"]
        assert loop.until(loop.post(kind)).error == code
    if job == "reset":
        refused = loop.until(loop.post_edit(split_at(loop.mesh, 0.03)))
        assert refused.error == ALONGSIDE["tissue/apply_edit"][OTHERS]
    else:
        # An edit waits for the model, and is carried out then.
        waiting = loop.post_edit(split_at(loop.mesh, 0.03))
        loop.frame()
        assert not waiting
    assert loop.bits() == before
    hurry[0] = True
    assert loop.until(finished).success
    if job == "set_model":
        assert loop.until(waiting).success


@pytest.mark.parametrize("spec", [*SPECS, *WATCH_SPECS], ids=lambda spec: spec.name)
def test_parameters_of_cutting_tearing_and_burning_keep_their_ranges(spec: Spec) -> None:
    bad: list[Any] = ["a lot", None, [1.0]]
    if spec.kind == "string":
        bad = ["no such choice", 3]
    if spec.kind == "double":
        bad += [np.nan, np.inf, -np.inf]
    if spec.minimum is not None:
        bad.append(spec.minimum - 1)
    if spec.maximum is not None:
        bad.append(spec.maximum * 2 + 1)
    for value in bad:
        with pytest.raises(ParameterError, match=rf"{spec.name} = .* is not allowed; allowed: "):
            spec.checked(value)


def test_the_page_shows_what_is_refused(repository: Path) -> None:
    assert as_markdown() in (repository / "docs/cutting.md").read_text(encoding="utf-8")
