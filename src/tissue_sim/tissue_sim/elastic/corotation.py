"""The tangent of corotated linear finite elements, renewed little by little."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels.corotation import (
    Solid,
    add_elements,
    assemble_nodes,
    clear_rows,
    invert_diagonals,
    node_forces,
    response,
)
from tissue_sim.kernels.stiffness import BlockRows

CLEARING, ADDING, INVERTING = 4, 64, 4
"""Steps over which a renewal is spread: rows cleared, elements added, diagonals inverted."""

ALL = CLEARING + ADDING + INVERTING


@dataclass
class Linearisation:
    """Forces near a shape: f(x) = force - W (x - shape).

    Attributes:
        blocks: Of W [N/m], shape (places, 9).
        inverse: Inverse diagonal blocks [m/N], shape (node_capacity, 9).
        force: Exact internal forces at the shape [N], shape (node_capacity, 3).
        shape: Displacements [m], shape (node_capacity, 3).
        energy: Elastic energy of the shape [J].
    """

    blocks: NDArray[np.floating]
    inverse: NDArray[np.floating]
    force: NDArray[np.float64]
    shape: NDArray[np.floating]
    energy: float = 0.0


class Tangent(Stiffness):
    """Tangent and exact forces at a shape met before; those of a newer shape in the making.

    Attributes:
        now: What is in use.
        next: What is being made.
        keep: Share of what is not positive in the stiffness of stressed elements against turning.
        renewed: Elements taken into the next one since somebody has put this to 0.
    """

    def __init__(self, springs: SpringNetwork) -> None:
        """Begin with that of rest."""
        super().__init__(springs)
        self._found, self.keep, self.renewed = response(), 0.0, 0
        places, capacity = len(self._blocks), springs.mesh.node_capacity
        self.now = _zeros(0, capacity, springs.dtype)
        self.now.blocks, self.now.inverse = self._blocks, self.inverse
        self.next = _zeros(places, capacity, springs.dtype)
        self._at = ALL
        self._all = np.arange(capacity, dtype=np.int32)
        self._place_of = np.full(capacity, -1, dtype=np.int32)
        self._sew(self.now, self.now.shape)
        self._invert(self._all[: springs.mesh.node_rows])

    @property
    def solid(self) -> Solid:
        """What kernels read of the mesh; edits may replace the arrays."""
        springs = self.springs
        return Solid(springs.elements, springs.mesh.rest, springs.field.matter, self.keep)

    @property
    def complete(self) -> bool:
        """Whether `next` is."""
        return self._at == ALL

    def begin(self, shape: NDArray[np.floating]) -> None:
        """Begin the next one, at a shape; what was not complete is lost."""
        np.copyto(self.next.shape, shape)
        self.next.force[:] = 0.0
        self.next.energy = 0.0
        self._at = 0

    def go_on(self) -> None:
        """One step of making the next one."""
        at, rows = self._at, self._rows_of(self.next)
        mesh, new = self.springs.mesh, self.next
        if at < CLEARING:
            clear_rows(*_part(at, CLEARING, mesh.node_rows), rows)
        elif at < CLEARING + ADDING:
            begin, end = _part(at - CLEARING, ADDING, mesh.element_rows)
            new.energy += add_elements(
                begin, end, mesh.element_alive, self.solid, new.shape, self._found, rows, new.force
            )
            self.renewed += end - begin
        elif not self.complete:
            if at == CLEARING + ADDING:
                new.energy += self.springs.stitches.add_forces(new.shape, new.force)
                self._sew(new, new.shape)
            begin, end = _part(at - CLEARING - ADDING, INVERTING, mesh.node_rows)
            invert_diagonals(self._all[begin:end], rows, new.inverse)
        self._at = min(at + 1, ALL)

    def swap(self) -> None:
        """Put the next one to use."""
        self.now, self.next = self.next, self.now
        self._blocks, self.inverse = self.now.blocks, self.now.inverse

    def forces(
        self, nodes: NDArray[np.int32], shape: NDArray[np.floating], out: NDArray[np.float64]
    ) -> None:
        """Exact internal forces on nodes [N]. Writes `out`, shape (len(nodes), 3)."""
        node_forces(nodes, self.solid, shape, self._found, self._place_of, out)
        out += self.springs.stitches.forces(shape, nodes)

    def warm_up(self) -> None:
        """Compile the kernels, or load them from the cache."""
        none, rows = self._all[:0], self._rows_of(self.next)
        alive = self.springs.mesh.element_alive
        clear_rows(0, 0, rows)
        add_elements(0, 0, alive, self.solid, self.next.shape, self._found, rows, self.next.force)
        assemble_nodes(none, self.solid, self.next.shape, self._found, rows)
        self.forces(none, self.next.shape, self.next.force[:0])

    def follow_at(self, change: EditChange, shape: NDArray[np.floating]) -> None:
        """Make anew, at a shape, the rows an edit touched; the next one has to be begun again."""
        mesh = self.springs.mesh
        self.now.blocks = _longer(self.now.blocks, len(self.springs.arrays.neighbour))
        self.next.blocks = _longer(self.next.blocks, len(self.springs.arrays.neighbour))
        for line in (self.now, self.next):
            for name in ("inverse", "force", "shape"):
                setattr(line, name, _longer(getattr(line, name), mesh.node_capacity))
        if mesh.node_capacity > len(self._all):
            self._all = np.arange(mesh.node_capacity, dtype=np.int32)
            self._place_of = np.full(mesh.node_capacity, -1, dtype=np.int32)
        self._blocks, self.inverse = self.now.blocks, self.now.inverse
        assemble_nodes(change.nodes, self.solid, shape, self._found, self.rows)
        self._sew(self.now, shape)
        self._invert(np.union1d(change.nodes, self.springs.stitches.nodes))
        self._at = ALL

    def _sew(self, line: Linearisation, shape: NDArray[np.floating]) -> None:
        """Write the blocks of the stitches at a shape."""
        springs = self.springs
        if len(springs.stitches):
            stitches = springs.stitches
            taut = stitches.lengths(shape) >= stitches.threads.length
            blocks = -stitches.tangents(shape, taut).reshape(-1, 9)
            for end in (0, 1):
                line.blocks[springs.stitch_places[:, end]] = blocks

    def _invert(self, nodes: NDArray[np.int32]) -> None:
        invert_diagonals(nodes, self.rows, self.now.inverse)

    def _rows_of(self, line: Linearisation) -> BlockRows:
        arrays = self.springs.arrays
        return BlockRows(arrays.start, self.springs.links, arrays.neighbour, line.blocks)


def _part(at: int, parts: int, count: int) -> tuple[int, int]:
    return at * count // parts, (at + 1) * count // parts


def _zeros(places: int, capacity: int, dtype: type[np.floating]) -> Linearisation:
    return Linearisation(
        np.zeros((places, 9), dtype=dtype), np.zeros((capacity, 9), dtype=dtype),
        np.zeros((capacity, 3)), np.zeros((capacity, 3), dtype=dtype),
    )  # fmt: skip


def _longer(array: NDArray, length: int) -> NDArray:
    if length <= len(array):
        return array
    more = np.zeros((length - len(array), *array.shape[1:]), dtype=array.dtype)
    return np.concatenate([array, more])
