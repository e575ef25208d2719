"""What a cut does to the springs of a sheet.

A spring at a node that was parted goes to the version on its own side of the sweep. A spring that
crosses the sweep is removed; one through the tissue is put back between each of its ends and the
nearest node across the tissue on that end's own side, so that nothing of the tissue's stiffness is
lost. Versions of a node that are left with fewer springs through the tissue than three get more,
out of those of the node.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from cut_service.sheet_selection import Parting, near, segments_crossed
from cut_service.sweep import Sweep
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import ANGULAR, CONNECTING, SURFACE
from tissue_sim.geometry.sheet_rows import WALL

Rows = NDArray[np.int32]
Pair = tuple[int, int]

ENOUGH = 3
"""Springs through the tissue that keep a node in its place."""

RINGS = 2
"""Edges to those neighbours of a node whose springs tell what lies across the tissue from it."""


@dataclass
class SpringCut:
    """What happens to springs, by row; copies are numbered as in `Parting`.

    Attributes:
        rewritten: New ends of springs that stay.
        removed: Springs that go.
        added: Ends of new springs and the removed spring each takes the place of.
        lost: Springs through the tissue that nothing took the place of.
        short: Versions of nodes that have fewer springs through the tissue than they should.
    """

    rewritten: dict[int, Pair] = field(default_factory=dict)
    removed: list[int] = field(default_factory=list)
    added: list[tuple[Pair, int]] = field(default_factory=list)
    lost: int = 0
    short: int = 0


class Sides:
    """Where the versions of nodes are, a little way off the sweep.

    Attributes:
        places: Positions of old nodes after snapping, then of copies [m].
    """

    def __init__(
        self,
        mesh: Mesh,
        places: NDArray[np.float64],
        parting: Parting,
        on_cut: Iterable[int],
        lips: Iterable[int] = (),
    ) -> None:
        """Find them.

        Args:
            mesh: The mesh before the cut.
            places: Positions of its nodes after snapping [m], shape (node_rows, 3).
            parting: The nodes that come apart.
            on_cut: Nodes of the cut; they say nothing about sides.
            lips: Nodes that earlier cuts parted, near the sweep. Those of the stroke lie on it, and
                a spring between two of them would not seem to cross it.
        """
        before = set(lips) - parting.fans.keys()
        self._undecided = set(on_cut) | before
        self._mesh, self._fans = mesh, parting.fans
        self._parted = dict(zip(parting.rows.tolist(), parting.nodes.tolist(), strict=True))
        self._fan_of = {
            version: fan for fans in parting.fans.values() for version, fan in fans.items()
        }
        rows = mesh.sheet_rows
        assert rows is not None
        for node in before:
            around = mesh.incident.of(node)
            self._fan_of[node] = around[rows.carries(around)].tolist()
        self.places = np.concatenate([places, places[parting.parents]])
        for version in self._fan_of:
            self.places[version] = places[self._clear_of(version)].mean(axis=0)

    def _clear_of(self, version: int) -> list[int]:
        """The closest old nodes off the cut that triangles lead to from a version of a node.

        All nodes of a fan can be nodes of the cut, and some of them not on the sweep.
        """
        seen, ring = {version}, [version]
        first: set[int] = set()
        while ring:
            corners: set[int] = set()
            for row in chain.from_iterable(self._fan_of[node] for node in ring):
                corners.update(self._parted.get(row) or self._mesh.tets[row, :3].tolist())
            clear = corners - self._undecided - self._fan_of.keys()
            if clear:
                return sorted(clear)
            first = first or set(self._mesh.tets[self._fan_of[version], :3].ravel().tolist())
            ring = sorted((corners & self._fan_of.keys()) - seen)
            seen.update(ring)
        return sorted(first)

    def versions(self, node: int) -> list[int]:
        """The versions of a node, itself first."""
        return list(self._fans[node]) if node in self._fans else [node]


def cut_springs(
    mesh: Mesh, positions: NDArray[np.float64], parting: Parting, tips: set[int], sides: Sides,
    opened: NDArray[np.int32], sweep: Sweep,
) -> SpringCut:  # fmt: skip
    """Find out what happens to the springs.

    Args:
        mesh: The mesh before the cut.
        positions: Its node positions [m], shape (node_rows, 3).
        parting: The nodes that come apart.
        tips: Nodes of the cut that stay whole: what is there is on neither side.
        sides: Where the versions of nodes are.
        opened: Nodes opposite the edges that come apart, shape (n, 2).
        sweep: What the cut follows.
    """
    return _Cutter(mesh, positions, parting, tips, sides, sweep).run(opened)


class _Cutter:
    def __init__(
        self, mesh: Mesh, positions: NDArray[np.float64], parting: Parting, tips: set[int],
        sides: Sides, sweep: Sweep,
    ) -> None:  # fmt: skip
        self.mesh, self.positions, self.parting = mesh, positions, parting
        self.tips, self.sides, self.sweep = tips, sides, sweep
        assert mesh.sheet_rows is not None
        self.kinds = mesh.sheet_rows.kinds
        self.cut = SpringCut()
        self.own = {
            copy: int(node) for copy, node in enumerate(parting.parents, parting.first_copy)
        }
        self._new: set[Pair] = set()
        self._known: dict[int, list[int]] = {}
        self._rings: dict[int, set[int]] = {}
        self._opposite: dict[int, set[int]] = {}
        self._seen_rows: set[int] = set()
        self._corners = dict(zip(parting.rows.tolist(), parting.nodes.tolist(), strict=True))

    def run(self, opened: NDArray[np.int32]) -> SpringCut:
        rows = self._touched()
        self._seen_rows = set(rows.tolist())
        ends, crossing = self._choose(rows)
        folds = {(min(c, d), max(c, d)) for c, d in opened.tolist()}
        children: dict[int, list[Pair]] = {}
        broken: list[int] = []
        kept: dict[int, Pair] = {}
        for row, pair, crosses in zip(rows.tolist(), ends, crossing, strict=True):
            old = (int(self.mesh.tets[row, 0]), int(self.mesh.tets[row, 1]))
            gone = self.kinds[row] == ANGULAR and (min(old), max(old)) in folds
            if self.kinds[row] == CONNECTING and crosses:
                broken.append(row)
            elif crosses or gone:
                self.cut.removed.append(row)
            else:
                kept[row] = pair
        self._put_back(broken, kept, children)
        for row in broken:
            self.cut.removed.append(row)
            self.cut.lost += not children.get(row)
        for row, pair in kept.items():
            if row in children:
                self.cut.removed.append(row)
                children[row].insert(0, pair)
            elif pair != (int(self.mesh.tets[row, 0]), int(self.mesh.tets[row, 1])):
                self.cut.rewritten[row] = pair
        self.cut.added = [(pair, row) for row in sorted(children) for pair in children[row]]
        return self.cut

    def _touched(self) -> Rows:
        """Rows of the springs that cross the sweep's box or end at a node that was parted."""
        mesh = self.mesh
        rows = mesh.element_rows
        springs = np.flatnonzero(mesh.element_alive[:rows] & (mesh.tets[:rows, 2] < 0))
        ends = mesh.tets[springs, :2]
        # What joins lips of earlier cuts lies in the sweep, or beside it by a rounding error.
        inside = near(self.positions, ends, self.sweep) | near(self.sides.places, ends, self.sweep)
        parted = np.array(sorted(self.parting.fans), dtype=np.int32)
        at = mesh.incident.of_all(parted)
        return np.union1d(springs[inside], at[mesh.tets[at, 2] < 0]).astype(np.int32)

    def _choose(self, rows: Rows) -> tuple[list[Pair], list[bool]]:
        """For every spring the versions of its ends that see each other, and if none do."""
        pairs: list[Pair] = []
        of: list[int] = []
        for place, (p, q) in enumerate(self.mesh.tets[rows, :2].tolist()):
            for one in self.sides.versions(p):
                for other in self.sides.versions(q):
                    pairs.append((one, other))
                    of.append(place)
        crossed, length = self._seen(pairs)
        best = np.lexsort((length, crossed, np.array(of)))
        _, first = np.unique(np.array(of)[best], return_index=True)
        chosen = best[first]
        free = [bool(self.tips & {self.own.get(n, n) for n in pairs[k]}) for k in chosen]
        crosses = [bool(crossed[k]) and not at for k, at in zip(chosen, free, strict=True)]
        return [pairs[k] for k in chosen], crosses

    def _seen(self, pairs: list[Pair]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Whether the sweep lies between the nodes of pairs, and how far apart they are [m]."""
        table = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        begin, end = self.sides.places[table[:, 0]], self.sides.places[table[:, 1]]
        crossed = segments_crossed(begin, end, self.sweep.passed or self.sweep)
        return crossed, np.linalg.norm(end - begin, axis=1)

    def _put_back(
        self, broken: list[int], kept: dict[int, Pair], children: dict[int, list[Pair]]
    ) -> None:
        """New springs on their own sides, for those that are gone and at needy nodes."""
        wishes = [wish for row in broken for wish in self._wishes(row)]
        self._grant(wishes, kept, children)
        count: dict[int, int] = {}
        pairs = [pair for row, pair in kept.items() if self.kinds[row] == CONNECTING]
        for some in (pairs, *children.values()):
            for node in chain.from_iterable(some):
                count[node] = count.get(node, 0) + 1
        needy = []
        for node, versions in self.parting.fans.items():
            around = self.mesh.incident.of(node)
            own = around[self.kinds[around] == CONNECTING].tolist()
            for version in versions:
                for k in range(min(ENOUGH, len(own)) - count.get(version, 0)):
                    row = own[k % len(own)]
                    needy.append((version, row))
        self.cut.short += len(needy) - self._grant(needy, kept, children)

    def _wishes(self, row: int) -> list[tuple[int, int]]:
        """New springs in the place of one that is gone: from which node, for which spring."""
        ends = (int(end) for end in self.mesh.tets[row, :2])
        return [(version, row) for node in ends for version in self.sides.versions(node)]

    def _grant(
        self,
        wishes: list[tuple[int, int]],
        kept: dict[int, Pair],
        children: dict[int, list[Pair]],
    ) -> int:
        """Find the nearest node on its own side for each wish; how many were found."""
        pairs: list[Pair] = []
        of: list[int] = []
        for place, (version, _) in enumerate(wishes):
            for candidate in self._across(version, kept):
                pairs.append((version, candidate))
                of.append(place)
        if not pairs:
            return 0
        crossed, length = self._seen(pairs)
        granted: set[int] = set()
        for k in np.lexsort((length, np.array(of))).tolist():
            pair = pairs[k]
            if of[k] in granted or crossed[k] or self._joined(pair, children):
                continue
            granted.add(of[k])
            children.setdefault(wishes[of[k]][1], []).append(pair)
        return len(granted)

    def _joined(self, pair: Pair, children: dict[int, list[Pair]]) -> bool:
        """Whether two nodes are the same, neighbours, or joined by a spring already."""
        old = [self.own.get(node, node) for node in pair]
        if old[0] == old[1] or self.tips & set(old):
            return True
        key = (min(pair), max(pair))
        around = self.mesh.incident.of(old[0])
        around = around[self.kinds[around] != WALL]
        known = bool((self.mesh.tets[around] == old[1]).any())
        if known or key in self._new:
            return True
        self._new.add(key)
        return False

    def _around(self, nodes: set[int]) -> set[int]:
        """Versions of nodes, and those that triangles join them to after the cut."""
        return nodes.union(*(self._ring(node) for node in nodes))

    def _ring(self, version: int) -> set[int]:
        if version not in self._rings:
            node = self.own.get(version, version)
            if node in self.parting.fans:
                rows = np.array(self.parting.fans[node][version], dtype=np.int32)
            else:
                rows = self.mesh.incident.of(node)
                rows = rows[self.kinds[rows] == SURFACE]
            table = self.mesh.tets[rows, :3].tolist()
            corners = (
                self._corners.get(row, old) for row, old in zip(rows.tolist(), table, strict=True)
            )
            self._rings[version] = set(chain.from_iterable(corners))
        return self._rings[version]

    def _partners(self, version: int, kept: dict[int, Pair]) -> set[int]:
        """Nodes that springs through the tissue which stay join to a version of a node."""
        if version not in self._opposite:
            rows = self.mesh.incident.of(self.own.get(version, version))
            rows = rows[self.kinds[rows] == CONNECTING]
            ends = self.mesh.tets[rows, :2].tolist()
            found: set[int] = set()
            for row, (p, q) in zip(rows.tolist(), ends, strict=True):
                pair = kept.get(row, (-1, -1) if row in self._seen_rows else (p, q))
                if version in pair:
                    found.update(pair)
            self._opposite[version] = found - {version}
        return self._opposite[version]

    def _root(self, version: int) -> int:
        """The node that a version was in the beginning, before any cut."""
        node = self.own.get(version, version)
        while (parent := int(self.mesh.node_parents[node])) != node:
            node = parent
        return node

    def _across(self, version: int, kept: dict[int, Pair]) -> list[int]:
        """Nodes across the tissue from a version of a node, about those of its neighbours."""
        if version not in self._known:
            near_by = {version}
            for _ in range(RINGS):
                near_by = self._around(near_by)
            far = self._around(set().union(*(self._partners(node, kept) for node in near_by)))
            # The other lip of an earlier cut is not across the tissue.
            own = {self._root(node) for node in near_by}
            self._known[version] = sorted(node for node in far if self._root(node) not in own)
        return self._known[version]
