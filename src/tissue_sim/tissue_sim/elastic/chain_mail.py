"""Generalised 3D ChainMail: edges give within limits, then pull; what is beyond them is moved."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.chains import PARAMETERS, Chains
from tissue_sim.elastic.mesh_model import ForcelessModel
from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh


class ChainMail(ForcelessModel):
    """Edges free within limits; who is beyond them follows its neighbour, farthest pushed first.

    A step is one propagation from the held nodes that moved and `relaxations` sweeps that pull
    every displaced node towards where its neighbours want it, within the limits; stitches that are
    then longer than at rest are put at their rest length.

    Limitations: no forces; limits are along the axes at rest, so that tissue turned as a whole is
    turned back; see docs/chain_mail.md.

    References:
        S. Gibson, 3D ChainMail: a fast algorithm for deforming volumetric objects, 1997,
        doi 10.1145/253284.253324; M. Schill and others, Biomechanical simulation of the vitreous
        humor in the eye using an enhanced ChainMail algorithm, 1998, doi 10.1007/BFb0056206; Y. Li
        and K. Brodlie, Soft object modelling with generalised ChainMail, 2003,
        doi 10.1111/j.1467-8659.2003.00719.x.
    """

    name: ClassVar[str] = "chain_mail"
    parameters: ClassVar[tuple[Parameter, ...]] = PARAMETERS

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        self._chains = Chains(self.values, self.springs.dtype, mesh.node_capacity)
        self._told = False

    @property
    def visits(self) -> int:
        """Visits of nodes in the last propagation."""
        return self._chains.visits

    @property
    def idle(self) -> bool:
        """Whether nothing moves as long as no held node does."""
        return self._chains.idle

    @property
    def awake(self) -> NDArray[np.uint32]:
        """Rows of the nodes that the next sweep visits, in its order."""
        return self._chains.awake

    def step(self, state: State) -> None:
        """One propagation and the sweeps of relaxation. Modifies the state in place."""
        stitches, u = self.springs.stitches, state.displacement
        before = u[stitches.nodes].copy() if len(stitches) else u[:0]
        self._chains.step(self.springs.arrays, state.prescribed, u)
        if len(stitches):
            stitches.limit(stitches.threads.length, state.prescribed, u)
            moved = np.abs(u[stitches.nodes] - before).max(axis=1) > self.values["rest_tolerance"]
            # Neighbours of what the threads have pulled along may be beyond their limits.
            self._chains.doubt(stitches.nodes[moved])

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Start from the held nodes; nodes let go of may be beyond their limits.

        Told the same again, or for the first time, it doubts every displaced node: another model,
        or something else, has moved them.
        """
        if not self._told or np.array_equal(held, self._chains.held):
            rows = self.mesh.node_rows
            doubtful = np.flatnonzero(state.displacement[:rows].any(axis=1))
        else:
            doubtful = np.setdiff1d(self._chains.held, held)
        self._told = True
        self._chains.hold(held)
        self._chains.doubt(doubtful)

    def nodes_placed(self, nodes: NDArray[np.int32]) -> None:
        """Doubt nodes that were put elsewhere."""
        self._chains.doubt(nodes)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit in time proportional to it."""
        self.springs.follow(change)
        self._chains.reserve(self.mesh.node_capacity)
        self._chains.doubt(change.nodes)
