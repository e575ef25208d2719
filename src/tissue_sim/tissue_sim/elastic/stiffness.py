"""The stiffness matrix of linear finite elements, row by row, kept up to date under edits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.material_field import lame_constants
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels.corotation import invert_diagonals
from tissue_sim.kernels.stiffness import BlockRows, assemble_rows

__all__ = ["Stiffness", "lame_constants"]


class Stiffness:
    """3x3 blocks in the places of the spring network's lists: an edge of the mesh is a block.

    So is a stitch, whose blocks are for whoever carries stitches to write (`set_stitches`).

    Linear tetrahedra of the network's material; see docs/finite_element.md and docs/materials.md.

    Attributes:
        inverse: Inverse diagonal blocks [m/N], shape (node_capacity, 9); zero for a node without
            elements.
    """

    def __init__(self, springs: SpringNetwork) -> None:
        """Assemble all rows."""
        self.springs = springs
        self._blocks = np.zeros((len(springs.arrays.neighbour), 9), dtype=springs.dtype)
        self.inverse = np.zeros((springs.mesh.node_capacity, 9), dtype=springs.dtype)
        self._place_of = np.full(springs.mesh.node_capacity, -1, dtype=np.int32)
        self._assemble(np.arange(springs.mesh.node_rows, dtype=np.int32))

    @property
    def rows(self) -> BlockRows:
        """The matrix for the kernels; edits may replace the arrays."""
        arrays = self.springs.arrays
        return BlockRows(arrays.start, self.springs.links, arrays.neighbour, self._blocks)

    def follow(self, change: EditChange) -> None:
        """Assemble the rows an edit touched; the network must have followed it before."""
        places = len(self.springs.arrays.neighbour)
        if places > len(self._blocks):
            more = np.zeros((places - len(self._blocks), 9), dtype=self._blocks.dtype)
            self._blocks = np.concatenate([self._blocks, more])
        extra = self.springs.mesh.node_capacity - len(self.inverse)
        if extra > 0:
            more = np.zeros((extra, 9), dtype=self.inverse.dtype)
            self.inverse = np.concatenate([self.inverse, more])
            self._place_of = np.full(len(self.inverse), -1, dtype=np.int32)
        self._assemble(change.nodes)

    def set_stitches(self, blocks: NDArray[np.float64]) -> None:
        """Write the blocks of all stitches, symmetric ones, and the inverses that depend on them.

        Args:
            blocks: Off-diagonal blocks [N/m], shape (stitches, 9).
        """
        for end in (0, 1):
            self._blocks[self.springs.stitch_places[:, end]] = blocks
        self._invert_at(self.springs.stitches.nodes)

    def _invert_at(self, nodes: NDArray[np.int32]) -> None:
        """Invert the diagonal blocks of nodes with elements anew."""
        invert_diagonals(nodes, self.rows, self.inverse)

    def _assemble(self, nodes: NDArray[np.int32]) -> None:
        springs = self.springs
        assemble_rows(
            nodes, springs.elements, springs.mesh.rest, springs.field.matter, self.rows,
            self._place_of, self.inverse,
        )  # fmt: skip
