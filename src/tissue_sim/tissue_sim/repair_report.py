"""What the repair of a septal defect did to the tissue, found by replaying its journal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.frame import AppliedEdit, Budget, Command, Frame, FrameInputs, JournalEntry
from tissue_sim.geometry.closure import Closure
from tissue_sim.geometry.holes import Hole, name_hole, surface_of
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sutures import tensions
from tissue_sim.journal import replay
from tissue_sim.simulation import Simulation
from tissue_sim.view import share_in_view

EYE_AWAY = 0.15
"""Distance of the surgeon's eye from the hole [m]."""

RINGS = 6
"""Rings of places that stand for the hole's area."""

SHORTER = 3e-4
"""Rays end so far before the hole [m]: tissue at its edge hides nothing."""


@dataclass
class _Observer:
    """Looks at every frame of a replay.

    Attributes:
        eye: Where the surgeon looks from [m].
    """

    name: str
    loop: NDArray[np.float64]
    reach: float
    depth: float
    eye: NDArray[np.float64]
    hole: Hole | None = None
    shape: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    edits: list[dict[str, Any]] = field(default_factory=list)
    threads: list[NDArray[np.uint32]] = field(default_factory=list)
    lips: list[tuple[NDArray[np.int32], NDArray[np.int32]]] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)
    frames: int = 0
    steps: int = 0
    lost: int = 0
    opening: float = 0.0

    def look(self, simulation: Simulation, frame: Frame) -> None:
        mesh = simulation.mesh
        for edit in frame.edits:
            # The shape is still that of the frame before, on the nodes there were.
            self._before(edit, mesh)
        self.shape = np.asarray(frame.positions, dtype=np.float64)
        if self.hole is None:
            self.hole = name_hole(mesh, self.shape, self.name, self.loop, self.reach, self.depth)
            self.figures["before"] = self._closure(mesh)
            self.figures["seen_before"] = self._seen(mesh)
        for edit in frame.edits:
            self._after(edit, mesh)
        for copies, parents in self.lips:
            apart = np.linalg.norm(self.shape[copies] - self.shape[parents], axis=1)
            self.opening = max(self.opening, 1e3 * float(apart.max()))
        self.frames, self.steps = frame.journal.frame, self.steps + frame.journal.steps
        self.lost += bool(frame.lost)

    def _before(self, edit: AppliedEdit, mesh: Mesh) -> None:
        if edit.change.edit.kind == "patch" and self.hole is not None:
            rows = len(self.shape)
            shape = np.zeros((mesh.node_rows, 3))
            shape[:rows] = self.shape
            tissue = surface_of(mesh).tissue
            self.figures["seen_open"] = self._share(mesh, shape, tissue)

    def _after(self, edit: AppliedEdit, mesh: Mesh) -> None:
        # Here, because cut_service depends on this package.
        from cut_service.validity import look_at

        change, seen = edit.change, look_at(mesh)
        self.edits.append(
            {
                "kind": change.edit.kind,
                "version": int(change.edit.version),
                "frame": self.frames + 1,
                "apply_ms": 1e3 * edit.seconds,
                "faults": list(seen.faults),
                "parts": seen.parts,
                "volume": seen.volume,
                "quality": seen.ratio,
            }
        )
        if len(change.copied_nodes):
            self.lips.append((change.copied_nodes, change.copy_parents))
        if change.edit.kind == "patch":
            self.figures["patch_nodes"] = len(change.born_nodes)
            self.figures["patch_elements"] = len(change.edit.added_elements)
        if change.edit.kind == "suture":
            self.threads.append(change.edit.added_sutures)
            if len(self.threads) > 1:
                self.figures["sewn"] = self._closure(mesh)

    def finish(self, mesh: Mesh) -> dict[str, Any]:
        """All that was seen."""
        copies, parents = self.lips[0]
        apart = 1e3 * np.linalg.norm(self.shape[copies] - self.shape[parents], axis=1)
        pulls = tensions(mesh.sutures, self.shape, np.zeros_like(self.shape))
        forces = {}
        for name, ids in zip(("rim", "atrium"), self.threads, strict=True):
            of = pulls[np.isin(mesh.sutures.ids, ids)]
            forces[name] = {"sum": float(of.sum()), "most": float(of.max(initial=0.0))}
        return {
            **self.figures,
            "nodes": int(mesh.node_alive.sum()),
            "elements": int(mesh.element_alive.sum()),
            "edits": self.edits,
            "frames": self.frames,
            "lost": self.lost,
            "steps_per_frame": self.steps / max(self.frames, 1),
            "opening_mm": self.opening,
            "lips_end_mm": {"median": float(np.median(apart)), "most": float(apart.max())},
            "after": self._closure(mesh),
            "forces": forces,
        }

    def _closure(self, mesh: Mesh) -> dict[str, float]:
        if self.hole is None:
            raise ValueError("the hole has no name yet")
        closure: Closure = self.hole.closure(mesh, self.shape)
        return {"covered": float(closure.covered), "gap_mm": 1e3 * float(closure.gap)}

    def _seen(self, mesh: Mesh) -> float:
        return self._share(mesh, self.shape, surface_of(mesh).tissue)

    def _share(self, mesh: Mesh, shape: NDArray[np.float64], triangles: NDArray[np.int32]) -> float:
        """Share of the hole's area that is seen from the surgeon's eye."""
        if self.hole is None:
            raise ValueError("the hole has no name yet")
        loop = self.hole.loop(mesh, shape)
        middle = loop.mean(axis=0)
        # Rings of the same area each.
        shares = np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
        places = (middle + shares[:, None, None] * (loop - middle)).reshape(-1, 3)
        return share_in_view(self.eye, places, shape[triangles], SHORTER)


def repair_report(entries: Sequence[JournalEntry], mesh: Mesh, procedure: Any) -> dict[str, Any]:
    """Replay a repair and say what it did; plain JSON values.

    Args:
        entries: Journal of its epoch.
        mesh: The epoch's first keyframe; changed in place.
        procedure: What was played (`tool_input.procedure.Procedure`), with a step `closure` that
            names the hole and a step `patch`.

    Raises:
        JournalError: The journal cannot be replayed.
        ValueError: The procedure has no such steps.
    """
    observer = _Observer(*_hole_of(procedure))
    first = _remembered(mesh)
    done = replay(entries, mesh, on_frame=observer.look)
    figures = observer.finish(mesh)
    undone = _undo_all(done.simulation)
    return {
        **figures,
        "replayed": not done.mismatches,
        "undone": undone == len(figures["edits"]) and _remembered(mesh) == first,
    }


def _hole_of(
    procedure: Any,
) -> tuple[str, NDArray[np.float64], float, float, NDArray[np.float64]]:
    """The hole's name, loop, reach and depth, and the eye that looks at it."""
    named = [event for event in procedure.events if event.hole and len(event.hole.loop)]
    patches = [event for event in procedure.events if event.patch]
    if not named or not patches:
        raise ValueError(f"{procedure.title} names no hole or adds no patch")
    hole = named[0].hole
    middle = hole.loop.mean(axis=0)
    turn = np.cross(hole.loop - middle, np.roll(hole.loop, -1, axis=0) - middle).sum(axis=0)
    normal = turn / np.linalg.norm(turn)
    # The patch comes from where the surgeon is.
    side = np.sign(normal @ (patches[0].patch.pose.position - middle))
    return named[0].target, hole.loop, hole.reach, hole.depth, middle + side * EYE_AWAY * normal


def _remembered(mesh: Mesh) -> dict[str, str]:
    from cut_service.trial import remembered

    return remembered(mesh)


def _undo_all(simulation: Simulation) -> int:
    """Take back every edit; how many there were."""
    count = 0
    while simulation.history.done:
        frame = simulation.advance(FrameInputs(commands=(Command("undo"),)), Budget(steps=1))
        if not frame.answers[0].success:
            return -1
        count += 1
    return count
