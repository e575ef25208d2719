"""A blade that cuts as it moves, with the simulation and the cutting service in one process."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutError
from cut_service.planner import Plan, plan
from cut_service.strokes import Strip, Stroke
from cut_service.work import Settings
from tissue_sim.frame import Budget, Command, Cut, Frame, FrameInputs, JournalEntry, ToolSample
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.replica import Replica
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation


def knife(size: tuple[float, float], **more: Any) -> ToolSpec:
    """A blade that cuts progressively."""
    return ToolSpec("knife", "cut", "rectangle", size, cutting="progressive", **more).checked()


class Operation:
    """Frames of a simulation; strips are planned `latency` frames before their edit is applied.

    Strips that come meanwhile wait, as they do in the service.

    Attributes:
        first: The mesh before anything.
        simulation: The simulation.
        replica: What the service follows.
        entries: Journal.
        cuts: What the simulation asked for.
        edits: What was applied.
        plans: What was planned and applied.
        events: What the simulation said.
        stroke: The stroke under way, or the last one.
        plan_seconds: Time of the processor for each of the plans, bookkeeping included [s].
        empty_seconds: The same for plans that parted nothing [s].
        frame_seconds: Time of the processor for each frame of the simulation [s].
        edit_frame_seconds: The same for frames with an edit [s].
    """

    def __init__(
        self, mesh: Mesh, tool: ToolSpec, latency: int = 2, method: str = "split", **scene: Any
    ) -> None:
        self.first = copy.deepcopy(mesh)
        self.simulation = Simulation(mesh, Scene(tools=(tool,), **scene))
        self.replica = Replica()
        self.replica.take_keyframe(self.simulation.epoch, copy.deepcopy(mesh))
        self.entries: list[JournalEntry] = []
        self.cuts: list[Cut] = []
        self.edits: list[TopologyEdit] = []
        self.plans: list[Plan] = []
        self.events: list[str] = []
        self.stroke: Stroke | None = None
        self.empty_seconds: list[float] = []
        self.plan_seconds: list[float] = []
        self.edit_frame_seconds: list[float] = []
        self.frame_seconds: list[float] = []
        self._tool, self._latency, self._method = tool.id, latency, method
        self._due: tuple[int, Plan, int] | None = None

    def frame(
        self,
        pose: NDArray[np.float64],
        use: bool = True,
        edge: int = 0,
        commands: tuple[Command, ...] = (),
    ) -> Frame:
        """One frame, and what the service does meanwhile.

        Args:
            pose: Of the blade, shape (7,).
            use: Whether it is pressed.
            edge: 1: pressed in this frame, -1: released.
            commands: What else takes effect.
        """
        simulation, replica, stroke = self.simulation, self.replica, self.stroke
        number = simulation.frame + 1
        due = self._due if self._due and self._due[0] <= number else None
        edits = (due[1].edit,) if due else ()
        sample = ToolSample(self._tool, pose, number, use, edge)  # type: ignore[arg-type]
        for edit in edits:
            # As it is done beside the loop when an edit arrives.
            simulation.offer_check(simulation.mesh.check(edit))
        begin = time.process_time()
        frame = simulation.advance(FrameInputs(commands, edits, (sample,)), Budget(steps=2))
        seconds = time.process_time() - begin
        self.frame_seconds.append(seconds)
        if frame.edits:
            self.edit_frame_seconds.append(seconds)
        self.entries.append(frame.journal)
        self.events += frame.events
        for applied in frame.edits:
            self.edits.append(applied.change.edit)
            replica.take_edit(simulation.epoch, applied.change.edit)
        replica.take_state(
            simulation.epoch, simulation.mesh.version, number, frame.positions.copy()
        )
        if due and stroke and replica.mesh:
            after = replica.shape_at(due[2])
            if after is None or not frame.edits:
                raise RuntimeError(f"a strip's edit was not applied: {frame.answers}")
            begin = time.process_time()
            stroke.done(replica.mesh, after, due[1])
            self.plan_seconds[-1] += time.process_time() - begin
            self._due = None
        for cut in frame.cuts:
            self._take(cut, number)
        if self._due is None and self.stroke is not None and self.stroke.waits:
            self._plan(number)
        return frame

    def _take(self, cut: Cut, number: int) -> None:
        self.cuts.append(cut)
        strip = Strip(
            cut.stroke, cut.strip, cut.ends, cut.tool, self.simulation.epoch, number,
            cut.vertices, cut.triangles,
        )  # fmt: skip
        if self.stroke is None or self.stroke.id != cut.stroke:
            self.stroke = Stroke(strip)
        self.stroke.take(strip)

    def _plan(self, number: int) -> None:
        mesh, shape, stroke = self.replica.mesh, self.replica.shape_at(), self.stroke
        if mesh is None or shape is None or stroke is None:
            raise RuntimeError("there is nothing to plan on")
        begin = time.process_time()
        try:
            sweep, settings = stroke.pick(mesh, shape, Settings())
            made = plan(
                mesh, shape.positions, sweep, self._method, settings=settings,
                base_frame=shape.frame, request_id=f"{stroke.id}/{number}",
            )  # fmt: skip
        except CutError as error:
            if not error.code.nothing_to_cut:
                raise
            stroke.done(mesh, shape, None)
            self.empty_seconds.append(time.process_time() - begin)
            return
        self.plan_seconds.append(time.process_time() - begin)
        self.plans.append(made)
        self._due = (number + self._latency, made, shape.frame)

    def go(self, poses: Iterable[NDArray[np.float64]]) -> None:
        """Press at the first pose, go through all, release at the last, and let it finish."""
        ways = list(poses)
        self.frame(ways[0], use=True, edge=1)
        for pose in ways[1:]:
            self.frame(pose)
        self.frame(ways[-1], use=False, edge=-1)
        for _ in range(3 * self._latency + 3):
            self.frame(ways[-1], use=False)


def line(start: Any, end: Any, frames: int, turn: Any = (0.0, 0.0, 0.0, 1.0)) -> list[Any]:
    """Poses along a straight way."""
    share = np.linspace(0.0, 1.0, frames)[:, None]
    places = np.asarray(start) * (1 - share) + np.asarray(end) * share
    return [np.array([*place, *turn], dtype=np.float64) for place in places]
