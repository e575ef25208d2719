"""A patch: tissue held by force, moved as a rigid body by its coupling and by the tissue."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Model, State
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.coupling import Coupling
from tissue_sim.interaction.patch_stiffness import LEAST_MOTION, LearnedStiffness
from tissue_sim.kernels.patches import (
    PatchNumbers,
    fill_rotation,
    local_wrench,
    move_patch,
    place_patch,
    turn_pose,
)

SMALLEST = 1e-4
"""Radius of a patch of a single node [m]."""

PROBE = 1e-3
"""Motion that senses the tissue's stiffness: an angle [rad], and a way in radii of the patch."""

SETTLED = 1e-8
"""A shorter motion counts as none [m]."""


class Patch:
    """Where held tissue is while its tool pulls at it.

    It has no mass: at all times B dq/dt = K (tool - q) + f(q), f the force of the tissue on it. It
    takes part in the model's sweeps as one more block: before every step of the model it makes a
    Newton step of backward Euler's equation in its six coordinates, the tissue left where it is.
    The stiffness for that is sensed by moving the held nodes a little. As it bounds the stiffness
    that remains when the tissue follows, no step overshoots, whatever K, B and the time step are.
    Where the model says that the tissue has followed, the stiffness that remains is learned and
    used instead: such steps are as long as they should be.

    Attributes:
        pose: Of the patch; the tool's at the grab, shape (7,).
        settled: Whether its last motion was as good as none.
    """

    def __init__(self, pose: NDArray[np.float64]) -> None:
        """Begin where the tool is."""
        self.pose = pose.copy()
        self.settled = False
        self._good, self._anchor = pose.copy(), pose.copy()
        self._numbers = PatchNumbers(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._size = SMALLEST
        self._sensed, self._stiffness = np.zeros((6, 6)), np.zeros((6, 6))
        self._wrench, self._motion = np.zeros(6), np.zeros(6)
        self._followed = LearnedStiffness()
        self._was_at_rest = self._known = False
        self._next, self._moved_by = 0, 0.0

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """What resists its next motion, in its own axes: sensed, or learned at rest, (6, 6)."""
        return self._followed.matrix if self._was_at_rest else self._stiffness

    def forget(self) -> None:
        """Sense the tissue's stiffness anew: nodes, tissue or model are no longer the same."""
        self._known = self._was_at_rest = False
        self._followed.forget()

    def remember(self) -> None:
        """Keep the pose, to go back to if the state is lost."""
        self._good[:] = self.pose

    def restore(self) -> None:
        """Go back to the pose kept."""
        self.pose[:] = self._good
        self.forget()

    def begin(
        self,
        coupling: Coupling,
        seconds: float,
        model: Model,
        state: State,
        mesh: Mesh,
        rows: NDArray[np.int32],
        local: NDArray[np.float64],
    ) -> None:
        """Prepare for the steps of a frame.

        Args:
            coupling: Between it and the tool.
            seconds: Time that passes until the anchor is set again [s]: a dynamic model's step, or
                the whole frame.
            model: What the tissue's force comes from; without forces it has none.
            state: Where the tissue is; held nodes are moved to sense forces, and put back.
            mesh: The mesh.
            rows: Rows of the held nodes, shape (n,).
            local: Their places in the patch's axes [m], shape (n, 3).
        """
        self._numbers = coupling.numbers(seconds)
        self._anchor[:] = self.pose
        self.settled = False
        if not model.has_forces or not len(rows):
            self._stiffness[:] = 0.0
            self._known = False
            return
        motions = range(self._next, self._next + 1)
        if not self._known:
            self._size = max(math.sqrt(float((local**2).sum(axis=1).mean())), SMALLEST)
            self._known, motions = True, range(6)
        self._sense(motions, model, state, mesh, rows, local)
        self._next = (motions[-1] + 1) % 6

    def _sense(
        self,
        motions: range,
        model: Model,
        state: State,
        mesh: Mesh,
        rows: NDArray[np.int32],
        local: NDArray[np.float64],
    ) -> None:
        """Feel the force of small motions, everything but the held nodes left where it is."""
        before = state.displacement[rows].copy()
        sides = np.empty((2, 6))
        for motion in motions:
            step = PROBE * (self._size if motion < 3 else 1.0)
            for side, way in enumerate((step, -step)):
                pose = self._moved(motion, way)
                place_patch(rows, local, mesh.rest, pose, state.displacement)
                forces = model.forces(state, rows)
                local_wrench(rows, forces, mesh.rest, state.displacement, self.pose, sides[side])
            column = (sides[1] - sides[0]) / (2.0 * step)
            self._sensed[motion] = self._sensed[:, motion] = column
        state.displacement[rows] = before
        if np.isfinite(self._sensed).all():
            # What pushes away, such as a buckling spring, is no less stiff.
            values, vectors = np.linalg.eigh(self._sensed)
            values = np.abs(values)
            np.matmul(vectors * values, vectors.T, out=self._stiffness)
            self._followed.sense(values, vectors)
        else:
            self.forget()

    def _moved(self, motion: int, way: float) -> NDArray[np.float64]:
        """The pose after a small motion in its own axes."""
        pose = self.pose.copy()
        if motion < 3:
            rotation = np.empty((3, 3))
            fill_rotation(pose, rotation)
            pose[:3] += way * rotation[:, motion]
        else:
            turn_pose(pose, way * np.eye(3)[motion - 3])
        return pose

    def advance(
        self,
        tool: NDArray[np.float64],
        model: Model,
        state: State,
        mesh: Mesh,
        rows: NDArray[np.int32],
        local: NDArray[np.float64],
        alone: bool,
    ) -> None:
        """Move before a step of the model. Modifies the state of the held nodes in place.

        Args:
            tool: Pose of the tool, shape (7,).
            model: What the tissue's force comes from.
            state: Where the tissue is.
            mesh: The mesh.
            rows: Rows of the held nodes, shape (n,).
            local: Their places in the patch's axes [m], shape (n, 3).
            alone: Whether nothing else is held.
        """
        stiffness = self._stiffness
        if self._known:
            before = self._wrench.copy()
            forces = model.forces(state, rows)
            local_wrench(rows, forces, mesh.rest, state.displacement, self.pose, self._wrench)
            if not np.isfinite(self._wrench).all():
                self.forget()
                return
            if self._learn(model, alone, before):
                stiffness = self._followed.matrix
        else:
            self._wrench[:] = 0.0
        if model.time_step is not None:
            self._anchor[:] = self.pose
        self._moved_by = move_patch(
            self._numbers, self._wrench, stiffness, tool, self._anchor, self._size,
            self.pose, self._motion,
        )  # fmt: skip
        self.settled = self._moved_by < SETTLED
        place_patch(rows, local, mesh.rest, self.pose, state.displacement)

    def _learn(self, model: Model, alone: bool, before: NDArray[np.float64]) -> bool:
        """Learn from the last motion; whether what is learned holds for the next one.

        Another hold that moves would change the force as well. Dynamic models are never at rest.
        """
        at_rest = alone and model.time_step is None and model.idle
        if at_rest and self._was_at_rest and self._moved_by >= LEAST_MOTION * self._size:
            self._followed.learn(self._motion, self._wrench - before)
        self._was_at_rest = at_rest
        return at_rest
