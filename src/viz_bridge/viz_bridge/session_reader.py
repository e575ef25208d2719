"""Reads what a report tells of a session out of its bag."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.report.session import (
    CutMade,
    Event,
    HoleHistory,
    Missing,
    Series,
    Session,
    ToolTrack,
    not_recorded,
)
from viz_bridge.bag_reader import BagError, only_namespace, read_organ, topic_counts
from viz_bridge.cdr import Message
from viz_bridge.session_listener import HOLES, JOURNAL, HeardEpoch, HeardPose, SessionListener
from viz_bridge.stress_follower import TOPIC as READINGS

STILL = 0.2
"""A tool without a new pose for longer than this stands still [s]."""
SLOW = 0.05
"""Share by which simulated time may lag behind the clock on the wall before a note says so."""


def read_session(
    bag: Path,
    name: str = "",
    namespace: str | None = None,
    epoch: int | None = None,
    risk: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Session:
    """What a report tells of a session.

    Args:
        bag: Bag directory or MCAP file.
        name: What to call the session; empty: as the bag.
        namespace: Of the organ; None for the only one.
        epoch: Which epoch, counted from 1; None: the longest.
        risk: File with risk regions to watch afterwards; None: the warnings that were recorded.
        progress: Called with the messages read so far and how many there are.

    Raises:
        ValueError: The bag cannot be read, is empty, or holds no journal of an organ.
    """
    counts = topic_counts(bag)
    if not sum(counts.values()):
        raise BagError(f"{bag} is empty: it holds no message")
    prefix = only_namespace(bag, namespace)
    if not counts.get(f"{prefix}/{JOURNAL}"):
        raise BagError(
            f"{bag} holds no {prefix}/{JOURNAL}, which says what was done; its topics: "
            f"{', '.join(sorted(topic for topic, count in counts.items() if count))}"
        )
    has = {topic.removeprefix(f"{prefix}/") for topic, count in counts.items() if count}
    listener, total = SessionListener(READINGS in has, risk), sum(counts.values())
    for count, (topic, item) in enumerate(read_organ(bag, namespace), start=1):
        listener.take(topic, item)
        if progress is not None and count % 200 == 0:
            progress(count, total)
    listener.close()
    chosen, notes = _chosen(bag, listener, epoch)
    return _session(bag, name or bag.resolve().stem, chosen, listener, has, notes)


def _chosen(
    bag: Path, listener: SessionListener, which: int | None
) -> tuple[HeardEpoch, list[str]]:
    epochs = [epoch for epoch in listener.epochs.values() if epoch.times]
    if which is not None and not 1 <= which <= len(epochs):
        raise BagError(f"{bag} has no epoch {which}; it has 1 to {len(epochs)}")
    if which is not None:
        return epochs[which - 1], []
    longest = max(epochs, key=lambda epoch: epoch.times[-1])
    if len(epochs) == 1:
        return longest, []
    number = epochs.index(longest) + 1
    return longest, [
        f"the bag holds {len(epochs)} epochs (resets or other organs begin a new one); "
        f"this is number {number}, the longest; --epoch chooses another"
    ]


def _session(
    bag: Path,
    name: str,
    epoch: HeardEpoch,
    listener: SessionListener,
    has: set[str],
    notes: list[str],
) -> Session:
    times = np.array(epoch.times)
    steps = np.diff(times)
    rate = 1.0 / float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 60.0
    even = times[0] + np.arange(round((times[-1] - times[0]) * rate) + 1) / rate
    stamps = np.array(epoch.stamps, dtype=np.float64)
    wall = 1e-9 * (stamps[-1] - stamps[0])
    paused = 1e-9 * float(np.diff(stamps)[np.array(epoch.paused)[:-1]].sum())
    notes += _notes(epoch, listener, float(times[-1] - times[0]), wall - paused)
    stress = epoch.stress
    violations = stress.violations(float(times[-1]))
    warned = () if isinstance(violations, Missing) else violations
    cuts = epoch.cuts.cuts
    events = [
        *(event for event in epoch.events if event.kind != "cut"),
        *(Event(cut.begin, "cut", _cut(cut), cut.tool) for cut in cuts),
        *(Event(one.begin, "warning", _violation(one.region, one.what, one.tool), one.tool)
          for one in warned),
    ]  # fmt: skip
    return Session(
        name=name, bag=str(bag), organ=epoch.organ, digest=epoch.digest, nodes=epoch.nodes,
        models=tuple(epoch.models), times=even, rate_hz=rate, wall_seconds=wall,
        paused_seconds=paused,
        tools={tool: _track(tool, epoch, listener, even, has) for tool in sorted(epoch.poses)},
        events=tuple(sorted(events, key=lambda event: event.time)),
        stress=stress.history(), violations=violations,
        cuts=cuts if epoch.digest else not_recorded("tissue/topology at the start"),
        holes={name: _hole(name, found, epoch) for name, found in epoch.holes.items()}
        if HOLES in has
        else not_recorded(HOLES),
        notes=tuple(notes),
    )  # fmt: skip


def _notes(
    epoch: HeardEpoch, listener: SessionListener, simulated: float, wall: float
) -> list[str]:
    notes = []
    if abs(wall - simulated) > SLOW * max(wall, 1.0):
        notes.append(
            f"{simulated:.1f} s were simulated in {wall:.1f} s on the clock: speeds and times are "
            "simulated ones"
        )
    missing = epoch.frames[-1] - epoch.frames[0] + 1 - len(epoch.frames)
    if missing > 0:
        notes.append(f"{missing} frames are missing from the journal")
    if listener.organ.replica.gaps:
        notes.append("edits are missing or did not apply: cuts may be missing")
    if not epoch.digest:
        notes.append("the organ at the start is not recorded: sessions cannot be compared")
    return notes


def _track(
    tool: str,
    epoch: HeardEpoch,
    listener: SessionListener,
    even: NDArray[np.float64],
    has: set[str],
) -> ToolTrack:
    poses = epoch.poses[tool]
    times = np.array([pose.time for pose in poses])
    used = np.array([pose.use for pose in poses])
    last = np.maximum(np.searchsorted(times, even + 1e-9, "right") - 1, 0)
    positions = _way(poses, even)
    topic = f"tools/{tool}/measured_cf"
    force: Series | Missing = not_recorded(topic)
    if topic in has:
        stamps, sizes = (np.array(column) for column in zip(*listener.forces[tool], strict=True))
        within = (stamps >= epoch.stamps[0]) & (stamps <= epoch.stamps[-1])
        # The journal's frames have the same stamps: differences keep their nanoseconds.
        known = np.array(epoch.stamps) - epoch.stamps[0]
        at = np.interp(stamps[within] - epoch.stamps[0], known, epoch.times)
        force = Series(at, sizes[within]) if within.any() else not_recorded(topic)
    return ToolTrack(tool, epoch.kinds.get(tool, ""), positions, used[last], force)


def _way(poses: list[HeardPose], even: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where a tip was at some times [m], shape (n, 3).

    A device and the simulation do not tick alike: a frame without a new pose is no stop, so between
    two poses the tip runs straight. Only where none came for `STILL` it stayed where it was. Where
    the scene had put the tool before its first pose came was nobody's motion.
    """
    first = next((place for place, pose in enumerate(poses) if pose.stamp), 0)
    poses = poses[first:]
    kept = [poses[0]]
    for before, pose in pairwise(poses):
        if pose.stamp == before.stamp and (pose.place == before.place).all():
            continue
        if pose.time - kept[-1].time > STILL:
            kept.append(kept[-1]._replace(time=before.time))
        kept.append(pose)
    times, places = np.array([pose.time for pose in kept]), np.array([p.place for p in kept])
    return np.stack([np.interp(even, times, along) for along in places.T], axis=1)


def _hole(name: str, found: list[tuple[int, Message]], epoch: HeardEpoch) -> HoleHistory:
    measured = [(frame, hole) for frame, hole in found if not hole.problem]
    frames = np.array([frame for frame, _ in measured], dtype=np.float64)

    def column(what: str) -> NDArray[np.float64]:
        return np.array([float(getattr(hole, what)) for _, hole in measured])

    times = np.interp(frames, epoch.frames, epoch.times)
    last = found[-1][1]
    return HoleHistory(
        name, float(last.first_area), times, column("covered"), column("open_area"),
        column("gap"), str(last.problem),
    )  # fmt: skip


def _cut(cut: CutMade) -> str:
    """A cut in words."""
    words = f"{cut.tool or 'a service'}: {cut.kind}"
    if np.isfinite(cut.surface.length):
        words += f" along {1e3 * cut.surface.length:.1f} mm"
    if cut.removed:
        words += f", {cut.removed} elements taken away"
    return words + (", undone" if cut.undone else "")


def _violation(region: str, what: str, tool: str) -> str:
    words = {"near": "is near", "touched": "touches", "cut": "cut", "stress": "stress in"}
    return f"{tool or 'tissue'}: {words.get(what, what)} {region}"
