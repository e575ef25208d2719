"""Stress in tetrahedra, from where their nodes are: which elements are pulled too hard, and how.

The strain is corotated: with the deformation gradient F = R S of an element, R a rotation, it is
S - 1, so that an organ that is only moved and turned has none. The stress in the axes of the
deformed tissue is sigma = 2 mu (V - 1) + lambda tr(V - 1) 1 with V = R S R^T, the root of F F^T.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissue_sim.elastic.material_field import MaterialField
from tissue_sim.elastic.model import Material
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.strain import STRAIN_FAST, left_cauchy_green, principal_stretches

Rows = NDArray[np.int32]
Reals = NDArray[np.float64]

_TWO_THIRDS_ROOT = float(np.sqrt(2.0 / 3.0))
_SLACK = 1e-9


@dataclass(frozen=True)
class ElementMaterial:
    """What elements are made of, as far as their stress goes.

    Attributes:
        kinds: Kind of each element: a row of `lame`, shape (element_rows,).
        lame: Lame's constants lambda and mu [Pa] of each kind, shape (kinds, 2).
    """

    kinds: NDArray[np.uint8]
    lame: Reals

    def of(self, elements: Rows) -> Reals:
        """Lame's constants of elements [Pa], shape (len(elements), 2)."""
        constants: Reals = self.lame[self.kinds[elements]]
        return constants


def element_material(field: MaterialField) -> ElementMaterial:
    """What stress needs of a mesh's material."""
    matter = field.matter
    return ElementMaterial(matter.kind, np.ascontiguousarray(matter.table[:, :2]))


def material_without_fibres(mesh: Mesh, material: Material) -> ElementMaterial:
    """What stress needs of a mesh's material where nobody knows how fibres run: they add none.

    Raises:
        MaterialError: The mesh lacks a region that the material is for.
    """
    regions = tuple(replace(part, fibre_stiffness=0.0) for part in material.regions)
    field = MaterialField(mesh, replace(material, fibre_stiffness=0.0, regions=regions))
    return element_material(field)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=STRAIN_FAST)
def _pulled_hard(
    rest: Reals,
    places: Reals,
    tets: Rows,
    alive: NDArray[np.bool_],
    kinds: NDArray[np.uint8],
    lame: Reals,
    limit: float,
    rows: Rows,
    stress: Reals,
) -> tuple[int, float]:
    """Enter elements whose largest principal stress exceeds a limit, and that stress [Pa].

    Their number, and the largest stress looked at (those clearly below the limit are not).
    """
    found, most = 0, 0.0
    for e in range(tets.shape[0]):
        if not alive[e]:
            continue
        i, j, k, m = tets[e, 0], tets[e, 1], tets[e, 2], tets[e, 3]
        xx, yy, zz, yz, xz, xy, turned, _ = left_cauchy_green(rest, places, i, j, k, m)
        first, second = lame[kinds[e], 0], lame[kinds[e], 1]
        # A bound that needs no roots: most elements are far below the limit.
        trace = xx + yy + zz - 3.0
        mean = trace / 3.0
        a, b, c = xx - 1.0 - mean, yy - 1.0 - mean, zz - 1.0 - mean
        spread = np.sqrt(a * a + b * b + c * c + 2.0 * (yz * yz + xz * xz + xy * xy))
        highest = mean + _TWO_THIRDS_ROOT * spread
        bound = 2.0 * second * (np.sqrt(1.0 + highest) - 1.0) + 0.5 * first * trace
        if bound < limit:
            continue
        s0, s1, s2 = principal_stretches(xx, yy, zz, yz, xz, xy, turned)
        value = 2.0 * second * (s0 - 1.0) + first * (s0 + s1 + s2 - 3.0)
        most = max(most, value)
        if value > limit:
            rows[found], stress[found] = e, value
            found += 1
    return found, most


def pulled_hard(
    rest: Reals,
    places: Reals,
    tets: Rows,
    alive: NDArray[np.bool_],
    material: ElementMaterial,
    limit: float,
) -> tuple[Rows, Reals, float]:
    """Elements whose largest principal stress exceeds a limit.

    Args:
        rest: Rest positions [m], shape (node_rows, 3).
        places: Current positions [m], shape (node_rows, 3).
        tets: Nodes of each element, shape (element_rows, 4).
        alive: Elements that there are, shape (element_rows,).
        material: What they are made of.
        limit: The limit [Pa], at least 0.

    Returns:
        Their rows, ascending; that stress of each [Pa]; the largest of all, or the largest that had
        to be looked at closely if none exceeds the limit [Pa].
    """
    rows = np.empty(len(tets), dtype=np.int32)
    stress = np.empty(len(tets))
    found, most = _pulled_hard(
        rest, places, tets, alive, material.kinds, material.lame, limit * (1.0 - _SLACK), rows,
        stress,
    )  # fmt: skip
    return rows[:found].copy(), stress[:found].copy(), float(most)


@dataclass(frozen=True)
class Stresses:
    """Stress of some elements, in the axes of the deformed tissue.

    Attributes:
        tensors: Stress [Pa], shape (n, 3, 3).
        largest: Largest principal stress [Pa], shape (n,).
        direction: Unit vector of the direction it pulls in, shape (n, 3).
    """

    tensors: Reals
    largest: Reals
    direction: Reals


def stresses_of(rest: Reals, places: Reals, nodes: Rows, lame: Reals) -> Stresses:
    """Stress of some elements.

    Args:
        rest: Rest positions [m], shape (node_rows, 3).
        places: Current positions [m], shape (node_rows, 3).
        nodes: Nodes of the elements, shape (n, 4).
        lame: Lame's constants of each [Pa], shape (n, 2).
    """
    before = np.swapaxes(rest[nodes[:, 1:]] - rest[nodes[:, :1]], 1, 2)
    after = np.swapaxes(places[nodes[:, 1:]] - places[nodes[:, :1]], 1, 2)
    gradient = after @ np.linalg.inv(before)
    squares, axes = np.linalg.eigh(gradient @ np.swapaxes(gradient, 1, 2))
    stretch = np.sqrt(np.maximum(squares, 0.0))
    stretch[np.linalg.det(gradient) < 0.0, 0] *= -1.0
    strain = stretch - 1.0
    principal = 2.0 * lame[:, 1:] * strain + lame[:, :1] * strain.sum(axis=1, keepdims=True)
    tensors = np.einsum("nik,nk,njk->nij", axes, principal, axes)
    return Stresses(tensors, principal[:, 2], axes[:, :, 2])
