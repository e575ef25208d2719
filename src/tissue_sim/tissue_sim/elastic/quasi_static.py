"""Quasi-static springs: no mass, no damping, every sweep one step towards equilibrium."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.acceleration import CHEBYSHEV, acceleration_of
from tissue_sim.elastic.active_set import ActiveSet
from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.spring_model import SpringModel
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh

STEP = Parameter(
    "step", 1.9, 0.01, 1.99, "", "share of the stable step that a node takes against its force"
)
FORCE_STEP = Parameter(
    "force_step", 0.0, 0.0, 1e6, "m/N",
    "instead of step, as in the thesis: how far a node moves against its force, stable or not; 0: "
    "not used",
)  # fmt: skip
REST_TOLERANCE = Parameter(
    "rest_tolerance", 1e-8, 1e-12, 1e-3, "m", "largest move in a sweep that counts as rest"
)
KEEP_UNTIL_REST = Parameter(
    "keep_until_rest", 1, 0, 1, "",
    "1: nodes that leave the active set stay in it until they rest; 0: they stop where they are",
    integer=True,
)  # fmt: skip

RELEASE_MOMENTUM = Parameter(
    "release_momentum", 0.95, 0.0, 0.98, "",
    "share of its last move that a node coming to rest repeats: released tissue returns sooner",
)  # fmt: skip


def steps_of(values: dict[str, float], springs: SpringNetwork) -> tuple[float, float]:
    """Share of the stable step, and step for a force [m/N]; one of them is zero.

    Raises:
        ValueError: `force_step` does not go with other values, or with torsion springs.
    """
    force_step = values["force_step"]
    if force_step == 0.0:
        return values["step"], 0.0
    for name in ("keep_until_rest", "momentum", "chebyshev"):
        if values.get(name):
            raise ValueError(
                f"force_step = {force_step:g} m/N is the plain sweep of the thesis and does not go "
                f"with {name} = {values[name]:g}; allowed with it: {name} = 0"
            )
    if springs.torsion is not None:
        raise ValueError(
            f"force_step = {force_step:g} m/N does not go with torsion springs; allowed: "
            "force_step = 0, or stiffness.torsion = 0"
        )
    return 0.0, force_step


class QuasiStatic(SpringModel):
    """Gauss-Seidel sweeps u_i += alpha F_i / sum_j k_ij, breadth-first from the held nodes.

    Limitations: springs do not resist inversion of elements; large models converge slowly; see
    docs/quasi_static.md.
    """

    name: ClassVar[str] = "quasi_static"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        STEP,
        FORCE_STEP,
        Parameter(
            "levels", 30, 1, WHOLE_ORGAN, "",
            f"breadth-first levels around the held nodes that move; {WHOLE_ORGAN}: all",
            integer=True,
        ),
        Parameter(
            "threshold", 0.0, 0.0, 1e-2, "m",
            "a sweep ends behind the first level none of whose nodes moved farther; 0: never",
        ),
        REST_TOLERANCE,
        KEEP_UNTIL_REST,
        RELEASE_MOMENTUM,
        Parameter(
            "momentum", 0.0, 0.0, 0.98, "",
            "share of its last move that a node near a hold repeats before a sweep; 0: none",
        ),
        CHEBYSHEV,
    )  # fmt: skip

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        momentum, chebyshev = self.values["momentum"], self.values["chebyshev"]
        if self.values["threshold"] > 0.0 and (momentum > 0.0 or chebyshev > 0.0):
            raise ValueError(
                f"threshold = {self.values['threshold']:g} m ends sweeps early; allowed with "
                "momentum or chebyshev: 0"
            )
        step, force_step = steps_of(self.values, self.springs)
        self.active = ActiveSet(
            self.springs, int(self.values["levels"]), self.values["rest_tolerance"],
            bool(self.values["keep_until_rest"]), self.values["release_momentum"],
            acceleration=acceleration_of(self.springs, momentum, chebyshev), force_step=force_step,
        )  # fmt: skip
        self._step = self.scalar(step)
        self._threshold = self.values["threshold"]

    @property
    def idle(self) -> bool:
        """Whether nothing is swept."""
        return self.active.count == 0

    def step(self, state: State) -> None:
        """One sweep. Modifies the state in place."""
        self.active.sweep(state, self._step, self._threshold)

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Order the nodes anew from the held ones."""
        self.active.prescribed_changed(state, held)

    def nodes_placed(self, nodes: NDArray[np.int32]) -> None:
        """Forget the last moves of nodes that were put elsewhere."""
        self.active.lingering.forget(nodes)

    @property
    def takes_guess(self) -> bool:
        """Sweeps go on from any shape."""
        return True

    def guess(
        self, state: State, before: NDArray[np.floating], after: NDArray[np.floating]
    ) -> None:
        """Move the nodes near holds; see `Model`. Modifies the state in place."""
        self.active.guess(state, before, after)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit in time proportional to it."""
        self.springs.follow(change)
        self.active.follow(change, state)

    def residual(self, state: State) -> float:
        """Largest internal force on a free active node [N]."""
        return self.active.residual(state)
