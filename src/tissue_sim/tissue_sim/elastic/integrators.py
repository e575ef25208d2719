"""Integrators of the equation of motion, and the longest time step each of them is stable with."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from tissue_sim.elastic.internal_forces import InternalForces
from tissue_sim.elastic.model import Parameter, State
from tissue_sim.kernels.integrators import Nodes, Stages, add_stage, begin_stages, end_stages

VERLET, EULER, RUNGE_KUTTA_2, RUNGE_KUTTA_4 = 0, 1, 2, 3

NAMES = ("Verlet", "explicit Euler", "Runge-Kutta 2", "Runge-Kutta 4")

INTEGRATOR = Parameter(
    "integrator", VERLET, VERLET, RUNGE_KUTTA_4, "",
    "0: Verlet, 1: explicit Euler, 2: Runge-Kutta 2 (midpoint), 3: Runge-Kutta 4; 1 and 2 are "
    "stable with damping only",
    integer=True,
)  # fmt: skip


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method each of whose stages starts from the one before only.

    Attributes:
        weights: Weight of each stage's slope in the step.
        ahead: How far the next stage lies along it, in time steps.
    """

    weights: tuple[float, ...]
    ahead: tuple[float, ...]


TABLEAUS = {
    EULER: Tableau((1.0,), (0.0,)),
    RUNGE_KUTTA_2: Tableau((0.0, 1.0), (0.5, 0.0)),
    RUNGE_KUTTA_4: Tableau((1 / 6, 1 / 3, 1 / 3, 1 / 6), (0.5, 0.5, 1.0, 0.0)),
}


def evaluations(integrator: int) -> int:
    """How often an integrator computes the forces in a time step."""
    return len(TABLEAUS[integrator].weights) if integrator in TABLEAUS else 1


def stability_limit(integrator: int, damping: float) -> float:
    """Largest h^2 omega^2 up to which every oscillation u'' = -omega^2 u - (d / h) u' dies away.

    With y = h^2 omega^2 the two eigenvalues of a step have the product (the determinant)

        Verlet: 1 - d, and the trace decides: y < 4 - 2 d;
        explicit Euler: 1 - d + y < 1, so y < d;
        Runge-Kutta 2: below 1 for y^2 - 2 d y - 4 d (1 - d/2) < 0;
        Runge-Kutta 4: below 1 up to its first root beyond y = 1; 8 for d = 0.

    Args:
        integrator: `VERLET`, `EULER`, `RUNGE_KUTTA_2` or `RUNGE_KUTTA_4`.
        damping: d, in [0, 0.9].
    """
    if integrator == VERLET:
        return 4.0 - 2.0 * damping
    if integrator == EULER:
        return damping
    if integrator == RUNGE_KUTTA_2:
        return damping + math.sqrt(damping * (4.0 - damping))
    roots = np.asarray((_determinant(4, damping) - 1.0).roots(), dtype=np.complex128)
    return float(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 1.0)].min())


def _determinant(order: int, damping: float) -> Polynomial:
    """Determinant of a step with the Taylor polynomial of this order, as a polynomial in y.

    The eigenvalues z of the system obey z^2 = -d z - y; so every power is a + b z.
    """
    y = Polynomial([0.0, 1.0])
    a, b = Polynomial([1.0]), Polynomial([0.0])
    sum_a, sum_b = a, b
    for power in range(1, order + 1):
        a, b = -y * b, a - damping * b
        sum_a = sum_a + a / math.factorial(power)
        sum_b = sum_b + b / math.factorial(power)
    return sum_a * sum_a - damping * sum_a * sum_b + y * sum_b * sum_b


class RungeKutta:
    """Explicit Runge-Kutta steps of a state whose velocity is (displacement - previous) / h.

    `previous` is where a node would come from at its present velocity. The moves kept here are the
    same to more digits; a node whose `previous` somebody else has written starts with what it says.
    """

    def __init__(self, forces: InternalForces, integrator: int) -> None:
        """Prepare steps of an integrator of `TABLEAUS`."""
        self.forces = forces
        dtype, capacity = forces.springs.dtype, forces.mesh.node_capacity
        tableau = TABLEAUS[integrator]
        self._stages = tuple(
            (dtype(weight), dtype(ahead))
            for weight, ahead in zip(tableau.weights, tableau.ahead, strict=True)
        )
        self._p = np.zeros((capacity, 3), dtype=dtype)
        self._work = Stages(*(np.zeros_like(self._p) for _ in range(4)))

    def step(self, nodes: Nodes, state: State, F: NDArray[np.floating]) -> None:
        """One time step. Modifies the state in place; `F` is overwritten.

        Args:
            nodes: What a step needs to know of the nodes.
            state: Displacements; `previous` is read as the velocity.
            F: Place for forces, shape (node_capacity, 3).
        """
        u, previous, p, work = state.displacement, state.previous, self._p, self._work
        begin_stages(nodes, u, previous, p, work)
        for weight, ahead in self._stages:
            self.forces.evaluate(work.u, F)
            add_stage(nodes, F, weight, ahead, u, p, work)
        end_stages(nodes, work, u, previous, p)

    def prescribed_changed(self, state: State) -> None:
        """Nodes that come from where they are have no velocity, to the last digit."""
        self._p[(state.previous == state.displacement).all(axis=1)] = 0.0

    def grow(self, capacity: int) -> None:
        """Make place for more nodes."""
        more = np.zeros((capacity - len(self._p), 3), dtype=self._p.dtype)
        self._p = np.concatenate([self._p, more])
        self._work = Stages(*(np.zeros_like(self._p) for _ in range(4)))
