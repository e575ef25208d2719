"""Planning sutures: from positions on the tissue to a `TopologyEdit`; see docs/sutures.md."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import RequestError
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sutures import DEFAULT_STIFFNESS, Sutures, is_surface_node, why_not

KIND = {0: "suture", 1: "tighten", 2: "unsuture"}
"""Kinds of the edits, by action; sewing a rim makes sutures as well."""

REACH = 0.003
"""Distance [m] within which a position is attached to a node if a request names none."""

FARTHEST_REACH = 0.1
"""Largest reach [m] that is believed."""

MOST_STITCHES = 500
"""Most stitches of one request: more is a mistake of units."""


class SutureCode(IntEnum):
    """Error codes of a request; the numbers are those of `tissue_interfaces/srv/Suture`."""

    NONE = 0
    INVALID = 1
    UNKNOWN_FRAME = 2
    NO_TISSUE = 3
    STATE_FRAME_GONE = 4
    NOTHING_THERE = 5
    UNKNOWN_SUTURE = 6
    STALE = 7
    SIMULATION_LOST = 8
    REFUSED = 9
    UNKNOWN_PATCH = 10
    UNKNOWN_HOLE = 11
    NO_RIM = 12


class SutureError(RequestError[SutureCode]):
    """A request that cannot be met; nothing was changed."""


@dataclass(frozen=True)
class Sewing:
    """What is to be sewn.

    Attributes:
        positions: In the organ's frame [m], shape (n, 3): pairs, or two polylines of the same
            number of corners, one after the other.
        spacing: Distance of stitches along the edges [m]; 0: every pair is a stitch.
        running: Whether one thread makes all stitches and crosses from each to the next.
        reach: Distance within which a position is attached to a node [m]; 0: `REACH`.
        stiffness: Of each stitch [N/m]; 0: `DEFAULT_STIFFNESS`.
        length: Rest length of each stitch [m]; negative: as long as it is now times -length.
    """

    positions: NDArray[np.float64]
    spacing: float = 0.0
    running: bool = False
    reach: float = 0.0
    stiffness: float = 0.0
    length: float = -1.0


def plan_sewing(mesh: Mesh, shape: NDArray[np.floating], wanted: Sewing) -> TopologyEdit:
    """Plan stitches on a deformed shape. Nothing is changed.

    Args:
        mesh: The mesh, at the version that `shape` belongs to.
        shape: Current node positions [m], shape (node_rows, 3).
        wanted: What is to be sewn.

    Raises:
        SutureError: A number is not allowed, or no node of the surface is within reach.
    """
    places = np.asarray(shape, dtype=np.float64)
    pairs = _pairs(wanted)
    reach = wanted.reach or REACH
    ends = np.array([_attach(mesh, places, pair, reach) for pair in pairs], dtype=np.int64)
    # Where stitches are closer than nodes, neighbours would be the same stitch.
    new = np.ones(len(ends), dtype=np.bool_)
    new[1:] = (ends[1:] != ends[:-1]).any(axis=1)
    ends = ends[new]
    return stitched(mesh, places, ends, wanted)


def stitched(
    mesh: Mesh,
    places: NDArray[np.float64],
    ends: NDArray[np.int64],
    wanted: Sewing,
    closed: bool = False,
) -> TopologyEdit:
    """The edit that makes stitches between given nodes.

    Args:
        mesh: The mesh, at the version that `places` belong to.
        places: Current node positions [m], shape (node_rows, 3).
        ends: Node rows of both ends of each stitch, shape (n, 2).
        wanted: How they are sewn; its positions do not matter.
        closed: Whether a running thread goes on from the last stitch to the first.

    Raises:
        SutureError: A number is not allowed, or a thread would join a node to itself.
    """
    along = np.zeros(len(ends))
    if wanted.running:
        ends, along = _with_crossings(places, ends, closed)
        if (ends[:, 0] == ends[:, 1]).any():
            raise SutureError(
                SutureCode.NOTHING_THERE,
                "the thread would cross from a node to itself: the edges are closer to each other "
                "there than nodes are",
            )
    lengths = _lengths(places, ends, along, wanted.length)
    stiffness = np.full(len(ends), wanted.stiffness or DEFAULT_STIFFNESS)
    if why := why_not(lengths, stiffness):
        raise SutureError(SutureCode.INVALID, why)
    ids = (PROVISIONAL + np.arange(len(ends))).astype(np.uint32)
    return TopologyEdit(
        base_version=mesh.version,
        kind=KIND[0],
        read_nodes=np.unique(mesh.node_ids[ends]),
        added_sutures=ids,
        suture_nodes=mesh.node_ids[ends],
        suture_lengths=lengths,
        suture_stiffness=stiffness,
        suture_groups=np.full_like(ids, ids[0]) if wanted.running else ids,
    )


def plan_tightening(
    mesh: Mesh, shape: NDArray[np.floating], sutures: Sutures, length: float
) -> TopologyEdit:
    """Plan other rest lengths; see `Sewing.length`. Nothing is changed.

    Stitches that cross from one stitch of a running thread to the next get the length that leaves
    the way along the edge to them.
    """
    if not np.isfinite(length):
        raise SutureError(SutureCode.INVALID, "the length is not finite")
    places = np.asarray(shape, dtype=np.float64)
    table, along = mesh.sutures, np.zeros(len(sutures))
    crossing = (sutures.ids.astype(np.int64) - sutures.groups) % 2 == 1
    before = table.places_of(sutures.ids.astype(np.int64) - 1)
    for k in np.flatnonzero(crossing & (before >= 0)):
        way = places[sutures.nodes[k, 1]] - places[table.nodes[before[k], 0]]
        along[k] = np.linalg.norm(way)
    lengths = _lengths(places, sutures.nodes, along, length)
    if why := why_not(lengths, sutures.stiffness):
        raise SutureError(SutureCode.INVALID, why)
    return TopologyEdit(
        mesh.version, kind=KIND[1], changed_sutures=sutures.ids, changed_lengths=lengths
    )


def plan_removal(mesh: Mesh, sutures: Sutures) -> TopologyEdit:
    """Plan to take sutures out. Nothing is changed."""
    return TopologyEdit(mesh.version, kind=KIND[2], removed_sutures=sutures.ids)


def chosen(table: Sutures, ids: NDArray[np.uint32], group: int) -> Sutures:
    """Sutures by id, or all of a group, or all there are (no id and group 0).

    Raises:
        SutureError: There is none.
    """
    known = ", ".join(map(str, table.ids.tolist()[:20])) or "none"
    if not len(ids):
        found = table.at(table.groups == group) if group else table
        if not len(found):
            what = f"thread {group}" if group else "suture"
            raise SutureError(SutureCode.UNKNOWN_SUTURE, f"there is no {what}; sutures: {known}")
        return found
    places = table.places_of(np.unique(ids))
    if (places < 0).any():
        missing = np.unique(ids)[places < 0].tolist()
        raise SutureError(
            SutureCode.UNKNOWN_SUTURE, f"there is no suture {missing[0]}; sutures: {known}"
        )
    return table.at(places)


def pulls(sutures: Sutures, shape: NDArray[np.floating]) -> NDArray[np.float64]:
    """Pull of each suture at a shape [N], shape (n,)."""
    nodes = sutures.nodes
    edge = shape[nodes[:, 1]].astype(np.float64) - shape[nodes[:, 0]]
    longer = np.maximum(np.linalg.norm(edge, axis=1) - sutures.lengths, 0.0)
    return np.asarray(sutures.stiffness * longer)


def refuse_bad_numbers(wanted: Sewing) -> None:
    """Refuse numbers that no request may have.

    Raises:
        SutureError: One is not finite or not allowed.
    """
    numbers = (wanted.spacing, wanted.reach, wanted.stiffness, wanted.length)
    if not (np.isfinite(wanted.positions).all() and np.isfinite(numbers).all()):
        raise SutureError(SutureCode.INVALID, "a position, or another number, is not finite")
    if min(wanted.spacing, wanted.stiffness) < 0.0 or not 0.0 <= wanted.reach <= FARTHEST_REACH:
        raise SutureError(
            SutureCode.INVALID,
            "spacing and stiffness must not be negative, and reach must be from 0 to "
            f"{FARTHEST_REACH:g} m",
        )


def _pairs(wanted: Sewing) -> NDArray[np.float64]:
    """Positions of both ends of each stitch [m], shape (n, 2, 3)."""
    points, invalid = wanted.positions, SutureCode.INVALID
    refuse_bad_numbers(wanted)
    if not len(points) or len(points) % 2:
        raise SutureError(invalid, f"{len(points)} positions; allowed: pairs, at least one")
    pairs = points.reshape(-1, 2, 3)
    if wanted.spacing:
        half = len(points) // 2
        pairs = _spread(points[:half], points[half:], wanted.spacing)
    if len(pairs) > MOST_STITCHES:
        raise SutureError(invalid, f"{len(pairs)} stitches; allowed: up to {MOST_STITCHES}")
    return pairs


def _spread(
    one: NDArray[np.float64], other: NDArray[np.float64], spacing: float
) -> NDArray[np.float64]:
    """Points spread evenly along two lines, as many on both [m], shape (n, 2, 3)."""
    longest = float(max(_ways(one)[-1], _ways(other)[-1]))
    count = round(min(longest / spacing, MOST_STITCHES)) + 1
    return np.stack([_along(one, count), _along(other, count)], axis=1)


def _ways(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Way along a line to each of its corners [m]."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))


def _along(line: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    ways = _ways(line)
    wanted = np.linspace(0.0, ways[-1], count) if count > 1 else np.array([0.5 * ways[-1]])
    return np.stack([np.interp(wanted, ways, line[:, axis]) for axis in range(3)], axis=1)


def _attach(
    mesh: Mesh, places: NDArray[np.float64], pair: NDArray[np.float64], reach: float
) -> tuple[int, int]:
    """Node rows for both ends: the closest of the surface, the second no neighbour of the first."""
    first = _closest(mesh, places, pair[0], reach, np.empty(0, dtype=np.int32))
    around = mesh.tets[mesh.incident.of(first)]
    second = _closest(mesh, places, pair[1], reach, np.append(around[around >= 0], first))
    return first, second


def _closest(
    mesh: Mesh,
    places: NDArray[np.float64],
    point: NDArray[np.float64],
    reach: float,
    but: NDArray[np.integer],
) -> int:
    distance = np.linalg.norm(places - point, axis=1)
    near = np.flatnonzero((distance <= reach) & mesh.node_alive[: len(places)])
    for node in near[np.argsort(distance[near], kind="stable")]:
        if node not in but and is_surface_node(mesh, int(node)):
            return int(node)
    where = ", ".join(f"{1e3 * value:.1f}" for value in point)
    besides = " that is not next to the other end" if len(but) else ""
    raise SutureError(
        SutureCode.NOTHING_THERE,
        f"no node of the surface{besides} within {1e3 * reach:g} mm of ({where}) mm",
    )


def _with_crossings(
    places: NDArray[np.float64], ends: NDArray[np.int64], closed: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Stitches and, after each, the way of the thread across to the next; ways along the edge [m].

    From the last the thread goes on to the first only if it is closed.
    """
    both, along = np.empty((2 * len(ends), 2), dtype=np.int64), np.zeros(2 * len(ends))
    after = np.roll(ends[:, 0], -1)
    both[::2] = ends
    both[1::2, 0], both[1::2, 1] = ends[:, 1], after
    along[1::2] = np.linalg.norm(places[after] - places[ends[:, 0]], axis=1)
    if closed and len(ends) > 1:
        return both, along
    return both[:-1], along[:-1]


def _lengths(
    places: NDArray[np.float64],
    ends: NDArray[np.integer],
    along: NDArray[np.float64],
    length: float,
) -> NDArray[np.float64]:
    """Rest lengths [m]; see `Sewing.length`."""
    if length < 0.0:
        now = np.linalg.norm(places[ends[:, 1]] - places[ends[:, 0]], axis=1)
        return np.asarray(-length * now)
    return np.hypot(length, along)
