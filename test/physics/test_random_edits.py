"""Whatever is cut, torn, burned, patched, sewn and undone, in whatever order: always valid.

hypothesis chooses the order and shrinks it to the shortest one that fails.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from cut_service import random_edits
from cut_service.trial import Trial
from support.sheets import ball, shell
from support.valid_mesh import check_valid
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block, sphere_shell, wall
from tissue_sim.geometry.sheet_geometry import CONNECTED, SURFACE, SheetSettings, with_sheet

SEEDS = st.integers(0, 2**32 - 1)
TETRAHEDRA: dict[str, Callable[[], RawMesh]] = {
    "block": lambda: block(5, 4, 5, 0.04, 0.03, 0.04),
    "wall": lambda: wall(9, 11, 2),
    "shell": lambda: sphere_shell(subdivisions=2, layers=2),
}
SHEETS: dict[str, Callable[[], RawMesh]] = {
    "surface": lambda: with_sheet(ball(), SheetSettings(SURFACE), []),
    "connected": lambda: with_sheet(shell(), SheetSettings(CONNECTED), []),
}


@cache
def raw_organ(name: str) -> RawMesh:
    return (TETRAHEDRA | SHEETS)[name]()


class Edits(RuleBasedStateMachine):
    """An organ that goes through anything; `Trial` checks each edit for all that it owes."""

    names: tuple[str, ...] = ()

    @initialize(data=st.data(), seed=SEEDS)
    def begin(self, data: st.DataObject, seed: int) -> None:
        raw = raw_organ(data.draw(st.sampled_from(self.names)))
        random = np.random.default_rng(seed)
        fixed = raw.points[:, 2] < raw.points[:, 2].min() + 0.1 * np.ptp(raw.points[:, 2])
        self.trial = Trial(raw, fixed if random.integers(2) else None, random)

    def by(self, operation: Callable[[Trial], None], seed: int) -> None:
        self.trial.random = np.random.default_rng(seed)
        operation(self.trial)

    @rule(seed=SEEDS)
    def deform(self, seed: int) -> None:
        self.by(random_edits.deform, seed)

    @rule(
        seed=SEEDS,
        way=st.sampled_from(list(random_edits.WAYS)),
        share=st.sampled_from(random_edits.SHARES),
    )
    def cut(self, seed: int, way: str, share: float) -> None:
        self.by(lambda trial: random_edits.cut(trial, way, share), seed)

    @rule(seed=SEEDS)
    def tear(self, seed: int) -> None:
        self.by(random_edits.tear, seed)

    @precondition(lambda self: self.trial.mesh.sheet_rows is None)
    @rule(seed=SEEDS)
    def burn(self, seed: int) -> None:
        self.by(random_edits.burn, seed)

    @rule(seed=SEEDS)
    def patch(self, seed: int) -> None:
        self.by(random_edits.patch, seed)

    @precondition(lambda self: len(self.trial.mesh.patches) > 0)
    @rule(seed=SEEDS)
    def sew_rim(self, seed: int) -> None:
        self.by(random_edits.sew_rim, seed)

    @rule(seed=SEEDS)
    def sew(self, seed: int) -> None:
        self.by(random_edits.sew, seed)

    @precondition(lambda self: len(self.trial.mesh.sutures) > 0)
    @rule(seed=SEEDS, what=st.sampled_from([random_edits.tighten, random_edits.unsew]))
    def change_stitches(self, seed: int, what: Callable[[Trial], None]) -> None:
        self.by(what, seed)

    @precondition(lambda self: len(self.trial.mesh.sutures) > 0)
    @rule(seed=SEEDS)
    def cut_thread(self, seed: int) -> None:
        self.by(random_edits.cut_thread, seed)

    @precondition(lambda self: len(self.trial.history.done) > 0)
    @rule(steps=st.integers(1, 8))
    def undo(self, steps: int) -> None:
        self.trial.go_back(steps)

    @precondition(lambda self: len(self.trial.history.undone) > 0)
    @rule(steps=st.integers(1, 8))
    def redo(self, steps: int) -> None:
        self.trial.go_on(steps)

    @invariant()
    def nothing_is_wrong(self) -> None:
        if hasattr(self, "trial"):
            assert self.trial.faults == []

    def teardown(self) -> None:
        if not hasattr(self, "trial"):
            return
        self.trial.finish()
        assert self.trial.faults == []
        if self.trial.mesh.sheet_rows is None:
            # Once more, by what tests of other edits ask.
            assert check_valid(self.trial.mesh).components == self.trial.valid.parts


@pytest.mark.parametrize("names", [tuple(TETRAHEDRA), tuple(SHEETS)], ids=["solid", "sheets"])
def test_any_edits_in_any_order_leave_a_valid_mesh_and_undo_is_exact(
    names: tuple[str, ...],
) -> None:
    class EditsOf(Edits):
        pass

    EditsOf.names = names
    quick = settings(
        max_examples=15, stateful_step_count=20, deadline=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    run_state_machine_as_test(EditsOf, settings=quick)
