"""The part of a mesh around a cut, to plan on: what a plan costs then depends on the cut alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.incidence import among, sorted_unique
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh

Rows = NDArray[np.int32]


class Excerpt(Mesh):
    """Some elements of a mesh and those around them, as a mesh of their own; nothing is changed.

    Rows are in the order of the mesh's, so that ties go the same way, and ids are the mesh's: a
    plan made on an excerpt is one on the mesh. Unlike those of a mesh, ids are not rows; an excerpt
    is for reading, and no edit can be applied to it.

    Attributes:
        nodes: Row in the mesh of each node, ascending, shape (node_rows,).
        elements: Row in the mesh of each element, ascending, shape (element_rows,).
        outer: Elements not all of whose neighbours are here, shape (element_rows,). Neither they
            nor any that meet one at a node have a node of the elements asked for.
    """

    def __init__(self, mesh: Mesh, elements: Rows) -> None:
        """Take elements and two rings of those around them.

        Args:
            mesh: The mesh, of tetrahedra.
            elements: Rows of living elements, shape (n,).
        """
        inner = mesh.incident.of_all(sorted_unique(mesh.tets[elements].ravel()))
        rows = mesh.incident.of_all(sorted_unique(mesh.tets[inner].ravel()))
        nodes = sorted_unique(mesh.tets[rows].ravel())
        tets = np.searchsorted(nodes, mesh.tets[rows])
        raw = RawMesh(mesh.rest[nodes], tets, name=mesh.name, source=mesh.source)
        super().__init__(raw, mesh.fixed[nodes], spare=0.0)
        self.nodes, self.elements = nodes, rows
        self.outer = ~among(rows, inner)
        self.node_ids[: len(nodes)] = mesh.node_ids[nodes]
        self.element_ids[: len(rows)] = mesh.element_ids[rows]
        self.version = mesh.version
