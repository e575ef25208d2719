"""Which nodes a sweep visits, and until when."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.acceleration import Acceleration
from tissue_sim.elastic.lingering import Lingering
from tissue_sim.elastic.model import State
from tissue_sim.elastic.node_sweeps import (
    largest_force,
    largest_sewn_force,
    sweep,
    sweep_sewn_nodes,
    sweep_with_momentum,
)
from tissue_sim.elastic.ordering import NodeOrdering
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels.extrapolation import add_difference
from tissue_sim.kernels.orderings import UNREACHED


class ActiveSet:
    """The nodes that node sweeps visit: those near held ones, and those still coming to rest.

    The *region* is the part of the breadth-first order from the held nodes up to a cut-off level.
    Nodes that leave it while they still move would stay stuck out of equilibrium; so they *linger*:
    they are visited after the region until, in one sweep, none of them moves more than
    `rest_tolerance`. What lingers:

    - nodes of the region or lingering before that are not in the new region;
    - displaced nodes that the held nodes cannot reach, or that lie closer to released nodes than to
      held ones;
    - nodes within the cut-off level of an edit: a cut must open wherever it is.

    When nothing is held the order stays what it was, and before the last lingering nodes are let go
    the whole organ is looked at: if anything is out of equilibrium, what is displaced lingers on.

    Attributes:
        ordering: Order of the nodes, breadth-first from the held ones.
        end: The region is ordering.nodes[:end].
        lingering: Nodes still coming to rest.
    """

    def __init__(
        self,
        springs: SpringNetwork,
        levels: int,
        rest_tolerance: float,
        keep_until_rest: bool = True,
        momentum: float = 0.0,
        alone: bool = True,
        acceleration: Acceleration | None = None,
        force_step: float = 0.0,
    ) -> None:
        """Start with nothing active.

        Args:
            springs: The network that is swept.
            levels: Cut-off level.
            rest_tolerance: Largest move in one sweep [m] that counts as rest.
            keep_until_rest: Whether nodes linger at all; without it, the fault of stuck nodes can
                be seen.
            momentum: Share of its last move that a lingering node repeats in the next sweep.
            alone: Whether nothing else moves the nodes outside the region. Then all that is
                displaced when the first holds are told (by the model before this one) lingers too.
            acceleration: What accelerates the sweeps over the region.
            force_step: What nodes of the region move besides, for their force [m/N]; those that
                linger do not.
        """
        self.springs = springs
        self.levels, self.keep_until_rest, self.alone = levels, keep_until_rest, alone
        self._tolerance, self._force_step = rest_tolerance**2, force_step
        self.ordering = NodeOrdering(springs)
        self.lingering = Lingering(springs, momentum, joins=not alone)
        self.end = 0
        self._acceleration = acceleration
        self._last_move = np.zeros((0, 3), dtype=springs.dtype)
        self._near = NodeOrdering(springs)
        self._held = np.empty(0, dtype=np.int32)
        self._has_ordering = self._was_told = False

    @property
    def count(self) -> int:
        """Nodes that the next sweep visits."""
        return self.end + self.lingering.count

    def visited(self) -> NDArray[np.uint32]:
        """Nodes that the next sweep visits, in its order."""
        lingering = self.lingering.nodes[: self.lingering.count]
        return np.concatenate([self.ordering.nodes[: self.end], lingering])

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Order the nodes anew from the held ones and let the others come to rest."""
        self._match_capacity()
        self._forget_moves()
        self.lingering.member[self.ordering.nodes[: self.end]] = True
        released = np.setdiff1d(self._held, held)
        self._held = held.astype(np.int32)
        if self.lingering.homing is not None:
            self.lingering.homing.begin(free=not len(held))
        if len(held) or not self._has_ordering:
            self.ordering.search(self._held, state.prescribed)
            self._has_ordering = bool(len(held))
        self.end = self.ordering.end_of(self.levels) if len(held) else 0
        self._find_elsewhere(state, released)
        self._was_told = True
        if self.keep_until_rest:
            self.lingering.choose(state, self.ordering, self.end)
        else:
            self.lingering.clear()

    def _find_elsewhere(self, state: State, released: NDArray[np.int32]) -> None:
        """Find the nodes that no hold reaches, or that lie closer to a released node."""
        elsewhere = self.lingering.elsewhere
        if not len(self._held) or (self.alone and not self._was_told):
            elsewhere[:] = True
            return
        level = self.ordering.level
        elsewhere[:] = level == UNREACHED
        released = released[~state.prescribed[released]]
        if len(released):
            self._near.search(released, state.prescribed)
            elsewhere |= (self._near.level != UNREACHED) & (self._near.level < level)

    def guess(
        self, state: State, before: NDArray[np.floating], after: NDArray[np.floating]
    ) -> None:
        """Move free nodes of the region by after - before. Modifies the state in place.

        Nodes outside would not be swept there.
        """
        nodes, end = self.ordering.nodes, self.end
        add_difference(nodes, 0, end, state.prescribed, before, after, state.displacement)
        if self._acceleration is not None:
            self._acceleration.shift(state, nodes, end, before, after)

    def sweep(self, state: State, step: np.floating, threshold: float = 0.0) -> None:
        """One Gauss-Seidel sweep over the active nodes. Modifies the state in place.

        Args:
            state: Displacements and prescribed nodes.
            step: Share of the stable step.
            threshold: Stop behind the first level none of whose nodes moved farther [m]; 0: go on
                to the cut-off.
        """
        if threshold > 0.0:
            self._sweep_levels(state, step, threshold)
        elif self.end and self._acceleration is not None:
            self._acceleration.sweep(
                state, self.ordering.nodes, self.end,
                lambda share: self._sweep_region(state, step, share),
            )  # fmt: skip
        elif self.end:
            self._sweep_part(state, step, 0, self.end)
        of_sewn = 0.0
        if len(self.springs.stitches) and self.count:
            of_sewn = self._sweep_sewn(state, self.moving_sewn(state))
        if self.lingering.count:
            moved = self.lingering.sweep(state, self.ordering, self.end, step)
            if max(moved, of_sewn) <= self._tolerance:
                self._come_to_rest(state)

    def moving_sewn(self, state: State) -> NDArray[np.bool_]:
        """Which of the sewn nodes are active and free, shape (s,)."""
        nodes = self.springs.stitches.nodes
        level = self.ordering.level[nodes]
        active: NDArray[np.bool_] = self.lingering.member[nodes].copy()
        if self.end:
            active |= (level != UNREACHED) & (level <= self.levels)
        return active & ~state.prescribed[nodes]

    def _sweep_sewn(self, state: State, moves: NDArray[np.bool_]) -> float:
        """One sweep over sewn nodes; the farthest squared move [m^2]. Modifies the state."""
        return sweep_sewn_nodes(self.springs, moves, state)

    def _largest_sewn(self, state: State, which: NDArray[np.bool_]) -> tuple[float, float]:
        """As `_largest`, of some of the sewn nodes."""
        return largest_sewn_force(self.springs, which, state)

    def _sweep_part(self, state: State, step: np.floating, begin: int, end: int) -> float:
        return sweep(
            self.springs, self.ordering.nodes, begin, end, state, step, self._force_step
        )  # fmt: skip

    def _sweep_region(self, state: State, step: np.floating, share: float) -> float:
        """One sweep over the region, before which every node repeats a share of its last move."""
        return sweep_with_momentum(
            self.springs, self.ordering.nodes, 0, self.end, state, step,
            self.springs.dtype(share), self._last_move,
        )  # fmt: skip

    def _forget_moves(self) -> None:
        if self._acceleration is not None:
            self._acceleration.begin()
            capacity = self.springs.mesh.node_capacity
            if len(self._last_move) != capacity:
                self._last_move = np.zeros((capacity, 3), dtype=self.springs.dtype)
            self._last_move.fill(0)

    def _sweep_levels(self, state: State, step: np.floating, threshold: float) -> None:
        begin = 0
        for level in range(min(self.levels + 1, self.ordering.levels) if self.end else 0):
            end = self.ordering.end_of(level)
            moved = self._sweep_part(state, step, begin, end)
            begin = end
            if level > 0 and moved <= threshold**2:
                break

    def _come_to_rest(self, state: State) -> None:
        self.lingering.clear()
        if self.end:
            return
        _, step = self._largest(state, self.ordering.nodes, self.ordering.used)
        if len(self.springs.stitches):
            free = ~state.prescribed[self.springs.stitches.nodes]
            step = max(step, self._largest_sewn(state, free)[1])
        homing = self.lingering.homing
        if step > self._tolerance or (homing is not None and homing.is_away(state)):
            self.lingering.choose(state, self.ordering, 0)

    def residual(self, state: State) -> float:
        """Largest internal force on a free active node [N]."""
        region, _ = self._largest(state, self.ordering.nodes, self.end)
        rest, _ = self._largest(state, self.lingering.nodes, self.lingering.count)
        sewn = 0.0
        if len(self.springs.stitches):
            sewn, _ = self._largest_sewn(state, self.moving_sewn(state))
        return math.sqrt(max(region, rest, sewn))

    def _largest(self, state: State, nodes: NDArray[np.uint32], end: int) -> tuple[float, float]:
        return largest_force(self.springs, nodes, 0, end, state)

    def follow(self, change: EditChange, state: State) -> None:
        """Follow an edit: copies join parents, what vanished is let go, what is near lingers."""
        self._match_capacity()
        self._forget_moves()
        if self.lingering.homing is not None:
            self.lingering.homing.follow()
        self.ordering.follow(change)
        self.lingering.drop(change.vanished_nodes)
        elsewhere = self.lingering.elsewhere
        elsewhere[change.copied_nodes] = elsewhere[change.copy_parents]
        elsewhere[change.returned_nodes] = elsewhere[change.returned_like]
        if len(self._held):
            self.end = self.ordering.end_of(self.levels)
        if self.keep_until_rest:
            self._near.search(change.nodes, state.prescribed, self.levels)
            deepest = self.levels if self.end else UNREACHED
            self.lingering.join(state, self._near, self.ordering.level, deepest)

    def _match_capacity(self) -> None:
        extra = self.springs.mesh.node_capacity - len(self.lingering.member)
        if extra > 0:
            self.lingering.grow(extra)
