"""Which elements lie near a box, without looking at every element.

Nodes are sorted into cells by where they are at rest, and elements by one of their nodes. A shape
is looked at once, node by node, for the box that each cell's nodes fill in it; an element can then
meet a box only if the boxes of the cells that elements of its cell reach do. Cells say where to
look, not what is there: they stay right, and only get wider, however the tissue is deformed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.sweep_kernels import elements_in_box
from tissue_sim.geometry.mesh import Mesh

Rows = NDArray[np.int32]
Reals = NDArray[np.float64]

CELL = 3.0
"""Width of a cell in mean edges."""
STRAYS = 0.25
"""Elements that are in no cell, as a share of all, above which the cells are made anew."""


@dataclass(frozen=True)
class Survey:
    """A shape seen through the cells.

    Attributes:
        finite: Whether all living nodes have finite positions.
        lower, upper: Corners of the box that the organ fills [m], shape (3,).
        cell_lower, cell_upper: Of the boxes that the cells' nodes fill [m], shape (cells, 3).
    """

    finite: bool
    lower: Reals
    upper: Reals
    cell_lower: Reals
    cell_upper: Reals


@njit(cache=True, nogil=True, error_model="numpy")
def _look(
    positions: Reals,
    alive: NDArray[np.bool_],
    cell: Rows,
    lower: Reals,
    upper: Reals,
) -> bool:
    finite = True
    for node in range(positions.shape[0]):
        if not alive[node]:
            continue
        for axis in range(3):
            x = positions[node, axis]
            finite = finite and np.isfinite(x)
            lower[cell[node], axis] = min(lower[cell[node], axis], x)
            upper[cell[node], axis] = max(upper[cell[node], axis], x)
    return finite


@njit(cache=True, nogil=True)
def _cells_near(
    starts: Rows,
    reached: Rows,
    cell_lower: Reals,
    cell_upper: Reals,
    lower: Reals,
    upper: Reals,
    out: Rows,
) -> int:
    found = 0
    for cell in range(len(starts) - 1):
        near = starts[cell + 1] > starts[cell]
        for axis in range(3):
            low, high = np.inf, -np.inf
            for k in range(starts[cell], starts[cell + 1]):
                low = min(low, cell_lower[reached[k], axis])
                high = max(high, cell_upper[reached[k], axis])
            near = near and low <= upper[axis] and high >= lower[axis]
        if near:
            out[found] = cell
            found += 1
    return found


@njit(cache=True, nogil=True)
def _gather(cells: Rows, starts: Rows, data: Rows, out: Rows) -> int:
    found = 0
    for cell in cells:
        for k in range(starts[cell], starts[cell + 1]):
            out[found] = data[k]
            found += 1
    return found


NOWHERE, STRAY = -1, -2
"""Instead of the cell of an element: it is not known yet; it is looked at by itself."""


class ElementGrid:
    """The cells of one mesh; `follow` keeps them with its edits."""

    def __init__(self, mesh: Mesh, mean_edge: float) -> None:
        """Sort a mesh of tetrahedra into cells.

        Args:
            mesh: The mesh.
            mean_edge: Of its elements [m].
        """
        self._mesh = mesh
        rest = mesh.rest[: mesh.node_rows]
        tets = mesh.tets[: mesh.element_rows]
        lower = rest.min(axis=0) if len(rest) else np.zeros(3)
        place = np.floor((rest - lower) / max(CELL * mean_edge, np.finfo(np.float64).tiny))
        place = np.minimum(place, 1 << 20).astype(np.int64)
        keys = (place[:, 0] << 42) | (place[:, 1] << 21) | place[:, 2]
        used, cell = np.unique(keys, return_inverse=True)
        self._count = len(used)
        self._cell = np.zeros(mesh.node_capacity, dtype=np.int32)
        self._cell[: mesh.node_rows] = cell.ravel()
        self._nodes = mesh.node_rows
        living = np.flatnonzero(mesh.element_alive[: mesh.element_rows]).astype(np.int32)
        cells = self._cell[tets[living]]
        order = np.argsort(cells[:, 0], kind="stable")
        self._elements = living[order]
        self._starts = _starts(cells[order, 0], self._count)
        self._sorted_into = np.full(mesh.element_capacity, NOWHERE, dtype=np.int32)
        self._sorted_into[living] = cells[:, 0]
        # Cell an element is sorted into, and cell of one of its nodes.
        self._pairs = np.unique(cells[:, :1].astype(np.int64) * self._count + cells)
        self._reached = (self._pairs % self._count).astype(np.int32)
        self._reach_starts = _starts(self._pairs // self._count, self._count)
        self._strays = np.empty(0, dtype=np.int32)

    @property
    def worn(self) -> bool:
        """Whether so many elements are in no cell that cells should be made anew."""
        return len(self._strays) > 1024 + STRAYS * len(self._elements)

    def follow(self, elements: Rows) -> None:
        """Take note of elements that an edit has changed or added, the mesh being as after it.

        New nodes belong to the cells of their parents. Elements that then reach further than those
        of their cell did, and new ones, are looked at by themselves.
        """
        mesh = self._mesh
        self._cell = _longer(self._cell, mesh.node_capacity, 0)
        self._sorted_into = _longer(self._sorted_into, mesh.element_capacity, NOWHERE)
        for node in range(self._nodes, mesh.node_rows):
            self._cell[node] = self._cell[mesh.node_parents[node]]
        self._nodes = mesh.node_rows
        elements = elements[mesh.element_alive[elements]]
        own = self._sorted_into[elements]
        pairs = own[:, None].astype(np.int64) * self._count + self._cell[mesh.tets[elements]]
        place = np.minimum(np.searchsorted(self._pairs, pairs), len(self._pairs) - 1)
        reached = (self._pairs[place] == pairs).all(axis=1)
        stray = elements[(own != STRAY) & ~reached]
        self._sorted_into[stray] = STRAY
        self._strays = np.concatenate([self._strays, stray])

    def survey(self, positions: Reals) -> Survey:
        """Look at a shape.

        Args:
            positions: Node positions [m], shape (node_rows, 3).
        """
        lower = np.full((self._count, 3), np.inf)
        upper = np.full((self._count, 3), -np.inf)
        alive = self._mesh.node_alive[: self._mesh.node_rows]
        finite = _look(positions, alive, self._cell, lower, upper)
        return Survey(bool(finite), lower.min(axis=0), upper.max(axis=0), lower, upper)

    def near(self, survey: Survey, positions: Reals, lower: Reals, upper: Reals) -> Rows:
        """Rows of living elements whose boxes meet a box, ascending.

        Args:
            survey: The shape.
            positions: The same [m], shape (node_rows, 3).
            lower: Lower corner of the box [m], shape (3,).
            upper: Upper corner [m], shape (3,).
        """
        cells = np.empty(self._count, dtype=np.int32)
        cells = cells[: _cells_near(
            self._reach_starts, self._reached, survey.cell_lower, survey.cell_upper, lower, upper,
            cells,
        )]  # fmt: skip
        room = int((self._starts[cells + 1] - self._starts[cells]).sum())
        rows = np.empty(room, dtype=np.int32)
        _gather(cells, self._starts, self._elements, rows)
        rows = np.concatenate([rows, self._strays])
        rows = rows[self._mesh.element_alive[rows]]
        tets = self._mesh.tets[rows]
        out = np.empty(len(rows), dtype=np.int32)
        all_of = np.ones(len(rows), dtype=np.bool_)
        out = out[: elements_in_box(positions, tets, all_of, lower, upper, out)]
        return np.unique(rows[out])


def _longer(array: Rows, length: int, fill: int) -> Rows:
    extra = length - len(array)
    return np.concatenate([array, np.full(extra, fill, dtype=np.int32)]) if extra > 0 else array


def _starts(sorted_cells: NDArray[np.integer], count: int) -> Rows:
    """Where each cell's items begin among items sorted by cell, shape (count + 1,)."""
    return np.searchsorted(sorted_cells, np.arange(count + 1)).astype(np.int32)
