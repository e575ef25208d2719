"""What the organ does about each motion of what is held: an affine space of solutions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels.responses import add_responses, project

AFFINE_MOTIONS = 12
"""Three translations, and nine entries of a matrix that turns or strains."""

MOST = 48
"""Most responses kept: twelve span the rigid motions of a hold, and several holds may move."""


class Responses:
    """Orthonormal motions of the held nodes met so far, and the solution for each.

    The last motion may be pending: it has no response yet.

    Attributes:
        used: Motions whose response is known.
        pending: Whether one more motion is being solved for.
        changed: Whether the last call of `follow_motion` changed `sum`.
        sum: Base and known responses at their present shares [m], shape (node_capacity, 3).
    """

    def __init__(self, capacity: int, dtype: type[np.floating]) -> None:
        """Begin with nothing held."""
        self.used, self.pending, self.changed = 0, False, False
        self.sum = np.zeros((capacity, 3), dtype=dtype)
        self._base = np.zeros((capacity, 3), dtype=dtype)
        self._known = np.zeros((MOST, capacity, 3), dtype=dtype)
        self._old = np.zeros((MOST, capacity, 3), dtype=dtype)
        self._old_count = 0
        self._shares, self._old_shares = np.zeros(MOST + 1), np.zeros(MOST + 1)
        self._hold(np.empty(0, dtype=np.int32))

    def _hold(self, held: NDArray[np.int32]) -> None:
        self._held = held
        self._origin = np.zeros((len(held), 3))
        self._left = np.zeros((len(held), 3))
        self._proposed = 0
        self._patterns = np.zeros((MOST + 1, len(held), 3))
        self._old_patterns = np.zeros_like(self._patterns)
        self._old_count = 0

    @property
    def share(self) -> float:
        """Share of the pending motion in the present pose [m]."""
        return float(self._shares[self.used])

    @property
    def overtaken(self) -> bool:
        """Whether the motion that is in none of them is far larger than the pending one."""
        return self.pending and math.sqrt(float((self._left**2).sum())) > 4.0 * abs(self.share)

    @property
    def full(self) -> bool:
        """Whether there is no place for one more."""
        return self.used == MOST

    def restart(self, state: State, held: NDArray[np.int32]) -> None:
        """Begin anew from the present shape, which is kept whatever it is.

        Args:
            state: Displacements.
            held: Rows of the held nodes.
        """
        self._hold(held.astype(np.int32))
        self.restart_at(state)

    def restart_at(self, state: State) -> None:
        """Begin anew from the present shape, with the same nodes held."""
        self._base[:] = state.displacement
        self.sum[:] = state.displacement
        self._origin[:] = state.displacement[self._held]
        self._shares[:] = 0.0
        self.used, self.pending = 0, False

    def follow(self, change: EditChange, state: State) -> None:
        """Begin anew after an edit; what was known is where further solutions start from."""
        extra = len(state.displacement) - len(self.sum)
        if extra > 0:
            self.sum, self._base = (np.pad(a, ((0, extra), (0, 0))) for a in (self.sum, self._base))
            self._known, self._old = (
                np.pad(a, ((0, 0), (0, extra), (0, 0))) for a in (self._known, self._old)
            )
        if self.used:
            self._known, self._old = self._old, self._known
            self._patterns, self._old_patterns = self._old_patterns, self._patterns
            self._old_count = self.used
        old = self._old[: self._old_count]
        old[:, change.copied_nodes] = old[:, change.copy_parents]
        self.restart_at(state)

    def follow_motion(self, state: State, rows: int) -> float:
        """Find the shares of all motions in the present pose and bring `sum` up to date.

        Returns:
            The largest motion of a node that is in none of them [m].
        """
        largest, self.changed = project(
            self._held, state.displacement, self._origin, self._patterns,
            self.used + self.pending, self._shares, self._left,
        )  # fmt: skip
        if self.changed:
            add_responses(rows, self._base, self._shares, self._known, self.used, self.sum)
        return math.sqrt(largest)

    def propose(self, rest: NDArray[np.float64]) -> bool:
        """Look for an affine motion of all that is held that has not been met yet.

        Args:
            rest: Rest positions of the mesh [m], shape (node_capacity, 3).

        Returns:
            Whether there is one; `begin` takes it.
        """
        while len(self._held) and self._proposed < AFFINE_MOTIONS and not self.full:
            axis, factor = self._proposed % 3, self._proposed // 3
            self._proposed += 1
            self._left[:] = 0.0
            if factor == 0:
                self._left[:, axis] = 1.0
            else:
                along = rest[self._held, factor - 1]
                self._left[:, axis] = along - along.mean()
            size = math.sqrt(float((self._left**2).sum()))
            for k in range(self.used):
                self._left -= (self._left * self._patterns[k]).sum() * self._patterns[k]
            if math.sqrt(float((self._left**2).sum())) > 1e-3 * size > 0.0:
                return True
        return False

    def begin(self, x: NDArray[np.floating], proposed: bool = False) -> None:
        """Make what is left of the motion the pending one, and write a first guess of its response.

        Args:
            x: Written: the motion in the held nodes, elsewhere what is known from before the last
                edit, shape (node_capacity, 3).
            proposed: Whether it is what `propose` found, and does not occur yet.
        """
        pattern = self._patterns[self.used]
        norm = math.sqrt(float((self._left**2).sum()))
        np.divide(self._left, norm, out=pattern)
        self._shares[self.used] = 0.0 if proposed else norm
        self.pending = True
        old = self._old_shares[: self._old_count]
        np.einsum("kij,ij->k", self._old_patterns[: self._old_count], pattern, out=old)
        x[:] = 0
        if self._old_count:
            add_responses(len(x), x, self._old_shares, self._old, self._old_count, x)
        x[self._held] = pattern

    def abandon(self) -> None:
        """Give the pending motion up; if it was proposed it will be again."""
        self.pending = False
        self._proposed = 0

    def finish(self, x: NDArray[np.floating]) -> None:
        """Keep the response of the pending motion."""
        self._known[self.used] = x
        self.sum += x.dtype.type(self.share) * x
        self.used += 1
        self.pending = False

    def correct(self, x: NDArray[np.floating]) -> None:
        """Add to what does not depend on the motion."""
        self._base += x
        self.sum += x
