"""A second model under the journal of a running session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import SPRINGS, Subject
from tissue_sim.elastic.model import Material
from tissue_sim.frame import Budget, Frame, FrameInputs, JournalEntry, ToolSample
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.coupling import FORCE
from tissue_sim.interaction.holds import Hold
from tissue_sim.interaction.tools import GRAB
from tissue_sim.journal import Replayer, scene_at_start
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

ROUNDING = 1e-6
"""Shapes that are closer than this are the same: positions are published in float32 [m]."""

REST_SECONDS = 5.0
"""Longest time for a model to come to rest in a frame [s]."""


class FollowingSimulation(Simulation):
    """A simulation whose tools take the nodes that they take in the session it follows.

    Attributes:
        seen: Positions of the session before the frame [m], shape (node_rows, 3); None: unknown.
    """

    seen: NDArray[np.float32] | None = None

    def grab(self, tool: str, radius: float, by_use: bool) -> Hold | None:
        """Hold what the tool takes in the session, from where it is there.

        Which nodes are held, and where, must not depend on the model that is judged (THESIS.md,
        section 6). Nodes that are in one place in both keep their own, so that rounding decides
        nothing.
        """
        mesh, seen = self.mesh, self.seen
        rows = mesh.node_rows
        if seen is None or len(seen) != rows:
            return super().grab(tool, radius, by_use)
        own = self.state.displacement[:rows]
        there = (seen - mesh.rest[:rows]).astype(own.dtype)
        agree = np.abs(there - own).max(axis=1) < ROUNDING
        there[agree] = own[agree]
        taken = self.within_reach(tool, radius, there)
        if not len(taken):
            return None
        free = taken[self.holds.owner[taken] == 0]
        self.state.displacement[free] = there[free]
        return self.hold(tool, taken, by_use, self.tools[tool].hold == FORCE)

    def take_over(self, entry: JournalEntry, held: NDArray[np.int32]) -> None:
        """Put tools where they are in a frame, and let those that grab have what is held then.

        Each node goes to the nearest of them.

        Args:
            entry: The frame.
            held: Rows that are held.
        """
        for sample in entry.inputs.tools:
            if sample.tool in self.tools:
                self.poses[sample.tool], self._pressed[sample.tool] = sample.pose, sample.use
        grabs = [tool.id for tool in self.tools.values() if tool.kind == GRAB]
        # Held by a request rather than by use: any tool that grabs may have it.
        grabbing = [tool for tool in grabs if self._pressed.get(tool, False)] or grabs
        if not grabbing or not len(held):
            return
        places = self.mesh.rest[held] + self.state.displacement[held]
        tips = np.array([self.poses[tool][:3] for tool in grabbing])
        nearest = np.linalg.norm(places[:, None] - tips, axis=2).argmin(axis=1)
        for number, tool in enumerate(grabbing):
            rows = held[nearest == number]
            if len(rows):
                self.hold(tool, rows, True, self.tools[tool].hold == FORCE)


class SecondModel:
    """Plays a session's journal to another model.

    Attributes:
        subject: The model, its parameters and its effort. Without an effort it makes as many steps
            as the session did, or those that its own time step asks for.
        simulation: What plays it.
    """

    def __init__(self, subject: Subject, simulation: FollowingSimulation) -> None:
        """Go on after the frame that a simulation stands at; see `from_start` and `from_shape`."""
        self.subject, self.simulation = subject, simulation
        self._replayer = Replayer(simulation, other_model=True)
        self._owed = 0.0

    @classmethod
    def from_start(cls, subject: Subject, entry: JournalEntry, mesh: Mesh) -> SecondModel:
        """Stand before the first frame of an epoch.

        Args:
            subject: The model.
            entry: The epoch's first entry.
            mesh: Its first keyframe; it is changed in place.

        Raises:
            ValueError: The model is not possible on this organ, or this is no beginning.
        """
        scene = scene_at_start(entry, mesh, subject.model, subject.parameters)
        scene = replace(scene, material=_material(subject, mesh, scene))
        return cls(subject, FollowingSimulation(mesh, scene, entry.epoch))

    @classmethod
    def from_shape(
        cls,
        subject: Subject,
        scene: Scene,
        entry: JournalEntry,
        mesh: Mesh,
        held: NDArray[np.int32],
    ) -> SecondModel:
        """Stand after a frame in the middle of a session.

        Args:
            subject: The model.
            scene: What is known of the session, with its shape at that frame.
            entry: The journal's entry of that frame.
            mesh: The organ as it is then; it is changed in place.
            held: Rows that are held.

        Raises:
            ValueError: The model is not possible on this organ.
        """
        own = {**scene.parameters.get(subject.model, {}), **subject.parameters}
        scene = replace(
            scene, model=subject.model, parameters={**scene.parameters, subject.model: own},
            material=_material(subject, mesh, scene),
        )  # fmt: skip
        simulation = FollowingSimulation(mesh, scene, entry.epoch)
        simulation.frame, simulation.sim_time = entry.frame, entry.sim_time
        simulation.take_over(entry, held)
        return cls(subject, simulation)

    def play(self, entry: JournalEntry, seen: NDArray[np.float32] | None) -> Frame:
        """Play a frame of the journal.

        Args:
            entry: The frame; those that were passed over are taken as nothing.
            seen: Positions of the session before it [m], shape (node_rows, 3); None: unknown.

        Raises:
            JournalError: It is of another epoch or was played already.
        """
        simulation = self.simulation
        simulation.frame = max(simulation.frame, entry.frame - 1)
        simulation.seen = seen
        return self._replayer.play(entry, self._budget(entry))

    def free_nodes(self) -> NDArray[np.bool_]:
        """Living nodes that are not held, shape (node_rows,)."""
        mesh = self.simulation.mesh
        free = mesh.node_alive[: mesh.node_rows].copy()
        free[self.simulation.holds.rows] = False
        return free

    def _budget(self, entry: JournalEntry) -> Budget | None:
        effort = self.subject.effort
        if effort == Effort():
            return None
        if effort.steps is not None:
            self._owed += effort.steps + 1e-9
            steps = int(self._owed)
            self._owed -= steps
            return Budget(steps=steps)
        return Budget(seconds=effort.seconds or REST_SECONDS)


def checked_subject(subject: Subject) -> Subject:
    """The subject, if it can follow a session.

    Raises:
        ValueError: It has springs of its own, which no edit keeps.
    """
    own = [name for name in subject.values if name.startswith(SPRINGS)]
    if own:
        raise ValueError(
            f"{own[0]} cannot be set in a running session: cuts make springs of the material; "
            "allowed: parameters of the model and material.NAME"
        )
    return subject


def only_moves(inputs: FrameInputs) -> bool:
    """Whether nothing but poses of tools is new in a frame."""
    return not (inputs.commands or inputs.edits or any(sample.edge for sample in inputs.tools))


def merged(before: JournalEntry, entry: JournalEntry) -> JournalEntry:
    """A frame in which the tools are also where one passed over before it had put them."""
    samples: Mapping[str, ToolSample] = {
        sample.tool: sample for sample in (*before.inputs.tools, *entry.inputs.tools)
    }
    inputs = replace(entry.inputs, tools=tuple(samples.values()))
    return replace(entry, inputs=inputs)


def _material(subject: Subject, mesh: Mesh, scene: Scene) -> Material:
    return subject.material(Organ(mesh.name, mesh, scene.material))
