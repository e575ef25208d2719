"""What a session amounted to: figures out of its bag and of the monitor's file."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim import edit_messages
from tissue_sim.geometry.edit import PATCH, REDO, UNDO
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patch_figures import patch_area
from tissue_sim.geometry.surface import surface_triangles
from viz_bridge.bag_reader import read_organ
from viz_bridge.cdr import Message
from viz_bridge.hole_figures import HoleFigures, take_holes
from viz_bridge.moments import opening
from viz_bridge.organ_follower import OrganFollower
from viz_bridge.session_events import nanoseconds

_TOPICS = (
    "tissue/topology", "tissue/edits", "tissue/state", "tissue/tools", "tissue/journal",
    "tissue/status", "tissue/holes", "/diagnostics",
)  # fmt: skip


@dataclass
class CutFigures:
    """One cut; lengths in metres."""

    version: int
    sim_time: float
    faces_split: int
    nodes_added: int
    copies: NDArray[np.int64]
    parents: NDArray[np.int64]
    plan_ms: float | None = None
    apply_ms: float | None = None
    opening: float = 0.0

    def document(self) -> dict[str, Any]:
        """As in summary.json."""
        return {
            "version": self.version,
            "sim_time": round(self.sim_time, 3),
            "faces_split": self.faces_split,
            "nodes_added": self.nodes_added,
            "plan_ms": self.plan_ms,
            "apply_ms": self.apply_ms,
            "opening_mm": round(1e3 * self.opening, 3),
        }


@dataclass
class GrabFigures:
    """One grab; lengths in metres."""

    tool: str
    sim_time: float
    tip: NDArray[np.float64]
    radius: float
    nodes: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    start: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 3), np.float32))
    moved: float = 0.0
    released: bool = False

    def document(self) -> dict[str, Any]:
        """As in summary.json."""
        return {
            "tool": self.tool,
            "sim_time": round(self.sim_time, 3),
            "nodes": len(self.nodes),
            "moved_mm": round(1e3 * self.moved, 3),
        }


class SessionFigures:
    """Gathers a session's figures while its messages go by."""

    def __init__(self) -> None:
        self._organ = OrganFollower()
        self._positions: NDArray[np.float32] | None = None
        self.cuts: list[CutFigures] = []
        self._open_cuts: list[CutFigures] = []
        self.patches: list[dict[str, Any]] = []
        self.grabs: list[GrabFigures] = []
        self.holes: dict[str, HoleFigures] = {}
        self.geometry: dict[str, Any] = {}
        self.model = ""
        self.models: list[str] = []
        self.frames = 0
        self.steps = 0
        self.journal_seconds = 0.0
        self.first_stamp = self.last_stamp = 0
        self.diagnostics: dict[str, dict[str, str]] = {}

    def take(self, topic: str, message: Message) -> None:
        """Take one message."""
        organ = self._organ
        if topic == "tissue/tools":
            organ.tools.take_list(message)
        elif topic == "tissue/status":
            self._take_status(message)
        elif topic == "tissue/topology":
            self._take_topology(message)
        elif topic == "tissue/edits":
            self._take_edit(message)
        elif topic == "tissue/state":
            self._take_state(message)
        elif topic == "tissue/journal":
            self._take_journal(message)
        elif topic == "tissue/holes":
            take_holes(self.holes, message, organ.sim_time)
        elif topic == "/diagnostics":
            self._take_diagnostics(message)

    def _take_topology(self, message: Message) -> None:
        epoch = self._organ.replica.epoch
        if not self._organ.take_topology(message) or self._organ.mesh is None:
            return
        if not self.geometry:
            self.geometry = describe(self._organ.mesh)
        if epoch != self._organ.replica.epoch:
            # Rows of another epoch mean nothing any more.
            self._open_cuts.clear()
            self._release(None)
            self._positions = None

    def _take_status(self, message: Message) -> None:
        if message.model:
            self.model = message.model
            if message.model not in self.models:
                self.models.append(message.model)

    def _take_edit(self, message: Message) -> None:
        mesh = self._organ.mesh
        if mesh is None:
            return
        before = boundary_size(mesh)
        if not self._organ.take_edit(message):
            return
        if message.kind in (UNDO, REDO):
            for cut in self._open_cuts:
                there = mesh.node_alive[cut.copies]
                cut.copies, cut.parents = cut.copies[there], cut.parents[there]
            return
        if message.kind == PATCH:
            self.patches.append(_patch_document(message, self._organ.sim_time))
            return
        changed = (message.rewritten_elements, message.removed_elements, message.added_elements)
        if not any(len(elements) for elements in changed):
            return  # Sutures cut nothing.
        self._open_cuts.append(
            CutFigures(
                version=int(message.version),
                sim_time=self._organ.sim_time,
                faces_split=(boundary_size(mesh) - before) // 2,
                nodes_added=len(message.copied_nodes),
                copies=np.asarray(message.copied_nodes, dtype=np.int64),
                parents=np.asarray(message.copy_parents, dtype=np.int64),
            )
        )
        self.cuts.append(self._open_cuts[-1])

    def _take_state(self, message: Message) -> None:
        positions = self._organ.take_state(message)
        if positions is None:
            return
        self._positions = positions
        for cut in self._open_cuts:
            cut.opening = max(cut.opening, opening(positions, cut.copies, cut.parents))
        for grab in self.grabs:
            if grab.released:
                continue
            if not len(grab.nodes):
                self._hold(grab)
            if len(grab.nodes):
                moved = np.linalg.norm(positions[grab.nodes] - grab.start, axis=1)
                grab.moved = max(grab.moved, float(moved.mean()))

    def _take_journal(self, message: Message) -> None:
        self._organ.take_journal(message)
        stamp = nanoseconds(message.header.stamp)
        self.first_stamp = self.first_stamp or stamp
        self.last_stamp = stamp
        self.frames += 1
        self.steps += int(message.steps)
        for command in message.commands:
            if command.kind == "grab":
                self._command_grab(message, command)
            elif command.kind in ("release", "reset", "load"):
                self._release(None)
        for sample in message.tools:
            tool = self._organ.tools.by_id.get(sample.id)
            if tool is None or tool.kind != "grab":
                continue
            if sample.edge > 0:
                self._grab(sample.id, message.sim_time, sample.pose, tool.size[0])
            elif sample.edge < 0:
                self._release(sample.id)

    def _command_grab(self, entry: Message, command: Message) -> None:
        arguments = json.loads(command.arguments or "{}")
        tool = self._organ.tools.by_id.get(str(arguments.get("tool", "")))
        if tool is None:
            return
        radius = float(arguments.get("radius") or 0.0) or (tool.size[0] if tool.size else 0.0)
        self._grab(tool.id, entry.sim_time, tool.pose, radius)

    def _grab(self, tool: str, sim_time: float, pose: Any, radius: float) -> None:
        tip = np.asarray(pose, dtype=np.float64)[:3].copy()
        grab = GrabFigures(tool, float(sim_time), tip, float(radius))
        self._hold(grab)
        self.grabs.append(grab)

    def _hold(self, grab: GrabFigures) -> None:
        """Find the nodes a grab took, in the newest state recorded."""
        mesh = self._organ.mesh
        if self._positions is None or mesh is None:
            return
        positions = self._positions
        count = len(positions)
        inside = np.linalg.norm(positions - grab.tip, axis=1) <= grab.radius
        inside &= mesh.node_alive[:count] & ~mesh.fixed[:count]
        for other in self.grabs:
            if not other.released and other is not grab:
                inside[other.nodes] = False
        grab.nodes = np.flatnonzero(inside)
        grab.start = positions[grab.nodes].copy()

    def _release(self, tool: str | None) -> None:
        for grab in self.grabs:
            if tool is None or grab.tool == tool:
                grab.released = True

    def _take_diagnostics(self, message: Message) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            self.diagnostics[status.name] = values
            if "last plan [ms]" not in values:
                continue
            for cut in self.cuts:
                if cut.plan_ms is None and values.get("last nodes added") == str(cut.nodes_added):
                    cut.plan_ms = float(values["last plan [ms]"])
                    cut.apply_ms = float(values.get("last apply [ms]", "nan"))


def boundary_size(mesh: Mesh) -> int:
    """Number of boundary triangles of a mesh as it is now."""
    return len(surface_triangles(mesh))


def describe(mesh: Mesh) -> dict[str, Any]:
    """Name and size of a mesh."""
    elements = {"tetrahedra": int(mesh.element_alive[: mesh.element_rows].sum())}
    if mesh.sheet is not None:
        elements = {"triangles": len(mesh.sheet.triangles)}
    return {
        "name": mesh.name,
        "nodes": int(mesh.node_alive[: mesh.node_rows].sum()),
        **elements,
    }


def summarise(
    bag: Path,
    monitor: Path | None = None,
    namespace: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """The fields of summary.json that a bag and the monitor's file give.

    Nodes held by a grab are found in the newest state recorded before it, so they are exact where
    every frame is recorded.

    Args:
        bag: Directory or file.
        monitor: What the monitor wrote; None: its figures are left out.
        namespace: Of the organ; None for the only one.
        progress: Called with the number of messages read so far.

    Returns:
        geometry, model, frames, model_steps_per_second, cuts, patches, grabs, wall_seconds; with
        the monitor published_hz, late_frames, lost_states, pose_to_state_ms, step_ms, cpu_share and
        load_average_before.

    Raises:
        ValueError: The bag cannot be read, or holds no organ.
        OSError: The monitor's file cannot be read.
    """
    figures = SessionFigures()
    for count, (topic, item) in enumerate(read_organ(bag, namespace), start=1):
        if topic in _TOPICS:
            figures.take(topic, item.message)
        if progress is not None:
            progress(count)
    seconds = (figures.last_stamp - figures.first_stamp) / 1e9
    document: dict[str, Any] = {
        "geometry": figures.geometry,
        "model": figures.model,
        "models": figures.models,
        "frames": figures.frames,
        "model_steps": figures.steps,
        "model_steps_per_second": figures.steps / seconds if seconds > 0 else 0.0,
        "cuts": [cut.document() for cut in figures.cuts],
        "patches": figures.patches,
        "grabs": [grab.document() for grab in figures.grabs],
        "holes": [hole.document() for hole in figures.holes.values()],
        "wall_seconds": seconds,
    }
    diagnostics = figures.diagnostics
    if monitor is not None:
        counted = json.loads(Path(monitor).read_text(encoding="utf-8"))
        for name in (
            "published_hz", "late_frames", "skipped_frames", "lost_states", "pose_to_state_ms",
            "cpu_share", "load_average_before",
        ):  # fmt: skip
            document[name] = counted.get(name)
        document["frames_received"] = counted.get("frames")
        diagnostics = {**diagnostics, **counted.get("diagnostics", {})}
    document["step_ms"] = step_times(diagnostics)
    return document


def _patch_document(message: Message, sim_time: float) -> dict[str, Any]:
    """A patch as in summary.json."""
    edit = edit_messages.edit_from_msg(message)
    return {
        "version": int(message.version),
        "sim_time": round(sim_time, 3),
        "name": edit.added_patches[0].name,
        "nodes": len(edit.born_nodes),
        "area_cm2": round(1e4 * patch_area(edit), 3),
        "carried_by": edit.held_by,
    }


def step_times(diagnostics: dict[str, dict[str, str]]) -> dict[str, float]:
    """p50, p99 and max of a frame's stepping [ms] as the simulation's diagnostics report it."""
    found: dict[str, float] = {}
    for values in diagnostics.values():
        for key, value in values.items():
            words = key.lower().replace("_", " ").replace("[ms]", "").replace(" ms", "").split()
            if words[:1] == ["step"] and len(words) == 2 and words[1] in ("p50", "p99", "max"):
                found[words[1]] = float(value)
    return found
