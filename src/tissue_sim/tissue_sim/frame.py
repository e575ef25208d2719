"""What goes into one frame of the simulation and what comes out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import EditChange, TopologyEdit

Edge = Literal[-1, 0, 1]


@dataclass(frozen=True)
class Command:
    """A change that takes effect at the start of a frame.

    Attributes:
        kind: grab, release, set_model, set_tool, remove_tool, pause, undo, redo or start.
        arguments: What it needs; plain JSON values, so that the journal keeps it exactly.
        request_id: Id of the request it came from; empty: none.
    """

    kind: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    request_id: str = ""


@dataclass(frozen=True)
class ToolSample:
    """One tool as it is used in one frame.

    Attributes:
        tool: Id of the tool.
        pose: Its pose as used, in the organ frame: x y z [m] and quaternion x y z w, shape (7,).
        stamp: Stamp of the pose that was applied [ns].
        use: Level of use.
        edge: 1: pressed in this frame, -1: released in this frame, 0: no change.
    """

    tool: str
    pose: NDArray[np.float64]
    stamp: int = 0
    use: bool = False
    edge: Edge = 0


@dataclass(frozen=True)
class FrameInputs:
    """Everything that takes effect in one frame, in this order."""

    commands: tuple[Command, ...] = ()
    edits: tuple[TopologyEdit, ...] = ()
    tools: tuple[ToolSample, ...] = ()


@dataclass(frozen=True)
class Budget:
    """How much a frame may step: for some time, or a fixed number of steps.

    Attributes:
        seconds: Time for stepping [s]. Ignored by dynamic models, which always make
            1 / (rate x time step) steps.
        steps: Exactly so many steps, whatever the model; None to go by time.
        until: Steady time (`time.perf_counter`) at which stepping must be over [s], however late
            it began; like `seconds`, at least one step is made.
    """

    seconds: float = 0.006
    steps: int | None = None
    until: float = math.inf


@dataclass(frozen=True)
class Answer:
    """What became of a command or an edit.

    Attributes:
        request_id: Id of the request.
        success: Whether it took effect.
        message: What a person should know.
        error: Name of the error in the service's constants, such as "STALE"; "NONE" on success.
        values: What the request asked for, such as a hold's id.
    """

    request_id: str
    success: bool
    message: str = ""
    error: str = "NONE"
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class AppliedEdit:
    """An edit that took effect in a frame.

    Attributes:
        change: What it touched.
        plan: The edit as it was requested.
        seconds: Time it took inside the frame [s].
        hold: Id of the hold that carries the patch it added; 0: none.
    """

    change: EditChange
    plan: TopologyEdit
    seconds: float
    hold: int = 0


@dataclass(frozen=True)
class Cut:
    """A cutting tool was used: the sweep of its blade in the organ frame.

    Without a stroke it is a cut of its own; the cuts of one stroke follow one another.

    Attributes:
        tool: Id of the tool.
        stamp: Stamp of its pose [ns].
        vertices: Corners of the sweep [m], shape (n, 3).
        triangles: Corner rows of its triangles, shape (m, 3).
        stroke: Id of the stroke of a tool that cuts progressively; empty: none.
        strip: Counts the cuts of the stroke from 0.
        ends: Whether it is the stroke's last; it may then be without triangles.
    """

    tool: str
    stamp: int
    vertices: NDArray[np.float64]
    triangles: NDArray[np.uint32]
    stroke: str = ""
    strip: int = 0
    ends: bool = False


@dataclass(frozen=True)
class JournalEntry:
    """What one frame applied; with the mesh at the epoch's start, all that a replay needs.

    Attributes:
        epoch: Id of the epoch, 16 bytes.
        frame: Counts up from 1.
        version: Version of the mesh after the frame.
        sim_time: Simulated time after the frame [s].
        steps: Model steps done.
        inputs: What took effect; edits are those that were accepted, as they were planned.
        crc32: Checksum of the frame's positions.
    """

    epoch: bytes
    frame: int
    version: int
    sim_time: float
    steps: int
    inputs: FrameInputs
    crc32: int


@dataclass(frozen=True)
class Frame:
    """What came out of one frame.

    Attributes:
        positions: Current positions [m], float32, shape (node_rows, 3). Valid until the next frame
            but one: two buffers take turns.
        journal: What went in, and the checksum of what came out.
        wrenches: Force [N] and torque about the tip [N m] on each tool that holds tissue, shape
            (6,); neither bounded nor smoothed (see `interaction.reaction`).
        answers: What became of commands and edits, in order.
        edits: Edits applied, those of undo and redo first. The journal has those as commands.
        cuts: Sweeps of cutting tools used in this frame.
        events: What happened besides, in words: holds released because their nodes vanished, ...
        step_seconds: Time of each step [s], shape (steps,).
        stepped_at: Steady time at which the last step was done [s].
        lost: Why the state was lost and restored; empty: it was not.
        tools_changed: Whether tools were set or removed.
    """

    positions: NDArray[np.float32]
    journal: JournalEntry
    wrenches: Mapping[str, NDArray[np.float64]]
    answers: tuple[Answer, ...]
    edits: tuple[AppliedEdit, ...]
    cuts: tuple[Cut, ...]
    events: tuple[str, ...]
    step_seconds: NDArray[np.float64]
    stepped_at: float
    lost: str
    tools_changed: bool
