"""What was done to the tissue in a session, found by replaying its journal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.frame import Frame, JournalEntry
from tissue_sim.geometry.edit import PATCH, REDO, UNDO
from tissue_sim.geometry.holes import Hole
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.patch_figures import patch_area
from tissue_sim.hole_report import HoleReport, measured
from tissue_sim.interaction.holds import Hold
from tissue_sim.journal import Replay, replay
from tissue_sim.simulation import Simulation


@dataclass
class GrabReport:
    """One hold from grab to release.

    Attributes:
        tool: Tool that held.
        frame: Frame it began in.
        nodes: Nodes held at first.
        moved_mm: How far they were moved, mean of the nodes, at its farthest [mm].
    """

    tool: str
    frame: int
    nodes: int
    moved_mm: float = 0.0


@dataclass
class CutOpening:
    """One cut.

    Attributes:
        frame: Frame it was applied in.
        version: Version it made.
        nodes_added: Copies made.
        apply_ms: Time to apply it in this replay [ms].
        opening_mm: Greatest distance between two nodes that were one, at any later time [mm].
    """

    frame: int
    version: int
    nodes_added: int
    apply_ms: float
    opening_mm: float = 0.0


@dataclass
class PatchReport:
    """One patch.

    Attributes:
        frame: Frame it was added in.
        name: Name of it.
        nodes: Its nodes.
        area_cm2: Area of one side [cm^2].
        tool: Tool that carried it at first; empty: none.
    """

    frame: int
    name: str
    nodes: int
    area_cm2: float
    tool: str

    def __str__(self) -> str:
        carried = f", carried by {self.tool}" if self.tool else ""
        return f"{self.name}: {self.nodes} nodes, {self.area_cm2:.3g} cm2{carried}"


@dataclass
class OperationReport:
    """What was done to the tissue.

    Attributes:
        frames: Frames replayed.
        steps: Model steps in them.
        grabs: Holds, in order.
        cuts: Cuts, in order.
        patches: Patches that were added, in order; those undone again included.
        holes: Holes that were named, after the last frame.
        finite: Whether every position of every frame is finite.
        mismatches: Frames that did not come out as recorded.
        positions: Positions after the last frame [m], shape (node_rows, 3).
    """

    frames: int = 0
    steps: int = 0
    grabs: list[GrabReport] = field(default_factory=list)
    cuts: list[CutOpening] = field(default_factory=list)
    patches: list[PatchReport] = field(default_factory=list)
    holes: list[HoleReport] = field(default_factory=list)
    finite: bool = True
    mismatches: tuple[int, ...] = ()
    positions: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 3), np.float32))


class _Observer:
    """Looks at every frame of a replay."""

    def __init__(self) -> None:
        self.report = OperationReport()
        self._grabs: dict[int, tuple[GrabReport, NDArray[np.int32], NDArray[np.float64]]] = {}
        self._lips: list[tuple[NDArray[np.int32], NDArray[np.int32]]] = []

    def _part_no_more(self, vanished: NDArray[np.int32]) -> None:
        """Lips of an undone cut are gone."""
        self._lips = [
            (copies[there], parents[there])
            for copies, parents in self._lips
            for there in (~np.isin(copies, vanished),)
        ]

    def look(self, simulation: Simulation, frame: Frame) -> None:
        places = np.asarray(frame.positions, dtype=np.float64)
        self.report.steps += frame.journal.steps
        self.report.finite &= bool(np.isfinite(places).all())
        for edit in frame.edits:
            change = edit.change
            if change.edit.kind in (UNDO, REDO):
                self._part_no_more(change.vanished_nodes)
                continue
            for patch in change.edit.added_patches:
                area = 1e4 * patch_area(change.edit)
                nodes, tool = len(change.born_nodes), change.edit.held_by
                self.report.patches.append(
                    PatchReport(frame.journal.frame, patch.name, nodes, area, tool)
                )
            if change.edit.kind == PATCH or not len(change.elements):
                continue  # Patches and sutures cut nothing.
            self._lips.append((change.copied_nodes, change.copy_parents))
            self.report.cuts.append(
                CutOpening(
                    frame.journal.frame,
                    change.edit.version,
                    len(change.copied_nodes),
                    1e3 * edit.seconds,
                )
            )
        for cut, (copies, parents) in zip(self.report.cuts, self._lips, strict=True):
            if len(copies):
                gaps = np.linalg.norm(places[copies] - places[parents], axis=1)
                cut.opening_mm = max(cut.opening_mm, 1e3 * float(gaps.max()))
        for tool in simulation.tools:
            for hold in simulation.holds.of_tool(tool):
                self._follow(hold, tool, frame.journal.frame, places)

    def _follow(self, hold: Hold, tool: str, frame: int, places: NDArray[np.float64]) -> None:
        if hold.id not in self._grabs:
            grab = GrabReport(tool, frame, len(hold.rows))
            self.report.grabs.append(grab)
            self._grabs[hold.id] = (grab, hold.rows.copy(), places[hold.rows].copy())
        grab, rows, start = self._grabs[hold.id]
        moved = np.linalg.norm(places[rows] - start, axis=1).mean() if len(rows) else 0.0
        grab.moved_mm = max(grab.moved_mm, 1e3 * float(moved))


def operation_report(
    entries: Sequence[JournalEntry],
    mesh: Mesh,
    model: str | None = None,
    on_frame: Callable[[int], None] | None = None,
    holes: Sequence[Hole] = (),
) -> OperationReport:
    """Replay one epoch and say what was done to the tissue.

    Args:
        entries: Its journal from the start.
        mesh: Its first keyframe; changed in place.
        model: Another model to run instead.
        on_frame: Told the number of each frame done.
        holes: Holes to be measured after the last frame.

    Raises:
        JournalError: The journal cannot be replayed.
    """
    observer = _Observer()

    def look(simulation: Simulation, frame: Frame) -> None:
        observer.look(simulation, frame)
        if on_frame is not None:
            on_frame(frame.journal.frame)

    done: Replay = replay(entries, mesh, model, on_frame=look)
    report = observer.report
    report.frames, report.mismatches = done.frames, done.mismatches
    report.positions = done.positions
    report.holes = [measured(hole, done.simulation.mesh, done.positions) for hole in holes]
    return report
