"""The smallest swinging organ: one free node on three springs."""

from __future__ import annotations

import numpy as np

from support.elastic_scenes import MATERIAL, double
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import State
from tissue_sim.elastic.spring_mass import SpringMass
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh

LENGTH = 0.01


def oscillator(
    time_step: float, damping: float = 0.0, integrator: int = 0
) -> tuple[SpringMass, State, float]:
    """Node 3 of a tetrahedron whose other nodes are fixed; above their centre it swings upright.

    Returns:
        The model, its state and the undamped angular frequency [rad/s].
    """
    angles = 2 * np.pi * np.arange(3) / 3
    base = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) * LENGTH / np.sqrt(3)
    top = [0, 0, LENGTH * np.sqrt(2 / 3)]
    mesh = Mesh(RawMesh(np.vstack([base, top]), np.array([[0, 1, 2, 3]])), np.arange(4) < 3)
    springs, state = double(mesh)
    values = {"damping": damping, "time_step": time_step, "integrator": integrator}
    model = SpringMass(mesh, MATERIAL, registry.checked_parameters("spring_mass", values), springs)
    # Three springs of stiffness k, each at cos^2 = 2/3 to the vertical.
    k = springs.springs.stiffness[:6][springs.springs.ends[:6, 1] == 3][0]
    omega = np.sqrt(3 * k * (2 / 3) / springs.masses[3])
    return model, state, float(omega)
