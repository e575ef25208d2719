"""The force on a hand from the contact models of a slower simulation; no ROS, no clock."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tissue_sim.interaction import rigid
from tissue_sim.interaction.contact_model import ContactModel
from tissue_sim.interaction.reaction import ForceLimiter, ForceLimits
from tool_input.haptics.passivity import PassivityController, bounded

Reals = NDArray[np.float64]

VELOCITY_SECONDS = 0.002
"""Time constant of the low-pass filter on velocities [s]."""

SHORTEST_BLEND, LONGEST_BLEND = 0.004, 0.05
"""A new model takes over within the time since the last one, but between these [s]."""

NO_MODEL = "no contact model yet"
OLD_MODEL = "the newest contact model is too old"


@dataclass(frozen=True)
class LoopLimits:
    """What the device bears, in forces on the tool.

    Attributes:
        force: Largest force and torque, and how fast they change.
        max_stiffness: Largest stiffness rendered [N/m].
        max_damping: Largest damping rendered [N s/m].
        fade: Time in which a force that must go is gone, and comes back [s].
        passive: Whether the passivity controller acts.
    """

    force: ForceLimits = field(default_factory=lambda: ForceLimits(3.0, 0.1, 300.0, 10.0))
    max_stiffness: float = 2000.0
    max_damping: float = 20.0
    fade: float = 0.03
    passive: bool = True

    @property
    def arm(self) -> float:
        """Way that counts as a radian [m]: at it the largest force has the largest torque."""
        return self.force.max_torque / self.force.max_force


class ContactLoop:
    """Evaluates the newest contact model, tick by tick.

    A function of the times, poses and models it is given. In each tick: the model's wrench at the
    tool's pose, plus what is left of the jump to it from the one before; faded beyond the model's
    reach and, in time, when there must be no force; bounded in size and rate; made passive.

    Attributes:
        wrench: Force [N] and torque [N m] on the tool from the last tick on, shape (6,).
        passivity: What keeps the account of the energy.
        share: Share of the force that is given now, 0 to 1.
        withheld: Why the force goes or is gone; empty: it is given.
        pushes_only: Whether the contact can only push the tool away, as a probe's.
        scaled_down: Models whose stiffness or damping was more than the limits.
    """

    def __init__(self, limits: LoopLimits, period: float) -> None:
        """Begin without a model and without force.

        Args:
            limits: What the device bears.
            period: Time between two ticks [s].
        """
        self.limits = limits
        self.wrench = np.zeros(6)
        self.passivity = PassivityController(limits.arm, limits.max_damping, period)
        self.share, self.withheld, self.pushes_only = 0.0, NO_MODEL, False
        self.scaled_down = 0
        self._period = period
        self._limiter = ForceLimiter(limits.force)
        self._model: ContactModel | None = None
        self._arrived: ContactModel | None = None
        self._found_at = self._blend_from = -np.inf
        self._blend = LONGEST_BLEND
        self._jump = np.zeros(6)
        self._now: float | None = None
        self._hand, self._tool = rigid.IDENTITY, rigid.IDENTITY
        self._hand_velocity, self._tool_velocity = np.zeros(6), np.zeros(6)

    def receive(self, model: ContactModel, found_at: float) -> None:
        """Take a model, from the next tick on; one older than the newest is left out.

        Args:
            model: The model.
            found_at: When it was found, on the clock of `step` [s].
        """
        if found_at < self._found_at:
            return
        self._found_at = found_at
        self._arrived = self._bearable(model)

    def step(self, now: float, tool: Reals, hand: Reals, withheld: str = "") -> Reals:
        """One tick: the wrench on the tool that the hand shall feel until the next, shape (6,).

        Args:
            now: The time [s].
            tool: Pose of the tool, shape (7,).
            hand: Pose of the hand in the tool's metres: it moves as the tool does unless a clutch
                or a workspace keeps the tool, shape (7,).
            withheld: Why there must be no force; empty: there may be.
        """
        if self._now is None:
            self._now, self._tool, self._hand = now - self._period, tool, hand
        seconds = now - self._now
        if seconds <= 0.0:
            return self.wrench
        motion = rigid.motion(self._hand, hand)
        self.passivity.observe(self.wrench, motion)
        smooth = 1.0 / (VELOCITY_SECONDS + seconds)
        self._hand_velocity += smooth * (motion - seconds * self._hand_velocity)
        # A hand on its tool moves as that does.
        together = tool is hand and self._tool is self._hand
        way = motion if together else rigid.motion(self._tool, tool)
        self._tool_velocity += smooth * (way - seconds * self._tool_velocity)
        self._now, self._tool, self._hand = now, tool, hand
        wanted = self._wanted(now)
        self._fade(now, seconds, withheld)
        self.wrench = self._allowed(self.share * wanted, seconds)
        if not self.wrench.any() and (self._model is None or not self._model.contact):
            self.passivity.forget()
        return self.wrench

    def _wanted(self, now: float) -> Reals:
        """What the models say, without a jump where one takes over from another."""
        if self._arrived is not None:
            before = self._rendered(now)
            self._model, self._arrived = self._arrived, None
            self._blend = min(max(now - self._blend_from, SHORTEST_BLEND), LONGEST_BLEND)
            self._blend_from = now
            self._jump = before - self._evaluated(self._model)
        return self._rendered(now)

    def _rendered(self, now: float) -> Reals:
        if self._model is None:
            return np.zeros(6)
        s = min((now - self._blend_from) / self._blend, 1.0)
        left = 1.0 - s * s * (3.0 - 2.0 * s)
        wrench: Reals = self._evaluated(self._model) + left * self._jump
        return wrench

    def _evaluated(self, model: ContactModel) -> Reals:
        if not model.contact:
            return np.zeros(6)
        motion = rigid.motion(model.reference, self._tool)
        wrench = model.wrench_at(motion, self._tool_velocity)
        if self.pushes_only:
            wrench = pushing(wrench, model.wrench)
        far = math.sqrt(motion[:3].dot(motion[:3])) / max(model.reach, 1e-9)
        return wrench * min(max(2.0 - far, 0.0), 1.0)

    def _fade(self, now: float, seconds: float, withheld: str) -> None:
        if not withheld and self._model is None:
            withheld = NO_MODEL
        elif not withheld and self._model is not None:
            withheld = OLD_MODEL if now - self._found_at > self._model.valid_for else ""
        self.withheld = withheld
        change = seconds / self.limits.fade
        self.share = max(self.share - change, 0.0) if withheld else min(self.share + change, 1.0)

    def _allowed(self, wanted: Reals, seconds: float) -> Reals:
        if self.share == 0.0:
            return self._limiter.next(None, seconds)
        wrench = self._limiter.next(wanted, seconds)
        if self.limits.passive:
            # At once, whatever the limit of the rate: energy does not wait.
            wrench = self.passivity.correct(wrench, self._hand_velocity * self._period)
        return bounded(wrench, self.limits.force.max_force, self.limits.force.max_torque)

    def _bearable(self, model: ContactModel) -> ContactModel:
        """The model with no more stiffness and damping than the limits."""
        stiffness = self._share_of(model.stiffness, self.limits.max_stiffness)
        damping = self._share_of(model.damping, self.limits.max_damping)
        if stiffness == damping == 1.0:
            return model
        self.scaled_down += 1
        return replace(
            model, stiffness=stiffness * model.stiffness, damping=damping * model.damping
        )

    def _share_of(self, matrix: Reals, most: float) -> float:
        """The share of a matrix whose largest eigenvalue is allowed, a radian being an arm long."""
        if not matrix.any():
            return 1.0
        ways = np.array([1.0, 1.0, 1.0, *[1.0 / self.limits.arm] * 3])
        largest = float(np.linalg.eigvalsh(ways[:, None] * matrix * ways)[-1])
        return min(1.0, most / max(largest, 1e-300))


def pushing(wrench: Reals, reference: Reals) -> Reals:
    """The wrench of a contact that cannot pull, shape (6,).

    As the force along the reference's goes to zero, so does the rest, as friction does.

    Args:
        wrench: That a linear model gives, shape (6,).
        reference: The wrench where it was found, shape (6,).
    """
    force = reference[:3]
    size = math.sqrt(force.dot(force))
    if size == 0.0:
        return wrench
    along = force / size
    push = float(wrench[:3] @ along)
    if push >= size:
        return wrench
    share = max(push, 0.0) / size
    rest = wrench.copy()
    rest[:3] -= push * along
    pushed: Reals = share * rest
    pushed[:3] += max(push, 0.0) * along
    return pushed
