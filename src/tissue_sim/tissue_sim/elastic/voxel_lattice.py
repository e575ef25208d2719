"""Tissue covered with voxels that know where it is cut, and which of them carry which node."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.incidence import sorted_unique
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels import voxel_lattice as kernels
from tissue_sim.kernels.springs import SpringArrays
from tissue_sim.kernels.voxel_lattice import CORNERS, Boxes, Marks, Slots
from tissue_sim.kernels.voxel_nodes import carry

MOST_POINTS = 1 << 24
"""Grid points in the box around the organ."""

SPACE = 0.5
"""Space for patches at every side of the organ, in its lengths: points without tissue cost a byte
or two, laying all voxels anew takes seconds."""

MOST_SLOTS = 1 << 25
"""Grid points that elements reach, counted by element: 12 bytes each."""

ROOM = 8
"""Links a voxel has room for at first: six, and more where tissue branches at the end of a cut."""

SPARE = 0.25
COARSER = 1.25


@dataclass(frozen=True)
class Renewal:
    """What an edit did to the voxels.

    Attributes:
        used: Rows in use before it.
        before: For every row from `used` on, the voxel whose displacement it takes over; -1 for
            none, shape (rows - used,).
        touched: Rows at and next to grid points whose parts were looked at again, shape (n,).
    """

    used: int
    before: NDArray[np.int32]
    touched: NDArray[np.int32]


class VoxelLattice:
    """Voxels of a mesh: a grid over it, one voxel for each part of the tissue around a grid point.

    Attributes:
        mesh: The mesh that is covered.
        spacing: Distance of voxels at rest [m].
        rows: Rows of voxels in use; those that are no more have no links.
        origin: Where the first grid point is at rest [m], shape (3,).
        place: Grid point of each voxel, shape (voxel_capacity, 3).
        corner: Voxels that carry each node, shape (node_capacity, 8).
        weight: Their shares, those that are not zero first, shape (node_capacity, 8).
    """

    def __init__(self, mesh: Mesh, spacing: float, edge: float, dtype: type[np.floating]) -> None:
        """Cover a mesh.

        Args:
            mesh: The mesh.
            spacing: Distance of voxels [m]; 0: `edge`, or as little more as the limits ask for.
            edge: Mean length of the mesh's edges [m].
            dtype: Precision of the kernels.

        Raises:
            ValueError: The spacing makes too many voxels; the message names the least.
        """
        self.mesh, self._dtype = mesh, dtype
        rest = mesh.rest[: mesh.node_rows][mesh.node_alive[: mesh.node_rows]]
        self.origin = rest.min(axis=0) if len(rest) else np.zeros(3)
        self._extent = np.ptp(rest, axis=0) if len(rest) else np.ones(3)
        alive = mesh.element_alive[: mesh.element_rows]
        self._elements = np.flatnonzero(alive).astype(np.int32)
        self.spacing = spacing or edge
        if why := self._too_many():
            while self._too_many():
                self.spacing *= COARSER
            if spacing:
                raise ValueError(
                    f"spacing = {spacing:g} m {why}; allowed: 0, {self.spacing:g} m on"
                )
        self._size = self._size_at(self.spacing)
        self._add_space()
        self.rows, self._used = 0, 0
        none = np.empty((0, 3), dtype=np.int32)
        self._boxes = Boxes(
            none, none, np.empty(0, dtype=np.int64), np.empty((0, 4), dtype=np.int32)
        )
        self._slots = Slots(*(np.empty(0, dtype=np.int32) for _ in range(3)))
        points = int(self._size.prod())
        self._marks = Marks(
            self._size, np.zeros(points, dtype=np.bool_), np.zeros(points, dtype=np.bool_),
            np.zeros((2, 3), dtype=np.int64),
        )  # fmt: skip
        self.place = np.full((0, 3), -1, dtype=np.int32)
        self._before = np.empty(0, dtype=np.int32)
        self._degree = np.zeros(0, dtype=np.uint32)
        self._neighbour = np.zeros((0, ROOM), dtype=np.uint32)
        self.corner = np.zeros((0, CORNERS), dtype=np.int32)
        self.weight = np.zeros((0, CORNERS), dtype=dtype)
        self._renew(self._elements, self._elements)
        del self._elements

    def _size_at(self, spacing: float) -> NDArray[np.int64]:
        points = np.ceil(self._extent / spacing - kernels.CLOSE).astype(np.int64) + 1
        return np.maximum(points, 2)

    def _add_space(self) -> None:
        """Make the grid larger than the organ, its points where they are, as far as it may be."""
        margin = int(SPACE * self._extent.max(initial=0.0) / self.spacing) + 1
        while margin and (self._size + 2 * margin).prod() > MOST_POINTS:
            margin -= 1
        self.origin = self.origin - margin * self.spacing
        self._size = self._size + 2 * margin

    def _too_many(self) -> str:
        """What makes this spacing too small; "" if nothing does."""
        size = np.maximum(np.ceil(self._extent / self.spacing), 1) + 1
        if size.prod() > MOST_POINTS:
            return f"makes a grid of {size.prod():.3g} points, at most {MOST_POINTS}"
        count = np.empty((len(self._elements), 3), dtype=np.int32)
        self._bound(self._elements, self._size_at(self.spacing), np.empty_like(count), count)
        slots = float(count.prod(axis=1, dtype=np.float64).sum())
        if slots > MOST_SLOTS:
            return f"has {slots:.3g} voxels in elements, counted by element, at most {MOST_SLOTS}"
        return ""

    def _bound(
        self,
        elements: NDArray[np.int32],
        size: NDArray[np.int64],
        low: NDArray[np.int32],
        count: NDArray[np.int32],
    ) -> None:
        kernels.bound(
            elements, self.mesh.tets, self.mesh.rest, self.origin, self.spacing, size, low, count
        )

    def covers(self, nodes: NDArray[np.int32]) -> bool:
        """Whether nodes lie within the grid at rest."""
        place = (self.mesh.rest[nodes] - self.origin) / self.spacing
        low, high = -kernels.CLOSE, self._size - 1 + kernels.CLOSE
        return bool(((place >= low) & (place <= high)).all())

    @property
    def capacity(self) -> int:
        """Rows of voxels there is room for."""
        return len(self.place)

    @property
    def arrays(self) -> SpringArrays:
        """Links by voxel for the kernels; edits may replace the arrays, so do not keep them."""
        return self._arrays

    @property
    def neighbour(self) -> NDArray[np.uint32]:
        """Voxels linked to each voxel, in the first `degree` places."""
        return self._neighbour

    @property
    def degree(self) -> NDArray[np.uint32]:
        """Links of each voxel, shape (voxel_capacity,)."""
        return self._degree

    def follow(self, change: EditChange) -> Renewal:
        """Follow an edit that the mesh has applied.

        In time proportional to the edit, but for one look at the box of every element and the cell
        of every node.
        """
        at = self.mesh.incident.of_all(change.nodes)
        changed = np.concatenate([change.elements, change.neighbours])
        return self._renew(sorted_unique(changed), sorted_unique(np.concatenate([at, changed])))

    def _renew(self, changed: NDArray[np.int32], around: NDArray[np.int32]) -> Renewal:
        """Look again at elements that changed, and at the faces of all around them."""
        mesh, marks, used = self.mesh, self._marks, self.rows
        self._reserve_elements()
        living = around[mesh.element_alive[around]]
        incident = mesh.incident
        kernels.find_faces(
            living, mesh.tets, incident.start, incident.count, incident.data, self._boxes.faces
        )
        marks.box[0], marks.box[1] = self._size, 0
        marked = [(self._boxes.low[changed], self._boxes.extent[changed])]
        self._enclose(changed)
        marked.append((self._boxes.low[changed], self._boxes.extent[changed]))
        for low, count in marked:
            kernels.mark(low, count, True, marks)
        reached = np.empty(mesh.element_rows, dtype=np.int32)
        number = kernels.reaching(
            mesh.element_rows, mesh.element_alive, self._boxes, marks, reached
        )
        reached = reached[:number]
        self._enter(reached)
        self._link(reached)
        self._carry()
        place = self.place[: self.rows]
        size = self._size
        point = (place[:, 0] * size[1] + place[:, 1]) * size[2] + place[:, 2]
        touched = np.flatnonzero((place[:, 0] >= 0) & marks.near[point]).astype(np.int32)
        for low, count in marked:
            kernels.mark(low, count, False, marks)
        return Renewal(used, self._before[used : self.rows].copy(), touched)

    def _reserve_elements(self) -> None:
        capacity, boxes = self.mesh.element_capacity, self._boxes
        if capacity > len(boxes.start):
            self._boxes = Boxes(
                _longer(boxes.low, capacity, 0), _longer(boxes.extent, capacity, 0),
                _longer(boxes.start, capacity, 0), _longer(boxes.faces, capacity, -1),
            )  # fmt: skip

    def _enclose(self, changed: NDArray[np.int32]) -> None:
        """Boxes of changed elements, and slots for those that have others than before."""
        boxes = self._boxes
        living = changed[self.mesh.element_alive[changed]]
        low, count = (np.empty((len(living), 3), dtype=np.int32) for _ in range(2))
        self._bound(living, self._size, low, count)
        other = ((low != boxes.low[living]) | (count != boxes.extent[living])).any(axis=1)
        ends = self._used + np.cumsum(count[other].prod(axis=1, dtype=np.int64))
        boxes.start[living[other]] = np.concatenate([[self._used], ends[:-1]])[: len(ends)]
        self._used = int(ends[-1]) if len(ends) else self._used
        boxes.low[living], boxes.extent[living] = low, count
        boxes.extent[changed[~self.mesh.element_alive[changed]]] = 0
        if self._used > len(self._slots.voxel):
            room = self._used + int(SPARE * self._used)
            self._slots = Slots(*(_longer(array, room, -1) for array in self._slots))

    def _enter(self, reached: NDArray[np.int32]) -> None:
        arguments = (reached, self._boxes, self._slots, self._marks)
        while True:
            kernels.join(*arguments)
            rows = kernels.enter(*arguments, self.rows, self.place, self._before)
            if rows <= self.capacity:
                break
            room = rows + int(SPARE * rows) + 64
            self.place = _longer(self.place, room, -1)
            self._before = _longer(self._before, room, -1)
            self._degree = _longer(self._degree, room, 0)
            self._neighbour = _longer(self._neighbour, room, 0)
        self.rows = rows

    def _link(self, reached: NDArray[np.int32]) -> None:
        while not kernels.link(
            reached, self._boxes, self._slots.voxel, self._marks, self.rows, self.place,
            self._degree, self._neighbour,
        ):  # fmt: skip
            self._neighbour = np.pad(self._neighbour, ((0, 0), (0, ROOM)))
        room = self._neighbour.shape[1]
        none = np.empty(0, dtype=self._dtype)
        self._arrays = SpringArrays(
            (self.place * self.spacing).astype(self._dtype),
            np.arange(0, room * self.capacity, room, dtype=np.uint32),
            self._degree, self._neighbour.reshape(-1), none, none,
        )  # fmt: skip

    def _carry(self) -> None:
        mesh, incident = self.mesh, self.mesh.incident
        self.corner = _longer(self.corner, mesh.node_capacity, 0)
        self.weight = _longer(self.weight, mesh.node_capacity, 0)
        carry(
            mesh.node_rows, mesh.node_alive, mesh.rest, self.origin, self.spacing, self._size,
            self._marks.dirty, incident.start, incident.count, incident.data, self._boxes,
            self._slots.voxel, self.corner, self.weight,
        )  # fmt: skip


def _longer(array: NDArray, rows: int, value: int) -> NDArray:
    """A copy with more rows; the array itself if it has as many."""
    if rows <= len(array):
        return array
    more = np.full((rows - len(array), *array.shape[1:]), value, dtype=array.dtype)
    return np.concatenate([array, more])
