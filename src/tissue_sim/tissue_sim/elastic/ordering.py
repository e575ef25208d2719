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

FEW = 8
"""An order of fewer than one in so many nodes is forgotten node by node."""


class NodeOrdering:
    """Nodes in breadth-first order from sources, level by level.

    Nodes that cannot be reached come last, by row.
    The search goes along springs and stitches and does not enter prescribed nodes that are no
    sources: nothing gets past a node that does not move. An edit keeps the levels: a copy takes its
    parent's level and follows it in the order. Keys that grow along the order, with room between
    them, tell where a node is without anybody having to renumber those behind a copy.

    Attributes:
        nodes: Node rows in order; valid in [0, used), uint32.
        level: Level of each node row, -1 where not reached, shape (node_capacity,).
        key: Number of each node row that grows along the order, -1 for none, int64, shape
            (node_capacity,).
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
        self.key = np.full(capacity, UNREACHED, dtype=np.int64)
        self._level_start = np.zeros(capacity + 2, dtype=np.int32)
        self.used = 0

    @property
    def rank(self) -> NDArray[np.int32]:
        """Place of each node row in the order, -1 for none, shape (node_capacity,); made anew."""
        return self.places_of(np.arange(len(self.key), dtype=np.int32))

    def places_of(self, nodes: NDArray[np.int32]) -> NDArray[np.int32]:
        """Place of nodes in the order, -1 for none, shape (len(nodes),)."""
        places = np.empty(len(nodes), dtype=np.int32)
        orderings.find_places(nodes, self.nodes, self.used, self.key, places)
        return places

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
            depth: Last level to visit; with one, nodes beyond it are left out, and the time that it
                takes does not depend on them.
        """
        mesh, arrays = self.springs.mesh, self.springs.arrays
        self._forget(mesh.node_capacity)
        self._reached, self.levels = orderings.breadth_first(
            sources, arrays.start, self.springs.links, arrays.neighbour, prescribed,
            depth, self.level, self.nodes, self._level_start,
        )  # fmt: skip
        self.used = self._reached
        if depth >= WHOLE_ORGAN:
            self.used = orderings.append_rest(
                mesh.node_rows, prescribed, mesh.node_alive, self.level, self.nodes, self._reached
            )
        orderings.number(self.nodes, self.used, self.key)

    def _forget(self, capacity: int) -> None:
        """Begin without any node in order."""
        if len(self.nodes) != capacity:
            self._allocate(capacity)
        elif self.used < capacity // FEW:
            orderings.forget(self.nodes, self.used, self.level, self.key)
        else:
            self.level[:] = UNREACHED
            self.key[:] = UNREACHED

    def end_of(self, level: int) -> int:
        """Place in `nodes` behind the last node of a level."""
        return int(self._level_start[min(level + 1, self.levels)])

    def follow(self, change: EditChange) -> None:
        """Put the copies an edit made behind their parents and take out what vanished.

        Local but for moving up the part of `nodes` that lies behind.
        """
        capacity = self.springs.mesh.node_capacity
        extra = capacity - len(self.nodes)
        if extra > 0:
            self.nodes = np.concatenate([self.nodes, np.zeros(extra, dtype=np.uint32)])
            more = np.full(extra, UNREACHED, dtype=np.int32)
            self.level = np.concatenate([self.level, more])
            self.key = np.concatenate([self.key, more.astype(np.int64)])
            self._level_start = np.concatenate([self._level_start, np.zeros_like(more)])
        self._remove(change.vanished_nodes)
        self._insert(change.copied_nodes, change.copy_parents)
        if len(change.returned_nodes):
            free = ~self.springs.mesh.fixed[change.returned_nodes]
            self._take_back(change.returned_nodes[free], change.returned_like[free])

    def _take_back(self, nodes: NDArray[np.int32], like: NDArray[np.int32]) -> None:
        """Put nodes that are back behind others; at the end where those are not in the order."""
        alone = nodes[self.key[like] == UNREACHED]
        self._insert(nodes, like)
        if not len(alone):
            return
        last = int(self.key[self.nodes[self.used - 1]]) if self.used else 0
        self.nodes[self.used : self.used + len(alone)] = alone
        self.key[alone] = last + orderings.GAP * np.arange(1, len(alone) + 1)
        self.used += len(alone)

    def _remove(self, nodes: NDArray[np.int32]) -> None:
        """Take nodes out of the order."""
        gone = nodes[self.key[nodes] != UNREACHED]
        if not len(gone):
            return
        orderings.take_out(np.sort(self.places_of(gone)), self.nodes, self.used)
        self.used -= len(gone)
        self._reached -= orderings.count_levels(
            gone, self.level, self.levels, -1, self._level_start
        )
        self.level[gone] = UNREACHED
        self.key[gone] = UNREACHED

    def _insert(self, news: NDArray[np.int32], behind: NDArray[np.int32]) -> None:
        """Put nodes behind others, those that are in the order, at the same level."""
        along = np.argsort(self.key[behind], kind="stable")
        self.used, reached = orderings.insert_copies(
            news, behind, along, self.nodes, self.used, self.level, self.levels, self._level_start,
            self.key,
        )  # fmt: skip
        self._reached += reached
