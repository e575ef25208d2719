"""What brings released sheets home: springs alone leave them folded through themselves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.components import connected_components
from tissue_sim.kernels.homing import draw_home

PATIENCE = 256
"""Sweeps with nothing held that springs have for themselves."""

WAY_HOME = 768
"""Sweeps from then on until all of the displacement is taken away before a sweep."""

AWAY = 1e-5
"""Displacement [m] of tissue at rest that is not at home."""


class Homing:
    """Takes the displacements of sheets back by a share before every sweep, if nothing is held.

    Tissue that is fixed somewhere and held nowhere has one equilibrium that it can reach without
    passing through itself: its rest shape. Springs know no inside and find others as well, a dome
    that was pulled through itself stays so. Elements tell where that has happened; triangles do
    not, since a surface turned inside out has the lengths and nearly the angles it had. So what is
    not home after `PATIENCE` is led there: the share taken back grows from nothing, since whatever
    springs resist, momentum makes many times more of it. Parts without a fixed node lie well
    wherever they are and are left alone.

    A cut leaves the rest shape as it is, and closes again if nothing is held. What is sewn is not
    led home: stitches keep it elsewhere.
    """

    def __init__(self, springs: SpringNetwork) -> None:
        """Find what hangs together with a fixed node."""
        self._springs = springs
        self._dtype, self._tiny = springs.dtype, springs.tiny
        self._free, self._sweeps = False, 0
        self.follow()
        none, nowhere = np.zeros(0, dtype=np.uint32), np.zeros((0, 3), springs.dtype)
        draw_home(none, 0, 0, self._anchored, springs.dtype(1.0), self._tiny, nowhere, nowhere)

    def follow(self) -> None:
        """Find it anew after an edit that the network has followed."""
        springs, mesh = self._springs, self._springs.mesh
        rows, used = mesh.node_rows, springs.springs.alive[: springs.rows]
        count, part = connected_components(springs.springs.ends[: springs.rows], used, rows)
        fixed = np.zeros(count + 1, dtype=np.bool_)
        fixed[part[mesh.fixed[:rows]]] = True
        fixed[-1] = False
        self._anchored = np.zeros(mesh.node_capacity, dtype=np.bool_)
        self._anchored[:rows] = fixed[part]
        self._sweeps = 0

    @classmethod
    def of(cls, springs: SpringNetwork) -> Homing | None:
        """What brings a sheet home; None for tetrahedra."""
        return None if springs.mesh.sheet_rows is None else cls(springs)

    def begin(self, free: bool) -> None:
        """Wait anew; `free`: whether nothing is held."""
        self._free, self._sweeps = free, 0

    def draw(
        self,
        state: State,
        nodes: NDArray[np.uint32],
        begin: int,
        end: int,
        last_move: NDArray[np.floating],
    ) -> None:
        """Take nodes[begin:end] a part of their way, once per sweep; and of their last moves.

        Modifies the state and `last_move` in place.
        """
        if not self._free or len(self._springs.stitches):
            return
        self._sweeps += 1
        if self._sweeps > PATIENCE:
            keep = max(1.0 - (self._sweeps - PATIENCE) / WAY_HOME, 0.0)
            draw_home(
                nodes, begin, end, self._anchored, self._dtype(keep), self._tiny,
                state.displacement, last_move,
            )  # fmt: skip

    def is_away(self, state: State) -> bool:
        """Whether nothing is held and anchored tissue is not where it was at rest."""
        far = np.abs(state.displacement[self._anchored])
        free = self._free and not len(self._springs.stitches)
        return free and bool(far.size) and float(far.max()) > AWAY
