"""LR spring-mass: elastic near the instruments, relaxed everywhere."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.active_set import ActiveSet
from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.quasi_static import (
    FORCE_STEP,
    KEEP_UNTIL_REST,
    RELEASE_MOMENTUM,
    REST_TOLERANCE,
    STEP,
    steps_of,
)
from tissue_sim.elastic.relaxation import FULL_EXCESS, PASSES, RelaxationPass, linear_factor
from tissue_sim.elastic.spring_model import SpringModel
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh


class LocalRelaxation(SpringModel):
    """A quasi-static sweep near the held nodes, then a relaxation pass over the whole organ.

    A released region goes on with quasi-static sweeps wherever the tissue is displaced, until it
    rests.

    Limitations: see docs/local_relaxation.md.
    """

    name: ClassVar[str] = "lr"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        STEP,
        FORCE_STEP,
        Parameter(
            "levels", 4, 1, WHOLE_ORGAN, "",
            f"breadth-first levels around the held nodes that are elastic; {WHOLE_ORGAN}: all",
            integer=True,
        ),
        Parameter("sweeps", 1, 1, 100, "", "quasi-static sweeps in a step", integer=True),
        linear_factor(0.1),
        PASSES,
        FULL_EXCESS,
        REST_TOLERANCE,
        KEEP_UNTIL_REST,
        RELEASE_MOMENTUM,
    )  # fmt: skip

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        step, force_step = steps_of(self.values, self.springs)
        self.active = ActiveSet(
            self.springs, int(self.values["levels"]), self.values["rest_tolerance"],
            bool(self.values["keep_until_rest"]), self.values["release_momentum"], alone=False,
            force_step=force_step,
        )  # fmt: skip
        self.relaxation = RelaxationPass(self.springs, self.values)
        self._sweeps = int(self.values["sweeps"])
        self._step = self.scalar(step)
        self._outside = 0
        self._longest = self.springs.stitches.threads.length

    @property
    def idle(self) -> bool:
        """Whether nothing is swept and no spring was outside its limits."""
        return self.active.count == 0 and self._outside == 0

    def step(self, state: State) -> None:
        """The sweeps and one run of relaxation. Modifies the state in place."""
        for _ in range(self._sweeps):
            self.active.sweep(state, self._step)
        self._outside = self.relaxation.run(state, self._limits(state))

    def _limits(self, state: State) -> NDArray[np.float64]:
        """A pass makes no stitch longer than the sweep left it; unswept ones stay as they were."""
        stitches = self.springs.stitches
        if not len(stitches):
            return self._longest
        swept = self.active.moving_sewn(state)
        place = np.full(self.mesh.node_capacity, False)
        place[stitches.nodes] = swept
        elastic = place[stitches.threads.ends].any(axis=1)
        now = stitches.lengths(state.displacement)
        self._longest = np.where(elastic, np.maximum(now, stitches.threads.length), self._longest)
        return self._longest

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Order nodes and springs anew from the held nodes."""
        self.active.prescribed_changed(state, held)
        self.relaxation.prescribed_changed(self.active.ordering)
        self._remember_lengths(state)

    def nodes_placed(self, nodes: NDArray[np.int32]) -> None:
        """Forget the last moves of nodes that were put elsewhere."""
        self.active.lingering.forget(nodes)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit in time proportional to it."""
        springs = self.springs.follow(change)
        self.active.follow(change, state)
        self.relaxation.follow(springs)
        self._remember_lengths(state)

    def _remember_lengths(self, state: State) -> None:
        """Stitches may stay as long as they are now, until they are swept."""
        stitches = self.springs.stitches
        now = stitches.lengths(state.displacement)
        self._longest = np.maximum(now, stitches.threads.length)

    def residual(self, state: State) -> float:
        """Largest internal force on a free active node [N]."""
        return self.active.residual(state)
