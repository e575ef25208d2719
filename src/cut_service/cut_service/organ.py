"""What plans ask of the whole organ, kept from one plan to the next and followed edit by edit."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from cut_service.element_grid import ElementGrid
from cut_service.parts import change_of_parts
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.incidence import sorted_unique
from tissue_sim.geometry.mesh import Mesh

Rows = NDArray[np.int32]


class Organ:
    """Figures of a mesh of tetrahedra at its newest version.

    Attributes:
        version: Version they belong to.
        volume: Of the rest shape [m^3].
        elements: Number of living elements.
        parts: Number of connected parts.
        grid: Where elements lie.
    """

    def __init__(self, mesh: Mesh) -> None:
        """Look at the whole mesh, once."""
        self._mesh = mesh
        self._start()

    def _start(self) -> None:
        mesh, rows = self._mesh, self._mesh.element_rows
        alive = mesh.element_alive[:rows]
        self.version = mesh.version
        self._volumes = np.zeros(mesh.element_capacity)
        self._volumes[:rows] = np.where(alive, volumes_of(mesh, np.arange(rows)), 0.0)
        self.volume = float(self._volumes.sum())
        self.elements = int(alive.sum())
        self.parts = connected_components(mesh.tets[:rows], alive, mesh.node_rows)[0]
        self.grid = ElementGrid(mesh, self.mean_edge)

    @property
    def mean_edge(self) -> float:
        """Edge [m] of a regular tetrahedron as large as the elements are on average."""
        # A regular tetrahedron of edge l has the volume l^3 / (6 sqrt 2).
        return float((self.volume / max(self.elements, 1) * 6.0 * np.sqrt(2.0)) ** (1 / 3))

    def follow(self) -> None:
        """Catch up with the edits that the mesh has applied, in time proportional to them."""
        mesh = self._mesh
        if mesh.version == self.version:
            return
        changes = [change for change in mesh.changes if change.edit.version > self.version]
        if len(changes) != mesh.version - self.version or self.grid.worn:
            self._start()
            return
        elements, old = _first_seen(changes)
        alive = mesh.element_alive[elements]
        new = np.where(alive[:, None], mesh.tets[elements], -1)
        self.parts += change_of_parts(mesh, elements, old, new)
        self.elements += int(alive.sum()) - int((old[:, 0] >= 0).sum())
        self._weigh(np.concatenate([elements, *(change.neighbours for change in changes)]))
        self.grid.follow(elements)
        self.version = mesh.version

    def _weigh(self, elements: Rows) -> None:
        elements = sorted_unique(elements)
        mesh = self._mesh
        spare = mesh.element_capacity - len(self._volumes)
        if spare > 0:
            self._volumes = np.concatenate([self._volumes, np.zeros(spare)])
        now = np.where(mesh.element_alive[elements], volumes_of(mesh, elements), 0.0)
        self.volume += float((now - self._volumes[elements]).sum())
        self._volumes[elements] = now


def volumes_of(mesh: Mesh, elements: NDArray[np.integer]) -> NDArray[np.float64]:
    """Rest volumes of elements [m^3], shape (n,)."""
    a, b, c, d = (mesh.rest[mesh.tets[elements, k]] for k in range(4))
    return np.asarray(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0)


def _first_seen(changes: list[EditChange]) -> tuple[Rows, Rows]:
    """Elements that edits changed, ascending, and their nodes before the first that did."""
    elements = np.concatenate([change.elements for change in changes])
    old = np.concatenate([change.old_elements for change in changes])
    rows, first = np.unique(elements, return_index=True)
    return rows.astype(np.int32), old[first]


_KNOWN: WeakKeyDictionary[Mesh, Organ] = WeakKeyDictionary()


def organ_of(mesh: Mesh) -> Organ:
    """The figures of a mesh as it is now."""
    organ = _KNOWN.get(mesh)
    if organ is None:
        organ = _KNOWN[mesh] = Organ(mesh)
    organ.follow()
    return organ
