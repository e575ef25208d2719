"""The tissue that models are compared on."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material
from tissue_sim.geometry.mesh import Mesh


@dataclass(frozen=True)
class Organ:
    """A mesh and what it is made of; nothing in a comparison changes either.

    Attributes:
        name: Name of the shape or of the file.
        mesh: The mesh, as `geometry.scene_geometry.load` makes it.
        material: What it is made of, where a subject does not say otherwise.
        hold: Rows that a tool takes if nobody says which, sorted, none of them fixed; may be empty.
    """

    name: str
    mesh: Mesh
    material: Material = field(default_factory=Material)
    hold: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))

    @property
    def rest(self) -> NDArray[np.float64]:
        """Rest positions of all rows [m], shape (node_rows, 3)."""
        return self.mesh.rest[: self.mesh.node_rows]

    @cached_property
    def size(self) -> float:
        """Longest side of its bounding box [m]."""
        return float(np.ptp(self.rest, axis=0).max())

    @cached_property
    def digest(self) -> str:
        """What tells it from any other organ: rest positions, elements and fixed nodes."""
        mesh = self.mesh
        told = hashlib.sha256()
        for array in (self.rest, mesh.tets[: mesh.element_rows], mesh.fixed[: mesh.node_rows]):
            told.update(np.ascontiguousarray(array).tobytes())
        return told.hexdigest()[:16]
