"""3D ChainMail on voxels that cover the tissue and carry its nodes."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.chains import PARAMETERS, Chains
from tissue_sim.elastic.mesh_model import ForcelessModel
from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.voxel_lattice import VoxelLattice
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.incidence import sorted_unique
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.voxel_nodes import fill, follow, place

NEAR = 0.1
"""A prescribed node prescribes the voxels that carry at least this share of it."""


class VoxelMail(ForcelessModel):
    """A grid of voxels over the tissue gives within limits, then pulls; nodes lie between voxels.

    A step puts the voxels near held nodes at their mean, propagates from those that moved, relaxes
    every displaced voxel towards the mean of its neighbours, and puts the nodes that are not
    prescribed at the trilinear mean of their voxels. Prescribed nodes themselves are never moved.
    Stitches that are then longer than at rest are put at their rest length, with the voxels that
    carry their ends.

    Limitations: no forces; nothing finer than the spacing is resolved; links are along the axes at
    rest, so that tissue turned as a whole is turned back. See docs/chain_mail.md.

    References:
        S. Gibson, 3D ChainMail: a fast algorithm for deforming volumetric objects, 1997,
        doi 10.1145/253284.253324; N. Molino, Z. Bao, R. Fedkiw, A virtual node algorithm for
        changing mesh topology during simulation, 2004, doi 10.1145/1015706.1015734.
    """

    name: ClassVar[str] = "voxel_chain_mail"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "spacing", 0.0, 0.0, 0.1, "m", "distance of voxels; 0: the mean length of the edges"
        ),
        *PARAMETERS,
    )
    needs_tetrahedra = True

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        table = self.springs.springs
        lengths = table.length[: self.springs.rows][table.alive[: self.springs.rows]]
        edge = float(lengths.mean()) if len(lengths) else 1.0
        self._cover(self.values["spacing"], edge)
        self._told, self._left_behind = False, True
        self._placed = [np.empty(0, dtype=np.int32)]
        self._listed = self._list(np.empty(0, dtype=np.int32), 0.0)
        self._held = np.empty(0, dtype=np.int32)

    def _cover(self, spacing: float, edge: float) -> None:
        """Lay voxels over the mesh, none of them displaced; see `VoxelLattice`."""
        dtype = self.springs.dtype
        self.lattice = VoxelLattice(self.mesh, spacing, edge, dtype)
        self._chains = Chains(self.values, dtype, self.lattice.capacity)
        self.displacement = np.zeros((self.lattice.capacity, 3), dtype)
        self._prescribed = np.zeros(self.lattice.capacity, dtype=np.bool_)

    @property
    def visits(self) -> int:
        """Visits of voxels in the last propagation."""
        return self._chains.visits

    @property
    def awake(self) -> NDArray[np.uint32]:
        """Rows of the voxels that the next sweep visits."""
        return self._chains.awake

    @property
    def idle(self) -> bool:
        """Whether nothing moves as long as no held node does."""
        return self._chains.idle and not self._left_behind

    def step(self, state: State) -> None:
        """One propagation, the sweeps of relaxation, and nodes after them. Modifies the state."""
        u, v, lattice = state.displacement, self.displacement, self.lattice
        rested = self.idle
        place(*self._listed, u, v)
        self._chains.step(lattice.arrays, self._prescribed, v)
        if rested and not self._chains.visits:
            return
        follow(self.mesh.node_rows, lattice.corner, lattice.weight, state.prescribed, v, u)
        self._left_behind = bool(len(self.springs.stitches)) and self._pull_threads(state)

    def _pull_threads(self, state: State) -> bool:
        """Put stitches longer than at rest at their rest length, and their voxels along with them.

        Modifies the state. Whether anything moved.
        """
        stitches, u, v = self.springs.stitches, state.displacement, self.displacement
        nodes, lattice = stitches.nodes, self.lattice
        before = u[nodes].copy()
        stitches.limit(stitches.threads.length, state.prescribed, u)
        moves = u[nodes] - before
        if np.abs(moves).max() <= self.values["rest_tolerance"]:
            return False
        corner = lattice.corner[nodes]
        share = lattice.weight[nodes] * ~self._prescribed[corner]
        # The least motion of voxels that moves the node by so much; of several nodes, the mean.
        reach = (share * share).sum(axis=1)
        each = moves / np.where(reach > 0.0, reach, np.inf)[:, None]
        total, weight = np.zeros_like(v), np.zeros(len(v))
        np.add.at(total, corner, (share * share)[:, :, None] * each[:, None, :])
        np.add.at(weight, corner, share)
        voxels = np.flatnonzero(weight > 0.0).astype(np.int32)
        v[voxels] += (total[voxels] / weight[voxels, None]).astype(v.dtype)
        self._chains.doubt(voxels)
        return True

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Prescribe the voxels near held and fixed nodes; those let go of may be beyond limits.

        Told the same again, or for the first time, it takes every voxel from the nodes: another
        model, or something else, has moved them.
        """
        if not self._told or np.array_equal(held, self._held):
            self._fit(state, np.arange(self.lattice.rows, dtype=np.int32))
        elif any(len(nodes) for nodes in self._placed):
            moved = self.lattice.corner[np.concatenate(self._placed)]
            self._fit(state, sorted_unique(moved.ravel()))
        self._placed.clear()
        self._told, self._held = True, held.astype(np.int32)
        self._prescribe(state)

    def nodes_placed(self, nodes: NDArray[np.int32]) -> None:
        """Take the voxels of these nodes from them when `prescribed_changed` follows."""
        self._placed.append(nodes.astype(np.int32))

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit: parts that came apart around a voxel have voxels of their own.

        A patch beyond the voxels has all of them laid out anew.
        """
        self.springs.follow(change)
        if self.lattice.covers(change.born_nodes):
            touched = self._renew(change, state)
        else:
            self._cover(0.0, self.lattice.spacing)
            touched = np.empty(0, dtype=np.int32)
            self._fit(state, np.arange(self.lattice.rows, dtype=np.int32))
            self.events.append(
                f"voxel_chain_mail: voxels {1e3 * self.lattice.spacing:.3g} mm apart are laid out "
                "anew, since the patch is beyond those there were"
            )
        news = np.concatenate([change.copied_nodes, change.merged_into])
        news = news[state.prescribed[news] & ~self.mesh.fixed[news]]
        held = sorted_unique(np.concatenate([self._held, news]))
        self._held = held[self.mesh.node_alive[held]]
        self._prescribe(state)
        self._chains.doubt(touched)

    def _renew(self, change: EditChange, state: State) -> NDArray[np.int32]:
        """Follow an edit within the voxels; rows of those it touched."""
        renewal = self.lattice.follow(change)
        capacity = self.lattice.capacity
        self._chains.reserve(capacity)
        if capacity > len(self.displacement):
            more = capacity - len(self.displacement)
            self.displacement = np.pad(self.displacement, ((0, more), (0, 0)))
            self._prescribed = np.pad(self._prescribed, (0, more))
        new = np.arange(renewal.used, self.lattice.rows, dtype=np.int32)
        self.displacement[new] = self.displacement[renewal.before]
        self._fit(state, new[renewal.before < 0])
        return renewal.touched

    def _prescribe(self, state: State) -> None:
        """Find the voxels near prescribed nodes, and start from those near held ones."""
        mesh = self.mesh
        rows, before = mesh.node_rows, np.flatnonzero(self._prescribed)
        nodes = np.flatnonzero(state.prescribed[:rows] & mesh.node_alive[:rows]).astype(np.int32)
        voxels, start, members, weight = self._list(nodes, NEAR)
        place(voxels, start, members, weight, state.displacement, self.displacement)
        self._prescribed[:] = False
        self._prescribed[voxels] = True
        # Voxels near fixed nodes only stay where they are.
        pulled = np.zeros(len(voxels), dtype=np.bool_)
        pulled[np.repeat(np.arange(len(voxels)), np.diff(start))[~mesh.fixed[members]]] = True
        keep = np.repeat(pulled, np.diff(start))
        ends = np.cumsum(np.diff(start)[pulled], dtype=np.int32)
        self._listed = (
            voxels[pulled], np.concatenate([start[:1], ends]), members[keep], weight[keep],
        )  # fmt: skip
        self._chains.hold(voxels[pulled])
        self._chains.doubt(before[~self._prescribed[before]])
        self._left_behind = True

    def _list(
        self, nodes: NDArray[np.int32], least: float
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.floating]]:
        """Voxels that carry a share of nodes above `least`, and the nodes and shares of each."""
        corner, weight = self.lattice.corner[nodes], self.lattice.weight[nodes]
        members = np.repeat(nodes, corner.shape[1])
        chosen = np.flatnonzero(weight.ravel() > least)
        order = chosen[np.argsort(corner.ravel()[chosen], kind="stable")]
        voxels, first = np.unique(corner.ravel()[order], return_index=True)
        start = np.concatenate([first, [len(order)]]).astype(np.int32)
        return voxels.astype(np.int32), start, members[order], weight.ravel()[order]

    def _fit(self, state: State, voxels: NDArray[np.int32]) -> None:
        """Take voxels from the nodes they carry, or else from linked ones, and doubt them."""
        if not len(voxels):
            return
        mesh, lattice, v = self.mesh, self.lattice, self.displacement
        chosen = np.zeros(lattice.capacity, dtype=np.bool_)
        chosen[voxels] = True
        rows = mesh.node_rows
        alive = mesh.node_alive[:rows] & (lattice.weight[:rows, 0] > 0)
        touched = alive & chosen[lattice.corner[:rows]].any(axis=1)
        found, start, members, weight = self._list(np.flatnonzero(touched).astype(np.int32), 0.0)
        values = np.empty((len(found), 3), v.dtype)
        own = np.arange(len(found), dtype=np.int32)
        place(own, start, members, weight, state.displacement, values)
        keep = chosen[found]
        v[found[keep]] = values[keep]
        known = ~chosen
        known[found[keep]] = True
        missing = voxels[~known[voxels] & (lattice.degree[voxels] > 0)]
        v[missing] = 0
        fill(missing, known, lattice.degree, lattice.neighbour, v)
        self._chains.doubt(voxels[v[voxels].any(axis=1)])
