"""A surface cut along the lines on which a quantity of its nodes has some values.

Between two such lines every band has one colour. A band's vertices lie on nodes, or on edges where
the quantity reaches the line's value; they follow the tissue until the quantity changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tool_input.table.surface_parts import Color, SurfacePart
from tool_input.table.tissue_frame import Surface

MOST_CORNERS = 5
"""A triangle and the strip between two parallel lines have a pentagon in common at most."""

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SurfaceEdges:
    """A surface with its edges numbered.

    Attributes:
        nodes: Rows of its nodes, shape (n,).
        triangles: Rows of `nodes`, shape (m, 3).
        edges: Rows of `nodes` at the ends of each edge, the lower first, shape (e, 2).
        edge_of: Edge from each corner of a triangle to its next, shape (m, 3).
    """

    nodes: Ints
    triangles: Ints
    edges: Ints
    edge_of: Ints


@lru_cache(maxsize=2)
def surface_edges(surface: Surface) -> SurfaceEdges:
    """The edges of a surface, numbered once for all windows."""
    triangles = surface.triangles.astype(np.int64)
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)
    ends.sort(axis=2)
    keys, edge_of = np.unique(ends[..., 0] << 32 | ends[..., 1], return_inverse=True)
    edges = np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1)
    return SurfaceEdges(surface.nodes, triangles, edges, edge_of.reshape(-1, 3).astype(np.int64))


def contour_bands(
    surface: SurfaceEdges,
    values: NDArray[np.floating],
    levels: Sequence[float] | NDArray[np.floating],
    colors: Sequence[Color],
    unknown: Color,
) -> tuple[SurfacePart, ...]:
    """Cut a surface into bands.

    Args:
        surface: The surface.
        values: A quantity at its nodes; nan: unknown, shape (n,).
        levels: Values between successive bands, ascending, shape (k - 1,).
        colors: Of the k bands, that of the lowest values first.
        unknown: Colour of triangles with a corner whose value is unknown.

    Returns:
        A part for each band, then one for what is unknown; any may have no triangles.

    Raises:
        ValueError: The levels do not ascend, or do not fit the colours.
    """
    steps = np.asarray(levels, dtype=np.float64)
    if len(steps) != len(colors) - 1 or (np.diff(steps) <= 0.0).any():
        raise ValueError(
            f"{len(colors)} colours need {len(colors) - 1} ascending levels between them, "
            f"not {steps.tolist()}"
        )
    known = np.isfinite(values)
    whole = known[surface.triangles].all(axis=1)
    band_of = np.searchsorted(steps, values, side="right").astype(np.int64)
    places = np.where(known, values, 0.0).astype(np.float64)
    used = np.zeros(len(surface.nodes), dtype=np.bool_)
    used[surface.triangles[whole]] = True
    crossed = np.zeros(len(surface.edges), dtype=np.bool_)
    crossed[surface.edge_of[whole]] = True
    vertex_band, first, second, weights, node_vertex, edge_start = _numbered(
        surface.edges, crossed, used, band_of, places, steps
    )
    faces, face_band = _faces(
        surface.triangles[whole], surface.edge_of[whole], surface.edges,
        band_of, node_vertex, edge_start,
    )  # fmt: skip
    vertices, vertex_ends = _by_band(vertex_band, len(colors))
    triangles, triangle_ends = _by_band(face_band, len(colors))
    place = np.empty(len(vertices), dtype=np.uint32)
    place[vertices] = (
        np.arange(len(vertices))
        - (vertex_ends - np.diff(vertex_ends, prepend=0))[vertex_band[vertices]]
    )
    first, second = surface.nodes[first[vertices]], surface.nodes[second[vertices]]
    weights = weights[vertices].astype(np.float32)
    corners = place[faces[triangles]]
    split = vertex_ends[:-1]
    parts = map(
        SurfacePart, colors, np.split(first, split), np.split(second, split),
        np.split(weights, split), np.split(corners, triangle_ends[:-1]),
    )  # fmt: skip
    rest = SurfacePart.of_nodes(unknown, surface.nodes[surface.triangles[~whole]])
    return (*parts, rest)


def _by_band(band_of: Ints, bands: int) -> tuple[Ints, Ints]:
    """Rows in the order of their bands, and where each band's end."""
    return np.argsort(band_of, kind="stable"), np.cumsum(np.bincount(band_of, minlength=bands))


@njit(cache=True, nogil=True)
def _numbered(
    edges: Ints,
    crossed: NDArray[np.bool_],
    used: NDArray[np.bool_],
    band_of: Ints,
    values: NDArray[np.float64],
    levels: NDArray[np.float64],
) -> tuple[Ints, Ints, Ints, NDArray[np.float64], Ints, Ints]:
    """Vertices of all bands: used nodes, and two where an edge reaches a level, one on each side.

    Returns:
        Band, both nodes and weight of each vertex; the vertex of each node; and the first vertex
        of each edge, whose crossings follow by ascending level, the one below first.
    """
    count = 0
    for node in range(len(used)):
        count += used[node]
    for edge in range(len(edges)):
        if crossed[edge]:
            count += 2 * abs(band_of[edges[edge, 0]] - band_of[edges[edge, 1]])
    vertex_band = np.empty(count, np.int64)
    first, second = np.empty(count, np.int64), np.empty(count, np.int64)
    weights = np.zeros(count)
    node_vertex = np.empty(len(used), np.int64)
    edge_start = np.empty(len(edges), np.int64)
    vertex = 0
    for node in range(len(used)):
        node_vertex[node] = vertex
        if used[node]:
            vertex_band[vertex] = band_of[node]
            first[vertex] = second[vertex] = node
            vertex += 1
    for edge in range(len(edges)):
        edge_start[edge] = vertex
        if not crossed[edge]:
            continue
        low, high = edges[edge]
        if band_of[low] > band_of[high]:
            low, high = high, low
        for level in range(band_of[low], band_of[high]):
            along = (levels[level] - values[low]) / (values[high] - values[low])
            for side in range(2):
                vertex_band[vertex] = level + side
                first[vertex], second[vertex] = low, high
                weights[vertex] = min(max(along, 0.0), 1.0)
                vertex += 1
    return vertex_band, first, second, weights, node_vertex, edge_start


@njit(cache=True, nogil=True)
def _faces(
    triangles: Ints,
    edge_of: Ints,
    edges: Ints,
    band_of: Ints,
    node_vertex: Ints,
    edge_start: Ints,
) -> tuple[Ints, Ints]:
    """What each band has of each triangle, as triangles that keep the way round.

    Returns:
        Vertices of each, shape (n, 3), and its band.
    """
    room = 0
    for triangle in range(len(triangles)):
        a, b, c = triangles[triangle]
        low = min(band_of[a], band_of[b], band_of[c])
        room += 3 * (max(band_of[a], band_of[b], band_of[c]) - low) + 1
    faces = np.empty((room, 3), np.int64)
    face_band = np.empty(room, np.int64)
    corners = np.empty(MOST_CORNERS, np.int64)
    count = 0
    for triangle in range(len(triangles)):
        a, b, c = triangles[triangle]
        low = min(band_of[a], band_of[b], band_of[c])
        high = max(band_of[a], band_of[b], band_of[c])
        for band in range(low, high + 1):
            length = 0
            for corner in range(3):
                node = triangles[triangle, corner]
                start, end = band_of[node], band_of[triangles[triangle, (corner + 1) % 3]]
                at = edge_start[edge_of[triangle, corner]] - 2 * min(start, end)
                if start == band:
                    corners[length] = node_vertex[node]
                    length += 1
                # Into the band, then out of it, along this edge.
                if start < band <= end:
                    corners[length] = at + 2 * (band - 1) + 1
                    length += 1
                elif end <= band < start:
                    corners[length] = at + 2 * band
                    length += 1
                if start <= band < end:
                    corners[length] = at + 2 * band
                    length += 1
                elif end < band <= start:
                    corners[length] = at + 2 * (band - 1) + 1
                    length += 1
            for corner in range(2, length):
                faces[count, 0] = corners[0]
                faces[count, 1] = corners[corner - 1]
                faces[count, 2] = corners[corner]
                face_band[count] = band
                count += 1
    return faces[:count], face_band[:count]
