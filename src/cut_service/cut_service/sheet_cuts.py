"""Planning a cut of tissue that is made of triangles and springs.

Triangles are split along edges and not divided: their number and the springs' stays what it is,
nothing gets thin or stiff, and spring models go on with the time steps they had. What the cut
follows less closely is made up for by snapping, along the edges that the sweep crosses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutCode, CutError
from cut_service.sheet_selection import (
    Crossing,
    Parting,
    cross,
    near,
    part,
    segments_crossed,
)
from cut_service.sheet_snapping import SheetSnapping, snap
from cut_service.sheet_springs import Sides, SpringCut, cut_springs
from cut_service.sheet_walls import Lips, Walls, build_walls
from cut_service.sweep import Sweep
from cut_service.work import Plan, Report, Work, distance_of, missed, too_shallow
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.sheet import CONNECTING, edge_keys, sides, triangle_areas
from tissue_sim.geometry.sheet_edit import NO_NODE
from tissue_sim.geometry.sheet_rows import WALL, SheetRows
from tissue_sim.interaction.blade_contact import mean_edge

Rows = NDArray[np.int32]
Reals = NDArray[np.float64]

FLAT = 1e-9
"""A wall's triangle whose area is below this share of its longest side squared is left out."""


@dataclass(frozen=True)
class SheetWork(Work):
    """What the steps of a plan share, on a mesh that is a sheet."""

    @property
    def rows(self) -> SheetRows:
        """What the elements are."""
        rows = self.mesh.sheet_rows
        if rows is None:
            raise CutError(CutCode.REFUSED, f"{self.mesh.name} is not made of triangles")
        return rows

    def of_kind(self, kind: int) -> Rows:
        """Rows of living elements of a kind."""
        used = self.mesh.element_rows
        alive = self.mesh.element_alive[:used] & (self.rows.kinds[:used] == kind)
        return np.flatnonzero(alive).astype(np.int32)


def split_sheet(given: Work) -> Plan:
    """Plan a cut that splits triangles along edges. Nothing is changed.

    Raises:
        CutError: The sweep crosses nothing, or parts nothing.
    """
    work = SheetWork(**vars(given))
    mesh, places = work.mesh, work.positions
    solid = work.of_kind(0)
    crossing = cross(mesh, places, solid, work.sweep)
    if not len(crossing.triangles):
        raise missed()
    keys, parting, glued = _without_crumbs(work, crossing, solid)
    lips, opposite = _lips(work, keys, parting)
    if not len(lips.edges):
        raise too_shallow(len(crossing.triangles))
    snapping = _snapped(work, crossing, lips)
    moved = snapping.moved(places)
    on_cut = set(crossing.chosen.tolist()) | set(lips.edges.ravel().tolist())
    tips = set(np.unique(np.stack([keys >> 32, keys & 0xFFFFFFFF])).tolist()) - set(parting.fans)
    tips -= _dead_ends(work, moved, tips)
    where = Sides(mesh, moved, parting, on_cut, _earlier_lips(work))
    springs = cut_springs(mesh, places, parting, tips, where, opposite, work.sweep)
    kept, lost_walls = _old_walls(work, parting, where, snapping)
    walls = Walls(np.empty((0, 3), dtype=np.int32), 0)
    through = work.of_kind(CONNECTING)
    if len(through):
        walls = build_walls(lips, moved, _across(work, lips), _parts(work)[1])
    edit = _edit(
        work, parting, snapping, springs, (kept, lost_walls), _with_area(work, parting, snapping,
        walls.triangles), through, keys,
    )  # fmt: skip
    report = Report(
        faces_split=len(lips.edges),
        nodes_added=len(parting.parents),
        nodes_moved=len(snapping.nodes),
        components=_parts(work, parting, springs)[0],
        distance_before=distance_of(_ends_twice(places, lips.edges), work.sweep),
        distance_after=distance_of(_ends_twice(moved, lips.edges), work.sweep),
        volume_change=_volume_change(work, snapping),
        crumbs_glued=glued,
        elements_removed=len(edit.removed_elements),
        elements_added=len(edit.added_elements),
        notes=_notes(springs, walls),
    )
    return Plan(edit, report, _ends_twice(moved, lips.edges))


def _earlier_lips(work: SheetWork) -> set[int]:
    """Nodes that were parted before, within an edge of the sweep or of what its stroke passed."""
    mesh, places = work.mesh, work.positions
    parents = mesh.node_parents[: mesh.node_rows]
    copies = np.flatnonzero(parents != mesh.node_ids[: mesh.node_rows])
    nodes = np.union1d(copies, parents[copies])
    nodes = nodes[mesh.node_alive[nodes]]
    sweep = work.sweep.passed or work.sweep
    lower, upper = sweep.box
    edge = mean_edge(mesh)
    nodes = nodes[((places[nodes] >= lower - edge) & (places[nodes] <= upper + edge)).all(axis=1)]
    return set(nodes[sweep.distance(places[nodes]) < edge].tolist())


def _dead_ends(work: SheetWork, moved: Reals, tips: set[int]) -> set[int]:
    """Nodes of the cut that stay whole, and do not lie at the end of the sweep but beside it.

    A branch of the cut that parts nothing ends there: unlike where the sweep ends, what is at such
    a node is on one side.
    """
    nodes = np.array(sorted(tips), dtype=np.int32)
    if not len(nodes):
        return set()
    nearest, distance, which = work.sweep.closest(moved[nodes])
    corners = work.sweep.measured[which]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    height = np.abs(np.einsum("ij,ij->i", moved[nodes] - nearest, normals))
    edges = moved[work.mesh.tets[work.mesh.incident.of_all(nodes), :2]]
    length = float(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).mean())
    beside = (height > 0.999 * distance) & (distance > 0.01 * length)
    return set(nodes[beside].tolist())


def _ends_twice(places: Reals, edges: Rows) -> Reals:
    """Edges as triangles without area, as reports have the faces of a cut, shape (n, 3, 3)."""
    return places[edges[:, [0, 1, 1]]]


def _notes(springs: SpringCut, walls: Walls) -> str:
    """What people should know that figures do not say; empty if nothing."""
    said = [
        f"{number} {what}"
        for number, what in (
            (springs.lost, "springs through the tissue could not be put back"),
            (springs.short, "springs through the tissue are missing at parted nodes"),
            (walls.open_lines, "lines of the cut have no wall: they do not go through"),
        )
        if number
    ]
    return "; ".join(said)


def _split_triangles(work: SheetWork, parting: Parting, solid: Rows) -> Rows:
    """Nodes of the triangles of tissue when nodes have come apart, shape (t, 3)."""
    nodes = work.mesh.tets[solid, :3].copy()
    nodes[np.searchsorted(solid, parting.rows)] = parting.nodes
    return nodes


def _without_crumbs(
    work: SheetWork, crossing: Crossing, solid: Rows
) -> tuple[NDArray[np.int64], Parting, int]:
    """The edges to cut, so that no piece of a few triangles comes free; how many were left."""
    mesh, keys = work.mesh, crossing.keys
    total = mesh.node_rows
    before = work.mesh.tets[solid, :3]
    alive = np.ones(len(solid), dtype=np.bool_)
    _, label = connected_components(before, alive, total)
    was = np.bincount(label[before[:, 0]])
    for _ in range(work.settings.smallest_piece):
        parting = part(mesh, keys, total)
        after = _split_triangles(work, parting, solid)
        _, now = connected_components(after, alive, total + len(parting.parents))
        size = np.bincount(now[after[:, 0]])
        small = size[now[after[:, 0]]] < work.settings.smallest_piece
        small &= size[now[after[:, 0]]] < was[label[before[:, 0]]]
        if not small.any():
            break
        crumbs = np.unique(edge_keys(sides(before[small])))
        keys = keys[~np.isin(keys, crumbs)]
    parting = part(mesh, keys, total)
    return keys, parting, len(crossing.keys) - len(keys)


def _lips(
    work: SheetWork, keys: NDArray[np.int64], parting: Parting
) -> tuple[Lips, NDArray[np.int32]]:
    """The edges that come apart, and the nodes opposite each in its two triangles."""
    mesh = work.mesh
    if not len(parting.rows):
        none = np.empty((0, 2), dtype=np.int32)
        return Lips(none, np.empty((0, 2, 2), np.int32), np.empty(0, np.bool_)), none
    at = np.array(sorted(parting.fans), dtype=np.int32)
    around = mesh.incident.of_all(at)
    around = around[work.rows.carries(around)]
    old = mesh.tets[around, :3]
    new = old.copy()
    place = np.searchsorted(around, parting.rows)
    new[place] = parting.nodes
    directed, copied = sides(old), sides(new)
    third = old[:, [2, 0, 1]].ravel()
    known = edge_keys(directed)
    order = np.argsort(known, kind="stable")
    found, start, count = np.unique(known[order], return_index=True, return_counts=True)
    pair = np.isin(found, keys) & (count == 2)
    first, second = order[start[pair]], order[start[pair] + 1]
    other = copied[second]
    # Triangles of one orientation run along their edge in opposite directions.
    turned = directed[first, 0] != directed[second, 0]
    other = np.where(turned[:, None], other[:, ::-1], other)
    apart = (copied[first] != other).any(axis=1)
    first, second, other = first[apart], second[apart], other[apart]
    opposite = np.stack([third[first], third[second]], axis=1).astype(np.int32)
    height = work.sweep.signed_distance(work.positions[opposite.ravel()]).reshape(-1, 2)
    return (
        Lips(
            directed[first].astype(np.int32),
            np.stack([copied[first], other], axis=1).astype(np.int32),
            height[:, 0] >= height[:, 1],
        ),
        opposite,
    )


def _snapped(work: SheetWork, crossing: Crossing, lips: Lips) -> SheetSnapping:
    nodes = np.unique(lips.edges)
    nodes = nodes[~work.still[nodes]] if work.settings.snap else nodes[:0]
    return snap(
        work.mesh,
        work.positions,
        crossing,
        nodes,
        work.sweep,
        work.settings.quality_floor,
        float(np.cos(work.settings.crease_angle)),
        work.settings.volume_budget * _tissue(work),
    )


def _tissue(work: SheetWork) -> float:
    """Volume of what the triangles stand for at rest [m^3]."""
    solid = work.of_kind(0)
    areas = triangle_areas(work.mesh.rest[: work.mesh.node_rows], work.mesh.tets[solid, :3])
    return float(areas @ work.rows.tissue[solid])


def _across(work: SheetWork, lips: Lips) -> dict[int, set[int]]:
    """For each end of a line of the cut, the nodes about those across the tissue from it."""
    nodes, count = np.unique(lips.edges, return_counts=True)
    mesh, kinds = work.mesh, work.rows.kinds
    found: dict[int, set[int]] = {}
    for node in nodes[count == 1].tolist():
        reached = np.array([node], dtype=np.int32)
        for through in (False, True, False, False):
            rows = mesh.incident.of_all(reached)
            rows = rows[kinds[rows] == (CONNECTING if through else 0)]
            met = np.unique(mesh.tets[rows])
            reached = np.union1d(reached if not through else reached[:0], met[met >= 0])
            reached = reached.astype(np.int32)
        found[node] = set(reached.tolist()) - {node}
    return found


def _old_walls(
    work: SheetWork, parting: Parting, where: Sides, snapping: SheetSnapping
) -> tuple[dict[int, list[int]], list[int]]:
    """What happens to the walls of earlier cuts: new corners by row, and rows that go.

    Each goes to the side its middle is on; one that would have to be on both goes.
    """
    mesh = work.mesh
    walls = work.of_kind(WALL)
    touched = np.union1d(np.array(sorted(parting.fans), dtype=np.int32), snapping.nodes)
    meets = np.isin(mesh.tets[walls, :3], touched).any(axis=1)
    walls = walls[meets | near(work.positions, mesh.tets[walls, :3], work.sweep)]
    kept: dict[int, list[int]] = {}
    gone: list[int] = []
    rest = snapping.moved(mesh.rest[: mesh.node_rows])
    for row, corners in zip(walls.tolist(), mesh.tets[walls, :3].tolist(), strict=True):
        middle = where.places[corners].mean(axis=0)
        new = [_seen_from(middle, where, corner, work.sweep) for corner in corners]
        if None in new or not _is_area(rest[corners][None])[0]:
            gone.append(row)
        elif new != corners:
            kept[row] = [corner for corner in new if corner is not None]
    return kept, gone


def _seen_from(middle: Reals, where: Sides, node: int, sweep: Sweep) -> int | None:
    versions = where.versions(node)
    ends = where.places[versions]
    crossed = segments_crossed(np.repeat(middle[None], len(ends), axis=0), ends, sweep)
    length = np.where(crossed, np.inf, np.linalg.norm(ends - middle, axis=1))
    best = int(np.argmin(length))
    return versions[best] if np.isfinite(length[best]) else None


def _is_area(corners: Reals) -> NDArray[np.bool_]:
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    one = np.arange(3 * len(corners)).reshape(-1, 3)
    return np.asarray(triangle_areas(corners.reshape(-1, 3), one) > FLAT * longest**2)


def _with_area(work: SheetWork, parting: Parting, snapping: SheetSnapping, triangles: Rows) -> Rows:
    rest = snapping.moved(work.mesh.rest[: work.mesh.node_rows])
    rest = np.concatenate([rest, rest[parting.parents]])
    return triangles[_is_area(rest[triangles])]


def _parts(
    work: SheetWork, parting: Parting | None = None, springs: SpringCut | None = None
) -> tuple[int, Rows]:
    """Number of parts of the tissue and the part of each node, after the cut or, without, before.

    Walls count as nothing: they carry nothing.
    """
    mesh = work.mesh
    solid = work.of_kind(0)
    used, nodes = mesh.element_rows, mesh.node_rows
    is_spring = mesh.element_alive[:used] & (mesh.tets[:used, 2] < 0)
    ends = mesh.tets[:used, :2].copy()
    triangles = mesh.tets[solid, :3]
    new = np.empty((0, 2), dtype=np.int32)
    if parting is not None:
        triangles = _split_triangles(work, parting, solid)
        nodes += len(parting.parents)
    if springs is not None:
        is_spring[springs.removed] = False
        for row, pair in springs.rewritten.items():
            ends[row] = pair
        new = np.array([pair for pair, _ in springs.added], dtype=np.int32).reshape(-1, 2)
    items = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], ends[is_spring], new])
    return connected_components(items, np.ones(len(items), dtype=np.bool_), nodes)


def _volume_change(work: SheetWork, snapping: SheetSnapping) -> float:
    mesh = work.mesh
    around = mesh.incident.of_all(snapping.nodes.astype(np.int32))
    around = around[work.rows.carries(around)]
    rest = mesh.rest[: mesh.node_rows]
    triangles, thickness = mesh.tets[around, :3], work.rows.tissue[around]
    change = triangle_areas(snapping.moved(rest), triangles) - triangle_areas(rest, triangles)
    return float(change @ thickness)


def _parents_of_walls(work: SheetWork, parting: Parting, walls: Rows, through: Rows) -> list[int]:
    """For each wall a spring through the tissue at one of its corners: it is of that region."""
    found = []
    for corners in walls.tolist():
        old = [n if n < parting.first_copy else parting.parents[n - parting.first_copy]
               for n in corners]  # fmt: skip
        rows = work.mesh.incident.of_all(np.unique(old).astype(np.int32))
        rows = rows[work.rows.kinds[rows] == CONNECTING]
        found.append(int(rows[0]) if len(rows) else int(through[0]))
    return found


def _edit(
    work: SheetWork,
    parting: Parting,
    snapping: SheetSnapping,
    springs: SpringCut,
    old_walls: tuple[dict[int, list[int]], list[int]],
    walls: Rows,
    through: Rows,
    keys: NDArray[np.int64],
) -> TopologyEdit:
    mesh = work.mesh
    first = parting.first_copy

    def named(rows: NDArray[np.integer]) -> NDArray[np.uint32]:
        """Ids of nodes: of the mesh, provisional ones of copies."""
        wide = np.asarray(rows, dtype=np.int64)
        is_copy = wide >= first
        ids = mesh.node_ids[np.where(is_copy, 0, wide)]
        return np.where(is_copy, wide - first + PROVISIONAL, ids).astype(np.uint32)

    def items(nodes: NDArray[np.integer], width: int) -> NDArray[np.uint32]:
        table = np.full((len(nodes), 4), NO_NODE, dtype=np.uint32)
        table[:, :width] = named(np.asarray(nodes, dtype=np.int64).reshape(-1, width))
        return table

    kept, lost = old_walls
    rewritten = [*parting.rows.tolist(), *springs.rewritten, *kept]
    nodes = [
        items(parting.nodes, 3), items(np.array(list(springs.rewritten.values())), 2),
        items(np.array(list(kept.values())), 3),
    ]  # fmt: skip
    removed = np.array([*springs.removed, *lost], dtype=np.int32)
    pairs = np.array([pair for pair, _ in springs.added], dtype=np.int64)
    parents = [row for _, row in springs.added] if len(through) else []
    parents += _parents_of_walls(work, parting, walls, through)
    split = np.array(sorted(parting.fans), dtype=np.int32)
    path = np.unique(np.concatenate([keys >> 32, keys & 0xFFFFFFFF])).astype(np.int32)
    read = np.union1d(mesh.incident.of_all(path), [*springs.removed, *rewritten, *lost, *parents])
    towards = snapping.towards
    share = snapping.share[:, None]
    return TopologyEdit(
        base_version=mesh.version,
        kind="split",
        read_nodes=mesh.node_ids[np.union1d(path, split)],
        read_elements=mesh.element_ids[read.astype(np.int64)],
        moved_nodes=mesh.node_ids[snapping.nodes],
        moved_rest=snapping.moved(mesh.rest[: mesh.node_rows])[snapping.nodes],
        moved_anchors=mesh.node_ids[np.stack([snapping.nodes, *[towards] * 3], axis=1)],
        moved_weights=np.concatenate([1.0 - share, share, 0.0 * share, 0.0 * share], axis=1),
        copied_nodes=(np.arange(len(parting.parents)) + PROVISIONAL).astype(np.uint32),
        copy_parents=mesh.node_ids[parting.parents],
        rewritten_elements=mesh.element_ids[np.array(rewritten, dtype=np.int64)],
        rewritten_nodes=np.concatenate(nodes),
        removed_elements=mesh.element_ids[removed],
        added_elements=(np.arange(len(parents)) + PROVISIONAL).astype(np.uint32),
        added_nodes=np.concatenate([items(pairs, 2), items(walls, 3)]),
        added_parents=mesh.element_ids[np.array(parents, dtype=np.int64)],
    )
