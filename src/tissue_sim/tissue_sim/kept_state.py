"""The state before a frame, to go back to if the frame loses it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.positions import place_nodes

EXPLODED = 20.0
"""A displacement of so many sizes of the organ is not believed."""


class KeptState:
    """Keeps a state from before anything moves, and gives the positions after it.

    Attributes:
        limit: Largest displacement along an axis that is believed [m].
    """

    def __init__(self, mesh: Mesh, state: State) -> None:
        """Begin.

        Args:
            mesh: The organ.
            state: Its state, looked at as it is at the time.
        """
        self._mesh, self._state = mesh, state
        self._good = state.displacement.copy()
        self._buffers = [np.zeros((mesh.node_capacity, 3), dtype=np.float32) for _ in range(2)]
        extent = np.ptp(mesh.rest[: mesh.node_rows], axis=0).max() if mesh.node_rows else 1.0
        self.limit = EXPLODED * float(max(extent, 1e-6))

    def keep(self) -> None:
        """Keep the state as it is."""
        if len(self._good) != len(self._state.displacement):
            self._good = np.empty_like(self._state.displacement)
        np.copyto(self._good, self._state.displacement)

    def positions(self) -> tuple[NDArray[np.float32], int]:
        """Positions now [m], shape (node_rows, 3), and how many of them cannot be believed.

        They stay as they are until the call after the next.
        """
        rows = self._mesh.node_rows
        if len(self._buffers[0]) < rows:
            shape = (self._mesh.node_capacity, 3)
            self._buffers = [np.zeros(shape, dtype=np.float32) for _ in range(2)]
        self._buffers.reverse()
        positions = self._buffers[0][:rows]
        return positions, self._place(positions)

    def restore(self, positions: NDArray[np.float32]) -> None:
        """Go back to what was kept, at rest; `positions` are overwritten."""
        np.copyto(self._state.displacement, self._good)
        np.copyto(self._state.previous, self._good)
        self._place(positions)

    def _place(self, positions: NDArray[np.float32]) -> int:
        rows = self._mesh.node_rows
        displacement = self._state.displacement[:rows]
        return int(place_nodes(self._mesh.rest[:rows], displacement, self.limit, positions))
