"""A procedure played with the simulation and the cutting service in one process, without ROS.

It is a rehearsal: simulated time, as many steps in each frame as it is told, and requests that are
answered at once. What is planned is what the services plan.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cut_service.patching import Wanted, plan_patch
from cut_service.planner import METHODS, plan
from cut_service.rim import patch_of, plan_rim
from cut_service.suturing import Sewing, chosen, plan_removal, plan_sewing, plan_tightening
from cut_service.sweep import Sweep
from tissue_sim.frame import Budget, Command, Frame, FrameInputs, JournalEntry, ToolSample
from tissue_sim.geometry.closure import Closure
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.holes import Hole, name_hole
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction import rigid
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

ALL = "all"


class StageError(RuntimeError):
    """A request of the procedure failed, or the simulation refused its edit."""


class Pose(Protocol):
    """Where a tool is."""

    @property
    def position(self) -> NDArray[np.float64]:
        """Of the tip [m], shape (3,)."""

    @property
    def quaternion(self) -> NDArray[np.float64]:
        """Its orientation, x y z w."""


@dataclass(frozen=True)
class Done:
    """A request that was carried out.

    Attributes:
        action: What the procedure calls it.
        target: Its name; empty: none.
        frame: Frame of its edit.
        version: Version it made.
    """

    action: str
    target: str
    frame: int
    version: int


class Stage:
    """Where a `tool_input.player.Player` plays a procedure; `frame` goes on by one frame.

    Attributes:
        simulation: The simulation.
        entries: Its journal.
        done: The requests carried out.
        closures: Frame, name of the hole and its closure at each step that asked for it.
        events: What the simulation said.
        shape: Positions after the last frame [m], shape (node_rows, 3).
    """

    def __init__(self, mesh: Mesh, scene: Scene, steps: int | None = None) -> None:
        """Stand before the first frame.

        Args:
            mesh: The organ; changed in place.
            scene: Model, material and tools, those of the procedure among them.
            steps: Model steps in a frame; None: as many as take 6 ms, or as the model's time step
                demands.
        """
        self.simulation = Simulation(mesh, scene)
        self.entries: list[JournalEntry] = []
        self.done: list[Done] = []
        self.closures: list[tuple[int, str, Closure]] = []
        self.holes: dict[str, Hole] = {}
        self.events: list[str] = []
        self.shape = mesh.rest[: mesh.node_rows].copy()
        self._budget = Budget(steps=steps)
        self._poses: dict[str, NDArray[np.float64]] = {}
        self._pressed: dict[str, bool] = {}
        self._edges: dict[str, int] = {}
        self._commands: list[tuple[Any, Command]] = []
        self._edits: list[tuple[Any, TopologyEdit]] = []
        self._sewn: dict[str, NDArray[np.uint32]] = {}

    # What the player calls

    def pose(self, tool: str, pose: Pose) -> None:
        """Put a tool somewhere."""
        if not self._edges.get(tool):
            self._poses[tool] = np.concatenate([pose.position, pose.quaternion])

    def use(self, tool: str, pressed: bool) -> None:
        """Press or release a tool."""
        if self._pressed.get(tool, False) != pressed:
            self._edges[tool] = 1 if pressed else -1
        self._pressed[tool] = pressed

    def act(self, event: Any) -> None:
        """Plan what an event asks for; it is applied in the next frame."""
        planner = _PLANNERS.get(event.action)
        try:
            if planner is not None:
                edit = planner(self, event)
                name = f"{event.action}-{event.time:g}"
                self._edits.append((event, replace(edit, request_id=name)))
            elif event.action == "closure":
                self._ask(event)
            elif event.action in _COMMANDS:
                kind, arguments = _COMMANDS[event.action](event)
                self._commands.append((event, Command(kind, arguments)))
            elif event.action != "label":
                raise StageError(f"{event.action} cannot be rehearsed")
        except ValueError as error:
            raise StageError(f"{event.where}: {event} failed: {error}") from error

    # What drives it

    def frame(self) -> Frame:
        """Go on by one frame.

        Raises:
            StageError: The simulation refused something.
        """
        number = self.simulation.frame + 1
        tools = tuple(
            ToolSample(tool, pose, number, self._pressed[tool], self._edges.pop(tool, 0))  # type: ignore[arg-type]
            for tool, pose in self._poses.items()
        )
        commands, self._commands = self._commands, []
        edits, self._edits = self._edits, []
        inputs = FrameInputs(
            tuple(command for _, command in commands), tuple(edit for _, edit in edits), tools
        )
        frame = self.simulation.advance(inputs, self._budget)
        self.entries.append(frame.journal)
        self.events += frame.events
        self.shape = frame.positions.astype(np.float64)
        for (event, _), answer in zip([*commands, *edits], frame.answers, strict=True):
            if not answer.success:
                raise StageError(f"{event.where}: {event} was refused: {answer.message}")
            self.done.append(Done(event.action, event.target, number, self.simulation.mesh.version))
        for applied in frame.edits:
            self._remember(applied.change.edit, [event for event, _ in edits])
        return frame

    def play(self, player: Any, on_frame: Callable[[Frame], None] | None = None) -> None:
        """Play a procedure to its end.

        Args:
            player: A `tool_input.player.Player` of this stage.
            on_frame: Called after each frame.
        """
        player.begin()
        period = 1.0 / self.simulation.scene.rate_hz
        while not player.over:
            player.advance(player.time + period)
            frame = self.frame()
            if on_frame is not None:
                on_frame(frame)

    # Plans

    def _remember(self, edit: TopologyEdit, events: list[Any]) -> None:
        for event in events:
            if (
                event.action in ("suture", "sew_rim")
                and edit.request_id == f"{event.action}-{event.time:g}"
            ):
                self._sewn[event.target] = edit.added_sutures

    def _cut(self, event: Any) -> TopologyEdit:
        sweep = Sweep.from_arrays(event.sweep.vertices, event.sweep.triangles)
        method = event.method or METHODS[0]
        return plan(self.simulation.mesh, self.shape, sweep, method).edit

    def _sew(self, event: Any) -> TopologyEdit:
        wanted = event.stitching
        sewing = Sewing(
            wanted.positions, wanted.spacing, wanted.running, wanted.reach, wanted.stiffness,
            event.value,
        )  # fmt: skip
        return plan_sewing(self.simulation.mesh, self.shape, sewing)

    def _patch(self, event: Any) -> TopologyEdit:
        item = event.patch
        corners, normal = item.corners, None
        if corners.shape[1] == 2:
            pose = np.concatenate([item.pose.position, item.pose.quaternion])
            flat = np.append(corners, np.zeros((len(corners), 1)), axis=1)
            corners = rigid.to_world(pose, flat)
            normal = rigid.to_world(pose, np.array([[0.0, 0.0, 1.0]]))[0] - item.pose.position
        wanted = Wanted(
            corners, normal, item.thickness, item.young_modulus, item.density, item.edge, item.name,
            item.tool,
        )  # fmt: skip
        return plan_patch(self.simulation.mesh, self.shape, wanted).edit

    def _sew_rim(self, event: Any) -> TopologyEdit:
        mesh, wanted = self.simulation.mesh, event.stitching
        loop, reach = wanted.positions, wanted.reach
        if wanted.hole:
            loop = self.holes[wanted.hole].loop(mesh, self.shape)
        sewing = Sewing(loop, wanted.spacing, wanted.running, reach, wanted.stiffness, event.value)
        return plan_rim(mesh, self.shape, patch_of(mesh, 0, wanted.patch), sewing)

    def _ask(self, event: Any) -> None:
        mesh, wanted, name = self.simulation.mesh, event.hole, event.target
        if len(wanted.loop):
            self.holes[name] = name_hole(
                mesh, self.shape, name, wanted.loop, wanted.reach, wanted.depth
            )
        closure = self.holes[name].closure(mesh, self.shape)
        self.closures.append((self.simulation.frame, name, closure))

    def _tighten(self, event: Any) -> TopologyEdit:
        sutures = chosen(self.simulation.mesh.sutures, self._named(event.target), 0)
        return plan_tightening(self.simulation.mesh, self.shape, sutures, event.value)

    def _unsew(self, event: Any) -> TopologyEdit:
        sutures = chosen(self.simulation.mesh.sutures, self._named(event.target), 0)
        return plan_removal(self.simulation.mesh, sutures)

    def _named(self, name: str) -> NDArray[np.uint32]:
        if name == ALL:
            return np.empty(0, dtype=np.uint32)
        if name not in self._sewn:
            raise StageError(f"{name} has not been sewn")
        return self._sewn[name]


_PLANNERS: dict[str, Callable[[Stage, Any], TopologyEdit]] = {
    "cut": Stage._cut,
    "suture": Stage._sew,
    "patch": Stage._patch,
    "sew_rim": Stage._sew_rim,
    "tighten": Stage._tighten,
    "unsuture": Stage._unsew,
}

_COMMANDS: dict[str, Callable[[Any], tuple[str, dict[str, Any]]]] = {
    "grab": lambda event: ("grab", {"tool": event.target, "radius": event.value}),
    "let_go": lambda event: ("release", {"tool": event.target}),
    "model": lambda event: ("set_model", {"model": event.target, "parameters": event.parameters}),
    "pause": lambda event: ("pause", {"on": bool(event.value)}),
    "undo": lambda _: ("undo", {}),
    "redo": lambda _: ("redo", {}),
}
