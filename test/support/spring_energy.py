"""Energies and laws of the dynamic spring model, written down again in plain numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import signed_volumes

Array = NDArray[np.float64]


def elongations(springs: SpringNetwork, u: Array) -> tuple[Array, Array, Array]:
    """Stiffness [N/m], rest length [m] and elongation over rest length of every spring."""
    used = springs.springs.alive[: springs.rows]
    ends = springs.springs.ends[: springs.rows][used]
    rest, x = springs.mesh.rest, springs.mesh.rest + u
    l0 = np.linalg.norm(rest[ends[:, 1]] - rest[ends[:, 0]], axis=1)
    length = np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1)
    return springs.springs.stiffness[: springs.rows][used], l0, length / l0 - 1.0


def volume_ratios(mesh: Mesh, u: Array) -> tuple[Array, Array]:
    """Rest volumes [m^3] and volumes over them of the elements that are alive."""
    rows = mesh.node_rows
    tets = mesh.tets[: mesh.element_rows][mesh.element_alive[: mesh.element_rows]]
    rest = signed_volumes(mesh.rest[:rows], tets)
    return rest, signed_volumes((mesh.rest + u)[:rows], tets) / rest


def spring_energy(springs: SpringNetwork, u: Array) -> float:
    """Elastic energy of linear springs [J]."""
    k, l0, e = elongations(springs, u)
    return float((k * (l0 * e) ** 2).sum() / 2)


def kinetic_energy(springs: SpringNetwork, velocity: Array) -> float:
    return float((springs.masses[:, None] * velocity**2).sum() / 2)


def biphasic(e: Array, critical: float, ratio: float) -> Array:
    """Integral of the biphasic law over the elongation."""
    beyond = np.maximum(e - critical, 0.0)
    return np.where(
        e <= critical,
        e**2 / 2,
        critical**2 / 2 + critical * beyond + ratio * beyond**2 / 2,
    )


def cubic(e: Array, a: float, b: float, end: float) -> Array:
    """Integral of the cubic law over the elongation."""

    def polynomial(e: Array) -> Array:
        return e**2 / 2 + a * e**3 / 3 + b * e**4 / 4

    inside = np.clip(e, -end, end)
    force = inside + a * inside**2 + b * inside**3
    slope = 1 + 2 * a * inside + 3 * b * inside**2
    beyond = e - inside
    return polynomial(inside) + force * beyond + slope * beyond**2 / 2
