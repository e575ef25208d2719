"""Nodes that have left the active set and still come to rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.homing import Homing
from tissue_sim.elastic.model import State
from tissue_sim.elastic.node_sweeps import sweep_with_momentum
from tissue_sim.elastic.ordering import NodeOrdering
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kernels import orderings
from tissue_sim.kernels.unflipping import unflip_nodes

WIDEN_EVERY = 8
"""Sweeps between two looks for nodes that something else has displaced meanwhile."""

UNFLIP_WITHIN = 32
"""Sweeps within which every lingering node's elements are looked at once for inversion."""

PATIENCE = 2 * UNFLIP_WITHIN
"""Sweeps with inverted elements after which every sweep looks for them at all nodes it visits."""

MOST_VISITED = 2000
"""Most nodes a sweep visits: a longer list is visited in parts, so that a large release does not
make steps longer than a frame."""


class Lingering:
    """Nodes outside the region that are swept until none of them moves any more.

    With momentum they return in a fraction of the sweeps: each node first repeats a share of its
    last move (Polyak's heavy ball). Elements that the pull has turned inside out, which springs
    would leave so, are turned back on the way.

    Attributes:
        nodes: Rows in the order of the sweep; valid in [0, count), uint32.
        count: How many linger.
        member: Whether a node lingers, shape (node_capacity,).
        elsewhere: Where displaced nodes may join by themselves, shape (node_capacity,).
        homing: Brings sheets home; None for tetrahedra.
    """

    def __init__(self, springs: SpringNetwork, momentum: float, joins: bool) -> None:
        """Start with none.

        Args:
            springs: The network that is swept.
            momentum: Share of its last move that a node repeats.
            joins: Whether displaced nodes of `elsewhere` join later on.
        """
        self.springs, self._joins = springs, joins
        self.homing = Homing.of(springs)
        self._momentum = springs.dtype(momentum)
        self.count = self._sweeps = self._since_flip = self._visited = 0
        self._flipping = 0
        self._farthest = 0.0
        capacity = springs.mesh.node_capacity
        self.nodes = np.zeros(capacity, dtype=np.uint32)
        self.member = np.zeros(capacity, dtype=np.bool_)
        self.elsewhere = np.ones(capacity, dtype=np.bool_)
        self._last_move = np.zeros((capacity, 3), dtype=springs.dtype)

    def grow(self, extra: int) -> None:
        """Make place for more nodes."""
        self.nodes = np.concatenate([self.nodes, np.zeros(extra, dtype=np.uint32)])
        self.member = np.concatenate([self.member, np.zeros(extra, dtype=np.bool_)])
        self.elsewhere = np.concatenate([self.elsewhere, np.ones(extra, dtype=np.bool_)])
        more = np.zeros((extra, 3), dtype=self._last_move.dtype)
        self._last_move = np.concatenate([self._last_move, more])

    def clear(self) -> None:
        """Let all go."""
        self.member[:] = False
        self.count = 0

    def forget(self, nodes: NDArray[np.int32]) -> None:
        """Forget the last moves of nodes that were put elsewhere."""
        self._last_move[nodes] = 0

    def choose(self, state: State, order: NodeOrdering, begin: int) -> None:
        """List the members behind the region, in the order of the nodes.

        Displaced nodes of `elsewhere` become members.

        Args:
            state: Displacements and prescribed nodes.
            order: Order of the nodes.
            begin: Place in it where the region ends.
        """
        if not self.count:
            self._since_flip = 0
        orderings.leave_lingering(order.nodes, begin, self.member)
        self.count = orderings.pick_lingering(
            order.nodes, begin, order.used, state.displacement, state.prescribed,
            self.elsewhere, self.member, self._last_move, self.nodes,
        )  # fmt: skip

    def drop(self, nodes: NDArray[np.int32]) -> None:
        """Let go of nodes that are no more."""
        if not self.member[nodes].any():
            return
        self.member[nodes] = False
        kept = self.nodes[: self.count][self.member[self.nodes[: self.count]]]
        self.count = len(kept)
        self.nodes[: self.count] = kept

    def join(
        self, state: State, near: NodeOrdering, level: NDArray[np.int32], deepest: int
    ) -> None:
        """Let free nodes outside the region linger too, after those that do.

        Args:
            state: Displacements and prescribed nodes.
            near: The nodes, in their order.
            level: Level of each node row in the order whose beginning is the region.
            deepest: Last level of the region; -1: there is none.
        """
        self._since_flip = 0
        # What a node did when it lingered last is over.
        self.count = orderings.join_lingering(
            near.nodes, near.used, level, deepest, state.prescribed, self.springs.mesh.node_alive,
            self.member, self._last_move, self.nodes, self.count,
        )  # fmt: skip

    def _next_part(self) -> tuple[int, int]:
        """The part of the list that the next sweep visits: all of it if that is not too long."""
        begin = self._visited if self._visited < self.count else 0
        end = min(begin + MOST_VISITED, self.count)
        self._visited = end
        return begin, end

    def _unflip(self, state: State, begin: int, end: int) -> int:
        """Look for inverted elements at some of the nodes that linger; how many were put back.

        Where a large part is inside out its nodes confirm each other and springs undo what one
        look in `UNFLIP_WITHIN` sweeps does: then all that was swept is looked at, every time.
        """
        if self.homing is not None:
            return 0  # Triangles have no inside to tell by.
        if self._flipping <= PATIENCE:
            part = self._sweeps % UNFLIP_WITHIN
            begin = self.count * part // UNFLIP_WITHIN
            end = self.count * (part + 1) // UNFLIP_WITHIN
        return unflip_nodes(
            self.nodes, begin, end, self.springs.mesh.rest, self.springs.elements,
            self.springs.arrays, state.displacement, self._last_move,
        )  # fmt: skip

    def sweep(self, state: State, order: NodeOrdering, begin: int, step: np.floating) -> float:
        """One sweep. Modifies the state in place.

        Returns:
            Largest squared distance that a node moved [m^2] since the list was begun; infinite as
            long as it is not through, or elements may be inverted.
        """
        self._sweeps += 1
        if self._joins and self._sweeps % WIDEN_EVERY == 0:
            self.choose(state, order, begin)
        begin, end = self._next_part()
        if self.homing is not None:
            self.homing.draw(state, self.nodes, begin, end, self._last_move)
        moved = sweep_with_momentum(
            self.springs, self.nodes, begin, end, state, step, self._momentum, self._last_move
        )
        self._farthest = max(self._farthest, moved)
        if end == self.count:
            moved, self._farthest = self._farthest, 0.0
        else:
            moved = np.inf
        if self._unflip(state, begin, end):
            self._since_flip, self._flipping = 0, self._flipping + 1
        else:
            self._since_flip += 1
        # Rest counts only when all elements have been looked at since the last one was turned.
        if self._since_flip >= UNFLIP_WITHIN:
            self._flipping = 0
        return moved if self._since_flip >= UNFLIP_WITHIN else np.inf
