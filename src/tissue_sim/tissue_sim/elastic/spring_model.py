"""What the models whose forces are those of springs share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import State
from tissue_sim.kernels.springs import node_forces
from tissue_sim.kernels.torsion import add_torsion_at


class SpringModel(MeshModel):
    """A model whose internal forces are those of its springs."""

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Internal elastic forces on nodes [N], shape (len(rows), 3)."""
        out = np.zeros((len(rows), 3))
        if self.has_forces:
            springs = self.springs
            node_forces(
                np.asarray(rows, dtype=np.int32),
                springs.arrays,
                state.displacement,
                springs.tiny,
                out,
            )
            if springs.torsion is not None:
                add_torsion_at(
                    np.asarray(rows, dtype=np.int32), springs.arrays, springs.torsion.arrays,
                    state.displacement, springs.tiny, out,
                )  # fmt: skip
            out += springs.stitches.forces(state.displacement, rows)
        return out
