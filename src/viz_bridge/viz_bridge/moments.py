"""The moments of a session worth a picture, found in its bag."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from viz_bridge.bag_reader import read_organ
from viz_bridge.cdr import Message
from viz_bridge.organ_follower import OrganFollower
from viz_bridge.organ_surface import OrganSurface, surface_of
from viz_bridge.tool_shapes import DrawnTool

_TOPICS = ("tissue/topology", "tissue/edits", "tissue/state", "tissue/tools", "tissue/journal")

TIGHT_SECONDS = 1.0
"""Simulated time after an edit in which its threads draw tight [s]."""


@dataclass(frozen=True)
class Moment:
    """The organ and its tools at one frame.

    Attributes:
        name: before, pulled, cut_open, patched, sewn, released, or the name asked for.
        caption: What is to be seen.
        sim_time: When [s].
        frame: Which frame.
        surface: The surface at its version.
        positions: Node positions [m], float32, shape (node_rows, 3).
        tools: The tools.
        focus: Where the operation takes place [m], shape (3,).
        threads: Both ends of every stitch [m], float32, shape (n, 2, 3).
    """

    name: str
    caption: str
    sim_time: float
    frame: int
    surface: OrganSurface
    positions: NDArray[np.float32]
    tools: tuple[DrawnTool, ...]
    focus: NDArray[np.float64]
    threads: NDArray[np.float32]


def lips(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of nodes that cuts have copied, and of the nodes they were copied from."""
    rows = np.arange(mesh.node_rows)
    parents = mesh.node_parents[: mesh.node_rows].astype(np.int64)
    copies = np.flatnonzero((parents != rows) & mesh.node_alive[: mesh.node_rows])
    return copies, parents[copies]


def opening(
    positions: NDArray[np.float32], copies: NDArray[np.int64], parents: NDArray[np.int64]
) -> float:
    """How far the lips part at most [m]."""
    if not len(copies):
        return 0.0
    apart = np.linalg.norm(positions[copies] - positions[parents], axis=1)
    return float(apart.max())


class MomentFinder:
    """Finds the standard moments while a session goes by.

    Before: the first state. Pulled: the largest displacement before the first cut (of all, if
    nothing is cut). Cut open: the widest opening. Patched, sewn: with the most patches and the most
    stitches, a moment after, when threads have drawn tight. Released: the last state.
    """

    def __init__(self) -> None:
        self._organ = OrganFollower()
        self._surfaces: dict[tuple[bytes, int], OrganSurface] = {}
        self._lips: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None
        self._first: NDArray[np.float32] | None = None
        self._found: dict[str, Moment] = {}
        self._last: Moment | None = None
        self._best = {"pulled": 0.0, "cut_open": 0.0}
        self._repairs = {"patched": (0, 0.0), "sewn": (0, 0.0)}
        self._early: Message | None = None

    def take(self, topic: str, message: Message) -> None:
        """Take one message."""
        organ = self._organ
        if topic == "tissue/tools":
            organ.tools.take_list(message)
        elif topic == "tissue/journal":
            organ.take_journal(message)
        elif topic == "tissue/topology":
            new = organ.take_topology(message)
            self._changed(new)
        elif topic == "tissue/edits":
            self._changed(organ.take_edit(message))
        elif topic == "tissue/state":
            self._take_state(message)

    def moments(self) -> list[Moment]:
        """What was found, in the order of time."""
        found = dict(self._found)
        if self._last is not None:
            found["released"] = self._last
        return sorted(found.values(), key=lambda moment: (moment.name == "released", moment.frame))

    def _changed(self, changed: bool) -> None:
        if changed:
            self._lips = None
            early, self._early = self._early, None
            if early is not None:
                self._take_state(early)

    def _take_state(self, message: Message) -> None:
        positions = self._organ.take_state(message)
        mesh = self._organ.mesh
        if positions is None or mesh is None:
            self._early = message
            return
        if self._lips is None:
            self._lips = lips(mesh)
        if self._first is None:
            self._first = positions
            self._found["before"] = self._moment("before", "Before the operation", positions)
        copies, parents = self._lips
        if not len(copies):
            count = min(len(self._first), len(positions))
            moved = np.linalg.norm(positions[:count] - self._first[:count], axis=1)
            furthest = int(moved.argmax())
            if moved[furthest] > self._best["pulled"]:
                self._best["pulled"] = float(moved[furthest])
                text = f"Pulled by {1e3 * moved[furthest]:.0f} mm"
                self._found["pulled"] = self._moment(
                    "pulled", text, positions, positions[furthest].astype(np.float64)
                )
        else:
            apart = opening(positions, copies, parents)
            if apart > self._best["cut_open"]:
                self._best["cut_open"] = apart
                text = f"Cut open: the lips part by {1e3 * apart:.1f} mm"
                focus = positions[copies].mean(axis=0).astype(np.float64)
                self._found["cut_open"] = self._moment("cut_open", text, positions, focus)
        self._take_repairs(mesh, positions)
        self._last = self._moment("released", "At the end", positions)

    def _take_repairs(self, mesh: Mesh, positions: NDArray[np.float32]) -> None:
        stitches = len(mesh.sutures.nodes)
        now = {
            "patched": (len(mesh.patches), "A patch is laid"),
            "sewn": (stitches, f"Sewn: {stitches} stitch{'es' if stitches != 1 else ''}"),
        }
        for name, (count, caption) in now.items():
            most, since = self._repairs[name]
            if count > most:
                most, since = self._repairs[name] = count, self._organ.sim_time
            if count and count == most and self._organ.sim_time - since <= TIGHT_SECONDS:
                self._found[name] = self._moment(name, caption, positions)

    def _moment(
        self,
        name: str,
        caption: str,
        positions: NDArray[np.float32],
        focus: NDArray[np.float64] | None = None,
    ) -> Moment:
        mesh = self._organ.mesh
        assert mesh is not None
        key = (self._organ.replica.epoch, mesh.version)
        if key not in self._surfaces:
            self._surfaces[key] = surface_of(mesh)
        tools = tuple(copy.deepcopy(tool) for tool in self._organ.tools.by_id.values())
        middle = positions.mean(axis=0).astype(np.float64)
        return Moment(
            name,
            caption,
            self._organ.sim_time,
            self._organ.frame,
            self._surfaces[key],
            positions,
            tools,
            middle if focus is None else focus,
            positions[mesh.sutures.nodes],
        )


def find_moments(
    bag: Path, namespace: str | None = None, progress: Callable[[int], None] | None = None
) -> list[Moment]:
    """The moments of a bag worth a picture.

    Args:
        bag: Directory or file.
        namespace: Of the organ; None for the only one.
        progress: Called with the number of messages read so far.

    Raises:
        ValueError: The bag cannot be read, or holds no organ.
    """
    finder = MomentFinder()
    for count, (topic, item) in enumerate(read_organ(bag, namespace), start=1):
        if topic in _TOPICS:
            finder.take(topic, item.message)
        if progress is not None:
            progress(count)
    return finder.moments()
