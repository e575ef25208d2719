"""The order in which sweeps visit nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels import orderings
from tissue_sim.kernels.orderings import UNREACHED

WHOLE_ORGAN = 10000
"""Cut-off level that means: no cut-off."""


class NodeOrdering:
    """Nodes in breadth-first order from sources, level by level.

    Nodes that cannot be reached come last, by row.
    The search goes along springs and stitches and does not enter prescribed nodes that are no
    sources: nothing gets past a node that does not move. An edit keeps the levels: a copy takes its
    parent's level and follows it in the order.

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
        self._rank = np.full(capacity, UNREACHED, dtype=np.int32)
        self._ranked = False

    @property
    def rank(self) -> NDArray[np.int32]:
        """Place of each node row in the order, -1 for none, shape (node_capacity,)."""
        if not self._ranked:
            self._rank[:] = UNREACHED
            self._rank[self.nodes[: self.used]] = np.arange(self.used, dtype=np.int32)
            self._ranked = True
        return self._rank

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
        self._ranked = False
        self._reached, self.levels = orderings.breadth_first(
            sources, arrays.start, self.springs.links, arrays.neighbour, prescribed,
            depth, self.level, self.nodes, self._level_start,
        )  # fmt: skip
        if depth < WHOLE_ORGAN:
            self.used = self._reached
            return
        self.used = orderings.append_rest(
            mesh.node_rows, prescribed, mesh.node_alive, self.level, self.nodes, self._reached
        )

    def end_of(self, level: int) -> int:
        """Place in `nodes` behind the last node of a level."""
        return int(self._level_start[min(level + 1, self.levels)])

    def follow(self, change: EditChange) -> None:
        """Put the copies an edit made behind their parents and take out what vanished.

        Local but for one copy of the order.
        """
        capacity = self.springs.mesh.node_capacity
        extra = capacity - len(self.nodes)
        if extra > 0:
            self.nodes = np.concatenate([self.nodes, np.zeros(extra, dtype=np.uint32)])
            more = np.full(extra, UNREACHED, dtype=np.int32)
            self.level = np.concatenate([self.level, more])
            self._rank = np.concatenate([self._rank, more])
            self._level_start = np.concatenate([self._level_start, np.zeros_like(more)])
        self._remove(change.vanished_nodes)
        self._insert(change.copied_nodes, change.copy_parents)
        if len(change.returned_nodes):
            free = ~self.springs.mesh.fixed[change.returned_nodes]
            self._take_back(change.returned_nodes[free], change.returned_like[free])

    def _take_back(self, nodes: NDArray[np.int32], like: NDArray[np.int32]) -> None:
        """Put nodes that are back behind others; at the end where those are not in the order."""
        alone = nodes[self.rank[like] == UNREACHED]
        self._insert(nodes, like)
        self.nodes[self.used : self.used + len(alone)] = alone
        self.used += len(alone)
        self._ranked = False

    def _remove(self, nodes: NDArray[np.int32]) -> None:
        """Take nodes out of the order."""
        gone = nodes[self.rank[nodes] != UNREACHED]
        if not len(gone):
            return
        keep = np.ones(self.used, dtype=np.bool_)
        keep[self.rank[gone]] = False
        kept = self.nodes[: self.used][keep]
        self.nodes[: len(kept)] = kept
        self.used = len(kept)
        self._count_levels(gone, -1)
        self.level[gone] = UNREACHED
        self._ranked = False

    def _insert(self, news: NDArray[np.int32], behind: NDArray[np.int32]) -> None:
        """Put nodes behind others, those that are in the order, at the same level."""
        places = self.rank[behind]
        ordered = np.flatnonzero(places != UNREACHED)
        if not len(ordered):
            return
        ordered = ordered[np.argsort(places[ordered], kind="stable")]
        news, behind = news[ordered], behind[ordered]
        self.level[news] = self.level[behind]
        orderings.insert_behind(news, places[ordered], self.nodes, self.used)
        self.used += len(news)
        self._count_levels(news, 1)
        self._ranked = False

    def _count_levels(self, nodes: NDArray[np.int32], sign: int) -> None:
        """Levels have so many nodes more, or fewer."""
        reached = self.level[nodes][self.level[nodes] != UNREACHED]
        added = np.cumsum(np.bincount(reached, minlength=self.levels))
        self._level_start[1 : self.levels + 1] += sign * added.astype(np.int32)
        self._reached += sign * len(reached)
