"""The order in which sweeps visit nodes and springs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.springs import REMOVED, SpringChange, SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels import orderings
from tissue_sim.kernels.orderings import UNREACHED
from tissue_sim.kernels.springs import SpringList

WHOLE_ORGAN = 10000
"""Cut-off level that means: no cut-off."""


class NodeOrdering:
    """Nodes in breadth-first order from sources, level by level.

    Nodes that cannot be reached come last, by row.
    The search goes along springs and does not enter prescribed nodes that are no sources: nothing
    gets past a node that does not move. An edit keeps the levels: a copy takes its parent's level
    and follows it in the order.

    Attributes:
        nodes: Node rows in order; valid in [0, used), uint32.
        level: Level of each node row, -1 where not reached, shape (node_capacity,).
        used: Nodes in order.
        levels: Number of levels.
    """

    def __init__(self, springs: SpringNetwork) -> None:
        self.springs = springs
        self.used = self.levels = self._reached = 0
        self._allocate(springs.mesh.node_capacity)

    def _allocate(self, capacity: int) -> None:
        self.nodes = np.zeros(capacity, dtype=np.uint32)
        self.level = np.full(capacity, UNREACHED, dtype=np.int32)
        self._level_start = np.zeros(capacity + 2, dtype=np.int32)
        self.rank = np.full(capacity, UNREACHED, dtype=np.int32)

    def search(
        self,
        sources: NDArray[np.int32],
        prescribed: NDArray[np.bool_],
        depth: int = WHOLE_ORGAN,
    ) -> None:
        """Order the nodes anew.

        Args:
            sources: Rows of the nodes of level 0, sorted.
            prescribed: Nodes that do not move, shape (node_capacity,).
            depth: Last level to visit; with one, nodes beyond it are left out.
        """
        mesh, arrays = self.springs.mesh, self.springs.arrays
        if len(self.nodes) != mesh.node_capacity:
            self._allocate(mesh.node_capacity)
        self.level[:] = UNREACHED
        self._reached, self.levels = orderings.breadth_first(
            sources, arrays.start, arrays.degree, arrays.neighbour, prescribed,
            depth, self.level, self.nodes, self._level_start,
        )  # fmt: skip
        if depth < WHOLE_ORGAN:
            self.used = self._reached
            return
        self.used = orderings.append_rest(
            mesh.node_rows, prescribed, mesh.node_alive, self.level, self.nodes, self._reached
        )
        self._rank_all()

    def end_of(self, level: int) -> int:
        """Place in `nodes` behind the last node of a level."""
        return int(self._level_start[min(level + 1, self.levels)])

    def follow(self, change: EditChange) -> None:
        """Put the copies an edit made behind their parents: local but for one copy of the order."""
        capacity = self.springs.mesh.node_capacity
        extra = capacity - len(self.nodes)
        if extra > 0:
            self.nodes = np.concatenate([self.nodes, np.zeros(extra, dtype=np.uint32)])
            more = np.full(extra, UNREACHED, dtype=np.int32)
            self.level = np.concatenate([self.level, more])
            self.rank = np.concatenate([self.rank, more])
            self._level_start = np.concatenate([self._level_start, np.zeros_like(more)])
        ordered = self.rank[change.copy_parents] != UNREACHED
        copies, parents = change.copied_nodes[ordered], change.copy_parents[ordered]
        if not len(copies):
            return
        self.level[copies] = self.level[parents]
        behind = np.argsort(self.rank[parents], kind="stable")
        orderings.insert_behind(
            copies[behind], self.rank[parents[behind]], self.nodes, self.used, self.rank
        )
        self.used += len(copies)
        reached = self.level[copies][self.level[copies] != UNREACHED]
        added = np.cumsum(np.bincount(reached, minlength=self.levels))
        self._level_start[1 : self.levels + 1] += added.astype(np.int32)
        self._reached += len(reached)

    def _rank_all(self) -> None:
        self.rank[:] = UNREACHED
        self.rank[self.nodes[: self.used]] = np.arange(self.used, dtype=np.int32)


class SpringOrdering:
    """Springs in the order of a relaxation pass: each at its end that the nodes' order has first.

    Springs that an edit makes are visited last until the next ordering; removed ones leave a
    tombstone.
    """

    def __init__(self, springs: SpringNetwork) -> None:
        self.springs = springs
        self.used = 0
        self._allocate(len(springs.springs.ends))

    def _allocate(self, capacity: int) -> None:
        self._first = np.zeros(capacity, dtype=np.uint32)
        self._second = np.zeros(capacity, dtype=np.uint32)
        self._length = np.zeros(capacity, dtype=self.springs.dtype)
        self._place_of = np.full(capacity, UNREACHED, dtype=np.int32)

    @property
    def list(self) -> SpringList:
        """The springs for the kernels; valid in [0, used)."""
        return SpringList(self.springs.arrays.rest, self._first, self._second, self._length)

    def order(self, nodes: NodeOrdering, prescribed: NDArray[np.bool_]) -> None:
        """List the springs anew along an order of nodes."""
        springs, arrays = self.springs, self.springs.arrays
        if len(self._place_of) < springs.rows:
            self._allocate(len(springs.springs.ends))
        self._place_of[:] = UNREACHED
        self.used = orderings.order_springs(
            nodes.nodes, nodes.used, nodes.rank, arrays.start, arrays.degree, arrays.neighbour,
            springs.spring_of, arrays.length, prescribed,
            self._first, self._second, self._length, self._place_of,
        )  # fmt: skip

    def follow(self, change: SpringChange) -> None:
        """Follow what an edit did to the springs, in time proportional to it."""
        springs = self.springs.springs
        self._reserve(len(springs.ends), len(change.rows))
        places = self._place_of[change.rows]
        listed = places != UNREACHED
        removed = change.kinds == REMOVED
        gone = places[listed & removed]
        self._second[gone] = self._first[gone]
        kept = listed & ~removed
        self._length[places[kept]] = springs.length[change.rows[kept]]
        made = change.rows[~listed & ~removed]
        end = self.used + len(made)
        self._first[self.used : end] = springs.ends[made, 0]
        self._second[self.used : end] = springs.ends[made, 1]
        self._length[self.used : end] = springs.length[made]
        self._place_of[made] = np.arange(self.used, end, dtype=np.int32)
        self.used = end

    def _reserve(self, rows: int, more: int) -> None:
        short = max(rows, self.used + more) - len(self._first)
        if short > 0:
            extra = short + len(self._first) // 4
            for name in ("_first", "_second", "_length"):
                array = getattr(self, name)
                setattr(self, name, np.concatenate([array, np.zeros(extra, dtype=array.dtype)]))
            unlisted = np.full(extra, UNREACHED, dtype=np.int32)
            self._place_of = np.concatenate([self._place_of, unlisted])
