"""What a tool feels near where it is, for loops that run faster than the simulation.

With d the motion from the reference to the tool's pose and v its velocity, the wrench on the tool
is w - K d - D v. Everything here is the response of tissue that has not had the time to follow
yet: stiffer than what the next frame will find, never softer. Between frames the force then runs
ahead of the tissue's, which takes energy from the hand; a softer one would give it energy.

References:
    Barbagli, F., Prattichizzo, D. and Salisbury, K. (2005): A multirate approach to haptic
    interaction with deformable objects: single and multipoint contacts. Int. J. Robotics Research
    24(9), 703-715 (local models between the frames of a slow simulation).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction import rigid
from tissue_sim.interaction.contact_parts import (
    Parts,
    axes_of,
    blade_parts,
    in_series,
    probe_parts,
    turned,
)
from tissue_sim.interaction.coupling import Coupling
from tissue_sim.interaction.patch import Patch

if TYPE_CHECKING:
    from tissue_sim.interaction.holds import Hold
    from tissue_sim.interaction.tools import ToolSpec
    from tissue_sim.simulation import Simulation

Reals = NDArray[np.float64]

VALID_FRAMES = 6.0
"""Frames of the simulation for which a model is believed."""

LEAST_MOTION = 1e-3
"""A smaller motion between two frames, in sizes of the tool, teaches nothing but rounding."""


@dataclass(frozen=True)
class ContactModel:
    """The wrench on a tool near a pose, in the organ's axes, torques about the tip.

    Attributes:
        reference: The pose, shape (7,).
        wrench: Force [N] and torque [N m] there at rest, shape (6,).
        stiffness: [N/m], [N/rad] and [N m/rad], shape (6, 6), symmetric positive semidefinite.
        damping: The same per speed, shape (6, 6), symmetric positive semidefinite.
        valid_for: How long it is believed [s].
        reach: How far from the reference it is believed [m].
        contact: Whether anything touches the tool; if not, all is zero.
    """

    reference: Reals
    wrench: Reals = field(default_factory=lambda: np.zeros(6))
    stiffness: Reals = field(default_factory=lambda: np.zeros((6, 6)))
    damping: Reals = field(default_factory=lambda: np.zeros((6, 6)))
    valid_for: float = 0.0
    reach: float = 0.0
    contact: bool = False

    def wrench_at(self, motion: Reals, velocity: Reals) -> Reals:
        """Force [N] and torque [N m] on the tool, shape (6,).

        Args:
            motion: From the reference to the tool's pose, as `rigid.motion` gives it, shape (6,).
            velocity: Of the tool [m/s], [rad/s], shape (6,).
        """
        wrench: Reals = self.wrench - self.stiffness @ motion - self.damping @ velocity
        return wrench


class ContactModels:
    """The contact models of a simulation's tools, made from its state after a frame.

    They change nothing in the simulation: a session is the same whether somebody feels it or not.
    """

    def __init__(self) -> None:
        """Begin with nothing felt."""
        self._felt: dict[int, _FeltHold] = {}
        self._last: dict[str, tuple[int, Reals]] = {}

    def of(self, simulation: Simulation, tool: str) -> ContactModel:
        """What a tool feels now.

        Args:
            simulation: After a frame; held nodes are moved to sense them, and put back.
            tool: Id of the tool.
        """
        spec, pose = simulation.tools[tool], simulation.poses[tool]
        velocity = self._velocity(simulation, tool, pose)
        parts: list[Parts] = []
        if simulation.model.has_forces:
            if tool in simulation.probes.touches:
                pressed = simulation.probes.pressed(spec, pose, simulation.state)
                parts.append(probe_parts(pressed, spec.contact, pose[:3], velocity))
            parts += [self._hold(simulation, hold) for hold in simulation.holds.of_tool(tool)]
        if tool in simulation.blades.wrenches:
            parts.append(blade_parts(simulation.blades.wrenches[tool], velocity))
        self._forget_ended(simulation)
        return _sum(parts, spec, pose, VALID_FRAMES / simulation.scene.rate_hz)

    def _velocity(self, simulation: Simulation, tool: str, pose: Reals) -> Reals:
        """Of the tool over the last frame; zero if it was not asked for then, shape (6,)."""
        frame, before = self._last.get(tool, (-1, pose))
        self._last[tool] = simulation.frame, pose.copy()
        if frame != simulation.frame - 1:
            return np.zeros(6)
        return rigid.motion(before, pose) * simulation.scene.rate_hz

    def _hold(self, simulation: Simulation, hold: Hold) -> Parts:
        spec, pose = simulation.tools[hold.tool], simulation.poses[hold.tool]
        wrench = simulation.hold_wrench(hold)
        if hold.patch is not None:
            tissue = turned(hold.patch.stiffness, hold.patch.pose)
            spring = spec.coupling.tangent(pose, hold.patch.pose)
            return (wrench, *in_series(spring, tissue, spec.coupling))
        felt = self._felt.setdefault(hold.id, _FeltHold(pose))
        stiffness = felt.stiffness(simulation, hold, wrench, spec.size[0])
        return wrench, stiffness, np.zeros((6, 6))

    def _forget_ended(self, simulation: Simulation) -> None:
        for ended in [key for key in self._felt if key not in simulation.holds.by_id]:
            del self._felt[ended]


class _FeltHold:
    """How stiff tissue is that a tool holds where it is itself: sensed, then learned by moving.

    A patch that nothing moves but its tool.
    """

    def __init__(self, pose: Reals) -> None:
        self._patch = Patch(pose)
        self._known: tuple[object, ...] = ()
        self._pose, self._wrench = pose.copy(), np.zeros(6)

    def stiffness(self, simulation: Simulation, hold: Hold, wrench: Reals, size: float) -> Reals:
        """In the organ's axes, shape (6, 6).

        Args:
            simulation: After a frame.
            hold: A hold by position.
            wrench: Of the tissue on the tool, shape (6,).
            size: Of the tool [m].
        """
        patch, pose = self._patch, simulation.poses[hold.tool]
        known = (simulation.mesh.version, simulation.model, len(hold.rows))
        motion = rigid.motion(self._pose, pose)
        if known != self._known:
            patch.forget()
        patch.pose[:] = pose
        patch.begin(
            Coupling(), 1.0 / simulation.scene.rate_hz, simulation.model, simulation.state,
            simulation.mesh, hold.rows, hold.local,
        )  # fmt: skip
        # What the tissue resists over a frame is what remains once it has followed for a frame.
        far = max(float(np.linalg.norm(motion[:3])) / size, float(np.linalg.norm(motion[3:])))
        if known == self._known and far > LEAST_MOTION:
            axes = axes_of(pose)
            patch.followed.learn(axes.T @ motion, axes.T @ (wrench - self._wrench))
        self._known, self._pose, self._wrench = known, pose.copy(), wrench
        return turned(patch.followed.matrix, pose)


def _sum(parts: list[Parts], spec: ToolSpec, pose: Reals, valid_for: float) -> ContactModel:
    wrench, stiffness, damping = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6))
    for part in parts:
        wrench, stiffness, damping = (
            wrench + part[0], stiffness + part[1], damping + part[2]
        )  # fmt: skip
    contact = bool(wrench.any() or stiffness.any() or damping.any())
    return ContactModel(pose.copy(), wrench, stiffness, damping, valid_for, spec.size[0], contact)
