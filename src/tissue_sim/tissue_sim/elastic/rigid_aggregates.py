"""A coarse space for conjugate gradients: parts of the organ that move as rigid bodies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix, csr_matrix, eye_array

from tissue_sim.elastic.block_factors import BlockFactors, compile_solver
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.kernels.aggregates import farthest_points, spread_labels
from tissue_sim.kernels.lanes import LANES
from tissue_sim.kernels.stiffness import Aggregates, aggregate_stiffness

EXPONENT = 0.6
"""Of the number of nodes, for the number of aggregates: 600 on an organ of 40,000 nodes."""

MOST = 1500
"""Most aggregates: their factor is read twice an iteration, and made when the model is built."""


class RigidAggregates:
    """Aggregates of nodes, their rigid motions Z and the factors of Z^T K Z.

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
        aggregates = min(MOST, round(float(anchored.sum()) ** EXPONENT))
        if aggregates > 1:
            rows = np.flatnonzero(anchored).astype(np.int32)
            seeds = farthest_points(mesh.rest, rows, aggregates)
            arrays = springs.arrays
            spread_labels(seeds, arrays.start, arrays.degree, arrays.neighbour, self.label)
            self.label[:count][~anchored] = -1
        else:
            aggregates = 0
        self._measure_arms(mesh.rest, aggregates)
        self._count = aggregates
        compile_solver(dtype)
        self._factors = self._factorise(stiffness) if aggregates else None
        self._force = np.zeros((aggregates, 6, LANES), dtype=dtype)
        self._motion = np.zeros_like(self._force)
        self.force = np.zeros((aggregates, 6))
        self.motion = np.zeros((aggregates, 6), dtype=dtype)

    @property
    def bytes(self) -> int:
        """Memory that a solution reads at least."""
        return self._factors.bytes if self._factors is not None else 0

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

    def _factorise(self, stiffness: Stiffness) -> BlockFactors:
        mesh, arrays = stiffness.springs.mesh, stiffness.springs.arrays
        degree = stiffness.springs.links[: mesh.node_rows].astype(np.int64)
        begin = np.repeat(arrays.start[: mesh.node_rows] - (np.cumsum(degree) - degree), degree)
        ends = np.repeat(np.arange(mesh.node_rows), degree), begin + np.arange(degree.sum())
        first, second = self.label[ends[0]], self.label[arrays.neighbour[ends[1]]]
        both = (first >= 0) & (second >= 0)
        shape = (self._count, self._count)
        joined = csr_matrix((np.ones(both.sum()), (first[both], second[both])), shape)
        joined = csr_matrix(joined + eye_array(self._count))
        joined.sort_indices()
        blocks = np.zeros((joined.nnz, 6, 6))
        aggregate_stiffness(
            mesh.node_rows, stiffness.rows, mesh.fixed, self.arrays, joined.indptr, joined.indices,
            blocks,
        )  # fmt: skip
        E = bsr_matrix((blocks, joined.indices, joined.indptr)).tocsr()
        E = 0.5 * (E + E.T)
        # An aggregate of one node or of nodes in a line has motions that move nothing.
        E += 1e-9 * E.diagonal().mean() * eye_array(E.shape[0])
        return BlockFactors(bsr_matrix(E, blocksize=(6, 6)), stiffness.springs.dtype)

    def solve(self) -> None:
        """What the aggregates do about the forces on them."""
        self._force[:, :, 0] = self.force
        self.solve_lanes(self._force, self._motion)
        self.motion[:] = self._motion[:, :, 0]

    def solve_lanes(self, force: NDArray[np.floating], motion: NDArray[np.floating]) -> None:
        """What the aggregates do about several sets of forces, shape (count, 6, 4) each."""
        if self._factors is not None:
            self._factors.solve(force, motion)

    def follow(self, copied: NDArray[np.int32], parents: NDArray[np.int32], capacity: int) -> None:
        """Copies join the aggregates of their parents."""
        extra = capacity - len(self.label)
        if extra > 0:
            self.label = np.concatenate([self.label, np.full(extra, -1, dtype=np.int32)])
            self.arms = np.concatenate([self.arms, np.zeros((extra, 3), self.arms.dtype)])
        self.label[copied] = self.label[parents]
        self.arms[copied] = self.arms[parents]
