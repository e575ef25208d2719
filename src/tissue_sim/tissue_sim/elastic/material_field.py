"""What each element of a mesh is made of, following the mesh's edits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material, RegionMaterial
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patches import MOST_PATCHES, Patches
from tissue_sim.geometry.regions import RegionError, label_of
from tissue_sim.kernels.matter import Matter

MOST_REGIONS = 255 - MOST_PATCHES
"""Regions with a material of their own, patches not counted."""


class MaterialError(ValueError):
    """A material that makes no sense, or that the mesh cannot have."""


def lame_constants(material: Material | RegionMaterial) -> tuple[float, float]:
    """Lame's constants lambda and mu [Pa]."""
    E, nu = material.young_modulus, material.poisson_ratio
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


class MaterialField:
    """The material of each element: that of its region, or the tissue's own.

    An element made by an edit is of the region, and has the fibres, of the one it descends from.
    Those of a patch are of what the patch is made of, with the tissue's own ratio and no fibres.

    Attributes:
        one_modulus: Whether Young's modulus is the same everywhere.
        one_ratio: Whether Poisson's ratio is the same everywhere.
        one_density: Whether the density is the same everywhere.
        fibrous: Whether any element has fibres of some stiffness.
    """

    def __init__(self, mesh: Mesh, material: Material) -> None:
        """Find each element's material.

        Raises:
            MaterialError: The mesh lacks a region, or has no fibres where they are stiff.
        """
        self._mesh, self._material = mesh, material
        if len(material.regions) > MOST_REGIONS:
            raise MaterialError(
                f"{len(material.regions)} regions have a material of their own; "
                f"allowed: up to {MOST_REGIONS}"
            )
        try:
            labels = mesh.regions[: mesh.element_rows]
            parts = material.parts[1:]
            self._wanted = [label_of(part.region, labels, mesh.region_names) for part in parts]
        except RegionError as error:
            raise MaterialError(str(error)) from None
        self._tabulate()
        self._kind = np.zeros(mesh.element_capacity, dtype=np.uint8)
        self._find(slice(0, mesh.element_rows))
        self.fibrous = self._find_fibres()

    def _tabulate(self) -> None:
        """List what there is: the tissue everywhere else, regions, patches."""
        material, self._patches = self._material, self._mesh.patches
        parts = (*material.parts, *_made_of(self._patches, material))
        labels = [*self._wanted, *self._patches.labels.tolist()]
        self._kind_of = {label: kind for kind, label in enumerate(labels, start=1)}
        self._table = np.array([[*lame_constants(p), p.fibre_stiffness] for p in parts])
        self._stiffness = np.array([p.young_modulus / material.young_modulus for p in parts])
        self._density = np.array([p.density / material.density for p in parts])
        ratios = [part.poisson_ratio for part in parts]
        self.one_ratio = all(ratio == ratios[0] for ratio in ratios)
        self.one_modulus = bool((self._stiffness == 1.0).all())
        self.one_density = bool((self._density == 1.0).all())

    def _find_fibres(self) -> bool:
        """Whether there are fibres of some stiffness."""
        stiff = self._table[:, 2] > 0.0
        if not stiff.any():
            return False
        rows = slice(0, self._mesh.element_rows)
        there = self._mesh.fibres[rows].any(axis=1)
        if not (there & stiff[self._kind[rows]]).any():
            raise MaterialError(
                f"fibre_stiffness is {self._table[:, 2].max():g} Pa, but no element of "
                f"{self._mesh.name} that it is for has a direction of fibres; give `fibres`, or "
                "fibre_stiffness = 0"
            )
        return True

    def _find(self, rows: slice | NDArray[np.int32]) -> None:
        labels = self._mesh.regions[rows]
        kinds = np.zeros(len(labels), dtype=np.uint8)
        for label, kind in self._kind_of.items():
            kinds[labels == label] = kind
        self._kind[rows] = kinds

    @property
    def matter(self) -> Matter:
        """What kernels read; edits may replace the arrays."""
        return Matter(self._kind, self._table, self._mesh.fibres)

    def stiffness_of(self, elements: NDArray[np.int32]) -> NDArray[np.float64]:
        """Young's modulus of elements over the tissue's own, shape (len(elements),)."""
        return self._stiffness[self._kind[elements]]

    def density_of(self, elements: NDArray[np.int32]) -> NDArray[np.float64]:
        """Density of elements over the tissue's own, shape (len(elements),)."""
        return self._density[self._kind[elements]]

    def follow(self, change: EditChange) -> None:
        """Follow an edit that the mesh has applied, in time proportional to it."""
        short = self._mesh.element_capacity - len(self._kind)
        if short > 0:
            self._kind = np.concatenate([self._kind, np.zeros(short, dtype=np.uint8)])
        if self._mesh.patches is not self._patches:
            # An undo takes out the newest: the kinds of all others stay.
            self._tabulate()
        self._find(change.elements)


def _made_of(patches: Patches, tissue: Material) -> list[RegionMaterial]:
    return [
        RegionMaterial(patch.name, patch.young_modulus, tissue.poisson_ratio, patch.density)
        for patch in patches
    ]
