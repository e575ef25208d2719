"""The active set of vertex block descent: the same nodes, swept by 3x3 Newton steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.acceleration import Chebyshev
from tissue_sim.elastic.active_set import ActiveSet
from tissue_sim.elastic.block_problem import BlockProblem
from tissue_sim.elastic.lingering import Lingering
from tissue_sim.elastic.model import State
from tissue_sim.elastic.ordering import NodeOrdering
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels.extrapolation import wake_around_moved

UNFOLD_WITHIN = 200
"""Sweeps after a change of holds or an edit in which crushed and inverted elements are unfolded."""


class Pace:
    """How the nodes of one list move: with momentum, and unfolding at first.

    Polyak's heavy ball, with a brake: when a sweep turns round more than half of what nodes have
    just repeated, the next sweep repeats nothing. That is what oscillations that grow from sweep to
    sweep do. Stopping at the first move backwards (O'Donoghue and Candes, doi
    10.1007/s10208-013-9150-3) takes the momentum from slow large moves because of quick small ones:
    six times the sweeps on the heart.

    Attributes:
        share: Share of its last move that every node repeats.
    """

    def __init__(self, share: np.floating) -> None:
        self._full, self._none = share, share - share
        self.share = share
        self._to_unfold = UNFOLD_WITHIN

    @property
    def unfolding(self) -> bool:
        """Whether nodes of crushed and inverted elements follow their neighbours."""
        return self._to_unfold > 0

    def begin(self) -> None:
        """Unfold from now on for a while."""
        self._to_unfold = UNFOLD_WITHIN

    def finish_unfolding(self) -> None:
        """Leave crushed and inverted elements to the energy from now on."""
        self._to_unfold = 0

    def judge(self, along: float, through: bool = True) -> None:
        """Go on after a sweep.

        Args:
            along: Sum of the new moves plus half of the repeated ones, times the latter [m^2].
            through: Whether the sweep has reached the end of the list.
        """
        self.share = self._full if along >= 0.0 else self._none
        self._to_unfold -= through and self.unfolding


class BlockLingering(Lingering):
    """Nodes outside the region that vertex block descent sweeps until they rest.

    No node has to be turned back: the energy does that by itself.
    """

    def __init__(self, problem: BlockProblem, momentum: float) -> None:
        super().__init__(problem.springs, momentum, joins=False)
        self.problem, self.pace = problem, Pace(problem.springs.dtype(momentum))
        self._last_move = problem.last_move

    def grow(self, extra: int) -> None:
        """Make place for more nodes; the problem has grown before."""
        super().grow(extra)
        self._last_move = self.problem.last_move

    def sweep(self, state: State, order: NodeOrdering, begin: int, step: np.floating) -> float:
        """One sweep; see `Lingering.sweep`. Modifies the state in place."""
        begin, end = self._next_part()
        moved, along = self.problem.sweep(
            state, self.nodes, begin, end, self.pace.share, self.pace.unfolding
        )
        self.pace.judge(along, through=end == self.count)
        self._farthest = max(self._farthest, moved)
        if end < self.count:
            return float(np.inf)
        moved, self._farthest = self._farthest, 0.0
        return moved


class BlockActiveSet(ActiveSet):
    """The nodes that vertex block descent visits.

    Attributes:
        moved: Largest squared distance a node of the region moved in the last sweep [m^2].
    """

    def __init__(
        self,
        problem: BlockProblem,
        levels: int,
        rest_tolerance: float,
        momentum: float,
        chebyshev: float = 0.0,
    ) -> None:
        """Start with nothing active.

        Args:
            problem: What is minimised.
            levels: Cut-off level.
            rest_tolerance: Largest move in one sweep [m] that counts as rest.
            momentum: Share of its last move that a node repeats.
            chebyshev: Estimated spectral radius of a sweep over the region, whose nodes then
                repeat nothing; 0: not used.
        """
        super().__init__(problem.springs, levels, rest_tolerance)
        self.chebyshev = Chebyshev(problem.springs, chebyshev) if chebyshev > 0.0 else None
        # Compiled, or loaded from the cache, before the first sweep.
        wake_around_moved(
            np.empty(0, dtype=np.uint32), 0, 0, problem.controls.tolerance, problem.last_move,
            problem.last_move, problem.springs.arrays, problem.awake,
        )  # fmt: skip
        self.problem, self.pace = problem, Pace(problem.springs.dtype(momentum))
        self.lingering = self._slow = BlockLingering(problem, momentum)
        self.moved = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether the last sweep moved nothing and nothing lingers."""
        return not self.lingering.count and (not self.end or self.moved <= self._tolerance)

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Order the nodes anew from the held ones; any of them may have to move."""
        self.problem.wake(state)
        self.problem.last_move[state.prescribed] = 0
        self._begin()
        super().prescribed_changed(state, held)

    def follow(self, change: EditChange, state: State) -> None:
        """Follow an edit that the problem has followed."""
        self._begin()
        super().follow(change, state)

    def guess(
        self, state: State, before: NDArray[np.floating], after: NDArray[np.floating]
    ) -> None:
        """Move free nodes of the region; see `ActiveSet`. Modifies the state in place."""
        super().guess(state, before, after)
        nodes, end, problem = self.ordering.nodes, self.end, self.problem
        if self.chebyshev is not None:
            self.chebyshev.shift(state, nodes, end, before, after)
        wake_around_moved(
            nodes, 0, end, problem.controls.tolerance, before, after, problem.springs.arrays,
            problem.awake,
        )  # fmt: skip

    def _begin(self) -> None:
        self.moved = np.inf
        self.pace.begin()
        if self.chebyshev is not None:
            self.chebyshev.begin()
        self._slow.pace.begin()

    def _sweep_part(self, state: State, step: np.floating, begin: int, end: int) -> float:
        nodes, pace = self.ordering.nodes, self.pace
        if self.chebyshev is not None:
            self.moved = self.sweep_by_chebyshev(self.chebyshev, state, end)
            pace.judge(0.0)
            return self.moved
        self.moved, along = self.problem.sweep(state, nodes, begin, end, pace.share, pace.unfolding)
        pace.judge(along)
        return self.moved

    def sweep_by_chebyshev(self, chebyshev: Chebyshev, state: State, end: int) -> float:
        """One sweep over the first nodes of the order, extrapolated. Modifies the state in place.

        Returns:
            Largest squared distance a node moved [m^2].
        """
        nodes, problem, unfolding = self.ordering.nodes, self.problem, self.pace.unfolding
        moved = chebyshev.sweep(
            state, nodes, end,
            lambda share: problem.sweep(
                state, nodes, 0, end, problem.springs.dtype(share), unfolding
            )[0],
        )  # fmt: skip
        wake_around_moved(
            nodes, 0, end, problem.controls.tolerance, chebyshev.before, state.displacement,
            problem.springs.arrays, problem.awake,
        )  # fmt: skip
        return moved

    def _come_to_rest(self, state: State) -> None:
        super()._come_to_rest(state)
        if self.lingering.count and len(self.springs.stitches):
            # Stitches pull by many moves that are each too small to wake a neighbour.
            self.problem.awake[self.lingering.nodes[: self.lingering.count]] = True

    def _sweep_sewn(self, state: State, moves: NDArray[np.bool_]) -> float:
        farthest = self.problem.sweep_sewn(state, moves, self.pace.unfolding)
        self.moved = max(self.moved, farthest)
        return farthest

    def _largest(self, state: State, nodes: NDArray[np.uint32], end: int) -> tuple[float, float]:
        return self.problem.largest(state, nodes, end)

    def _largest_sewn(self, state: State, which: NDArray[np.bool_]) -> tuple[float, float]:
        return self.problem.largest_sewn(state, which)
