"""Stitches as 3x3 blocks of a linear stiffness matrix, and the forces that go with them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.stiffness import Stiffness

SLACK = 1e-3
"""Share of its rest length by which a thread is shorter when it is taken out of the matrix."""


TURNED = 0.97
"""Cosine of the angle by which a thread turns before its blocks are written anew."""

ACROSS = 0.01
"""Least stiffness of a thread across itself in the matrix, as a share of that along it: a little
more than it has when it is hardly longer than at rest, so that solutions do not swing about."""

OTHER = 2.0
"""Times by which the stiffness across may be another one before blocks are written anew."""


class StitchBlocks:
    """Linear stitches: the tangent of a taut thread, and the constant force that goes with it.

    With B the tangent at some shape u_0 and f(u) the pull of the threads, stitches pull with
    load - B u, load = f(u_1) + B u_1: exactly at u_1. Solving and taking the load anew (`renew`) at
    the solution, by turns, ends where the threads' own pull is in balance. A slack thread has
    neither blocks nor force.

    Attributes:
        load: Constant force of the stitches on each sewn node [N], shape (s, 3).
        taut: Threads that are in the matrix, shape (n,).
    """

    def __init__(self, stiffness: Stiffness) -> None:
        """Sew the shape at rest."""
        self._stiffness = stiffness
        self.sew(np.zeros((stiffness.springs.mesh.node_capacity, 3)))

    def __len__(self) -> int:
        """How many there are."""
        return len(self._stiffness.springs.stitches)

    @property
    def nodes(self) -> NDArray[np.int32]:
        """Rows of the sewn nodes."""
        return self._stiffness.springs.stitches.nodes

    def _taut_at(self, u: NDArray[np.floating], short: float) -> NDArray[np.bool_]:
        stitches = self._stiffness.springs.stitches
        least = stitches.threads.length * (1.0 - short)
        return np.asarray(stitches.lengths(u) >= least)

    def sew(self, u: NDArray[np.floating]) -> None:
        """Write the blocks of the threads that are taut at a shape, and their load.

        Args:
            u: Displacements [m], shape (node_capacity, 3).
        """
        self.taut = self._taut_at(u, SLACK)
        springs = self._stiffness.springs
        if not len(self):
            self.load = np.zeros((0, 3))
            return
        stitches = springs.stitches
        self._blocks = stitches.tangents(u, self.taut, ACROSS)
        self._directions, self._across = stitches.directions(u), stitches.across(u, ACROSS)
        self._stiffness.set_stitches(-self._blocks.reshape(-1, 9))
        self.load = self._load_at(u)

    def _load_at(self, u: NDArray[np.floating]) -> NDArray[np.float64]:
        stitches = self._stiffness.springs.stitches
        force, _ = stitches.at_nodes(u)
        sewn = stitches.sewn
        own = np.repeat(np.arange(len(sewn.nodes)), np.diff(sewn.start))
        places = u[sewn.nodes].astype(np.float64)
        between = places[own] - places[sewn.other]
        np.add.at(force, own, np.einsum("tij,tj->ti", self._blocks[sewn.thread], between))
        return force

    def _outdated(self, u: NDArray[np.floating]) -> bool:
        """Whether a thread's stiffness points elsewhere, or is another one across it."""
        stitches = self._stiffness.springs.stitches
        directed = self.taut & (stitches.threads.length > 0.0)
        along = np.einsum("ni,ni->n", stitches.directions(u), self._directions)
        ratio = stitches.across(u, ACROSS) / self._across
        other = (along < TURNED) | (ratio > OTHER) | (ratio < 1.0 / OTHER)
        return bool(other[directed].any())

    def catch(self, u: NDArray[np.floating]) -> bool:
        """Put slack threads that are longer than at rest into the matrix; whether there are any."""
        if not (self._taut_at(u, 0.0) & ~self.taut).any():
            return False
        self.sew(u)
        return True

    def renew(self, u: NDArray[np.floating], tolerance: float, least: float) -> str:
        """Take the rest edges anew where they have turned.

        Args:
            u: Displacements [m], shape (node_capacity, 3).
            tolerance: Share of the largest pull by which a load may be wrong.
            least: Length [m] by which a thread may be wrong.

        Returns:
            "matrix" if other threads are taut now, or have another stiffness, and the blocks were
            written anew, "load" if the load is another one, "" if nothing has changed.
        """
        if not len(self):
            return ""
        # A thread in the matrix stays there until it is clearly slack; others join when longer.
        now = np.where(self.taut, self._taut_at(u, SLACK), self._taut_at(u, 0.0))
        if not np.array_equal(now, self.taut) or self._outdated(u):
            self.sew(u)
            return "matrix"
        load = self._load_at(u)
        wrong = np.abs(load - self.load).max()
        stitches = self._stiffness.springs.stitches
        pull = np.abs(stitches.at_nodes(u)[0]).max()
        if wrong <= max(tolerance * pull, least * stitches.threads.stiffness.max()):
            return ""
        self.load = load
        return "load"

    def load_at(self, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Load on nodes [N], shape (len(rows), 3)."""
        return self._stiffness.springs.stitches.spread(self.load, rows)
