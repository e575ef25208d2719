"""The spring network of a mesh: its edges and, in a sheet, more; it follows the mesh's edits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.material_field import MaterialField
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.sheet_springs import categories_of, sheet_edges
from tissue_sim.elastic.stitches import Stitches
from tissue_sim.elastic.torsion import TorsionSprings
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.incidence import among, sorted_unique
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels import networks
from tissue_sim.kernels.networks import REMOVED
from tissue_sim.kernels.springs import TINY, SpringArrays

EDGES_OF_TET = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
LIST_SLACK = 2


@dataclass(frozen=True)
class SpringChange:
    """What following an edit did to the springs.

    Attributes:
        version: Version of the mesh that the network followed.
        rows: Rows of the springs touched, shape (n,).
        kinds: `CHANGED`, `MADE`, `REMOVED` or `STIFFER` for each, shape (n,).
    """

    version: int
    rows: NDArray[np.int32]
    kinds: NDArray[np.int8]


class SpringNetwork:
    """One spring per edge of a mesh; its elements share out stiffness and mass.

    Every element t gives each of its edges the stiffness E_t V_t / l0^2 and each of its nodes the
    mass density_t V_t / 4; fibres do not count. A split that moves nothing hands these shares out
    anew, so that total stiffness and mass stay. Springs are kept by row (tombstones where one was
    removed) and by node, with spare room, in the layout that sweeps read.
    In a sheet the triangles do the same with their area times thickness, and elements that are
    springs give themselves the volume of their tissue (`geometry.sheet_rows`).

    Attributes:
        mesh: The mesh that is followed.
        material: Where stiffness and mass come from.
        field: The material of each element.
        dtype: Precision of the kernels' arrays.
        rows: Rows of springs in use.
        springs: Ends, stiffness, rest length and existence by row, float64; capacity may exceed
            `rows`.
        tiny: `TINY` in the kernels' precision.
        categories: Category of each spring of a sheet (`geometry.sheet.CATEGORIES`), by row; empty
            for tetrahedra, whose springs are all alike.
        torsion: Torsion springs of a sheet; None: it has none.
        stitches: The mesh's sutures, which are no springs of the lists: models carry them besides.
        links: Entries of each node's list: its springs and, behind them, its stitches (which have
            no stiffness there). Who asks for neighbours, or wants a place for each, takes this in
            place of `arrays.degree`.
        stitch_places: Place in the lists of both ends of each stitch, shape (n, 2).
        version: Version of the mesh that the network is in step with.

    References:
        A. Van Gelder, Approximate simulation of elastic membranes by triangulated spring meshes,
        Journal of Graphics Tools 3(2), 1998, doi 10.1080/10867651.1998.10487490. See
        docs/springs.md for its limits.
    """

    def __init__(
        self, mesh: Mesh, material: Material, dtype: type[np.floating] = np.float32
    ) -> None:
        self.mesh, self.material, self.dtype = mesh, material, dtype
        self.version = mesh.version
        self.field = MaterialField(mesh, material)
        self.tiny = dtype(TINY[dtype])
        # Whole eighths of a metre: an edit does not change where a network built afresh has it.
        self._origin = np.round(mesh.rest[: mesh.node_rows].mean(axis=0) * 8) / 8
        self._rest = np.zeros((mesh.node_capacity, 3), dtype=dtype)
        self._rest[: mesh.node_rows] = mesh.rest[: mesh.node_rows] - self._origin
        self._volumes = np.zeros(mesh.element_capacity)
        # Volumes, scaled where an element is not made of the tissue's own material.
        self._stiff = self._heavy = self._volumes
        self._separate()
        self._measure(np.flatnonzero(mesh.element_alive[: mesh.element_rows]).astype(np.int32))
        self._scratch = _scratch(mesh.node_capacity)
        self._buried: dict[int, NDArray[np.int32]] = {}
        self._masses = np.zeros(mesh.node_capacity)
        self._to_weigh = [np.arange(mesh.node_rows, dtype=np.int32)]
        self.categories = np.empty(0, dtype=np.uint8)
        self.springs, self.rows = self._build_rows()
        self._lists, self._used = self._build_lists()
        networks.fill_lists(self.springs, self.rows, self._lists)
        self.stitches = Stitches(mesh)
        self._list_stitches()
        self._expose()
        self.torsion = TorsionSprings.of(mesh, material, dtype, self.field)
        if self.torsion is not None:
            self.torsion.measure(self._rest)
        self.last_change = SpringChange(self.version, _no_rows(), np.empty(0, dtype=np.int8))

    @property
    def arrays(self) -> SpringArrays:
        """Springs by node for the kernels; edits may replace the arrays, so do not keep them."""
        return self._arrays

    @property
    def masses(self) -> NDArray[np.float64]:
        """Mass of each node [kg], shape (node_capacity,); weighed when somebody asks."""
        for nodes in self._to_weigh:
            networks.node_volumes(nodes, self.elements._replace(volumes=self._heavy), self._masses)
            self._masses[nodes] *= self.material.density
        self._to_weigh.clear()
        return self._masses

    @property
    def spring_of(self) -> NDArray[np.int32]:
        """Row of the spring at each place of the lists by node."""
        return self._lists.spring

    def set_stiffness(self, stiffness: NDArray[np.float64]) -> None:
        """Give springs a stiffness that does not follow from the material.

        Modifies the network in place. Springs that an edit touches get the material's again.

        Args:
            stiffness: Of each row [N/m], shape (rows,).
        """
        self.springs.stiffness[: self.rows] = stiffness
        lists = self._lists
        degree = lists.degree.astype(np.int64)
        first = np.cumsum(degree) - degree
        places = np.arange(degree.sum()) + np.repeat(lists.start - first, degree)
        lists.stiffness[places] = stiffness[lists.spring[places]]

    def node_stiffness(self, nodes: NDArray[np.int32]) -> NDArray[np.float64]:
        """Sum of the stiffnesses of the springs at nodes [N/m], shape (len(nodes),)."""
        sums = np.zeros(self.mesh.node_capacity)
        networks.stiffness_at(nodes, self._lists, sums)
        return sums[nodes]

    def follow(self, change: EditChange) -> SpringChange:
        """Follow an edit that the mesh has applied, in time proportional to it.

        Modifies the network in place.
        Several models may share a network: only the first call for a version does anything.

        Raises:
            ValueError: An edit before this one has not been followed.
        """
        version = change.edit.version
        if version == self.version:
            return self.last_change
        if version != self.version + 1:
            raise ValueError(
                f"the spring network is at version {self.version} and cannot follow the edit "
                f"that made version {version}; allowed: {self.version + 1}"
            )
        self._grow_nodes()
        self.field.follow(change)
        self._separate()
        networks.place_rest(change.nodes, self.mesh.rest, self._origin, self._rest)
        self._measure(change.elements)
        self._measure(change.neighbours)
        self._to_weigh.append(change.nodes)
        kinds, rows = self._repair(change)
        if self.mesh.sheet_rows is not None:
            made = self.springs.ends[len(self.categories) : self.rows]
            self.categories = np.concatenate([self.categories, categories_of(self.mesh, made)])
        if self.torsion is not None:
            self.torsion.follow(change, self._rest)
        if self.stitches.follow() or not self._keeps_stitches(change.nodes):
            self._list_stitches()
        self.version = version
        self.last_change = SpringChange(version, rows, kinds)
        return self.last_change

    def _repair(self, change: EditChange) -> tuple[NDArray[np.int8], NDArray[np.int32]]:
        """Repair the springs between the nodes of an edit; what happened to which rows."""
        nodes = change.nodes
        most = int(self._lists.degree[nodes].sum(dtype=np.int64)) + 6 * len(change.elements)
        kinds, rows = np.empty(most, dtype=np.int8), np.empty(most, dtype=np.int32)
        self._scratch.among[nodes] = True
        self._scratch.moved[change.moved_nodes] = True
        buried = self._buried.pop(change.edit.reverts, _no_rows())
        done = count = 0
        while done < len(nodes):
            done, self.rows, self._used, count = networks.repair(
                nodes, done, self.springs, self.rows, self._lists, self._used, self._stiff_elements,
                self._rest, self.material.young_modulus, self._scratch, buried, kinds, rows, count,
            )  # fmt: skip
            if done < len(nodes):
                self._make_room()
        self._scratch.among[nodes] = False
        self._scratch.moved[change.moved_nodes] = False
        kinds, rows = kinds[:count], rows[:count]
        gone = rows[kinds == REMOVED]
        if len(gone):
            ends = self.springs.ends[gone]
            # An undo of this edit gives them their rows back.
            self._buried[change.edit.version] = gone[np.lexsort((ends[:, 1], ends[:, 0]))]
        return kinds, rows

    def _keeps_stitches(self, nodes: NDArray[np.int32]) -> bool:
        """Whether stitches are where they were: no sewn node is among those that were repaired."""
        if not len(self.stitches) or len(self.links) != len(self._lists.degree):
            return False
        self.links[nodes] = self._lists.degree[nodes]
        return not among(self.stitches.nodes, nodes).any()

    def _list_stitches(self) -> None:
        """Enter the stitches at both of their ends, behind the springs."""
        self.links = self._lists.degree
        ends = self.stitches.threads.ends
        self.stitch_places = np.empty((len(ends), 2), dtype=np.int64)
        if not len(ends):
            return
        self.links = self.links.copy()
        nodes, counts = np.unique(ends, return_counts=True)
        for node, count in zip(nodes.tolist(), counts.tolist(), strict=True):
            self._reserve_at(node, count)
        lists = self._lists
        for thread, (first, second) in enumerate(ends.tolist()):
            for end, (node, other) in enumerate(((first, second), (second, first))):
                place = int(lists.start[node]) + int(self.links[node])
                lists.neighbour[place], lists.spring[place] = other, -1
                lists.stiffness[place], lists.length[place] = 0.0, 1.0
                self.stitch_places[thread, end] = place
                self.links[node] += 1

    def _reserve_at(self, node: int, more: int) -> None:
        """Make room for more entries at a node; a list that is full moves to the end."""
        used = int(self._lists.degree[node])
        if used + more <= int(self._lists.room[node]):
            return
        room = max(8, 2 * (used + more))
        while self._used + room > len(self._lists.neighbour):
            self._make_room()
        lists, begin = self._lists, int(self._lists.start[node])
        for array in (lists.neighbour, lists.spring, lists.stiffness, lists.length):
            array[self._used : self._used + used] = array[begin : begin + used]
        lists.start[node], lists.room[node] = self._used, room
        self._used += room

    @property
    def elements(self) -> networks.Elements:
        """The mesh for the kernels; edits may replace the arrays."""
        mesh, incident = self.mesh, self.mesh.incident
        return networks.Elements(
            mesh.tets, self._volumes, incident.start, incident.count, incident.data
        )

    @property
    def _stiff_elements(self) -> networks.Elements:
        return self.elements._replace(volumes=self._stiff)

    def _separate(self) -> None:
        """Keep scaled volumes from where on there is more than one material; none are merged."""
        if self._stiff is self._volumes and not self.field.one_modulus:
            self._stiff = self._volumes.copy()
        many = not self.field.one_density or self.mesh.sheet_rows is not None
        if self._heavy is self._volumes and many:
            self._heavy = self._volumes.copy()

    def _measure(self, elements: NDArray[np.int32]) -> None:
        short = self.mesh.element_capacity - len(self._volumes)
        if short > 0:
            longer = np.concatenate([self._volumes, np.zeros(short)])
            one, light = self._stiff is self._volumes, self._heavy is self._volumes
            self._stiff = longer if one else _padded(self._stiff, len(longer))
            self._heavy = longer if light else _padded(self._heavy, len(longer))
            self._volumes = longer
        sheet, field = self.mesh.sheet_rows, self.field
        if sheet is None:
            networks.measure_volumes(elements, self.mesh.rest, self.mesh.tets, self._volumes)
            heavy = self._volumes[elements]
        else:
            stiff, heavy = sheet.volumes(elements, self.mesh.rest, self.mesh.tets)
            self._volumes[elements] = stiff
        # Where there is one material only, a scale of 1 changes nothing.
        if self._stiff is not self._volumes:
            self._stiff[elements] = self._volumes[elements] * field.stiffness_of(elements)
        if self._heavy is not self._volumes:
            self._heavy[elements] = heavy * field.density_of(elements)

    def _build_rows(self) -> tuple[networks.Springs, int]:
        mesh = self.mesh
        alive = mesh.element_alive[: mesh.element_rows]
        if mesh.sheet is not None:
            edges = sheet_edges(mesh.sheet)
            self.categories = categories_of(mesh, edges)
        else:
            edges = _edges_of(mesh.tets[: mesh.element_rows][alive])
        rows = len(edges)
        capacity = int(rows * 1.25) + 1024
        springs = networks.Springs(
            _padded(edges, capacity), np.full(capacity, 0.0), np.full(capacity, 0.0),
            np.arange(capacity) < rows,
        )  # fmt: skip
        networks.measure_springs(
            springs, rows, self._stiff_elements, self._rest, self.material.young_modulus
        )  # fmt: skip
        return springs, rows

    def _build_lists(self) -> tuple[networks.Lists, int]:
        nodes = self.mesh.node_capacity
        degree = np.bincount(self.springs.ends[: self.rows].ravel(), minlength=nodes)
        room = np.where(degree > 0, degree + LIST_SLACK, 0)
        ends = np.cumsum(room)
        used = int(ends[-1])
        places = used + used // 4 + 65536
        # Full, not zeros: the system must not look for memory in the frame of the first edit.
        lists = networks.Lists(
            (ends - room).astype(np.uint32), np.zeros(nodes, dtype=np.uint32),
            room.astype(np.uint32), np.full(places, 0, dtype=np.uint32),
            np.full(places, -1, dtype=np.int32), np.full(places, 0, dtype=self.dtype),
            np.full(places, 0, dtype=self.dtype),
        )  # fmt: skip
        return lists, used

    def _expose(self) -> None:
        lists = self._lists
        self._arrays = SpringArrays(
            self._rest, lists.start, lists.degree, lists.neighbour, lists.stiffness, lists.length
        )

    def _grow_nodes(self) -> None:
        capacity = self.mesh.node_capacity
        if capacity == len(self._rest):
            return
        self._rest = _padded(self._rest, capacity)
        self._scratch = _scratch(capacity)
        self._masses = _padded(self._masses, capacity)
        lists = self._lists
        self._lists = lists._replace(
            start=_padded(lists.start, capacity),
            degree=_padded(lists.degree, capacity),
            room=_padded(lists.room, capacity),
        )
        self._expose()

    def _make_room(self) -> None:
        """Make room for more springs."""
        capacity = len(self.springs.ends) * 5 // 4 + 1024
        self.springs = networks.Springs(*(_padded(array, capacity) for array in self.springs))
        lists = self._lists
        places = len(lists.neighbour) * 5 // 4 + 65536
        self._lists = lists._replace(
            neighbour=_padded(lists.neighbour, places),
            spring=_padded(lists.spring, places),
            stiffness=_padded(lists.stiffness, places),
            length=_padded(lists.length, places),
        )
        self._expose()


def _scratch(nodes: int) -> networks.Scratch:
    among, moved = np.zeros((2, nodes), dtype=np.bool_)
    return networks.Scratch(among, moved, np.zeros(nodes))


def _no_rows() -> NDArray[np.int32]:
    return np.empty(0, dtype=np.int32)


def _padded(array: NDArray, rows: int) -> NDArray:
    extra = np.zeros((rows - len(array), *array.shape[1:]), dtype=array.dtype)
    return np.concatenate([array, extra])


def _edges_of(tets: NDArray[np.int32]) -> NDArray[np.int32]:
    """Distinct edges of elements, lower row first, sorted, shape (n, 2)."""
    first, second = tets[:, EDGES_OF_TET[:, 0]].ravel(), tets[:, EDGES_OF_TET[:, 1]].ravel()
    keys = np.minimum(first, second).astype(np.int64) << 32
    keys = sorted_unique(keys | np.maximum(first, second))
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1).astype(np.int32)
