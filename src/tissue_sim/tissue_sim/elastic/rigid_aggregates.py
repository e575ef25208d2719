"""A coarse space for conjugate gradients: parts of the organ that move as rigid bodies."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.kernels.aggregates import farthest_points, spread_labels
from tissue_sim.kernels.conjugate_lanes import coarse_product as lanes_product
from tissue_sim.kernels.stiffness import Aggregates, aggregate_stiffness, coarse_product

NODES_EACH = 40
"""Nodes of an aggregate of a small organ."""

MOST = 300
"""Most aggregates: their dense inverse is read once an iteration."""


class RigidAggregates:
    """Aggregates of nodes, their rigid motions Z and the inverse of Z^T K Z.

    Added to the inverse diagonal blocks they make a two-level additive preconditioner: the blocks
    see what is local, the aggregates what moves far. It stays as it was made under edits and holds,
    which it knows nothing of: it only has to be positive definite and near the truth.

    Attributes:
        label: Aggregate of each node, -1 for none, shape (node_capacity,).
        arms: Node minus the centre of its aggregate in lengths of an aggregate, shape
            (node_capacity, 3).
        force: Force and moment on each aggregate, shape (count, 6); written by the iteration.
        motion: What the aggregates do about it, shape (count, 6).
    """

    def __init__(self, stiffness: Stiffness) -> None:
        """Choose aggregates that nothing leaves unconstrained, and factorise."""
        springs = stiffness.springs
        mesh, dtype = springs.mesh, springs.dtype
        count = mesh.node_rows
        self.label = np.full(mesh.node_capacity, -1, dtype=np.int32)
        self.arms = np.zeros((mesh.node_capacity, 3), dtype=dtype)
        anchored = self._anchored(stiffness)
        aggregates = min(MOST, int(anchored.sum()) // NODES_EACH)
        if aggregates > 1:
            rows = np.flatnonzero(anchored).astype(np.int32)
            seeds = farthest_points(mesh.rest, rows, aggregates)
            arrays = springs.arrays
            spread_labels(seeds, arrays.start, arrays.degree, arrays.neighbour, self.label)
            self.label[:count][~anchored] = -1
        else:
            aggregates = 0
        self._measure_arms(mesh.rest, aggregates)
        E = np.zeros((6 * aggregates, 6 * aggregates))
        aggregate_stiffness(count, stiffness.rows, mesh.fixed, self.arrays, E)
        self._inverse = _inverse_of(E).astype(dtype)
        self.force = np.zeros((aggregates, 6))
        self.motion = np.zeros((aggregates, 6), dtype=dtype)

    @property
    def arrays(self) -> Aggregates:
        """The aggregates for the kernels; edits may replace the arrays."""
        return Aggregates(self.label, self.arms)

    def _anchored(self, stiffness: Stiffness) -> NDArray[np.bool_]:
        """Free nodes of components held in place by fixed nodes: elsewhere Z^T K Z is singular."""
        mesh = stiffness.springs.mesh
        arrays = stiffness.springs.arrays
        reached = np.full(mesh.node_capacity, -1, dtype=np.int32)
        fixed = np.flatnonzero(mesh.fixed[: mesh.node_rows]).astype(np.int32)
        spread_labels(fixed, arrays.start, arrays.degree, arrays.neighbour, reached)
        rows = slice(mesh.node_rows)
        anchored: NDArray[np.bool_] = (reached[rows] >= 0) & ~mesh.fixed[rows]
        return anchored & (arrays.degree[rows] > 0) & (len(fixed) >= 3)

    def _measure_arms(self, rest: NDArray[np.float64], aggregates: int) -> None:
        members = np.flatnonzero(self.label >= 0)
        label = self.label[members]
        rest = rest[members]
        sizes = np.bincount(label, minlength=aggregates).clip(min=1)[:, None]
        centres = np.zeros((aggregates, 3))
        np.add.at(centres, label, rest)
        arms = rest - (centres / sizes)[label]
        spread = np.zeros(aggregates)
        np.add.at(spread, label, (arms**2).sum(axis=1))
        length = np.sqrt(spread / sizes[:, 0]).clip(min=1e-12)
        self.arms[members] = arms / length[label][:, None]

    def solve(self) -> None:
        """What the aggregates do about the forces on them."""
        if len(self.force):
            coarse_product(self._inverse, self.force.ravel(), self.motion.ravel())

    def solve_lanes(self, force: NDArray[np.floating], motion: NDArray[np.floating]) -> None:
        """What the aggregates do about several sets of forces, shape (count, 6, 4) each."""
        unknowns = (len(self._inverse), 1, force.shape[2])
        lanes_product(self._inverse, force.reshape(unknowns), motion.reshape(unknowns))

    def follow(self, copied: NDArray[np.int32], parents: NDArray[np.int32], capacity: int) -> None:
        """Copies join the aggregates of their parents."""
        extra = capacity - len(self.label)
        if extra > 0:
            self.label = np.concatenate([self.label, np.full(extra, -1, dtype=np.int32)])
            self.arms = np.concatenate([self.arms, np.zeros((extra, 3), self.arms.dtype)])
        self.label[copied] = self.label[parents]
        self.arms[copied] = self.arms[parents]


def _inverse_of(E: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse of a symmetric positive definite matrix, some of whose rows may be zero."""
    if not len(E):
        return E
    # An aggregate of one node or of nodes in a line has motions that move nothing.
    scale = np.trace(E) / len(E)
    E = E + 1e-9 * scale * np.eye(len(E))
    inverse: NDArray[np.float64] = scipy.linalg.cho_solve(
        scipy.linalg.cho_factor(E), np.eye(len(E))
    )
    return (inverse + inverse.T) / 2
