"""Preconditioned conjugate gradients, one iteration at a time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.rigid_aggregates import RigidAggregates
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.kernels.stiffness import (
    Vectors,
    add_coarse,
    advance_solution,
    next_direction,
    product,
)

MOST_ITERATIONS = 5000


class ConjugateGradients:
    """Solves K x = b in the free nodes, going on where it was left.

    Attributes:
        residual: Norm of b - K x in free nodes [N].
        largest: Largest preconditioned residual of a node [m]: how far it may still have to go.
        iterations: Made since `begin`.
        stuck: Whether rounding, or a matrix that is not positive definite, keeps it from going on.
    """

    def __init__(self, stiffness: Stiffness) -> None:
        """Prepare the preconditioner."""
        self._stiffness = stiffness
        self._aggregates = RigidAggregates(stiffness)
        capacity, dtype = stiffness.springs.mesh.node_capacity, stiffness.springs.dtype
        self._vectors = _zero_vectors(capacity, dtype)
        self.residual = self.largest = self._rz = 0.0
        self.iterations, self.stuck = 0, False

    @property
    def x(self) -> NDArray[np.floating]:
        """The solution, with prescribed values in prescribed nodes, shape (node_capacity, 3)."""
        return self._vectors.x

    @property
    def coarse_unknowns(self) -> int:
        """Unknowns of the coarse part of the preconditioner."""
        return self._aggregates.force.size

    def begin(self, prescribed: NDArray[np.bool_], shape: NDArray[np.floating]) -> None:
        """Solve K (shape + change of x) = 0 in the free nodes; x is where its change is added.

        Args:
            prescribed: Nodes that do not move, shape (node_capacity,).
            shape: Displacements to start from [m], shape (node_capacity, 3); may be `x` itself.
        """
        r = self._vectors.r
        self._product(prescribed, shape, r)
        np.negative(r, out=r)
        self._vectors.p[:] = 0
        self.iterations, self.stuck = 0, False
        self._rz = 0.0
        self._precondition(prescribed, 0.0)

    def iterate(self, prescribed: NDArray[np.bool_]) -> None:
        """One iteration. Modifies `x` in place."""
        pq = self._product(prescribed, self._vectors.p, self._vectors.q)
        if not pq > 0.0 or not math.isfinite(pq) or self.iterations >= MOST_ITERATIONS:
            self.stuck = True
            return
        self._precondition(prescribed, self._rz / pq)
        self.iterations += 1

    def _product(
        self, prescribed: NDArray[np.bool_], x: NDArray[np.floating], y: NDArray[np.floating]
    ) -> float:
        count = self._stiffness.springs.mesh.node_rows
        return float(product(count, self._stiffness.rows, prescribed, x, y))

    def _precondition(self, prescribed: NDArray[np.bool_], alpha: float) -> None:
        count, coarse = self._stiffness.springs.mesh.node_rows, self._aggregates
        squared = advance_solution(
            count, alpha, self._vectors, self._stiffness.inverse, coarse.arrays, coarse.force
        )
        coarse.solve()
        rz, largest = add_coarse(count, prescribed, coarse.arrays, coarse.motion, self._vectors)
        self.residual, self.largest = math.sqrt(squared), math.sqrt(largest)
        next_direction(
            count, rz / self._rz if self._rz > 0.0 else 0.0, self._vectors.z, self._vectors.p
        )
        self._rz = float(rz)

    def follow(self, copied: NDArray[np.int32], parents: NDArray[np.int32]) -> None:
        """Make place for copies of nodes, which join their parents in the preconditioner."""
        capacity = self._stiffness.springs.mesh.node_capacity
        self._aggregates.follow(copied, parents, capacity)
        if capacity > len(self.x):
            self._vectors = _zero_vectors(capacity, self.x.dtype.type)


def _zero_vectors(capacity: int, dtype: type[np.floating]) -> Vectors:
    return Vectors(*(np.zeros((capacity, 3), dtype=dtype) for _ in range(5)))
