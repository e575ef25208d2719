"""A procedure: what tools do when, read from a YAML file (format: docs/tool_input.md)."""

from __future__ import annotations

import bisect
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tool_input.located_yaml import Item, read_located, read_located_file
from tool_input.motion import Motion, Pose
from tool_input.patch_items import KEYS as PATCH_KEYS
from tool_input.patch_items import PatchItem, patch_of
from tool_input.procedure_items import (
    SIZES,
    Stitching,
    pose_of,
    rest_length_of,
    rotation_of,
    stitching_of,
    sweep_of,
)
from tool_input.rim_items import HoleItem, hole_of, rim_of

TOP_KEYS = ("title", "units", "frame_id", "tools", "timeline", "end")
TOOL_KEYS = ("kind", "shape", "size", "start", "cutting", "response")
RESPONSES = ("toughness", "friction", "puncture_force", "puncture_depth")
MOVE_KEYS = ("at", "move", "to", "by", "turn", "orientation", "for", "path", "through")
ACTIONS = {
    "label": (),
    "move": MOVE_KEYS,
    "press": (),
    "release": (),
    "use": ("for",),
    "cut": ("method",),
    "grab": ("radius",),
    "let_go": (),
    "model": ("parameters",),
    "pause": (),
    "reset": (),
    "undo": (),
    "redo": (),
    "suture": ("name", "spacing", "running", "length", "share", "reach", "stiffness"),
    "tighten": ("length", "share"),
    "unsuture": (),
    "patch": (),
    "sew_rim": ("name", "spacing", "running", "length", "share", "reach", "stiffness"),
    "closure": ("loop", "reach", "depth"),
}
"""Actions of the timeline, and the keys each may have besides itself and `at`."""

SHAPES = {
    "grab": ("sphere", "box", "capsule"),
    "cut": ("rectangle", "triangle"),
    "patch": ("rectangle",),
    "probe": ("sphere", "capsule"),
}
"""Shapes of tools by kind; of other kinds they are spheres."""

DEFAULT_USE_SECONDS = 0.1

MAKES_SUTURES = ("suture", "sew_rim")
"""Actions whose stitches have a name from then on."""

ALL_SUTURES = "all"
"""What `tighten` and `unsuture` call everything that is sewn."""


@dataclass(frozen=True)
class ProcedureTool:
    """A tool of a procedure.

    Attributes:
        name: Its name in topics.
        kind: "grab", "cut", "burn", "patch" or "probe".
        shape: "sphere", "rectangle" or "triangle"; empty: as the scene has it.
        size: Its size [m] as in Tool.msg; empty: as the scene has it.
        start: Where it is before its first motion.
        cutting: How a blade cuts: "at_use" or "progressive"; empty: as the scene has it.
        response: What tissue does to the blade: toughness [J/m^2], friction [N/m], puncture_force
            [N] and puncture_depth [m]; those left out are the defaults.
    """

    name: str
    kind: str
    shape: str
    size: tuple[float, ...]
    start: Pose
    cutting: str = ""
    response: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SweepShape:
    """Triangles that a cut follows.

    Attributes:
        vertices: Corners [m] in the procedure's frame, shape (n, 3).
        triangles: Three rows of `vertices` each, shape (m, 3).
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.uint32]


@dataclass(frozen=True)
class Event:
    """Something that happens at once.

    Attributes:
        time: When [s].
        action: One of `ACTIONS` but "move" and "use", which are taken apart when the file is read.
        target: Tool, model, name of stitches, of a patch or of a hole, or text of the label; empty
            where the action needs none.
        value: Radius [m] of a grab, rest length [m] of stitches (negative: as long as they are
            times -value), or whether to pause.
        method: Method of a cut; empty: the service's default.
        sweep: What a cut follows.
        stitching: What is sewn.
        patch: What patch is added.
        hole: What hole is named or asked for.
        parameters: Parameters of a model.
        where: File and line.
    """

    time: float
    action: str
    target: str = ""
    value: float = 0.0
    method: str = ""
    sweep: SweepShape | None = None
    stitching: Stitching | None = None
    patch: PatchItem | None = None
    hole: HoleItem | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    where: str = ""

    def __str__(self) -> str:
        if self.action == "pause":
            return "pause" if self.value else "continue"
        return f"{self.action} {self.target}".strip()

    def needs(self, earlier: Event) -> bool:
        """Whether it names what an earlier event makes: stitches, a patch or a hole."""
        if earlier.action in MAKES_SUTURES:
            alters = self.action in ("tighten", "unsuture")
            return alters and self.target in (earlier.target, ALL_SUTURES)
        if earlier.action == "patch":
            return self.stitching is not None and self.stitching.patch == earlier.target != ""
        if earlier.hole is not None and len(earlier.hole.loop):
            named = self.stitching.hole if self.stitching is not None else ""
            return earlier.target in (named, self.target if self.hole is not None else "")
        return False


@dataclass(frozen=True)
class Procedure:
    """What tools do when.

    Attributes:
        title: What people call it.
        frame_id: Frame of all poses and sweeps.
        tools: The tools by name.
        motions: Each tool's motions in order of time, without overlap.
        events: Everything else in order of time.
        end: Length [s].
    """

    title: str
    frame_id: str
    tools: dict[str, ProcedureTool]
    motions: dict[str, list[Motion]]
    events: list[Event]
    end: float

    def pose(self, tool: str, time: float) -> Pose:
        """Where a tool is at a time [s]."""
        motions = self.motions[tool]
        index = bisect.bisect_right([motion.start for motion in motions], time) - 1
        return self.tools[tool].start if index < 0 else motions[index].at(time)

    def pressed(self, tool: str, time: float) -> bool:
        """Whether a tool is used at a time [s]."""
        level = False
        for event in self.events:
            if event.time > time:
                break
            if event.target == tool and event.action in ("press", "release"):
                level = event.action == "press"
        return level


def load_procedure(path: Path) -> Procedure:
    """Read a procedure from a file.

    Raises:
        ProcedureError: The file cannot be read or played; the message names the line.
    """
    return _Reader(read_located_file(path)).procedure()


def parse_procedure(text: str, source: str = "procedure") -> Procedure:
    """Read a procedure from a text.

    Raises:
        ProcedureError: It cannot be played; the message names the line.
    """
    return _Reader(read_located(text, source)).procedure()


class _Reader:
    """Turns the items of one file into a procedure."""

    def __init__(self, root: Item) -> None:
        self.top = root.mapping(TOP_KEYS, ("units", "tools", "timeline"))
        self.scale = 1e-3 if self.top["units"].one_of(("m", "mm")) == "mm" else 1.0
        self.tools = {
            name: self._tool(name, item) for name, item in self.top["tools"].entries().items()
        }
        self.places = {name: tool.start for name, tool in self.tools.items()}
        self.motions: dict[str, list[Motion]] = {name: [] for name in self.tools}
        self.events: list[Event] = []
        self.sewn: set[str] = set()
        self.patched: set[str] = set()
        self.holes: set[str] = set()
        self.levels: dict[str, list[tuple[float, bool, Item]]] = {name: [] for name in self.tools}

    def procedure(self) -> Procedure:
        steps = [(item, self._step(item)) for item in self.top["timeline"].list()]
        if not steps:
            raise self.top["timeline"].error("has no step")
        previous = 0.0
        for item, (time, action, keys) in steps:
            if time < previous:
                raise keys["at"].error(
                    f"{time:g} s comes before the step above it ({previous:g} s); "
                    "steps must be in order of time"
                )
            previous = time
            self._read(item, time, action, keys)
        self._check_levels()
        end = self._end()
        title = self.top["title"].text() if "title" in self.top else "procedure"
        frame = self.top["frame_id"].text() if "frame_id" in self.top else "organ"
        events = sorted(self.events, key=lambda event: event.time)
        return Procedure(title, frame, self.tools, self.motions, events, end)

    def _tool(self, name: str, item: Item) -> ProcedureTool:
        if not name.isidentifier():
            raise item.error(
                "a tool's name must be letters, digits and _, not starting with a digit"
            )
        keys = item.mapping(TOOL_KEYS, ("kind", "start"))
        kind = keys["kind"].one_of(("grab", "cut", "burn", "patch", "probe"))
        shape, size = "", ()
        if "shape" in keys or "size" in keys:
            item.mapping(TOOL_KEYS, ("shape", "size"))
            shapes = SHAPES.get(kind, ("sphere",))
            shape = keys["shape"].one_of(shapes)
            numbers = keys["size"].vector(SIZES[shape])
            if not (numbers > 0).all():
                raise keys["size"].error("must be greater than 0")
            size = tuple((numbers * self.scale).tolist())
        cutting, response = self._cutting(item, kind, keys)
        start = pose_of(keys["start"], self.scale)
        return ProcedureTool(name, kind, shape, size, start, cutting, response)

    @staticmethod
    def _cutting(item: Item, kind: str, keys: dict[str, Item]) -> tuple[str, dict[str, float]]:
        if "cutting" not in keys:
            if "response" in keys:
                raise keys["response"].error("goes with cutting: progressive")
            return "", {}
        cutting = keys["cutting"].one_of(("at_use", "progressive"))
        if kind != "cut":
            raise item.error("only a cut tool has the key 'cutting'")
        given = keys["response"].mapping(RESPONSES) if "response" in keys else {}
        return cutting, {name: value.number(minimum=0.0) for name, value in given.items()}

    def _step(self, item: Item) -> tuple[float, str, dict[str, Item]]:
        every_key = {"at", *ACTIONS}.union(*ACTIONS.values())
        keys = item.mapping(sorted(every_key), ("at",))
        actions = [key for key in keys if key in ACTIONS]
        if len(actions) != 1:
            raise item.error(
                f"must have exactly one action, not {len(actions)}; allowed: {', '.join(ACTIONS)}"
            )
        item.mapping({"at", actions[0], *ACTIONS[actions[0]]})
        return keys["at"].number(minimum=0.0), actions[0], keys

    def _read(self, item: Item, time: float, action: str, keys: dict[str, Item]) -> None:
        subject = keys[action]
        if action == "move":
            self._move(item, time, self._known(subject), keys)
        elif action in ("press", "release", "use"):
            self._use(time, action, keys)
        elif action == "cut":
            method = keys["method"].text() if "method" in keys else ""
            vertices, triangles = sweep_of(subject, self.scale)
            sweep = SweepShape(vertices, triangles)
            self._add(item, time, action, method=method, sweep=sweep)
        elif action == "grab":
            radius = keys["radius"].number(above=0.0) * self.scale if "radius" in keys else 0.0
            self._add(item, time, action, self._known(subject, "grab"), value=radius)
        elif action == "let_go":
            self._add(item, time, action, self._known(subject, "grab"))
        elif action == "model":
            entries = keys["parameters"].entries() if "parameters" in keys else {}
            parameters = {name: entry.number() for name, entry in entries.items()}
            self._add(item, time, action, subject.text(), parameters=parameters)
        elif action == "label":
            self._add(item, time, action, subject.text())
        elif action == "pause":
            self._add(item, time, action, value=float(subject.flag()))
        elif action in ("suture", "sew_rim", "tighten", "unsuture"):
            self._sew(item, time, action, keys)
        elif action == "closure":
            self._hole(item, time, keys)
        elif action == "patch":
            self._patch(item, time, subject)
        elif action in ("reset", "undo", "redo"):
            if not subject.flag():
                raise subject.error("must be true")
            self._add(item, time, action)

    def _sew(self, item: Item, time: float, action: str, keys: dict[str, Item]) -> None:
        subject, stitching = keys[action], None
        if action in MAKES_SUTURES:
            name = keys["name"].text() if "name" in keys else ""
            if name in (*self.sewn, ALL_SUTURES):
                raise keys["name"].error(f"{name!r} is taken")
            self.sewn |= {name} - {""}
            read = stitching_of if action == "suture" else rim_of
            stitching = read(subject, keys, self.scale)
            self._refuse_unknown(subject, stitching)
        else:
            name = subject.text()
            if name not in (*self.sewn, ALL_SUTURES):
                known = ", ".join([*sorted(self.sewn), ALL_SUTURES])
                raise subject.error(f"nothing was sewn as {name!r} before; allowed: {known}")
        length = rest_length_of(item, keys, self.scale)
        if action == "tighten" and not {"length", "share"} & set(keys):
            raise item.error("must have either length or share")
        event = Event(time, action, name, length, stitching=stitching, where=item.where)
        self.events.append(event)

    def _refuse_unknown(self, item: Item, stitching: Stitching) -> None:
        for what, name, there in (
            ("patch", stitching.patch, self.patched),
            ("hole", stitching.hole, self.holes),
        ):
            if name and name not in there:
                known = ", ".join(sorted(there)) or "none"
                raise item.error(f"there is no {what} {name!r} before this step; known: {known}")

    def _hole(self, item: Item, time: float, keys: dict[str, Item]) -> None:
        name = keys["closure"].text()
        hole = hole_of(item, keys, self.scale)
        if len(hole.loop):
            self.holes.add(name)
        elif name not in self.holes:
            known = ", ".join(sorted(self.holes)) or "none"
            raise item.error(
                f"no hole was named {name!r} before this step, with a loop; known: {known}"
            )
        self.events.append(Event(time, "closure", name, hole=hole, where=item.where))

    def _patch(self, item: Item, time: float, subject: Item) -> None:
        patch = patch_of(subject, self.scale)
        if patch.name in self.patched:
            raise subject.error(f"the name {patch.name!r} is taken")
        if patch.tool:
            self._known(subject.mapping(PATCH_KEYS)["carried_by"])
        self.patched |= {patch.name} - {""}
        self.events.append(Event(time, "patch", patch.name, patch=patch, where=item.where))

    def _add(
        self,
        item: Item,
        time: float,
        action: str,
        target: str = "",
        value: float = 0.0,
        method: str = "",
        sweep: SweepShape | None = None,
        parameters: dict[str, float] | None = None,
    ) -> None:
        event = Event(
            time, action, target, value, method, sweep, parameters=parameters or {},
            where=item.where,
        )  # fmt: skip
        self.events.append(event)

    def _known(self, item: Item, kind: str = "") -> str:
        name = item.text()
        if name not in self.tools:
            raise item.error(f"unknown tool {name!r}; known: {', '.join(self.tools) or 'none'}")
        if kind and self.tools[name].kind != kind:
            raise item.error(f"{name} is a {self.tools[name].kind} tool; a {kind} tool is needed")
        return name

    def _use(self, time: float, action: str, keys: dict[str, Item]) -> None:
        subject = keys[action]
        tool = self._known(subject)
        changes = [(time, action != "release")]
        if action == "use":
            seconds = keys["for"].number(above=0.0) if "for" in keys else DEFAULT_USE_SECONDS
            changes.append((time + seconds, False))
        for when, pressed in changes:
            self.levels[tool].append((when, pressed, subject))
            self._add(subject, when, "press" if pressed else "release", tool)

    def _check_levels(self) -> None:
        for tool, changes in self.levels.items():
            level, last = False, -1.0
            for time, pressed, item in changes:
                if time < last:
                    raise item.error(f"{tool} is still in use until {last:g} s")
                if pressed == level:
                    state = "pressed" if level else "not pressed"
                    raise item.error(f"{tool} is {state} already at {time:g} s")
                level, last = pressed, time

    def _move(self, item: Item, time: float, tool: str, keys: dict[str, Item]) -> None:
        earlier = self.motions[tool]
        if earlier and time < earlier[-1].end:
            raise item.error(
                f"{tool} is still moving until {earlier[-1].end:g} s; motions must not overlap"
            )
        legs = [keys]
        if "path" in keys:
            if {"to", "by", "turn", "orientation", "for"} & set(keys):
                raise item.error("has a path: the poses and times belong inside of it")
            allowed = ("to", "by", "turn", "orientation", "for")
            legs = [leg.mapping(allowed, ("for",)) for leg in keys["path"].list()]
            if not legs:
                raise keys["path"].error("has no pose")
        elif "for" not in keys:
            raise item.error("the key 'for' is missing: how many seconds the motion takes")
        times, poses = [time], [self.places[tool]]
        for leg in legs:
            times.append(times[-1] + leg["for"].number(above=0.0))
            poses.append(self._next(item, poses[-1], leg))
        through = keys["through"].flag() if "through" in keys else False
        earlier.append(Motion(times, poses, through))
        self.places[tool] = poses[-1]

    def _next(self, item: Item, pose: Pose, leg: dict[str, Item]) -> Pose:
        if not {"to", "by", "turn", "orientation"} & set(leg):
            raise item.error("must say where the tool goes: to, by, turn or orientation")
        if ("to" in leg and "by" in leg) or ("turn" in leg and "orientation" in leg):
            raise item.error("either to or by, and either orientation or turn")
        position, rotation = pose.position, pose.quaternion
        if "to" in leg:
            position = leg["to"].vector(3) * self.scale
        if "by" in leg:
            position = position + leg["by"].vector(3) * self.scale
        if "orientation" in leg:
            rotation = rotation_of(leg["orientation"]).as_quat()
        if "turn" in leg:
            turn = rotation_of(leg["turn"])
            rotation = (turn * turn.from_quat(pose.quaternion)).as_quat()
        return Pose(position, rotation)

    def _end(self) -> float:
        ends = [motion.end for motions in self.motions.values() for motion in motions]
        ends += [event.time for event in self.events]
        last = max(ends)
        if "end" not in self.top:
            return last
        end = self.top["end"].number(above=0.0)
        if end < last:
            raise self.top["end"].error(f"{end:g} s comes before the last step ends ({last:g} s)")
        return end
