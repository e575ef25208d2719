"""Preconditioned conjugate gradients for several right-hand sides, one iteration at a time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.rigid_aggregates import RigidAggregates
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.kernels.conjugate_lanes import (
    advance_solutions,
    next_directions,
    precondition,
    product,
    squared_forces,
)
from tissue_sim.kernels.lanes import LANES
from tissue_sim.kernels.stiffness import Vectors

MOST_ITERATIONS = 5000


class ConjugateGradients:
    """Solves K x = b in the free nodes in four lanes, which begin and end each by itself.

    A sweep over the matrix costs little more for four right-hand sides than for one: it waits for
    the matrix.

    Attributes:
        active: Lanes that are being solved, shape (4,).
        residual: Norm of b - K x in free nodes by lane [N], shape (4,).
        largest: Largest preconditioned residual of a node by lane [m]: how far it may have to go.
        iterations: Made since `begin`, by lane.
        stuck: Lanes that rounding, or a matrix that is not positive definite, keeps from going on.
    """

    def __init__(self, stiffness: Stiffness) -> None:
        """Prepare the preconditioner."""
        self._stiffness = stiffness
        self._aggregates = RigidAggregates(stiffness)
        self._vectors = _zero_vectors(stiffness.springs.mesh.node_capacity, stiffness.springs.dtype)
        dtype = stiffness.springs.dtype
        self._coarse = np.zeros((len(self._aggregates.force), 6, LANES), dtype=dtype)
        self._motion = np.zeros_like(self._coarse)
        self._steps = np.zeros((1, 2, LANES), dtype=dtype)
        self._betas = np.zeros((1, 1, LANES), dtype=dtype)
        self._products, self._squared = np.zeros(LANES), np.zeros(LANES)
        self._dots = np.zeros((2, LANES))
        self._rz = np.zeros(LANES)
        self._begun = np.zeros(LANES, dtype=bool)
        self.active, self.stuck = np.zeros(LANES, dtype=bool), np.zeros(LANES, dtype=bool)
        self.residual, self.largest = np.zeros(LANES), np.zeros(LANES)
        self.iterations = np.zeros(LANES, dtype=np.int64)

    @property
    def x(self) -> NDArray[np.floating]:
        """The solutions, prescribed values in prescribed nodes, shape (node_capacity, 3, 4)."""
        return self._vectors.x

    @property
    def coarse_bytes(self) -> int:
        """Memory that the coarse part of the preconditioner reads in an iteration at least."""
        return self._aggregates.bytes

    def begin(self, lane: int, shape: NDArray[np.floating], change: bool = False) -> None:
        """Solve K (shape + change) = 0 in the free nodes.

        Args:
            lane: Which; what it was solving is given up.
            shape: Displacements to start from [m], shape (node_capacity, 3).
            change: Whether x is to be the change alone, instead of shape and change.
        """
        # The first iteration takes K times the direction for the residual.
        self._vectors.x[:, :, lane] = 0.0 if change else shape
        self._vectors.r[:, :, lane] = 0.0
        self._vectors.p[:, :, lane] = shape
        self.active[lane], self._begun[lane], self.stuck[lane] = True, False, False
        self.iterations[lane] = 0
        self._rz[lane] = 0.0

    def load(self, lane: int, nodes: NDArray[np.int32], forces: NDArray[np.float64]) -> None:
        """Solve K (shape + change) = forces instead, which are zero elsewhere; right after `begin`.

        Args:
            lane: Which.
            nodes: Rows of free nodes.
            forces: Forces on them [N], shape (len(nodes), 3).
        """
        self._vectors.r[nodes, :, lane] = forces

    def end(self, lane: int) -> None:
        """Leave a lane alone; its x stays until it begins again."""
        self.active[lane] = False

    def iterate(self, prescribed: NDArray[np.bool_]) -> None:
        """One iteration of every active lane. Modifies `x` in place."""
        count = self._stiffness.springs.mesh.node_rows
        vectors, aggregates = self._vectors, self._aggregates
        product(count, self._stiffness.rows, prescribed, vectors.p, vectors.q, self._products)
        for lane in range(LANES):
            self._steps[0, :, lane] = self._step(lane)
        advance_solutions(
            count, self._steps, vectors, aggregates.arrays, self._coarse, self._squared
        )
        aggregates.solve_lanes(self._coarse, self._motion)
        precondition(
            count, prescribed, self._stiffness.inverse, aggregates.arrays, self._motion, vectors,
            self._dots,
        )  # fmt: skip
        for lane in range(LANES):
            self._betas[0, 0, lane] = self._beta(lane)
        next_directions(count, self._betas, vectors.z, vectors.p)

    def _step(self, lane: int) -> tuple[float, float]:
        """Shares of p in the step of x, and of K p in that of the residual."""
        if not self.active[lane] or self.stuck[lane]:
            return 0.0, 0.0
        if not self._begun[lane]:
            return 0.0, 1.0
        pq = self._products[lane]
        if not pq > 0.0 or not math.isfinite(pq) or self.iterations[lane] >= MOST_ITERATIONS:
            self.stuck[lane] = True
            return 0.0, 0.0
        alpha = self._rz[lane] / pq
        return alpha, alpha

    def _beta(self, lane: int) -> float:
        if not self.active[lane] or self.stuck[lane]:
            return 0.0
        self.residual[lane] = math.sqrt(self._squared[lane])
        self.largest[lane] = math.sqrt(self._dots[1, lane])
        before, self._rz[lane] = self._rz[lane], self._dots[0, lane]
        self.iterations[lane] += 1
        if not self._begun[lane]:
            self._begun[lane] = True
            return 0.0
        return float(self._rz[lane] / before) if before > 0.0 else 0.0

    def forces(self, nodes: NDArray[np.int32], out: NDArray[np.float64]) -> None:
        """Norms of the forces on nodes at x by lane [N]. Writes `out`, shape (4,)."""
        squared_forces(nodes, self._stiffness.rows, self._vectors.x, out)
        np.sqrt(out, out=out)

    def follow(self, copied: NDArray[np.int32], parents: NDArray[np.int32]) -> None:
        """Make place for copies of nodes, which join their parents in the preconditioner."""
        capacity = self._stiffness.springs.mesh.node_capacity
        self._aggregates.follow(copied, parents, capacity)
        if capacity > len(self.x):
            self._vectors = _zero_vectors(capacity, self.x.dtype.type)
            self.active[:] = False


def _zero_vectors(capacity: int, dtype: type[np.floating]) -> Vectors:
    return Vectors(*(np.zeros((capacity, 3, LANES), dtype=dtype) for _ in range(5)))
