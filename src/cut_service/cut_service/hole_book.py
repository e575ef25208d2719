"""The holes that have been named in one epoch of the simulation."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import RequestError
from tissue_sim.geometry.closure import Closure, LoopError
from tissue_sim.geometry.holes import Hole, HoleLostError, NothingThereError, name_hole
from tissue_sim.geometry.mesh import Mesh

MOST_HOLES = 32
"""Holes that are remembered at a time."""


class ClosureCode(IntEnum):
    """Error codes of a request; the numbers are those of `tissue_interfaces/srv/Closure`."""

    NONE = 0
    INVALID = 1
    UNKNOWN_FRAME = 2
    NO_TISSUE = 3
    STATE_FRAME_GONE = 4
    NOTHING_THERE = 5
    UNKNOWN_HOLE = 6
    HOLE_LOST = 7


class ClosureError(RequestError[ClosureCode]):
    """A request that cannot be met; nothing was changed."""


@dataclass(frozen=True)
class Looked:
    """A hole and what was found of it.

    Attributes:
        hole: The hole.
        closure: How far it is closed; None: see `problem`.
        lost: Positions of its edge that are no more.
        problem: Why it cannot be measured.
    """

    hole: Hole
    closure: Closure | None
    lost: int
    problem: str = ""

    def __str__(self) -> str:
        if self.closure is None:
            return self.problem
        found = self.closure
        edge = ""
        if np.isfinite(found.edge_gap):
            edge = f", patches up to {1e3 * found.edge_gap:.2f} mm from its edge"
        return (
            f"{self.hole.name}: {100.0 * found.covered:.1f} % of {1e6 * found.area:.1f} mm^2 "
            f"covered, widest gap {1e3 * found.gap:.2f} mm{edge}"
        )


class HoleBook:
    """Remembers holes by name; another epoch's nodes are others, and so are its holes."""

    def __init__(self) -> None:
        self._epoch = b""
        self._holes: dict[str, Hole] = {}

    def of(self, epoch: bytes) -> dict[str, Hole]:
        """The holes of an epoch by name, in the order they were named."""
        if epoch != self._epoch:
            self._epoch, self._holes = epoch, {}
        return self._holes

    def hole(self, epoch: bytes, name: str) -> Hole:
        """A hole by name.

        Raises:
            ClosureError: There is none.
        """
        holes = self.of(epoch)
        if name not in holes:
            known = ", ".join(holes) or "none"
            raise ClosureError(
                ClosureCode.UNKNOWN_HOLE, f"no hole is named {name!r}; holes: {known}"
            )
        return holes[name]

    def name(
        self,
        epoch: bytes,
        mesh: Mesh,
        shape: NDArray[np.floating],
        name: str,
        positions: NDArray[np.float64],
        reach: float,
        depth: float,
    ) -> Hole:
        """Name a hole, or name it anew; see `geometry.holes.name_hole`.

        Raises:
            ClosureError: The loop, a number or the name is not allowed, or there are too many.
        """
        holes = self.of(epoch)
        if len(holes) >= MOST_HOLES and name not in holes:
            raise ClosureError(
                ClosureCode.INVALID, f"{len(holes)} holes are named; allowed: up to {MOST_HOLES}"
            )
        try:
            hole = name_hole(mesh, shape, name, positions, reach, depth)
        except NothingThereError as error:
            raise ClosureError(ClosureCode.NOTHING_THERE, str(error)) from None
        except LoopError as error:
            raise ClosureError(ClosureCode.INVALID, str(error)) from None
        holes[name] = hole
        return hole


def look_at(hole: Hole, mesh: Mesh, shape: NDArray[np.floating]) -> Looked:
    """Measure a hole at a shape [m], shape (node_rows, 3)."""
    lost = hole.lost(mesh)
    try:
        return Looked(hole, hole.closure(mesh, shape), lost)
    except HoleLostError as error:
        return Looked(hole, None, lost, str(error))
