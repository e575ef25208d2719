"""What a tool feels near where it is, for loops that run faster than the simulation.

With d the motion from the reference to the tool's pose and v its velocity, the wrench on the tool
is w - K d - D v. K is first that of tissue that has not followed yet, as far as it can be sensed:
the penalty of the nodes in contact, or what resists held nodes with everything else left where it
is. Such a force runs ahead of the tissue's and takes energy from the hand. What remains once the
tissue has followed for a frame is then learned from the tool's own motions.

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
from tissue_sim.interaction.patch_stiffness import LearnedStiffness

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
        self._touched: dict[int | str, _Touched] = {}
        self._patches: dict[int, tuple[Patch, tuple[object, ...]]] = {}
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
                parts.append(self._probe(simulation, spec, pose, velocity))
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

    def _probe(self, simulation: Simulation, spec: ToolSpec, pose: Reals, velocity: Reals) -> Parts:
        pressed = simulation.probes.pressed(spec, pose, simulation.state)
        wrench, sensed, damping = probe_parts(pressed, spec.contact, pose[:3], velocity)
        if not wrench.any():
            self._touched.pop(spec.id, None)
            return wrench, sensed, damping
        touched = self._touched.setdefault(spec.id, _Touched())
        known = (simulation.mesh.version, simulation.model, spec)
        return wrench, touched.stiffness(known, pose, wrench, sensed, spec.size[0]), damping

    def _hold(self, simulation: Simulation, hold: Hold) -> Parts:
        spec, pose = simulation.tools[hold.tool], simulation.poses[hold.tool]
        wrench = simulation.hold_wrench(hold)
        if hold.patch is not None:
            tissue = turned(hold.patch.stiffness, hold.patch.pose)
            spring = spec.coupling.tangent(pose, hold.patch.pose)
            return (wrench, *in_series(spring, tissue, spec.coupling))
        known = (simulation.mesh.version, simulation.model, len(hold.rows))
        sensed = self._sensed(simulation, hold, pose, known)
        touched = self._touched.setdefault(hold.id, _Touched())
        stiffness = touched.stiffness(known, pose, wrench, sensed, spec.size[0])
        return wrench, stiffness, np.zeros((6, 6))

    def _sensed(
        self, simulation: Simulation, hold: Hold, pose: Reals, known: tuple[object, ...]
    ) -> Reals:
        """Stiffness of the tissue around a hold by position: a patch that nothing else moves."""
        patch, before = self._patches.get(hold.id, (Patch(pose), ()))
        self._patches[hold.id] = patch, known
        if known != before:
            patch.forget()
        patch.pose[:] = pose
        patch.begin(
            Coupling(), 1.0 / simulation.scene.rate_hz, simulation.model, simulation.state,
            simulation.mesh, hold.rows, hold.local,
        )  # fmt: skip
        return turned(patch.stiffness, pose)

    def _forget_ended(self, simulation: Simulation) -> None:
        there = {*simulation.holds.by_id, *simulation.probes.touches}
        for ended in [key for key in self._touched if key not in there]:
            del self._touched[ended]
        for gone in [key for key in self._patches if key not in there]:
            del self._patches[gone]


class _Touched:
    """How stiff what a tool touches is: as sensed, then as its own motions have shown.

    What is sensed is the stiffness against tissue that has not followed yet. What remains when it
    has for a frame is learned from the motions and forces of one frame to the next.
    """

    def __init__(self) -> None:
        self._learned = LearnedStiffness()
        self._known: tuple[object, ...] = ()
        self._pose, self._wrench = rigid.IDENTITY, np.zeros(6)

    def stiffness(
        self, known: tuple[object, ...], pose: Reals, wrench: Reals, sensed: Reals, size: float
    ) -> Reals:
        """Stiffness in the organ's axes, shape (6, 6).

        Args:
            known: What was learned holds as long as this is the same.
            pose: Of the tool, shape (7,).
            wrench: Of the tissue on the tool, shape (6,).
            sensed: The bound of the stiffness, in the organ's axes, shape (6, 6).
            size: Of the tool [m].
        """
        axes, motion = axes_of(pose), rigid.motion(self._pose, pose)
        if known != self._known:
            self._learned.forget()
        self._learned.sense(*np.linalg.eigh(axes.T @ sensed @ axes))
        far = max(float(np.linalg.norm(motion[:3])) / size, float(np.linalg.norm(motion[3:])))
        if known == self._known and far > LEAST_MOTION:
            self._learned.learn(axes.T @ motion, axes.T @ (wrench - self._wrench))
        self._known, self._pose, self._wrench = known, pose.copy(), wrench
        return turned(self._learned.matrix, pose)


def _sum(parts: list[Parts], spec: ToolSpec, pose: Reals, valid_for: float) -> ContactModel:
    wrench, stiffness, damping = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6))
    for part in parts:
        wrench, stiffness, damping = (
            wrench + part[0], stiffness + part[1], damping + part[2]
        )  # fmt: skip
    contact = bool(wrench.any() or stiffness.any() or damping.any())
    return ContactModel(pose.copy(), wrench, stiffness, damping, valid_for, spec.size[0], contact)
