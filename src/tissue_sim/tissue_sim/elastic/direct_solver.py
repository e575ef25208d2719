"""Direct solution of linear finite elements, for organs that are never cut.

Symbols: K the stiffness of the nodes that are not fixed, H those of them that are held, E their
columns of the identity, S = E^T K^-1 E (the compliance of the held nodes).

K is factorised once. With H held, the change e of a shape that leaves residual forces r in free
nodes is K e = r - E f with e = 0 in H, f being the forces that hold them:

    f = S^-1 E^T K^-1 r,    e = K^-1 (r - E f),

so that a grab needs 3 |H| solutions for S, and every shape two.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from tissue_sim.elastic.stiffness import Stiffness

MOST_NODES = 5000
"""Larger factors take gigabytes and minutes; see docs/finite_element.md."""

COLUMNS = 3
"""Of the compliance, found in a step."""


class DirectSolver:
    """A factorised stiffness matrix, and what to solve with any nodes held.

    Attributes:
        ready: Whether the compliance of the held nodes is complete.
    """

    def __init__(self, stiffness: Stiffness) -> None:
        """Factorise.

        Raises:
            ValueError: The organ is too large, or a part of it has no fixed node.
        """
        mesh = stiffness.springs.mesh
        count = mesh.node_rows
        if count > MOST_NODES:
            raise ValueError(
                f"direct = 1 is not possible with {count} nodes; allowed: up to {MOST_NODES}"
            )
        self._all = _matrix(stiffness, count)
        unfixed = ~mesh.fixed[:count] & mesh.node_alive[:count]
        loose = _loose(stiffness, mesh.fixed[:count], mesh.node_alive[:count])
        if loose:
            raise ValueError(
                f"direct = 1 is not possible: {loose} nodes are in parts without a fixed node; "
                "allowed: organs of which every part has fixed nodes"
            )
        self._unknown = np.flatnonzero(np.repeat(unfixed, 3))
        self._place = np.full(3 * count, -1, dtype=np.int64)
        self._place[self._unknown] = np.arange(len(self._unknown))
        K = self._all[self._unknown][:, self._unknown].tocsc()
        self._factor = splu(
            K, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )  # fmt: skip
        self.hold(np.empty(0, dtype=np.int32))

    @property
    def entries(self) -> int:
        """Numbers that the factors hold."""
        return int(self._factor.nnz)

    def hold(self, held: NDArray[np.int32]) -> None:
        """Begin with the compliance of these nodes, none of them fixed."""
        dofs = (3 * held.astype(np.int64)[:, None] + np.arange(3)).ravel()
        self._held = self._place[dofs]
        self._compliance = np.empty((len(dofs), len(dofs)))
        self._columns = 0
        self.ready = not len(dofs)

    def go_on(self) -> bool:
        """Some more columns of the compliance; whether it is complete."""
        if self.ready:
            return True
        columns = self._held[self._columns : self._columns + COLUMNS]
        b = np.zeros((len(self._unknown), len(columns)))
        b[columns, np.arange(len(columns))] = 1.0
        end = self._columns + len(columns)
        self._compliance[:, self._columns : end] = self._factor.solve(b)[self._held]
        self._columns = end
        if end == len(self._held):
            self._cholesky = cho_factor(0.5 * (self._compliance + self._compliance.T))
            self.ready = True
        return self.ready

    def change(self, shape: NDArray[np.floating]) -> NDArray[np.float64]:
        """What a shape lacks to equilibrium in free nodes [m], shape (len(shape), 3).

        Args:
            shape: Displacements [m], those of fixed and held nodes as they have to be.
        """
        count = self._all.shape[0] // 3
        r = -(self._all @ shape[:count].astype(np.float64).ravel())[self._unknown]
        if len(self._held):
            f = cho_solve(self._cholesky, self._factor.solve(r)[self._held])
            r[self._held] -= f
        e = self._factor.solve(r)
        e[self._held] = 0.0
        out = np.zeros((len(shape), 3))
        out[:count].reshape(-1)[self._unknown] = e
        return out


def _matrix(stiffness: Stiffness, count: int) -> csr_matrix:
    """The whole stiffness matrix of the rows in use [N/m]."""
    rows = stiffness.rows
    degree = rows.degree[:count].astype(np.int64)
    first = np.repeat(rows.start[:count].astype(np.int64), degree)
    places = first + np.arange(len(first)) - np.repeat(np.cumsum(degree) - degree, degree)
    i = np.repeat(np.arange(count), degree)
    j = rows.neighbour[places].astype(np.int64)
    blocks = rows.blocks[places].astype(np.float64)
    diagonal = np.zeros((count, 9))
    np.add.at(diagonal, i, -blocks)
    i, j = np.concatenate([i, np.arange(count)]), np.concatenate([j, np.arange(count)])
    blocks = np.concatenate([blocks, diagonal])
    inner = np.arange(9)
    at = 3 * i[:, None] + inner // 3, 3 * j[:, None] + inner % 3
    shape = (3 * count, 3 * count)
    matrix = csr_matrix((blocks.ravel(), (at[0].ravel(), at[1].ravel())), shape=shape)
    # Blocks in single precision are symmetric but for rounding.
    return csr_matrix(0.5 * (matrix + matrix.T))


def _loose(stiffness: Stiffness, fixed: NDArray[np.bool_], alive: NDArray[np.bool_]) -> int:
    """Living nodes of parts that no fixed node holds."""
    rows, count = stiffness.rows, len(fixed)
    degree = rows.degree[:count].astype(np.int64)
    first = np.repeat(rows.start[:count].astype(np.int64), degree)
    places = first + np.arange(len(first)) - np.repeat(np.cumsum(degree) - degree, degree)
    i, j = np.repeat(np.arange(count), degree), rows.neighbour[places].astype(np.int64)
    graph = csr_matrix((np.ones(len(i), dtype=np.int8), (i, j)), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    held = np.zeros(part.max(initial=-1) + 1, dtype=np.bool_)
    held[part[fixed]] = True
    return int((alive & ~held[part]).sum())
