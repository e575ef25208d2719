"""Quantities of tissue at its nodes: stress, strain, displacement.

An element has one stress, since its strain is the same all over it. A node gets the mean of the
elements at it, weighted by their volumes at rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.stress import ElementMaterial
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.readings import (
    LARGEST,
    MISES,
    SMALLEST,
    STRAIN,
    add_up_edges,
    add_up_tetrahedra,
)

Reals = NDArray[np.float64]

DISPLACEMENT, VON_MISES = "displacement", "von_mises_stress"
LARGEST_STRESS, SMALLEST_STRESS = "largest_principal_stress", "smallest_principal_stress"
LARGEST_STRAIN, SPRING_STRAIN, RISK = "strain", "spring_strain", "risk"
UNITS = {
    DISPLACEMENT: "m", VON_MISES: "Pa", LARGEST_STRESS: "Pa", SMALLEST_STRESS: "Pa",
    LARGEST_STRAIN: "", SPRING_STRAIN: "", RISK: "",
}  # fmt: skip
"""Unit of each quantity; empty: a plain number."""


def in_words(quantity: str) -> str:
    """The name of a quantity as people write it, such as "von Mises stress"."""
    return quantity.replace("_", " ").replace("von mises", "von Mises")


def displacement(mesh: Mesh, places: NDArray[np.floating]) -> Reals:
    """Distance of each node from where it is at rest [m], shape (node_rows,).

    Args:
        mesh: The tissue.
        places: Where its nodes are [m], shape (node_rows, 3).
    """
    rows = mesh.node_rows
    moved = np.linalg.norm(places - mesh.rest[:rows], axis=1)
    return np.where(mesh.node_alive[:rows], moved, np.nan)


def stresses(
    mesh: Mesh, places: NDArray[np.floating], material: ElementMaterial | None
) -> dict[str, Reals]:
    """Stress and strain of tetrahedra, at their nodes; nan at nodes without any.

    Args:
        mesh: The tissue, made of tetrahedra.
        places: Where its nodes are [m], shape (node_rows, 3).
        material: What its elements are made of; None: not known, and only the strain is told.

    Returns:
        By name, shape (node_rows,): von Mises, largest and smallest principal stress [Pa], largest
        principal strain.
    """
    rows, elements = mesh.node_rows, mesh.element_rows
    sums, weights = np.zeros((rows, 4)), np.zeros(rows)
    of = material or ElementMaterial(np.zeros(elements, dtype=np.uint8), np.zeros((1, 2)))
    add_up_tetrahedra(
        mesh.rest, places, mesh.tets[:elements], mesh.element_alive[:elements], of.kinds, of.lame,
        sums, weights,
    )  # fmt: skip
    means = _means(sums, weights[:, None])
    told = {LARGEST_STRAIN: means[:, STRAIN]}
    if material is not None:
        told |= {
            VON_MISES: means[:, MISES],
            LARGEST_STRESS: means[:, LARGEST],
            SMALLEST_STRESS: means[:, SMALLEST],
        }
    return told


def spring_strain(mesh: Mesh, places: NDArray[np.floating]) -> Reals:
    """How much the springs at each node are stretched or squeezed, shape (node_rows,).

    The mean of |l / l0 - 1| over the springs at a node, weighted by the volume of the tissue whose
    stiffness they have; the springs of a tetrahedron or triangle are its edges. nan where there
    are none.

    Args:
        mesh: The tissue.
        places: Where its nodes are [m], shape (node_rows, 3).
    """
    elements, rest = mesh.element_rows, mesh.rest
    items, alive = mesh.tets[:elements], mesh.element_alive[:elements]
    if mesh.sheet_rows is None:
        edges = rest[items[:, 1:]] - rest[items[:, :1]]
        volumes = np.einsum("ij,ij->i", edges[:, 0], np.cross(edges[:, 1], edges[:, 2]))
    else:
        volumes = mesh.sheet_rows.volumes(np.arange(elements, dtype=np.int32), rest, items)[0]
        # The walls of a cut are only shown.
        alive = alive & (volumes > 0.0)
    sums, weights = np.zeros(mesh.node_rows), np.zeros(mesh.node_rows)
    add_up_edges(rest, places, items, alive, volumes, sums, weights)
    return _means(sums, weights)


def _means(sums: Reals, weights: Reals) -> Reals:
    with np.errstate(invalid="ignore"):
        means: Reals = np.where(weights > 0.0, sums / weights, np.nan)
    return means
