"""Pieces a cut would free that are too small to be meant: crumbs, glued back."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cut_service.neighbours import NOBODY, Links, across, corner_facing, has_node

GOES_ON = 16
"""Bit of an element, beside those of its faces in the cut: the mesh goes on behind it.

A piece with such an element is large.
"""


@njit(cache=True, nogil=True)
def piece_of(
    links: Links, cut: NDArray[np.uint8], seed: int, limit: int, found: NDArray[np.int32]
) -> int:
    """Collect the elements joined to `seed` through uncut faces, at most limit + 1 of them.

    Their number.
    """
    found[0] = seed
    number, done = 1, 0
    while done < number and number <= limit:
        element = found[done]
        done += 1
        if cut[element] & GOES_ON:
            return limit + 1
        for corner in range(4):
            if cut[element] & (1 << corner):
                continue
            other = across(links, element, corner)
            if other == NOBODY:
                continue
            known = False
            for k in range(number):
                known = known or found[k] == other
            if not known and number <= limit:
                found[number] = other
                number += 1
    return number


@njit(cache=True, nogil=True)
def _touches(links: Links, element: int, crumb: NDArray[np.int32]) -> bool:
    for k in range(crumb.shape[0]):
        for corner in range(4):
            if has_node(links, element, links.tets[crumb[k], corner]):
                return True
    return False


@njit(cache=True, nogil=True)
def _flood(
    links: Links,
    cut: NDArray[np.uint8],
    seed: int,
    crumb: NDArray[np.int32],
    found: NDArray[np.int32],
) -> int:
    """Elements joined to `seed` through uncut faces without leaving what touches the crumb.

    Their number.
    """
    found[0] = seed
    number, done = 1, 0
    while done < number:
        element = found[done]
        done += 1
        for corner in range(4):
            if cut[element] & (1 << corner):
                continue
            other = across(links, element, corner)
            if other == NOBODY or not _touches(links, other, crumb):
                continue
            known = False
            for k in range(number):
                known = known or found[k] == other
            if not known and number < found.shape[0]:
                found[number] = other
                number += 1
    return number


@njit(cache=True, nogil=True)
def _twice_area(positions: NDArray[np.float64], links: Links, element: int, corner: int) -> float:
    a = positions[links.tets[element, (corner + 1) % 4]]
    u = positions[links.tets[element, (corner + 2) % 4]] - a
    v = positions[links.tets[element, (corner + 3) % 4]] - a
    return np.sqrt(max(0.0, np.dot(u, u) * np.dot(v, v) - np.dot(u, v) ** 2))


@njit(cache=True, nogil=True)
def _glue(
    links: Links,
    positions: NDArray[np.float64],
    cut: NDArray[np.uint8],
    crumb: NDArray[np.int32],
    found: NDArray[np.int32],
) -> int:
    """Take the faces between a crumb and the side it shares most area with out of the cut.

    Their number.
    """
    best, best_seed = -1.0, NOBODY
    for k in range(crumb.shape[0]):
        for corner in range(4):
            if not cut[crumb[k]] & (1 << corner):
                continue
            seed = across(links, crumb[k], corner)
            number = _flood(links, cut, seed, crumb, found)
            area = 0.0
            for m in range(crumb.shape[0]):
                for c in range(4):
                    if cut[crumb[m]] & (1 << c):
                        other = across(links, crumb[m], c)
                        for n in range(number):
                            if found[n] == other:
                                area += _twice_area(positions, links, crumb[m], c)
            if area > best * (1.0 + 1e-9):
                best, best_seed = area, seed
    if best_seed == NOBODY:
        return 0
    number = _flood(links, cut, best_seed, crumb, found)
    glued = 0
    for k in range(crumb.shape[0]):
        for corner in range(4):
            if not cut[crumb[k]] & (1 << corner):
                continue
            other = across(links, crumb[k], corner)
            for n in range(number):
                if found[n] == other:
                    cut[crumb[k]] &= ~(1 << corner)
                    cut[other] &= ~(1 << corner_facing(links, other, crumb[k]))
                    glued += 1
                    break
    return glued


@njit(cache=True, nogil=True)
def glue_crumbs(
    links: Links,
    positions: NDArray[np.float64],
    faces: NDArray[np.int32],
    limit: int,
    cut: NDArray[np.uint8],
) -> int:
    """Give every piece of at most `limit` elements that a cut would free back to a neighbour.

    Modifies `cut` in place.

    A plane through an irregular mesh can leave single elements on their own between the two sides.
    They would fall out of the organ as unconstrained bodies of no meaning to a surgeon.

    Args:
        links: The mesh.
        positions: Node positions [m], shape (node_rows, 3).
        faces: Element row and opposite corner of the faces of the cut surface, shape (n, 2).
        limit: Largest number of elements of a crumb.
        cut: Faces in the cut surface, bits by corner, shape (element_rows,).

    Returns:
        Number of faces taken out of the cut surface.
    """
    piece = np.empty(limit + 1, dtype=np.int32)
    found = np.empty(4096, dtype=np.int32)
    glued, before = 0, -1
    while glued != before:
        before = glued
        for k in range(faces.shape[0]):
            for side in range(2):
                element = faces[k, 0]
                if not cut[element] & (1 << faces[k, 1]):
                    continue
                if side == 1:
                    element = across(links, element, faces[k, 1])
                number = piece_of(links, cut, element, limit, piece)
                if number <= limit:
                    glued += _glue(links, positions, cut, piece[:number], found)
    return glued
