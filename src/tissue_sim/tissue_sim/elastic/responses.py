"""What the organ does about each motion of what is held: an affine space of solutions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels.lanes import LANES
from tissue_sim.kernels.responses import add_responses, project

LINEAR_MOTIONS = np.array(
    [
        [[0, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 0]],
        [[1, 0, 0], [0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 1, 0], [0, 0, 0]],
        [[0, 0, 0], [0, 0, 0], [0, 0, 1]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
    ],
    dtype=np.float64,
)
"""Small turns, and what a large turn R - I has beside them."""

AFFINE_MOTIONS = 3 + len(LINEAR_MOTIONS)
"""Three translations come before."""

MOST = 48
"""Most responses kept: twelve span the rigid motions of a hold, and several holds may move."""

FAR = 0.1
"""Largest displacement of a held node over that of any node from which all is seen from rest."""


class Responses:
    """Orthonormal motions of the held nodes met so far, and the solution for each.

    Some of the motions may be pending: they have no response yet, and a lane of the solver works on
    it. Held nodes that are neighbours form a patch, which is moved by one tool or several.

    Attributes:
        used: Motions whose response is known.
        pending: Lane of each pending motion.
        changed: Whether the last call of `follow_motion` changed `sum`.
        strained: Whether tissue is strained that nothing holds: no motion is seen from rest then.
        from_rest: Whether motions are those from rest: there is no base then, and what is left of
            the forces shrinks with them. Otherwise they are those since the last change of what is
            held, beside a base that may be anything.
        sum: Base and known responses at their present shares [m], shape (node_capacity, 3).
        guess: First guess of the response of the motion that began last, shape (node_capacity, 3).
    """

    def __init__(self, capacity: int, dtype: type[np.floating]) -> None:
        """Begin with nothing held."""
        self.used, self.changed, self.from_rest = 0, False, False
        self.strained = False
        self.pending: list[int] = []
        self.sum = np.zeros((capacity, 3), dtype=dtype)
        self.guess = np.zeros((capacity, 3), dtype=dtype)
        self._base = np.zeros((capacity, 3), dtype=dtype)
        self._known = np.zeros((MOST, capacity, 3), dtype=dtype)
        self._old = np.zeros((MOST, capacity, 3), dtype=dtype)
        self._old_count = 0
        # Known motions come first, then the pending ones in the order of `pending`.
        self._shares, self._old_shares = np.zeros(MOST + LANES), np.zeros(MOST)
        self._hold(np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int32))

    def _hold(self, held: NDArray[np.int32], patches: NDArray[np.int32]) -> None:
        self._held, self._patches = held, patches
        self._origin = np.zeros((len(held), 3))
        self._left = np.zeros((len(held), 3))
        self._proposed = np.zeros(int(patches.max(initial=-1)) + 1, dtype=np.int64)
        self._moved = 0
        self._patterns = np.zeros((MOST + LANES, len(held), 3))
        self._old_patterns = np.zeros_like(self._patterns)
        self._old_count = 0

    @property
    def full(self) -> bool:
        """Whether there is no place for one more."""
        return self.used + len(self.pending) >= MOST

    @property
    def crowded(self) -> bool:
        """Whether the places that are left should be kept for motions that occur."""
        return self.used + len(self.pending) >= MOST - LANES

    @property
    def remembers(self) -> bool:
        """Whether responses from before an edit are known."""
        return self._old_count > 0

    def share_of(self, lane: int) -> float:
        """Share of a pending motion in the present pose [m]."""
        return float(self._shares[self.used + self.pending.index(lane)])

    def overtaken(self) -> int | None:
        """Lane of a pending motion that is far smaller than what is in none of them."""
        if not self.pending:
            return None
        lane = min(self.pending, key=lambda each: abs(self.share_of(each)))
        left = math.sqrt(float((self._left**2).sum()))
        return lane if left > 4.0 * abs(self.share_of(lane)) else None

    def restart(self, state: State, held: NDArray[np.int32], patches: NDArray[np.int32]) -> None:
        """Begin anew from the present shape.

        Args:
            state: Displacements.
            held: Rows of the held nodes.
            patches: Which patch each belongs to, counted from 0.
        """
        self._hold(held.astype(np.int32), patches)
        self.restart_at(state)

    def restart_at(self, state: State) -> None:
        """Begin anew from the present shape, with the same nodes held."""
        shape = state.displacement
        far = np.abs(shape[self._held]).max(initial=0.0)
        # Without an array of sizes: it would be as large as the organ.
        farthest = max(float(shape.max()), -float(shape.min()))
        self.from_rest = bool(far > FAR * farthest) and not self.strained
        for array in (self._base, self.sum):
            if self.from_rest:
                array.fill(0.0)
            else:
                np.copyto(array, shape)
        self._origin[:] = self._base[self._held]
        self._shares[:] = 0.0
        self._proposed[:] = 0
        self.used, self.pending = 0, []

    def follow(self, change: EditChange, state: State) -> None:
        """Begin anew after an edit; what was known is where further solutions start from."""
        extra = len(state.displacement) - len(self.sum)
        if extra > 0:
            self.sum, self._base, self.guess = (
                np.pad(a, ((0, extra), (0, 0))) for a in (self.sum, self._base, self.guess)
            )
            self._known, self._old = (
                np.pad(a, ((0, 0), (0, extra), (0, 0))) for a in (self._known, self._old)
            )
        if self.used:
            self._known, self._old = self._old, self._known
            self._patterns, self._old_patterns = self._old_patterns, self._patterns
            self._old_count = self.used
        old = self._old[: self._old_count]
        old[:, change.copied_nodes] = old[:, change.copy_parents]
        old[:, change.born_nodes] = 0.0
        self.restart_at(state)

    def follow_motion(self, state: State, rows: int) -> float:
        """Find the shares of all motions in the present pose and bring `sum` up to date.

        Returns:
            The largest motion of a node that is in none of them [m].
        """
        largest, self.changed = project(
            self._held, state.displacement, self._origin, self._patterns,
            self.used + len(self.pending), self._shares, self._left,
        )  # fmt: skip
        if self.changed:
            add_responses(rows, self._base, self._shares, self._known, self.used, self.sum)
        return math.sqrt(largest)

    def propose(self, rest: NDArray[np.float64]) -> bool:
        """Look for an affine motion of a patch that has not been met yet.

        The patch that moved last comes first.

        Args:
            rest: Rest positions of the mesh [m], shape (node_capacity, 3).

        Returns:
            Whether there is one; `begin` takes it.
        """
        patches = len(self._proposed)
        for k in range(patches):
            patch = (self._moved + k) % patches
            while self._proposed[patch] < AFFINE_MOTIONS and not self.crowded:
                number = int(self._proposed[patch])
                self._proposed[patch] += 1
                if self._leave(number, self._patches == patch, rest[self._held]):
                    return True
        return False

    def _leave(self, number: int, members: NDArray[np.bool_], rest: NDArray[np.float64]) -> bool:
        """Leave what is new of an affine motion of a patch; whether it is anything."""
        arms = rest[members] - rest[members].mean(axis=0)
        self._left[:] = 0.0
        if number < 3:
            self._left[members, number] = 1.0
        else:
            self._left[members] = arms @ LINEAR_MOTIONS[number - 3].T
        size = math.sqrt(float((self._left**2).sum()))
        for pattern in self._patterns[: self.used + len(self.pending)]:
            self._left -= (self._left * pattern).sum() * pattern
        return math.sqrt(float((self._left**2).sum())) > 1e-3 * size > 0.0

    def begin(self, lane: int, proposed: bool = False) -> None:
        """Make what is left of the motion a pending one, and write a first guess of its response.

        The guess is the motion in the held nodes, and elsewhere what is known from before the last
        edit.

        Args:
            lane: Lane of the solver that works on it.
            proposed: Whether it is what `propose` found, and does not occur yet.
        """
        place = self.used + len(self.pending)
        self.pending.append(lane)
        pattern = self._patterns[place]
        squared = (self._left**2).sum(axis=1)
        norm = math.sqrt(float(squared.sum()))
        if not proposed:
            self._moved = int(self._patches[squared.argmax()])
        np.divide(self._left, norm, out=pattern)
        self._shares[place] = 0.0 if proposed else norm
        old = self._old_shares[: self._old_count]
        np.einsum("kij,ij->k", self._old_patterns[: self._old_count], pattern, out=old)
        self.guess[:] = 0
        if self._old_count:
            add_responses(
                len(self.guess), self.guess, self._old_shares, self._old, self._old_count,
                self.guess,
            )  # fmt: skip
        self.guess[self._held] = pattern

    def improve_guess(self, lane: int, shape: NDArray[np.floating], rows: int) -> None:
        """Start the response that has just begun from a shape somebody guesses for this pose.

        Modifies `guess` in place.

        Args:
            lane: Lane of the solver that works on it.
            shape: Displacements [m], shape (node_capacity, 3).
            rows: Nodes in use.
        """
        share = self.share_of(lane)
        if share == 0.0:
            return
        np.subtract(shape[:rows], self.sum[:rows], out=self.guess[:rows])
        self.guess[:rows] /= self.guess.dtype.type(share)
        self.guess[self._held] = self._patterns[self.used + self.pending.index(lane)]

    def abandon(self, lane: int) -> None:
        """Give a pending motion up; if it was proposed it will be again."""
        self._swap(self.pending.index(lane), len(self.pending) - 1)
        self.pending.pop()
        self._proposed[:] = 0

    def finish(self, lane: int, x: NDArray[np.floating]) -> None:
        """Keep the response of a pending motion."""
        self._swap(self.pending.index(lane), 0)
        self.pending.pop(0)
        self._known[self.used] = x
        self.sum += self.sum.dtype.type(self._shares[self.used]) * self._known[self.used]
        self.used += 1

    def _swap(self, first: int, second: int) -> None:
        places = [self.used + first, self.used + second]
        self._patterns[places] = self._patterns[places[::-1]]
        self._shares[places] = self._shares[places[::-1]]
        lanes = self.pending
        lanes[first], lanes[second] = lanes[second], lanes[first]

    def correct(self, x: NDArray[np.floating]) -> None:
        """Add to what does not depend on the motion."""
        self._base += x
        self.sum += x
