"""Springs that keep the curvature of a surface: where they go and whose tissue they stand for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.sheet import edge_keys, sides, triangle_areas

STRAIGHT = -0.8
"""Cosine of the angle between two edges that go straight on; farther from it they turn off."""


def hinges(triangles: NDArray[np.integer]) -> NDArray[np.int32]:
    """Pairs of triangles that share an edge.

    Edges with one triangle (the border of a surface) or with more than two have no hinge.

    Args:
        triangles: Nodes of triangles, shape (t, 3).

    Returns:
        Nodes of each hinge: the two of the edge, then the opposite node of the triangle that runs
        along it in this direction, then that of the other; shape (h, 4), in the order of edges.
    """
    return hinges_and_triangles(triangles)[0]


def hinges_and_triangles(
    triangles: NDArray[np.integer],
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """`hinges`, and the places of their two triangles, shape (h, 2)."""
    directed = sides(triangles)
    opposite = triangles[:, [2, 0, 1]].ravel()
    keys = edge_keys(directed)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
    counts = np.diff(np.concatenate([starts, [len(ordered)]]))
    first = order[starts[counts == 2]]
    second = order[starts[counts == 2] + 1]
    found = np.concatenate([directed[first], opposite[first, None], opposite[second, None]], axis=1)
    real = found[:, 2] != found[:, 3]
    return found[real].astype(np.int32), np.stack([first // 3, second // 3], axis=1)[real]


def angular_springs(
    points: NDArray[np.float64], triangles: NDArray[np.integer], thickness: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Springs between the opposite nodes of two triangles that share an edge.

    Each stands for a third of the tissue of both triangles, as an edge of theirs does.

    Returns:
        Ends, shape (n, 2), and volumes of tissue [m^3], shape (n,).
    """
    pairs = hinges(triangles)
    volumes = triangle_areas(points, triangles) * thickness
    around = _around(triangles, volumes, edge_keys(pairs[:, :2]))
    return pairs[:, 2:], around / 3.0


def bending_springs(
    points: NDArray[np.float64], triangles: NDArray[np.integer], thickness: NDArray[np.float64]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Springs across two successive edges: from a node straight over a neighbour to the next.

    At every node each edge goes on in the one that most nearly continues it, if both choose each
    other and the turn is below 37 degrees. On a grid these are the springs over two cells. Each
    stands for a third of the tissue of the triangles at the two edges.

    Returns:
        Ends, shape (n, 2), and volumes of tissue [m^3], shape (n,).
    """
    keys = np.unique(edge_keys(sides(triangles)))
    ends = np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1)
    volumes = triangle_areas(points, triangles) * thickness
    shares = _around(triangles, volumes, keys) / 3.0
    at = np.concatenate([ends[:, 0], ends[:, 1]])
    to = np.concatenate([ends[:, 1], ends[:, 0]])
    edge = np.concatenate([np.arange(len(ends))] * 2)
    order = np.lexsort((to, at))
    at, to, edge = at[order], to[order], edge[order]
    start = np.searchsorted(at, np.arange(len(points) + 1))
    unit = points[to] - points[at]
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    found: list[tuple[int, int]] = []
    tissue: list[float] = []
    for node in np.flatnonzero(np.diff(start) > 1):
        here = slice(start[node], start[node + 1])
        cosine = unit[here] @ unit[here].T
        partner = np.argmin(cosine, axis=1)
        for one, other in enumerate(partner.tolist()):
            mutual = one < other and partner[other] == one
            if mutual and cosine[one, other] < STRAIGHT:
                found.append((int(to[here][one]), int(to[here][other])))
                tissue.append(float(shares[edge[here][one]] + shares[edge[here][other]]))
    return np.array(found, dtype=np.int32).reshape(-1, 2), np.array(tissue)


def _around(
    triangles: NDArray[np.integer], volumes: NDArray[np.float64], keys: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Sum of the volumes of the triangles at each of the edges [m^3], shape (len(keys),)."""
    known, edge = np.unique(edge_keys(sides(triangles)), return_inverse=True)
    sums = np.bincount(edge.ravel(), weights=np.repeat(volumes, 3))
    return np.asarray(sums[np.searchsorted(known, keys)])
