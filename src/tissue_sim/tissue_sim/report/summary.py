"""All figures of a session, each with its unit or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from tissue_sim.readings.fields import in_words
from tissue_sim.report.coordination import coordination_of
from tissue_sim.report.loads import load_of
from tissue_sim.report.motion import IDLE_SPEED, Motion, Reals, motion_of, path_length, speeds_of
from tissue_sim.report.plan import Deviation, Planned, deviation_of
from tissue_sim.report.session import CutMade, Missing, Session, ToolTrack

NO_PLAN = "no plan was given: --plan"
NO_MEANING = "has no meaning here"
NOT_MOVED = "the tool was not moved"


@dataclass(frozen=True)
class Figure:
    """One figure of a session.

    Attributes:
        key: Names it in JSON, the same in all sessions.
        group: What it is about, such as "tool left".
        label: In words.
        unit: SI; empty: a plain number.
        value: nan where there is none.
        why: Why there is none; empty where there is one.
    """

    key: str
    group: str
    label: str
    unit: str
    value: float
    why: str = ""


@dataclass(frozen=True)
class Settings:
    """What figures depend on besides the session.

    Attributes:
        idle_speed: A tip slower than this is idle [m/s].
        hands: Tools of each hand; none: each tool that was moved is a hand.
        plans: Where cuts were planned.
    """

    idle_speed: float = IDLE_SPEED
    hands: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    plans: Sequence[Planned] = ()


def figures_of(session: Session, settings: Settings) -> list[Figure]:
    """All figures of a session."""
    moved = [track for track in session.tools.values() if was_moved(track)]
    found = [*_session_figures(session, moved)]
    for track in moved:
        found += _tool_figures(session, track, settings)
    found += _hand_figures(session, moved, settings)
    found += [*_tissue_figures(session), *_cut_figures(session, settings)]
    return [*found, *_risk_figures(session), *_hole_figures(session)]


def was_moved(track: ToolTrack) -> bool:
    """Whether a tool was moved or used at all; the others are part of the scene."""
    return bool(track.pressed.any()) or path_length(track.positions) > 0.0


def deviations_of(session: Session, settings: Settings) -> list[Deviation | None]:
    """How far each cut is from its plan; None: nothing of it can be held against one."""
    if isinstance(session.cuts, Missing):
        return []
    return [deviation_of(cut.surface, cut.seen, settings.plans) for cut in session.cuts]


def hand_speeds(session: Session, settings: Settings) -> dict[str, Reals]:
    """Speed of each hand at the session's times [m/s]: of a hand's tools one moves at a time.

    Raises:
        ValueError: A hand's tool is not in the session.
    """
    moved = [tool for tool, track in session.tools.items() if was_moved(track)]
    hands = settings.hands or {tool: (tool,) for tool in moved}
    speeds = {}
    for hand, tools in hands.items():
        unknown = [tool for tool in tools if tool not in session.tools]
        if unknown:
            raise ValueError(
                f"{session.name} has no tool {unknown[0]!r} for the hand {hand}; its tools: "
                f"{', '.join(session.tools) or 'none'}"
            )
        each = [speeds_of(session.tools[tool].positions, session.rate_hz) for tool in tools]
        speeds[hand] = np.sum(each, axis=0)
    return speeds


def _session_figures(session: Session, moved: list[ToolTrack]) -> Iterator[Figure]:
    group = "session"
    yield _figure("session.seconds", group, "simulated time", "s", session.seconds)
    yield _figure("session.wall_seconds", group, "time on the clock", "s", session.wall_seconds)
    yield _figure("session.paused_seconds", group, "of that paused", "s", session.paused_seconds)
    for kind, label in (("press", "presses"), ("undo", "undone"), ("redo", "done again")):
        count = sum(event.kind == kind for event in session.events)
        yield _figure(f"session.{kind}", group, label, "", float(count))
    yield _figure("session.tools", group, "tools moved or used", "", float(len(moved)))


def _tool_figures(session: Session, track: ToolTrack, settings: Settings) -> Iterator[Figure]:
    group, key = f"tool {track.tool}", f"tool.{track.tool}"
    motion = motion_of(track.positions, session.rate_hz, settings.idle_speed)
    why = NOT_MOVED if not motion.movements else NO_MEANING
    for name, label, unit, value in _motion_values(motion):
        yield _figure(f"{key}.{name}", group, label, unit, value, why)
    pressed = float(track.pressed.sum()) / session.rate_hz
    edges = int((np.diff(track.pressed.astype(np.int8), prepend=0) > 0).sum())
    yield _figure(f"{key}.presses", group, "presses", "", float(edges))
    yield _figure(f"{key}.pressed_seconds", group, "time pressed", "s", pressed)
    force = track.force
    load = None if isinstance(force, Missing) else load_of(force.times, force.values)
    why = str(force) if isinstance(force, Missing) else "no force was felt"
    values = (math.nan,) * 4 if load is None else (load.peak, load.mean, load.integral, load.loaded)
    for (name, label, unit), value in zip(_FORCES, values, strict=True):
        yield _figure(f"{key}.{name}", group, label, unit, value, why)


_FORCES = (
    ("peak_force", "peak force", "N"), ("mean_force", "mean force while loaded", "N"),
    ("impulse", "impulse of the force", "N s"), ("loaded_seconds", "time loaded", "s"),
)  # fmt: skip


def _motion_values(motion: Motion) -> Iterator[tuple[str, str, str, float]]:
    space = motion.space
    some = motion.movements > 0
    yield "path", "path length", "m", motion.path
    yield "seconds", "first to last movement", "s", motion.seconds if some else math.nan
    yield "idle_seconds", "idle of that", "s", motion.idle if some else math.nan
    yield "idle_share", "idle share", "", motion.idle / motion.seconds if some else math.nan
    yield "movements", "movements", "", float(motion.movements)
    yield "mean_speed", "mean speed of movements", "m/s", motion.mean_speed
    yield "straightness", "economy of motion (chord over way)", "", motion.straightness
    yield "sparc", "smoothness SPARC, median movement", "", motion.sparc
    yield "sparc_whole", "smoothness SPARC, whole session", "", motion.sparc_whole
    yield "jerk", "smoothness LDLJ, median movement", "", motion.jerk
    yield "hull_volume", "working volume (hull)", "m^3", space.hull_volume if space else math.nan
    yield "hull_area", "area of the hull", "m^2", space.hull_area if space else math.nan
    box = float(space.box.prod()) if space else math.nan
    yield "box_volume", "working volume (box)", "m^3", box
    yield "economy_of_volume", "economy of volume", "", motion.economy_of_volume


def _hand_figures(session: Session, moved: list[ToolTrack], settings: Settings) -> Iterator[Figure]:
    speeds = hand_speeds(session, settings)
    if settings.hands:
        for hand, speed in speeds.items():
            group, key = f"hand {hand}", f"hand.{hand}"
            tools = [session.tools[tool] for tool in settings.hands[hand]]
            way = sum(path_length(track.positions) for track in tools)
            moving = float((speed >= settings.idle_speed).sum()) / session.rate_hz
            yield _figure(f"{key}.path", group, "path length of its tools", "m", way)
            yield _figure(f"{key}.moving_seconds", group, "time moving", "s", moving)
    for one, other in combinations(speeds, 2):
        found = coordination_of(speeds[one], speeds[other], settings.idle_speed)
        group, key = f"hands {one} and {other}", f"hands.{one}.{other}"
        for name, label, value in (
            ("correlation", "correlation of speeds", found.correlation),
            ("together", "both move while any does", found.together),
            ("balance", "way of the lesser over the other", found.balance),
        ):
            yield _figure(f"{key}.{name}", group, label, "", value, NOT_MOVED)


def _tissue_figures(session: Session) -> Iterator[Figure]:
    stress = session.stress
    name, unit, why, load = "stress", "Pa", str(stress), None
    if not isinstance(stress, Missing):
        name, unit = in_words(stress.quantity), stress.unit
        load = load_of(stress.peak.times, stress.peak.values, math.inf)
        why = "needs more than one reading"
    values = (math.nan,) * 3 if load is None else (load.peak, load.peak_at, load.integral)
    yield _figure("tissue.peak", "tissue", f"peak {name}", unit, values[0], why)
    yield _figure("tissue.peak_at", "tissue", "when", "s", values[1], why)
    yield _figure(
        "tissue.integral", "tissue", f"time integral of the peak {name}", f"{unit} s".strip(),
        values[2], why,
    )  # fmt: skip


def _cut_figures(session: Session, settings: Settings) -> Iterator[Figure]:
    made = session.cuts
    why = str(made) if isinstance(made, Missing) else "nothing was cut"
    pairs: list[tuple[CutMade, Deviation | None]] = []
    if not isinstance(made, Missing):
        everyone = zip(made, deviations_of(session, settings), strict=True)
        pairs = [pair for pair in everyone if not pair[0].undone]
        yield _figure("cuts.count", "cuts", "cuts that stayed", "", float(len(pairs)))
    lengths = np.array([cut.surface.length for cut, _ in pairs])
    areas = np.array([cut.surface.area for cut, _ in pairs])
    depths = np.array([cut.surface.depth for cut, _ in pairs])
    yield _figure("cuts.length", "cuts", "length", "m", _sum(lengths), why)
    # Of those that have both: a sheet's cut has no area, one inside the wall no length.
    both = np.isfinite(lengths + areas)
    depth = _sum(areas[both]) / _sum(lengths[both])
    yield _figure("cuts.mean_depth", "cuts", "mean depth", "m", depth, why)
    yield _figure("cuts.depth", "cuts", "largest depth", "m", _largest(depths), why)
    held = [(cut.surface.length, apart) for cut, apart in pairs if apart is not None]
    weights = np.nan_to_num(np.array([length for length, _ in held]), nan=1.0)
    squares = np.array([apart.rms**2 for _, apart in held])
    rms = math.sqrt(np.average(squares, weights=weights)) if held else math.nan
    why = why if not pairs else (NO_PLAN if not settings.plans else NO_MEANING)
    largest = _largest(np.array([apart.largest for _, apart in held]))
    missed = _largest(np.array([apart.missed for _, apart in held]))
    yield _figure("cuts.deviation_rms", "cuts", "deviation from the plan, RMS", "m", rms, why)
    yield _figure("cuts.deviation", "cuts", "deviation from the plan, largest", "m", largest, why)
    yield _figure("cuts.missed", "cuts", "farthest planned point from the cut", "m", missed, why)


def _risk_figures(session: Session) -> Iterator[Figure]:
    found = session.violations
    if isinstance(found, Missing):
        yield _figure("risk.count", "risk regions", "warnings", "", math.nan, str(found))
        return
    yield _figure("risk.count", "risk regions", "warnings", "", float(len(found)))
    for what, label in (
        ("near", "a tool is near"), ("touched", "touched or held"), ("cut", "cut"),
        ("stress", "stress beyond its limit"),
    ):  # fmt: skip
        those = [one for one in found if one.what == what]
        yield _figure(f"risk.{what}", "risk regions", label, "", float(len(those)))
    seconds = sum(one.end - one.begin for one in found)
    yield _figure("risk.seconds", "risk regions", "time of all warnings", "s", seconds)


def _hole_figures(session: Session) -> Iterator[Figure]:
    if isinstance(session.holes, Missing):
        yield _figure("holes", "holes", "closure", "", math.nan, str(session.holes))
        return
    for name, hole in session.holes.items():
        why, group, key = hole.problem or "never measured", f"hole {name}", f"hole.{name}"
        some = len(hole.times) > 0
        for what, label, unit, values in (
            ("covered", "covered at the end", "", hole.covered),
            ("open_area", "open at the end", "m^2", hole.open_area),
            ("gap", "widest gap at the end", "m", hole.gap),
        ):
            value = float(values[-1]) if some else math.nan
            yield _figure(f"{key}.{what}", group, label, unit, value, why)


def _figure(
    key: str, group: str, label: str, unit: str, value: float, why: str = NO_MEANING
) -> Figure:
    known = math.isfinite(value)
    return Figure(key, group, label, unit, value if known else math.nan, "" if known else why)


def _sum(values: Reals) -> float:
    known = values[np.isfinite(values)]
    return float(known.sum()) if len(known) else math.nan


def _largest(values: Reals) -> float:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else math.nan
