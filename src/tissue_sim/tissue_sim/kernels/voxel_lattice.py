"""Loops that cover tissue with voxels: which there are, their links, and what nodes they carry.

A grid point is a place p = (x, y, z) at origin + h p; its support is the open box of h around it.
The elements that reach into the support, joined through the faces that they share, make up one or
more parts, and every part has a voxel of its own there: a cut, or a gap that is closed nowhere
within a support, has voxels on either side that know nothing of each other. Voxels of neighbouring
grid points are linked if an element has both. An element has a slot for each grid point of its box,
in the order of `slot_of`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

CLOSE = 1e-6
"""Share of the spacing that is none: a face in a plane of the grid ends there."""

CORNERS = 8


class Boxes(NamedTuple):
    """Which grid points an element reaches.

    Attributes:
        low: First grid point along each axis, shape (element_capacity, 3).
        extent: Grid points along each axis, shape (element_capacity, 3).
        start: Its first slot, shape (element_capacity,).
        faces: Elements across its faces, -1 for none, shape (element_capacity, 4).
    """

    low: NDArray[np.int32]
    extent: NDArray[np.int32]
    start: NDArray[np.int64]
    faces: NDArray[np.int32]


class Slots(NamedTuple):
    """What an element has at its grid points.

    Attributes:
        voxel: Row of the voxel, -1 for none yet, shape (slot_capacity,).
        parent: To write on: a slot of the same part, shape (slot_capacity,).
        row: To write on: row of the part's voxel, shape (slot_capacity,).
    """

    voxel: NDArray[np.int32]
    parent: NDArray[np.int32]
    row: NDArray[np.int32]


class Marks(NamedTuple):
    """Grid points that are looked at again.

    Attributes:
        size: Grid points along each axis, shape (3,).
        dirty: Those whose parts may have changed, shape (points,).
        near: Those and their neighbours, shape (points,).
        box: First and last of `near` along each axis, shape (2, 3).
    """

    size: NDArray[np.int64]
    dirty: NDArray[np.bool_]
    near: NDArray[np.bool_]
    box: NDArray[np.int64]


@njit(cache=True, nogil=True)
def bound(
    elements: NDArray[np.int32],
    tets: NDArray[np.int32],
    rest: NDArray[np.float64],
    origin: NDArray[np.float64],
    spacing: float,
    size: NDArray[np.int64],
    low: NDArray[np.int32],
    count: NDArray[np.int32],
) -> None:
    """Boxes of elements, into low[k], count[k] for elements[k]."""
    for k in range(len(elements)):
        for axis in range(3):
            first = last = (rest[tets[elements[k], 0], axis] - origin[axis]) / spacing
            for corner in range(1, 4):
                x = (rest[tets[elements[k], corner], axis] - origin[axis]) / spacing
                first, last = min(first, x), max(last, x)
            begin = min(max(int(np.floor(first + CLOSE)), 0), size[axis] - 1)
            end = min(max(int(np.ceil(last - CLOSE)), begin), size[axis] - 1)
            low[k, axis], count[k, axis] = begin, end - begin + 1


@njit(cache=True, nogil=True)
def find_faces(
    elements: NDArray[np.int32],
    tets: NDArray[np.int32],
    start: NDArray[np.int64],
    degree: NDArray[np.int32],
    data: NDArray[np.int32],
    faces: NDArray[np.int32],
) -> None:
    """Elements across the faces of elements, by lists of elements at nodes. Modifies `faces`."""
    for e in elements:
        for face in range(4):
            a, b, c = tets[e, (face + 1) % 4], tets[e, (face + 2) % 4], tets[e, (face + 3) % 4]
            faces[e, face] = -1
            for place in range(start[a], start[a] + degree[a]):
                other = data[place]
                if other == e:
                    continue
                shared = 0
                for corner in range(4):
                    shared += tets[other, corner] == b or tets[other, corner] == c
                if shared == 2:
                    faces[e, face] = other
                    break


@njit(cache=True, nogil=True)
def mark(low: NDArray[np.int32], count: NDArray[np.int32], value: bool, marks: Marks) -> None:
    """Mark the grid points of boxes, and their neighbours, or unmark them. Modifies `marks`."""
    size, dirty, near, box = marks
    for k in range(len(low)):
        if count[k, 0] == 0:
            continue
        for axis in range(3):
            box[0, axis] = min(box[0, axis], low[k, axis] - 1)
            box[1, axis] = max(box[1, axis], low[k, axis] + count[k, axis])
        for x in range(low[k, 0] - 1, low[k, 0] + count[k, 0] + 1):
            for y in range(low[k, 1] - 1, low[k, 1] + count[k, 1] + 1):
                for z in range(low[k, 2] - 1, low[k, 2] + count[k, 2] + 1):
                    if not (0 <= x < size[0] and 0 <= y < size[1] and 0 <= z < size[2]):
                        continue
                    point = (x * size[1] + y) * size[2] + z
                    near[point] = value
                    if (
                        0 <= x - low[k, 0] < count[k, 0]
                        and 0 <= y - low[k, 1] < count[k, 1]
                        and 0 <= z - low[k, 2] < count[k, 2]
                    ):
                        dirty[point] = value


@njit(cache=True, nogil=True)
def reaching(
    rows: int, alive: NDArray[np.bool_], boxes: Boxes, marks: Marks, out: NDArray[np.int32]
) -> int:
    """List the elements whose box meets that of the marks; how many."""
    low, extent, _, _ = boxes
    box, count = marks.box, 0
    for e in range(rows):
        if not alive[e]:
            continue
        meets = True
        for axis in range(3):
            meets &= low[e, axis] <= box[1, axis] and box[0, axis] < low[e, axis] + extent[e, axis]
        if meets:
            out[count] = e
            count += 1
    return count


@njit(inline="always")
def slot_of(start, low, count, e, x, y, z):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Slot of an element at one of the grid points of its box."""
    step = ((x - low[e, 0]) * count[e, 1] + y - low[e, 1]) * count[e, 2] + z - low[e, 2]
    return start[e] + step


@njit(cache=True, nogil=True)
def _find(parent: NDArray[np.int32], slot: int) -> int:
    while parent[slot] != slot:
        parent[slot] = parent[parent[slot]]
        slot = parent[slot]
    return slot


@njit(cache=True, nogil=True)
def join(elements: NDArray[np.int32], boxes: Boxes, slots: Slots, marks: Marks) -> None:
    """Join the slots of elements at marked grid points through faces. Modifies `slots`."""
    low, count, start, faces = boxes
    parent, size, dirty = slots.parent, marks.size, marks.dirty
    for e in elements:
        for slot in range(start[e], start[e] + count[e, 0] * count[e, 1] * count[e, 2]):
            parent[slot] = slot
            slots.row[slot] = -1
    for e in elements:
        for face in range(4):
            other = faces[e, face]
            if other < e:
                continue
            x0, x1 = (
                max(low[e, 0], low[other, 0]),
                min(low[e, 0] + count[e, 0], low[other, 0] + count[other, 0]),
            )
            y0, y1 = (
                max(low[e, 1], low[other, 1]),
                min(low[e, 1] + count[e, 1], low[other, 1] + count[other, 1]),
            )
            z0, z1 = (
                max(low[e, 2], low[other, 2]),
                min(low[e, 2] + count[e, 2], low[other, 2] + count[other, 2]),
            )
            for x in range(x0, x1):
                for y in range(y0, y1):
                    for z in range(z0, z1):
                        if not dirty[(x * size[1] + y) * size[2] + z]:
                            continue
                        one = _find(parent, slot_of(start, low, count, e, x, y, z))
                        two = _find(parent, slot_of(start, low, count, other, x, y, z))
                        parent[max(one, two)] = min(one, two)


@njit(cache=True, nogil=True)
def enter(
    elements: NDArray[np.int32],
    boxes: Boxes,
    slots: Slots,
    marks: Marks,
    used: int,
    place: NDArray[np.int32],
    before: NDArray[np.int32],
) -> int:
    """Give every part at a marked grid point a voxel; one keeps the row it had.

    Modifies `slots`, `place` and `before` in place.

    Args:
        elements: All that reach a marked grid point.
        boxes: Of the elements.
        slots: Of the elements, joined.
        marks: Which grid points are marked.
        used: Rows of voxels in use.
        place: Grid point of each voxel, -1 for one that is no more; shape (voxel_capacity, 3).
        before: Voxel whose displacement each one takes over: itself, that which it was a part of,
            or -1 for none; shape (voxel_capacity,).

    Returns:
        Rows of voxels in use then; if there is no room for so many, nothing but `slots.row` and
        `before` is changed.
    """
    low, count, start, _ = boxes
    voxel, parent, row = slots
    size, dirty = marks.size, marks.dirty
    rows, room = used, len(place)
    for v in range(used):
        before[v] = v
    for turn in range(4):
        if turn == 3:
            if rows > room:
                return rows
            for v in range(used):
                at = place[v]
                if at[0] >= 0 and dirty[(at[0] * size[1] + at[1]) * size[2] + at[2]]:
                    at[0] = -1
        for e in elements:
            slot = start[e]
            for x in range(low[e, 0], low[e, 0] + count[e, 0]):
                for y in range(low[e, 1], low[e, 1] + count[e, 1]):
                    for z in range(low[e, 2], low[e, 2] + count[e, 2]):
                        here, slot = slot, slot + 1
                        if not dirty[(x * size[1] + y) * size[2] + z]:
                            continue
                        part, old = _find(parent, here), voxel[here]
                        if turn == 0:
                            # `before` tells which rows are kept already.
                            if old >= 0 and row[part] < 0 and before[old] >= 0:
                                row[part], before[old] = old, -1 - old
                        elif turn < 3:
                            if row[part] < 0 and (old >= 0 or turn == 2):
                                if rows < room:
                                    before[rows] = old
                                row[part] = rows
                                rows += 1
                        else:
                            v = row[part]
                            voxel[here] = v
                            place[v, 0], place[v, 1], place[v, 2] = x, y, z
    for v in range(used):
        before[v] = v
    return rows


@njit(cache=True, nogil=True)
def link(
    elements: NDArray[np.int32],
    boxes: Boxes,
    voxel: NDArray[np.int32],
    marks: Marks,
    used: int,
    place: NDArray[np.int32],
    degree: NDArray[np.uint32],
    neighbour: NDArray[np.uint32],
) -> bool:
    """List the links of voxels at and next to marked grid points; whether there is room.

    Modifies `degree` and `neighbour`, shape (voxel_capacity, room), in place.
    """
    low, count, start, _ = boxes
    size, near = marks.size, marks.near
    for v in range(used):
        x = place[v, 0]
        if x < 0 or near[(x * size[1] + place[v, 1]) * size[2] + place[v, 2]]:
            degree[v] = 0
    for e in elements:
        slot = start[e]
        across = count[e, 1] * count[e, 2]
        for x in range(low[e, 0], low[e, 0] + count[e, 0]):
            for y in range(low[e, 1], low[e, 1] + count[e, 1]):
                for z in range(low[e, 2], low[e, 2] + count[e, 2]):
                    here, slot = slot, slot + 1
                    point = (x * size[1] + y) * size[2] + z
                    for axis in range(3):
                        at = x if axis == 0 else (y if axis == 1 else z)
                        if at + 1 == low[e, axis] + count[e, axis]:
                            continue
                        stride = size[1] * size[2] if axis == 0 else (size[2] if axis == 1 else 1)
                        step = across if axis == 0 else (count[e, 2] if axis == 1 else 1)
                        for way in range(2):
                            end = point + way * stride
                            if not near[end]:
                                continue
                            one = voxel[here + way * step]
                            two = voxel[here + (1 - way) * step]
                            known = False
                            for k in range(degree[one]):
                                known |= neighbour[one, k] == two
                            if known:
                                continue
                            if degree[one] == neighbour.shape[1]:
                                return False
                            neighbour[one, degree[one]] = two
                            degree[one] += 1
    return True
