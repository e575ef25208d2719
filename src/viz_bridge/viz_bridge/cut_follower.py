"""The cuts of a session, followed edit by edit."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import PATCH, REDO, UNDO
from tissue_sim.geometry.faces import face_nodes
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.report.cut_surface import CutSurface, OpenedFaces, Rows, surface_of_cut
from tissue_sim.report.session import CutMade
from viz_bridge.cdr import Message
from viz_bridge.organ_follower import OrganFollower
from viz_bridge.session_events import SEWING

SPONTANEOUS = ("tear", "burn")
"""Kinds of edits that belong together though each was asked for by itself."""


@dataclass
class _Open:
    """A cut that may go on."""

    key: str
    kind: str
    tool: str
    begin: float
    end: float
    versions: list[int] = field(default_factory=list)
    removed: int = 0
    lip: list[Rows] = field(default_factory=list)
    other: list[Rows] = field(default_factory=list)
    seen: list[NDArray[np.float64]] = field(default_factory=list)
    surface: CutSurface | None = None


class CutFollower:
    """Finds what each cut of an epoch opens. A stroke's edits are one cut."""

    def __init__(self) -> None:
        """Begin with none."""
        self._cuts: list[_Open] = []
        self._opened = OpenedFaces()
        self._gone: set[int] = set()
        self._undone_by: dict[int, int] = {}

    def begin(self, mesh: Mesh) -> None:
        """Stand before the first edit of an organ."""
        self._opened.look(mesh)

    def before(self, edit: Message, mesh: Mesh) -> None:
        """Know of an edit before it is applied: measure the cut that it does not belong to."""
        if self._cuts and self._cuts[-1].key != _key(edit):
            self.close(mesh)

    def after(self, edit: Message, organ: OrganFollower, tools: set[str]) -> None:
        """Take an edit that was applied.

        Args:
            edit: The edit.
            organ: The organ, with the edit.
            tools: Ids of the tools; another author is a service's client.
        """
        mesh = organ.mesh
        assert mesh is not None
        if edit.kind in (UNDO, REDO):
            self._take_back(edit)
            self._opened.look(mesh)
            return
        if edit.kind in SEWING or edit.kind == PATCH:
            return
        time, key = organ.sim_time, _key(edit)
        if not self._cuts or self._cuts[-1].key != key or self._cuts[-1].surface is not None:
            tool = str(edit.author) if edit.author in tools else ""
            self._cuts.append(_Open(key, str(edit.kind), tool, time, time))
        cut = self._cuts[-1]
        cut.end = time
        cut.versions.append(int(edit.version))
        cut.removed += len(edit.removed_elements)
        lip, other = self._opened.look(mesh)
        cut.lip.append(lip)
        cut.other.append(other)
        shape = organ.replica.shape_at()
        places = mesh.rest if shape is None else shape.positions.astype(np.float64)
        cut.seen.append(_corners(places, mesh, lip))

    def close(self, mesh: Mesh) -> None:
        """Measure the last cut: nothing more belongs to it."""
        if self._cuts and self._cuts[-1].surface is None:
            cut = self._cuts[-1]
            lip, other = np.concatenate(cut.lip), np.concatenate(cut.other)
            cut.surface = surface_of_cut(mesh, lip, other)

    @property
    def cuts(self) -> tuple[CutMade, ...]:
        """The cuts, in order; the last one is measured once it is closed."""
        nothing = CutSurface(np.empty((0, 3, 3)), ())
        return tuple(
            CutMade(
                cut.kind, cut.tool, cut.begin, cut.end, len(cut.versions), cut.removed,
                cut.surface or nothing, np.concatenate(cut.seen),
                undone=all(version in self._gone for version in cut.versions),
            )
            for cut in self._cuts
        )  # fmt: skip

    def _take_back(self, edit: Message) -> None:
        """An undo names the version it takes back, a redo that of the undo."""
        reverts = int(edit.reverts)
        if edit.kind == UNDO:
            self._gone.add(reverts)
            self._undone_by[int(edit.version)] = reverts
        else:
            self._gone.discard(self._undone_by.get(reverts, -1))


def _key(edit: Message) -> str:
    """What all edits of one cut have in common: the stroke in their request ids."""
    if edit.kind in SPONTANEOUS:
        return str(edit.kind)
    name = str(edit.request_id).split("~")[0].split("/")[0]
    return name or f"version {edit.version}"


def _corners(places: NDArray[np.float64], mesh: Mesh, faces: Rows) -> NDArray[np.float64]:
    """Corners of faces somewhere [m], shape (n, 3, 3); none of a sheet's edges."""
    if mesh.sheet_rows is not None:
        return np.empty((0, 3, 3))
    return places[face_nodes(mesh.tets, faces)]
