"""The surface of tissue: triangles with outward normals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.geometry.faces import LOCAL_FACES

if TYPE_CHECKING:
    from tissue_sim.geometry.mesh import Mesh


@njit(cache=True, nogil=True)
def _border_faces(
    tets: NDArray[np.int32],
    alive: NDArray[np.bool_],
    local_faces: NDArray[np.int64],
    start: NDArray[np.int32],
    keys: NDArray[np.uint64],
    faces: NDArray[np.int32],
    is_border: NDArray[np.bool_],
) -> int:
    """Mark the faces that only one element has, and count them.

    Faces are sorted into one short list per lowest node, where the other two nodes, packed into
    one number, are compared. A face that finds its partner takes it off the list.

    Args:
        tets: Node rows of elements.
        alive: Elements that count.
        local_faces: Corners of the face opposite each corner.
        start: Beginning of each node's list, one more than there are nodes; zero on entry.
        keys: Work space, one per face.
        faces: Work space, one per face.
        is_border: Result, one per face; false on entry.
    """
    node_count = len(start) - 1
    for element in range(len(tets)):
        if alive[element]:
            for k in range(4):
                a = tets[element, local_faces[k, 0]]
                b = tets[element, local_faces[k, 1]]
                c = tets[element, local_faces[k, 2]]
                start[min(a, b, c) + 1] += 1
    for node in range(node_count):
        start[node + 1] += start[node]
    length = np.zeros(node_count, dtype=np.int32)
    count = 0
    for element in range(len(tets)):
        if not alive[element]:
            continue
        for k in range(4):
            a = tets[element, local_faces[k, 0]]
            b = tets[element, local_faces[k, 1]]
            c = tets[element, local_faces[k, 2]]
            low, high = min(a, b, c), max(a, b, c)
            middle = a + b + c - low - high
            key = (np.uint64(middle) << np.uint64(32)) | np.uint64(high)
            begin = start[low]
            end = begin + length[low]
            place = begin
            while place < end and keys[place] != key:
                place += 1
            if place == end:
                keys[end] = key
                faces[end] = 4 * element + k
                length[low] += 1
                is_border[4 * element + k] = True
                count += 1
            else:
                is_border[faces[place]] = False
                keys[place] = keys[end - 1]
                faces[place] = faces[end - 1]
                length[low] -= 1
                count -= 1
    return count


@njit(cache=True, nogil=True)
def _collect(
    tets: NDArray[np.int32],
    local_faces: NDArray[np.int64],
    is_border: NDArray[np.bool_],
    triangles: NDArray[np.int32],
    elements: NDArray[np.int32],
) -> None:
    count = 0
    for face in range(len(is_border)):
        if is_border[face]:
            element, k = face // 4, face % 4
            for corner in range(3):
                triangles[count, corner] = tets[element, local_faces[k, corner]]
            elements[count] = element
            count += 1


def boundary_triangles(
    tets: NDArray[np.int32], alive: NDArray[np.bool_], node_count: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Triangles between tissue and outside.

    Args:
        tets: Node rows of positively oriented elements, shape (element_count, 4).
        alive: Elements that exist, shape (element_count,).
        node_count: Number of node rows.

    Returns:
        Node rows of the triangles with outward normals (right hand), shape (triangle_count, 3), in
        the order of their elements; and the element of each, shape (triangle_count,).
    """
    tets = np.ascontiguousarray(tets, dtype=np.int32)
    start = np.zeros(node_count + 1, dtype=np.int32)
    keys = np.empty(4 * len(tets), dtype=np.uint64)
    faces = np.empty(4 * len(tets), dtype=np.int32)
    is_border = np.zeros(4 * len(tets), dtype=np.bool_)
    count = _border_faces(tets, alive, LOCAL_FACES, start, keys, faces, is_border)
    triangles = np.empty((count, 3), dtype=np.int32)
    elements = np.empty(count, dtype=np.int32)
    _collect(tets, LOCAL_FACES, is_border, triangles, elements)
    return triangles, elements


def surface_triangles(mesh: Mesh) -> NDArray[np.int32]:
    """Node rows of a mesh's surface as it is now, normals outward, shape (triangle_count, 3).

    The triangles of a sheet, or the boundary of the tetrahedra.
    """
    if mesh.sheet is not None:
        return np.concatenate([mesh.sheet.triangles, mesh.sheet.walls])
    rows = mesh.element_rows
    return boundary_triangles(mesh.tets[:rows], mesh.element_alive[:rows], mesh.node_rows)[0]


@njit(cache=True, nogil=True, error_model="numpy")
def vertex_normals(
    positions: NDArray[np.floating], triangles: NDArray[np.int32], normals: NDArray[np.floating]
) -> None:
    """Unit normals of nodes, means of their triangles' normals weighted by area.

    Args:
        positions: Node positions [m], shape (node_count, 3).
        triangles: Node rows of surface triangles, shape (triangle_count, 3).
        normals: Overwritten in place, shape (node_count, 3); zero where no triangle meets.
    """
    for node in range(len(normals)):
        for axis in range(3):
            normals[node, axis] = 0.0
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux = positions[b, 0] - positions[a, 0]
        uy = positions[b, 1] - positions[a, 1]
        uz = positions[b, 2] - positions[a, 2]
        vx = positions[c, 0] - positions[a, 0]
        vy = positions[c, 1] - positions[a, 1]
        vz = positions[c, 2] - positions[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for node in (a, b, c):
            normals[node, 0] += nx
            normals[node, 1] += ny
            normals[node, 2] += nz
    for node in range(len(normals)):
        x, y, z = normals[node, 0], normals[node, 1], normals[node, 2]
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0.0:
            for axis in range(3):
                normals[node, axis] /= length
