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

from tissue_sim.elastic.factorisation import factorised
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.geometry.edit import EditChange

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
            ValueError: The organ is too large, or a part of it can move or turn freely.
        """
        mesh = stiffness.springs.mesh
        count = mesh.node_rows
        refuse_loose(stiffness, "direct = 1")
        matrix = rows_of(stiffness, np.arange(count))
        # Blocks in single precision are symmetric but for rounding.
        self._all = csr_matrix(0.5 * (matrix + matrix.T))
        unfixed = ~mesh.fixed[:count] & mesh.node_alive[:count]
        self._unknown = dofs_of(np.flatnonzero(unfixed))
        self._place = np.full(3 * count, -1, dtype=np.int64)
        self._place[self._unknown] = np.arange(len(self._unknown))
        self._factor = factorised(self._all[self._unknown][:, self._unknown])
        self.hold(np.empty(0, dtype=np.int32))

    @property
    def entries(self) -> int:
        """Numbers that the factors hold."""
        return int(self._factor.nnz)

    def follow(self, change: EditChange) -> str:
        """Why there are no factors any more, after an edit."""
        what = "patch" if len(change.born_nodes) else "cut"
        return (
            f"the factorised matrix is that of the organ before the {what}; "
            "conjugate gradients go on"
        )

    def refusal(self, nodes: NDArray[np.int32]) -> str:
        """Why an edit that changes the elements of these nodes is not possible: it always is."""
        return ""

    def hold(self, held: NDArray[np.int32]) -> None:
        """Begin with the compliance of these nodes, none of them fixed."""
        dofs = dofs_of(held)
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


def rows_of(stiffness: Stiffness, nodes: NDArray[np.integer]) -> csr_matrix:
    """Rows of the stiffness matrix [N/m], shape (3 len(nodes), 3 node_rows)."""
    rows, count = stiffness.rows, stiffness.springs.mesh.node_rows
    i, places = _entries(stiffness, nodes)
    blocks = rows.blocks[places].astype(np.float64)
    diagonal = np.zeros((len(nodes), 9))
    np.add.at(diagonal, i, -blocks)
    i = np.concatenate([i, np.arange(len(nodes))])
    j = np.concatenate([rows.neighbour[places].astype(np.int64), nodes])
    blocks = np.concatenate([blocks, diagonal])
    inner = np.arange(9)
    at = 3 * i[:, None] + inner // 3, 3 * j[:, None] + inner % 3
    shape = (3 * len(nodes), 3 * count)
    return csr_matrix((blocks.ravel(), (at[0].ravel(), at[1].ravel())), shape=shape)


def _entries(
    stiffness: Stiffness, nodes: NDArray[np.integer]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Place in `nodes`, and in the matrix's arrays, of every block in the nodes' rows."""
    degree = stiffness.rows.degree[nodes].astype(np.int64)
    first = np.repeat(stiffness.rows.start[nodes].astype(np.int64), degree)
    places = first + np.arange(len(first)) - np.repeat(np.cumsum(degree) - degree, degree)
    return np.repeat(np.arange(len(nodes)), degree), places


def dofs_of(nodes: NDArray[np.integer]) -> NDArray[np.int64]:
    """Rows of nodes' displacements in the matrix, shape (3 len(nodes),)."""
    return (3 * nodes.astype(np.int64)[:, None] + np.arange(3)).ravel()


def refuse_loose(stiffness: Stiffness, parameter: str) -> None:
    """Refuse an organ that is too large, or of which a part can move or turn freely.

    Args:
        stiffness: Of the organ.
        parameter: What has asked for factors.

    Raises:
        ValueError: It is.
    """
    mesh = stiffness.springs.mesh
    count = mesh.node_rows
    if count > MOST_NODES:
        raise ValueError(
            f"{parameter} is not possible with {count} nodes; allowed: up to {MOST_NODES}"
        )
    i, places = _entries(stiffness, np.arange(count))
    j = stiffness.rows.neighbour[places].astype(np.int64)
    graph = csr_matrix((np.ones(len(i), dtype=np.int8), (i, j)), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    alive, fixed = mesh.node_alive[:count], mesh.fixed[:count]
    loose = 0
    for number in np.unique(part[alive]):
        inside = part == number
        if not _hold_still(mesh.rest[:count][inside & fixed]):
            loose += int((inside & alive).sum())
    if loose:
        raise ValueError(
            f"{parameter} is not possible: {loose} nodes are in parts without a fixed node, or "
            "with fixed nodes in one line only, about which they turn; allowed: organs of which "
            "every part has three fixed nodes that are not in a line"
        )


def _hold_still(points: NDArray[np.float64]) -> bool:
    """Whether there are three points that are not in a line."""
    if len(points) < 3:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > 1e-6 * spread[0])
