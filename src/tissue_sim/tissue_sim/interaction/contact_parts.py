"""The contacts that a contact model is made of: wrench, stiffness and damping of each.

Every stiffness and damping is symmetric and positive semidefinite, and so is their sum:

* A pressed node has kappa A n n^T. Its force also turns with the normal, by
  -f / r (1 - n n^T): what is nearest to the sum of both without a negative eigenvalue is the first.
* A sensed stiffness has the absolute values of its eigenvalues (`Patch`), a learned one lies
  between zero and it.
* Springs in series and what dissipates in them are congruences of such matrices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction import rigid
from tissue_sim.interaction.contact import Contact
from tissue_sim.interaction.coupling import Coupling
from tissue_sim.interaction.probes import Pressed

Reals = NDArray[np.float64]
Parts = tuple[Reals, Reals, Reals]
"""Wrench (6,), stiffness (6, 6) and damping (6, 6) of one contact, about the tip."""

SLIDES_AT = 0.01
"""Friction of what slides is a damper that gives all of it at this speed, or the tool's own [m/s]:
at rest it pushes nowhere."""

LEAST_POWER = 1e-9
"""Power that a blade takes below which it counts as at rest [W]."""


def probe_parts(pressed: Pressed, contact: Contact, tip: Reals, velocity: Reals) -> Parts:
    """Wrench at rest, stiffness and damping of a probe's contact, the nodes left where they are.

    A node that sticks holds the probe by the spring of its friction; one that slides by a damper,
    which has Coulomb's force at the speed the probe has now.

    Args:
        pressed: The nodes inside the probe.
        contact: The contact's numbers.
        tip: The probe's tip [m], shape (3,).
        velocity: Of the probe [m/s], [rad/s], shape (6,).
    """
    normal, area = pressed.normal, pressed.area
    arms = pressed.places - tip
    stiffness = contact.contact_stiffness * area
    push = stiffness * pressed.depth
    most = contact.contact_friction * push
    sticks = stiffness * np.linalg.norm(pressed.slip, axis=1) < most
    held = np.where(sticks, stiffness, 0.0)[:, None]
    forces = -push[:, None] * normal + held * pressed.slip
    along = velocity[:3] + np.cross(velocity[3:], arms)
    along -= np.einsum("ij,ij->i", along, normal)[:, None] * normal
    speed = np.maximum(np.linalg.norm(along, axis=1), SLIDES_AT)
    rubbing = np.where(sticks, 0.0, most / speed)
    across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    out = normal[:, :, None] * normal[:, None, :]
    wrench = np.concatenate([forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)])
    return (
        wrench,
        _of_points(arms, _weighted(stiffness, out) + _weighted(held[:, 0], across)),
        _of_points(
            arms, _weighted(contact.contact_damping * area, out) + _weighted(rubbing, across)
        ),
    )


def in_series(spring: Reals, tissue: Reals, coupling: Coupling) -> tuple[Reals, Reals]:
    """Stiffness and damping of a coupling's spring with tissue behind it, shapes (6, 6).

    Of a motion d of the tool the patch between them makes A d, A = (K + S)^-1 K. What remains is
    K - K A; the coupling's damper B takes the power of the patch's motion, A^T B A.

    Args:
        spring: K, the spring's stiffness.
        tissue: S, the tissue's.
        coupling: What the damper is taken from.
    """
    moved = np.array([coupling.stiffness] * 3 + [coupling.angular_stiffness] * 3)
    share = np.linalg.solve(spring + tissue + np.diag(1e-9 * moved), spring)
    series = spring - spring @ share
    damper = np.array([coupling.damping] * 3 + [coupling.angular_damping] * 3)
    return 0.5 * (series + series.T), share.T @ (damper[:, None] * share)


def blade_parts(wrench: Reals, velocity: Reals) -> Parts:
    """What a blade feels of what it cuts: a damper along the resistance w, w w^T / (-w . v).

    It gives w at the velocity v of now and pushes nowhere once the blade rests.

    Args:
        wrench: Resistance on the blade [N], [N m], shape (6,).
        velocity: Of the blade [m/s], [rad/s], shape (6,).
    """
    power = -float(wrench @ velocity)
    damping = np.outer(wrench, wrench) / power if power > LEAST_POWER else np.zeros((6, 6))
    return np.zeros(6), np.zeros((6, 6)), damping


def turned(matrix: Reals, pose: Reals) -> Reals:
    """A matrix given in a pose's axes, in outer axes, shape (6, 6)."""
    axes = axes_of(pose)
    return axes @ matrix @ axes.T


def axes_of(pose: Reals) -> Reals:
    """The axes of a pose as a change of motions and wrenches, shape (6, 6)."""
    axes = np.zeros((6, 6))
    axes[:3, :3] = axes[3:, 3:] = rigid.matrix(pose[3:])
    return axes


def _weighted(weights: Reals, matrices: Reals) -> Reals:
    return weights[:, None, None] * matrices


def _of_points(arms: Reals, matrices: Reals) -> Reals:
    """Sum of J^T M J with J = [1, -[r]x]: what acts at points r from the tip, by its motion."""
    jacobians = np.zeros((len(arms), 3, 6))
    jacobians[:, (0, 1, 2), (0, 1, 2)] = 1.0
    x, y, z = arms.T
    jacobians[:, 0, 4], jacobians[:, 0, 5] = z, -y
    jacobians[:, 1, 3], jacobians[:, 1, 5] = -z, x
    jacobians[:, 2, 3], jacobians[:, 2, 4] = y, -x
    total: Reals = (jacobians.transpose(0, 2, 1) @ matrices @ jacobians).sum(axis=0)
    return total
