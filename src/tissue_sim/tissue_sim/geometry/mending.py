"""The steps of `check.mend`: each takes a mesh, mends one thing and says so, or refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csgraph
from scipy.spatial import cKDTree

from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.errors import MeshError
from tissue_sim.geometry.faces import (
    LOCAL_FACES,
    face_nodes,
    order_of_triples,
    pair_faces,
    turns_alike,
)
from tissue_sim.geometry.quality import longest_edges, signed_volumes
from tissue_sim.geometry.raw_mesh import RawMesh

Step = Callable[[RawMesh, list[str]], RawMesh]

SAME_PLACE = 1e-6
"""Nodes closer than this share of the mesh's diagonal are one node."""

FLAT = 1e-9
"""An element is flat if six times its volume is below this share of its longest edge cubed."""

ISLAND = 0.01
"""Parts with fewer elements than this share of the largest part's are dropped."""


def label(raw: RawMesh) -> str:
    """How messages name a mesh."""
    return raw.source or raw.name


def node_id(raw: RawMesh, row: int) -> int:
    """Id of a node in its file."""
    return int(raw.node_file_ids[row]) if len(raw.node_file_ids) else int(row)


def element_id(raw: RawMesh, row: int) -> int:
    """Id of an element in its file."""
    return int(raw.element_file_ids[row]) if len(raw.element_file_ids) else int(row)


def _examples(raw: RawMesh, rows: NDArray[np.integer]) -> str:
    ids = ", ".join(str(element_id(raw, int(row))) for row in rows[:3])
    return f"element {ids}" if len(rows) == 1 else f"elements {ids}{', ...' * (len(rows) > 3)}"


def _with_file_ids(raw: RawMesh, mended: list[str]) -> RawMesh:
    """Give every node and element a file id, so that rows can be dropped from here on."""
    nodes = raw.node_file_ids if len(raw.node_file_ids) else np.arange(len(raw.points))
    elements = raw.element_file_ids
    if not len(elements):
        elements = np.arange(len(raw.tetrahedra))
    return replace(raw, node_file_ids=nodes, element_file_ids=elements)


def _refuse_unusable(raw: RawMesh, mended: list[str]) -> RawMesh:
    bad = ~np.isfinite(raw.points).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise MeshError(
            f"{label(raw)}: node {node_id(raw, row)} is at {raw.points[row].tolist()}, "
            "which is not finite"
        )
    for items, what in ((raw.tetrahedra, "tetrahedron"), (raw.triangles, "triangle")):
        outside = ((items < 0) | (items >= len(raw.points))).any(axis=1)
        if outside.any():
            row = int(np.argmax(outside))
            raise MeshError(
                f"{label(raw)}: {what} {row} names node rows {items[row].tolist()} "
                f"of {len(raw.points)} nodes"
            )
    return raw


def _keep_elements(raw: RawMesh, keep: NDArray[np.bool_]) -> RawMesh:
    """The mesh with some of its elements, all of its nodes."""
    return replace(
        raw,
        tetrahedra=raw.tetrahedra[keep],
        element_file_ids=raw.element_file_ids[keep],
        regions=raw.regions[keep] if len(raw.regions) else raw.regions,
        element_vectors={name: rows[keep] for name, rows in raw.element_vectors.items()},
        fibres=raw.fibres[keep] if len(raw.fibres) else raw.fibres,
    )


def _drop_unused(raw: RawMesh, mended: list[str]) -> RawMesh:
    """Drop nodes without an element."""
    compact = compacted(raw)
    if len(compact.points) < len(raw.points):
        count = len(raw.points) - len(compact.points)
        mended.append(f"{count} nodes that no element uses were dropped")
    if len(compact.triangles) < len(raw.triangles):
        count = len(raw.triangles) - len(compact.triangles)
        mended.append(f"{count} surface triangles at dropped nodes were dropped")
    return compact


def compacted(raw: RawMesh) -> RawMesh:
    """The mesh without nodes that no element uses, and without surface triangles that name them."""
    items = raw.tetrahedra if len(raw.tetrahedra) else raw.triangles
    used = np.zeros(len(raw.points), dtype=np.bool_)
    used[items] = True
    if used.all():
        return raw
    new_row = np.where(used, np.cumsum(used) - 1, -1)
    triangles = new_row[raw.triangles]
    return replace(
        raw,
        points=raw.points[used],
        tetrahedra=new_row[raw.tetrahedra],
        triangles=triangles[(triangles >= 0).all(axis=1)],
        node_sets={
            name: np.unique(new_row[rows][new_row[rows] >= 0])
            for name, rows in raw.node_sets.items()
        },
        node_file_ids=raw.node_file_ids[used],
    )


def _join_nodes(raw: RawMesh, mended: list[str]) -> RawMesh:
    """Make one node of nodes at the same place."""
    size = float(np.linalg.norm(np.ptp(raw.points, axis=0)))
    # Exact copies first: they may be many, and the tree search takes time quadratic in them.
    places, place_of = np.unique(raw.points, axis=0, return_inverse=True)
    close = cKDTree(places).query_pairs(SAME_PLACE * size, output_type="ndarray")
    graph = coo_matrix((np.ones(len(close)), close.T), shape=(len(places), len(places)))
    _, group = csgraph.connected_components(graph, directed=False)
    group = group[place_of.ravel()]
    _, first = np.unique(group, return_index=True)
    row = first[group]
    joined = int((row != np.arange(len(row))).sum())
    if not joined:
        return raw
    mended.append(f"{joined} nodes that lay on another one were joined with it")
    return compacted(
        replace(
            raw,
            tetrahedra=row[raw.tetrahedra],
            triangles=row[raw.triangles],
            node_sets={name: np.unique(row[rows]) for name, rows in raw.node_sets.items()},
        )
    )


def _drop_collapsed(raw: RawMesh, mended: list[str]) -> RawMesh:
    """Drop elements that have a node twice: their two other faces coincide, so nothing opens."""
    corners = np.sort(raw.tetrahedra, axis=1)
    bad = (corners[:, 1:] == corners[:, :-1]).any(axis=1)
    if not bad.any():
        return raw
    rows = np.flatnonzero(bad)
    mended.append(f"{len(rows)} elements with a node twice were dropped: {_examples(raw, rows)}")
    return _keep_elements(raw, ~bad)


def _drop_duplicates(raw: RawMesh, mended: list[str]) -> RawMesh:
    corners = np.sort(raw.tetrahedra, axis=1)
    by_last = np.argsort(corners[:, 3], kind="stable")
    order = by_last[order_of_triples(corners[by_last, :3])]
    keep = np.ones(len(corners), dtype=np.bool_)
    keep[order[1:]] = (corners[order[1:]] != corners[order[:-1]]).any(axis=1)
    if keep.all():
        return raw
    rows = np.flatnonzero(~keep)
    mended.append(
        f"{len(rows)} elements with the same nodes as another one were dropped: "
        f"{_examples(raw, rows)}"
    )
    return _keep_elements(raw, keep)


def _drop_flat(raw: RawMesh, mended: list[str]) -> RawMesh:
    """Drop flat elements at the surface; one inside would leave a hidden crack."""
    volumes = signed_volumes(raw.points, raw.tetrahedra)
    longest = longest_edges(raw.points, raw.tetrahedra)
    flat = 6 * np.abs(volumes) <= FLAT * longest**3
    if not flat.any():
        return raw
    at_surface = np.zeros(len(flat), dtype=np.bool_)
    at_surface[pair_faces(raw.tetrahedra).border // 4] = True
    inside = np.flatnonzero(flat & ~at_surface)
    if len(inside):
        raise MeshError(
            f"{label(raw)}: {_examples(raw, inside)} inside the mesh: no volume; dropping would "
            "leave a hidden crack, so mesh it again"
        )
    rows = np.flatnonzero(flat)
    mended.append(
        f"{len(rows)} elements without volume at the surface were dropped: {_examples(raw, rows)}"
    )
    return _keep_elements(raw, ~flat)


def _turn(raw: RawMesh, mended: list[str]) -> RawMesh:
    """Make all volumes positive and refuse elements that then overlap their neighbour."""
    negative = signed_volumes(raw.points, raw.tetrahedra) < 0
    if negative.all():
        mended.append("all elements were numbered the other way round and were turned")
    elif negative.any():
        rows = np.flatnonzero(negative)
        mended.append(
            f"{len(rows)} elements were numbered the other way round and were turned: "
            f"{_examples(raw, rows)}"
        )
    turned = raw.tetrahedra[:, [0, 1, 3, 2]]
    return replace(raw, tetrahedra=np.where(negative[:, None], turned, raw.tetrahedra))


def _refuse_overlaps(raw: RawMesh, mended: list[str]) -> RawMesh:
    pairs = pair_faces(raw.tetrahedra)
    if len(pairs.crowded):
        face = pairs.crowded[:1]
        nodes = [node_id(raw, n) for n in face_nodes(raw.tetrahedra, face)[0]]
        same = np.sort(face_nodes(raw.tetrahedra, pairs.crowded), axis=1)
        elements = np.unique(pairs.crowded[(same == same[0]).all(axis=1)] // 4)
        raise MeshError(
            f"{label(raw)}: more than two elements share the face of nodes {nodes}: "
            f"{_examples(raw, elements)}; a face may separate two"
        )
    alike = np.flatnonzero(turns_alike(raw.tetrahedra, pairs.first, pairs.second))
    if len(alike):
        a, b = pairs.first[alike[0]] // 4, pairs.second[alike[0]] // 4
        raise MeshError(
            f"{label(raw)}: element {element_id(raw, a)} and its neighbour {element_id(raw, b)} "
            f"lie on the same side of their common face: one is inverted ({len(alike)} such "
            "pairs); mesh it again"
        )
    return raw


def _split_pinches(raw: RawMesh, mended: list[str]) -> RawMesh:
    """Give every piece of tissue that meets another in a node only a node of its own."""
    pairs = pair_faces(raw.tetrahedra)
    corners = [
        4 * (faces[:, None] // 4)
        + np.take_along_axis(
            LOCAL_FACES[faces % 4], np.argsort(face_nodes(raw.tetrahedra, faces), axis=1), axis=1
        )
        for faces in (pairs.first, pairs.second)
    ]
    count = 4 * len(raw.tetrahedra)
    links = (corners[0].ravel(), corners[1].ravel())
    graph = coo_matrix((np.ones(len(links[0]), dtype=np.int8), links), shape=(count, count))
    _, piece = csgraph.connected_components(graph, directed=False)
    _, first = np.unique(piece, return_index=True)
    node_of_piece = raw.tetrahedra.ravel()[first]
    by_node = np.lexsort((first, node_of_piece))
    ordered = node_of_piece[by_node]
    is_extra = np.zeros(len(ordered), dtype=np.bool_)
    is_extra[1:] = ordered[1:] == ordered[:-1]
    extra = by_node[is_extra]
    if not len(extra):
        return raw
    parents = node_of_piece[extra]
    new_node = node_of_piece.copy()
    new_node[extra] = len(raw.points) + np.arange(len(extra))
    mended.append(
        f"{len(np.unique(parents))} nodes where tissue met in a point or an edge only were split "
        f"into one per piece, node {node_id(raw, int(parents[0]))} among them"
    )
    sets = {
        name: np.concatenate([rows, len(raw.points) + np.flatnonzero(np.isin(parents, rows))])
        for name, rows in raw.node_sets.items()
    }
    return replace(
        raw,
        points=np.concatenate([raw.points, raw.points[parents]]),
        tetrahedra=new_node[piece].reshape(-1, 4),
        node_file_ids=np.concatenate([raw.node_file_ids, raw.node_file_ids[parents]]),
        node_sets=sets,
    )


def _parts(raw: RawMesh) -> tuple[int, NDArray[np.int32]]:
    items = (raw.tetrahedra if len(raw.tetrahedra) else raw.triangles).astype(np.int32)
    return connected_components(items, np.ones(len(items), dtype=np.bool_), len(raw.points))


def part_sizes(raw: RawMesh) -> tuple[int, ...]:
    """Nodes of each connected part, largest first."""
    count, labels = _parts(raw)
    sizes = np.bincount(labels[labels >= 0], minlength=count)
    return tuple(sorted(sizes.tolist(), reverse=True))


def _drop_islands(raw: RawMesh, mended: list[str]) -> RawMesh:
    count, labels = _parts(raw)
    if count < 2:
        return raw
    part = labels[raw.tetrahedra[:, 0]]
    elements = np.bincount(part, minlength=count)
    small = elements < ISLAND * elements.max()
    if not small.any():
        return raw
    nodes = int(np.isin(labels, np.flatnonzero(small)).sum())
    mended.append(
        f"{int(small.sum())} small islands with {nodes} nodes and {int(elements[small].sum())} "
        "elements in all were dropped"
    )
    return compacted(_keep_elements(raw, ~small[part]))


def _clean_triangles(raw: RawMesh, mended: list[str]) -> RawMesh:
    """Drop triangles with a node twice and repeated triangles of a surface."""
    corners = np.sort(raw.triangles, axis=1)
    collapsed = (corners[:, 1:] == corners[:, :-1]).any(axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    repeated = np.ones(len(corners), dtype=np.bool_)
    repeated[first] = False
    repeated &= ~collapsed
    for bad, what in ((collapsed, "with a node twice"), (repeated, "that lay on another one")):
        if bad.any():
            mended.append(f"{int(bad.sum())} triangles {what} were dropped")
    return replace(raw, triangles=raw.triangles[~(collapsed | repeated)])


MENDERS: tuple[Step, ...] = (
    _refuse_unusable, _with_file_ids, _drop_unused, _join_nodes, _drop_collapsed, _drop_duplicates,
    _drop_flat, _turn, _refuse_overlaps, _split_pinches, _drop_islands, _drop_unused,
)  # fmt: skip
"""Steps for a mesh of tetrahedra, in order."""

SURFACE_MENDERS: tuple[Step, ...] = (
    _refuse_unusable, _with_file_ids, _drop_unused, _join_nodes, _clean_triangles, _drop_unused,
)  # fmt: skip
"""Steps for a surface."""
