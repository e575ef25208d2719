"""What is known of a recorded session, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.report.cut_surface import CutSurface

Reals = NDArray[np.float64]


@dataclass(frozen=True)
class Missing:
    """Why something is not known of a session; never taken for 0.

    Attributes:
        why: In words, such as "not recorded: tissue/readings".
    """

    why: str

    def __str__(self) -> str:
        return self.why


def not_recorded(topic: str) -> Missing:
    """What to say where a topic is not in the bag."""
    return Missing(f"not recorded: {topic}")


@dataclass(frozen=True)
class Event:
    """One thing that happened.

    Attributes:
        time: When in the session [s].
        kind: press, release, cut, suture, patch, undo, redo, pause, warning, label, frozen, or the
            kind of another command.
        text: In words.
        tool: The tool it is about; empty: none.
    """

    time: float
    kind: str
    text: str
    tool: str = ""


@dataclass(frozen=True)
class Series:
    """A quantity over time.

    Attributes:
        times: Ascending [s], shape (n,).
        values: Shape (n,).
    """

    times: Reals
    values: Reals


@dataclass(frozen=True)
class ToolTrack:
    """Where a tool was and what it was used for.

    Attributes:
        tool: Its id.
        kind: grab, cut, burn, patch or probe.
        positions: Of its tip in the organ's frame at the session's times [m], shape (n, 3).
        pressed: Whether it was used then, shape (n,).
        force: Magnitude of the force on it [N].
    """

    tool: str
    kind: str
    positions: Reals
    pressed: NDArray[np.bool_]
    force: Series | Missing


@dataclass(frozen=True)
class StressHistory:
    """Largest stress of the tissue over time; of a sheet the largest strain of its springs.

    Attributes:
        quantity: Its name in `tissue_sim.readings.fields`.
        unit: Its unit; empty: a plain number.
        peak: Its largest value at a node.
        source: Where it comes from, in words.
    """

    quantity: str
    unit: str
    peak: Series
    source: str


@dataclass(frozen=True)
class RiskViolation:
    """A warning of a risk region, from its begin to its end.

    Attributes:
        region: Name of the region.
        what: near, touched, cut or stress.
        tool: Id of the tool; empty: none.
        begin: [s].
        end: [s]; that of the session if it was still on.
        worst: Smallest distance [m] for near, else the largest stress [Pa] or number of nodes.
    """

    region: str
    what: str
    tool: str
    begin: float
    end: float
    worst: float


@dataclass(frozen=True)
class CutMade:
    """One cut, from press to release of a blade that cuts progressively.

    Attributes:
        kind: split, subdivide, remove, tear, burn, ...
        tool: Whose blade; empty: asked of the service.
        begin: Time of its first edit [s].
        end: Time of its last [s].
        edits: How many edits it took.
        removed: Elements that it took away.
        surface: What it has opened, at rest.
        seen: The same faces where they were when they were opened [m], shape (n, 3, 3).
        undone: Whether it was taken back and not done again.
    """

    kind: str
    tool: str
    begin: float
    end: float
    edits: int
    removed: int
    surface: CutSurface
    seen: Reals
    undone: bool = False


@dataclass(frozen=True)
class HoleHistory:
    """How a hole that was named was closed over time.

    Attributes:
        name: Its name.
        first_area: Area when it was named [m^2].
        times: [s], shape (n,).
        covered: Share covered, 0 to 1, shape (n,).
        open_area: What is not covered [m^2], shape (n,).
        gap: Diameter of the widest circle in that [m], shape (n,).
        problem: Why it could not be measured in the end; empty: it could.
    """

    name: str
    first_area: float
    times: Reals
    covered: Reals
    open_area: Reals
    gap: Reals
    problem: str = ""


@dataclass(frozen=True)
class Session:
    """What is known of a recorded session.

    Attributes:
        name: What it is called in the report.
        bag: Where it was read from.
        organ: Name of the geometry.
        digest: What tells the organ at the start from any other; empty: not known.
        nodes: Of the organ at the start.
        models: Elastic models, in the order they ran.
        times: Simulated time of each frame, evenly spaced [s], shape (n,).
        rate_hz: Frames per simulated second [1/s].
        wall_seconds: What a clock on the wall said it took, pauses included [s].
        paused_seconds: Of that while it was paused [s].
        tools: Their tracks by id.
        events: What happened, in order.
        stress: Largest stress over time.
        violations: Warnings of risk regions.
        cuts: Cuts, in order; those undone again included.
        holes: Holes that were named, by name.
        notes: What a reader should know, such as what is missing.
    """

    name: str
    bag: str
    organ: str
    digest: str
    nodes: int
    models: tuple[str, ...]
    times: Reals
    rate_hz: float
    wall_seconds: float
    paused_seconds: float = 0.0
    tools: dict[str, ToolTrack] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    stress: StressHistory | Missing = Missing("not looked at")
    violations: tuple[RiskViolation, ...] | Missing = Missing("not looked at")
    cuts: tuple[CutMade, ...] | Missing = Missing("not looked at")
    holes: dict[str, HoleHistory] | Missing = Missing("not looked at")
    notes: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Simulated time from the first to the last frame [s]."""
        return float(self.times[-1] - self.times[0]) if len(self.times) else 0.0
