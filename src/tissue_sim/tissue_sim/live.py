"""The simulation as it runs: what comes in at any time becomes the inputs of the next frame.

Other threads post; the loop thread calls `next_frame`. Posting appends to a queue that the loop
empties between frames; only edits, which are checked on the mesh when they are posted, take a lock.
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim import snapshot
from tissue_sim.commands import CommandError, checked_model
from tissue_sim.elastic.model import Model
from tissue_sim.frame import Answer, Budget, Command, Frame, FrameInputs, ToolSample
from tissue_sim.geometry.edit import REDO, UNDO, EditError, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.interaction.tracker import ToolLimits, ToolTracker
from tissue_sim.requests import Job, PlannedEdit, Request, refuse
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation


class LiveSimulation:
    """A simulation with sources of tool motion, requests and work beside the loop.

    Attributes:
        simulation: The running epoch; replaced between frames by load and reset.
        trackers: What follows each tool's source, by tool; changed by the loop thread only.
        budget: Time for model steps in each frame [s].
        steps_per_frame: Model steps in each frame; 0: by time.
        switched: Counts epochs since the start.
        prepared: What `prepare` made of the running epoch.
    """

    def __init__(
        self,
        simulation: Simulation,
        limits: ToolLimits,
        data_dir: Path,
        budget: float = 0.006,
        steps_per_frame: int = 0,
        prepare: Callable[[Simulation], Any] = lambda _simulation: None,
    ) -> None:
        """Start with no source and no request.

        Args:
            simulation: The first epoch.
            limits: What sources may do.
            data_dir: Folder of saved organs.
            budget: Time for model steps in each frame [s].
            steps_per_frame: Model steps in each frame; 0: by time.
            prepare: Makes what is wanted of a new epoch before it runs, beside the loop.
        """
        self.simulation = simulation
        self.budget, self.steps_per_frame = budget, steps_per_frame
        self.switched = 0
        self._prepare = prepare
        self.prepared = prepare(simulation)
        self.trackers: dict[str, ToolTracker] = {}
        self._limits = limits
        self._data_dir = data_dir
        self._pristine = copy.deepcopy(simulation.mesh)
        self._inbox: deque[Callable[[], None]] = deque()
        self._requests: deque[Request] = deque()
        self._edits: deque[Request] = deque()
        # Held while the mesh changes, and while somebody beside the loop reads all of it.
        self._mesh_changes = threading.Lock()
        self._job: Job | None = None
        self._saves: list[Job] = []
        self._ids = itertools.count(1)
        for tool in simulation.tools.values():
            self.trackers[tool.id] = ToolTracker(tool, limits)

    # From any thread

    def post(self, request: Request) -> None:
        """Ask for something; it is answered through `request.done`."""
        if request.kind == "edit":
            self._edits.append(self._checked(request))
        else:
            self._requests.append(request)

    def _checked(self, request: Request) -> Request:
        """The request of an edit with what can be found out about it beside the loop."""
        planned: PlannedEdit = request.arguments["planned"]
        simulation = self.simulation
        if planned.epoch != simulation.epoch:
            return request
        with self._mesh_changes:
            try:
                checked = simulation.mesh.check(planned.edit)
            except EditError:
                return request  # The loop says so, in the order of requests.
        return replace(request, arguments={"planned": replace(planned, checked=checked)})

    def post_pose(self, tool: str, pose: NDArray[np.float64], stamp: int, now: float) -> None:
        """Hand over a pose from a tool's source (see `ToolTracker.receive_pose`)."""
        self._to(tool, lambda tracker: tracker.receive_pose(pose, stamp, now))

    def post_refusal(self, tool: str, reason: str) -> None:
        """Say that a pose could not be used."""
        self._to(tool, lambda tracker: tracker.refuse_pose(reason))

    def post_use(self, tool: str, pressed: bool) -> None:
        """Hand over a level of `use`."""
        self._to(tool, lambda tracker: tracker.receive_use(pressed))

    def post_clutch(self, tool: str, engaged: bool) -> None:
        """Hand over a level of the clutch."""
        self._to(tool, lambda tracker: tracker.receive_clutch(engaged))

    def post_sources(self, tool: str, names: list[str]) -> None:
        """Say which nodes publish a tool's pose."""
        self._to(tool, lambda tracker: tracker.set_sources(names))

    def post_limits(self, limits: ToolLimits) -> None:
        """Change what sources may do."""

        def change() -> None:
            self._limits = limits
            for tracker in self.trackers.values():
                tracker.limits = limits

        self._inbox.append(change)

    def _to(self, tool: str, action: Callable[[ToolTracker], None]) -> None:
        def deliver() -> None:
            if tool in self.trackers:
                action(self.trackers[tool])

        self._inbox.append(deliver)

    # In the loop thread

    @property
    def busy_with(self) -> str:
        """What is worked on beside the loop; empty: nothing."""
        return self._job.request.kind if self._job else ""

    @property
    def loading(self) -> bool:
        """Whether a load or a reset is under way."""
        return self.busy_with in ("load", "reset")

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self.simulation.paused

    @property
    def progress(self) -> float:
        """Share of what is worked on that is done, 0 to 1, where it is known."""
        return 0.0

    def due(self, until: float) -> bool:
        """Whether there is a frame to make now; called before each.

        Args:
            until: Steady time at which whatever is done instead must be over [s].
        """
        return True

    def next_frame(self, now: float, until: float = math.inf) -> tuple[Frame, Callable[[], None]]:
        """Advance by one frame.

        Args:
            now: Local steady time [s].
            until: Steady time at which model steps must be over [s].

        Returns:
            The frame, and what answers its requests once it is published.
        """
        self._empty_inbox()
        inputs, answers_to = self._gather(now)
        frame = self._advance(inputs, self._live_budget(until))

        def answer() -> None:
            for request, result in zip(answers_to, frame.answers, strict=True):
                request.done(result)

        return frame, answer

    def _empty_inbox(self) -> None:
        for _ in range(len(self._inbox)):
            self._inbox.popleft()()

    def _gather(self, now: float) -> tuple[FrameInputs, list[Request]]:
        """What takes effect in the next frame; who asked for its commands, then for its edits."""
        commands: list[Command] = []
        answers_to: list[Request] = []
        self._finish_jobs(commands, answers_to)
        for _ in range(len(self._requests)):
            self._accept(self._requests.popleft(), commands, answers_to)
        samples = self._samples(now, commands, answers_to)
        edits = self._planned(answers_to)
        return FrameInputs(tuple(commands), edits, samples), answers_to

    def _live_budget(self, until: float) -> Budget:
        static = self.simulation.model.time_step is None
        steps = self.steps_per_frame if static else 0
        return Budget(self.budget, steps or None, until)

    def _advance(self, inputs: FrameInputs, budget: Budget) -> Frame:
        changes = inputs.edits or any(command.kind in (UNDO, REDO) for command in inputs.commands)
        with self._mesh_changes if changes else contextlib.nullcontext():
            frame = self.simulation.advance(inputs, budget)
        if frame.tools_changed:
            self._follow_tools()
        return frame

    def _samples(
        self, now: float, commands: list[Command], answers_to: list[Request]
    ) -> tuple[ToolSample, ...]:
        simulation = self.simulation
        # While time stands still what is held does not move.
        period = 0.0 if simulation.paused else 1.0 / simulation.scene.rate_hz
        samples = []
        for tool, tracker in self._sourced().items():
            holds = simulation.holds.of_tool(tool)
            busy = bool(holds) or tool in simulation.blades.strokes
            sample, let_go = tracker.sample(now, period, busy)
            samples.append(sample)
            if let_go and holds:
                commands.append(Command("release", {"hold_id": 0, "tool": tool}))
                answers_to.append(Request("release"))
        return tuple(samples)

    def _sourced(self) -> Mapping[str, ToolTracker]:
        """The tools that are moved by their sources."""
        return self.trackers

    def _planned(self, answers_to: list[Request]) -> tuple[TopologyEdit, ...]:
        """Edits for this frame; they wait while a model is built on the mesh as it is."""
        if self.busy_with == "set_model":
            return ()
        edits = []
        for _ in range(len(self._edits)):
            request = self._edits.popleft()
            planned: PlannedEdit = request.arguments["planned"]
            if self.loading:
                refuse(request, "BUSY", f"a {self.busy_with} is running")
            elif planned.epoch != self.simulation.epoch:
                refuse(
                    request,
                    "STALE",
                    f"planned in epoch {planned.epoch.hex()}; the tissue is in epoch "
                    f"{self.simulation.epoch.hex()}",
                )
            else:
                edits.append(planned.edit)
                if planned.checked:
                    self.simulation.offer_check(planned.checked)
                answers_to.append(request)
        return tuple(edits)

    def _accept(self, request: Request, commands: list[Command], answers_to: list[Request]) -> None:
        if self.loading:
            refuse(request, "BUSY", f"a {self.busy_with} is running")
        elif request.kind in (UNDO, REDO) and self.busy_with == "set_model":
            refuse(request, "BUSY", "a model is being built on the mesh as it is")
        elif request.kind == "save":
            self._save(request)
        elif request.kind in ("set_model", "load", "reset"):
            if self._job:
                refuse(request, "BUSY", f"a {self.busy_with} is running")
            else:
                self._begin(request)
        else:
            commands.append(Command(request.kind, request.arguments, request.request_id))
            answers_to.append(request)

    def _begin(self, request: Request) -> None:
        simulation, arguments = self.simulation, request.arguments
        if request.kind == "set_model":
            name, parameters = str(arguments["model"]), dict(arguments["parameters"])
            try:
                checked_model(name, parameters)
            except CommandError as error:
                refuse(request, error.code, str(error))
                return
            self._job = Job(request, lambda: simulation.build_model(name, parameters))
        elif request.kind == "load":
            try:
                snapshot.path_of(self._data_dir, str(arguments["name"]))
            except snapshot.SnapshotNameError as error:
                refuse(request, "BAD_NAME", str(error))
                return
            scene = self._scene()
            self._job = Job(request, lambda: self._loaded(str(arguments["name"]), scene))
        else:
            scene, pristine = self._scene(), self._pristine
            scene = replace(scene, displacement=simulation.scene.displacement)
            self._job = Job(request, lambda: self._epoch(pristine, scene))

    def _scene(self) -> Scene:
        """The scene to begin anew with: the model and the tools of now."""
        simulation = self.simulation
        name = simulation.model.name
        parameters = {**simulation.scene.parameters, name: simulation.model_parameters}
        tools = tuple(
            replace(tool, pose=tuple(simulation.poses[tool.id].tolist()))
            for tool in simulation.tools.values()
        )
        return replace(simulation.scene, model=name, parameters=parameters, tools=tools)

    def _loaded(self, name: str, scene: Scene) -> tuple[Simulation, Mesh, Any]:
        saved = snapshot.load(self._data_dir, name)
        displacement = saved.displacement if saved.displacement.any() else None
        return self._epoch(saved.mesh(), replace(scene, fibres=None, displacement=displacement))

    def _epoch(self, mesh: Mesh, scene: Scene) -> tuple[Simulation, Mesh, Any]:
        """A new epoch, the mesh to reset it to, and what is prepared of it."""
        simulation = Simulation(copy.deepcopy(mesh), scene)
        return simulation, mesh, self._prepare(simulation)

    def _save(self, request: Request) -> None:
        name = str(request.arguments["name"])
        try:
            snapshot.path_of(self._data_dir, name)
        except snapshot.SnapshotNameError as error:
            refuse(request, "BAD_NAME", str(error))
            return
        now = snapshot.take(self.simulation.mesh, self.simulation.state.displacement)
        self._saves.append(Job(request, lambda: snapshot.save(now, self._data_dir, name)))

    def _finish_jobs(self, commands: list[Command], answers_to: list[Request]) -> None:
        for save in [job for job in self._saves if job.over]:
            self._saves.remove(save)
            self._answer_job(save, f"saved as {save.result}")
        job = self._job
        if job is None or not job.over:
            return
        self._job = None
        if job.error:
            self._answer_job(job, "")
        elif job.request.kind == "set_model":
            self._offer(job.request, job.result, commands, answers_to)
        else:
            self._switch(job.result)
            self._answer_job(job, f"epoch {self.simulation.epoch.hex()}")

    def _offer(
        self, request: Request, model: Model, commands: list[Command], answers_to: list[Request]
    ) -> None:
        key = request.request_id or f"model-{next(self._ids)}"
        self.simulation.offer_model(key, self.simulation.mesh.version, model)
        commands.append(Command("set_model", request.arguments, key))
        answers_to.append(request)

    @staticmethod
    def _answer_job(job: Job, message: str) -> None:
        request, error = job.request, job.error
        code = "OUT_OF_RANGE" if request.kind == "set_model" else "FAILED"
        request.done(
            Answer(request.request_id, not error, error or message, code if error else "NONE")
        )

    def _switch(self, epoch: tuple[Simulation, Mesh, Any]) -> None:
        """Go on with another epoch; tools keep their sources."""
        self.simulation, self._pristine, self.prepared = epoch
        self.switched += 1
        self._follow_tools()

    def _follow_tools(self) -> None:
        tools: Mapping[str, ToolSpec] = self.simulation.tools
        for gone in [tool for tool in self.trackers if tool not in tools]:
            del self.trackers[gone]
        for tool in tools.values():
            if tool.id not in self.trackers:
                self.trackers[tool.id] = ToolTracker(tool, self._limits)
            elif self.trackers[tool.id].spec != tool:
                self.trackers[tool.id].change(tool)


def mesh_for_keyframe(mesh: Mesh) -> Mesh:
    """A copy of what a keyframe shows of a mesh; quick enough for the pause between two frames."""
    view = copy.copy(mesh)
    nodes, elements = mesh.node_rows, mesh.element_rows
    for name in ("rest", "fixed", "node_ids", "node_file_ids", "node_parents", "node_alive"):
        setattr(view, name, getattr(mesh, name)[:nodes].copy())
    for name in ("tets", "element_ids", "element_file_ids", "element_alive", "regions"):
        setattr(view, name, getattr(mesh, name)[:elements].copy())
    if mesh.sheet_rows is not None:
        view.sheet_rows = mesh.sheet_rows.copy(elements)
    return view
