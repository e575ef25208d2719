"""Relaxation: springs outside their limits are put at them, one after the other."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.ordering import NodeOrdering, SpringOrdering
from tissue_sim.elastic.spring_model import SpringModel
from tissue_sim.elastic.springs import SpringChange, SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.springs import relax_springs

PASSES = Parameter("passes", 1, 1, 100, "", "relaxation passes in a step", integer=True)
FULL_EXCESS = Parameter(
    "full_excess", 0, 0, 1, "",
    "1: each of two free ends moves the whole excess, as the thesis lists it; 0: half each",
    integer=True,
)  # fmt: skip


def linear_factor(default: float) -> Parameter:
    """The share of its rest length that a spring may be longer or shorter."""
    meaning = "share of its rest length that a spring may be longer or shorter"
    return Parameter("linear_factor", default, 0.0, 0.9, "", meaning)


class RelaxationPass:
    """Relaxation passes over all springs in the order of the nodes."""

    def __init__(self, springs: SpringNetwork, values: dict[str, float]) -> None:
        """Prepare passes with the values of `linear_factor`, `passes` and `full_excess`."""
        eps = values["linear_factor"]
        share = 1.0 if values["full_excess"] else 0.5
        self.springs = springs
        self.order = SpringOrdering(springs)
        self._passes = int(values["passes"])
        self._limits = np.array([eps, eps * (2 + eps), -eps * (2 - eps), share], springs.dtype)

    def run(self, state: State) -> int:
        """The passes of one step. Modifies the state in place.

        Returns:
            Number of springs that the last pass found outside their limits.
        """
        outside = 0
        for _ in range(self._passes):
            outside = relax_springs(
                self.order.list, 0, self.order.used, state.prescribed, self._limits,
                self.springs.tiny, state.displacement,
            )  # fmt: skip
        return int(outside)


class Relaxation(SpringModel):
    """Every spring outside [l0 (1 - eps), l0 (1 + eps)] is put at that limit, half by each end.

    Limitations: no forces; what lies within the limits does not return to rest; see
    docs/relaxation.md.
    """

    name: ClassVar[str] = "relaxation"
    parameters: ClassVar[tuple[Parameter, ...]] = (linear_factor(0.00035), PASSES, FULL_EXCESS)
    has_forces = False

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        self.relaxation = RelaxationPass(self.springs, self.values)
        self._nodes = NodeOrdering(self.springs)
        self._ordered = False

    def step(self, state: State) -> None:
        """One step of `passes` passes over all springs. Modifies the state in place."""
        self.relaxation.run(state)

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Order the springs anew from the held nodes; with none held the last order stays."""
        if len(held) or not self._ordered:
            self._nodes.search(held.astype(np.int32), state.prescribed)
            self._ordered = bool(len(held))
        self.relaxation.order.order(self._nodes, state.prescribed)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit in time proportional to it."""
        springs: SpringChange = self.springs.follow(change)
        self._nodes.follow(change)
        self.relaxation.order.follow(springs)

    def residual(self, state: State) -> float:
        """Has no meaning without forces: nan."""
        return math.nan
