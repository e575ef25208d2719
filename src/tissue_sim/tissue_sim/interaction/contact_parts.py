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
from tissue_sim.kernels.pressed_parts import add_pressed

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
    wrench, stiffness, damping = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6))
    numbers = contact.contact_stiffness, contact.contact_damping, contact.contact_friction
    add_pressed(
        pressed.places - tip, pressed.normal, pressed.depth, pressed.slip, pressed.area, numbers,
        velocity, SLIDES_AT, wrench, stiffness, damping,
    )  # fmt: skip
    return wrench, stiffness, damping


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
