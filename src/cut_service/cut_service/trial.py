"""An organ that goes through edits, each of them checked for all that an edit owes."""

from __future__ import annotations

import hashlib
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from cut_service.burning import Burns
from cut_service.validity import Validity, lists_of, look_at
from tissue_sim.elastic.model import State
from tissue_sim.geometry.edit import NO_PARENT, EditChange, TopologyEdit
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import triangle_areas

Reals = NDArray[np.float64]

VOLUME_KEPT = 1e-9
"""Largest change of rest volume by an edit that moves nothing, or on the sweep only, as a share."""

VOLUME_SNAPPED = 1e-3
"""The same by a cut that snaps."""

LARGE = 20_000
"""Nodes of an organ that is not looked at again once an undo has brought back every bit of it."""


def remembered(mesh: Mesh) -> dict[str, str]:
    """All that lives in a mesh, bit for bit: a digest of each array, by name."""
    nodes, elements = np.flatnonzero(mesh.node_alive), np.flatnonzero(mesh.element_alive)
    table = mesh.sutures
    arrays: dict[str, NDArray[np.generic]] = {
        "nodes": nodes, "rest": mesh.rest[nodes], "fixed": mesh.fixed[nodes],
        "parents": mesh.node_parents[nodes], "file ids": mesh.node_file_ids[nodes],
        "elements": elements, "their nodes": mesh.tets[elements],
        "regions": mesh.regions[elements], "fibres": mesh.fibres[elements],
        "elements at nodes": lists_of(mesh), "stitches": table.ids, "their ends": table.nodes,
        "their lengths": table.lengths, "their stiffness": table.stiffness,
        "their threads": table.groups,
    }  # fmt: skip
    names = f"{mesh.patches.items} {sorted(mesh.region_names.items())}"
    arrays["patches and regions"] = np.frombuffer(names.encode(), dtype=np.uint8)
    if mesh.sheet_rows is not None:
        arrays["kinds"] = mesh.sheet_rows.kinds[elements]
        arrays["tissue"] = mesh.sheet_rows.tissue[elements]
    return {
        name: hashlib.blake2b(np.ascontiguousarray(array).tobytes(), digest_size=16).hexdigest()
        for name, array in arrays.items()
    }


class Trial:
    """An organ, its shape and its history, and a replica that is told of every edit.

    Attributes:
        mesh: The organ.
        state: Its shape.
        random: Where all that is random comes from.
        burns: How hot its elements are.
        done: Edits carried out, by what made them; "undo" and "redo" among them.
        missed: Requests that changed nothing, by what made them.
        faults: What was wrong, in words; empty if nothing ever was.
        valid: What the organ was found to be after the last edit.
        most_parts: Most parts it ever had.
        deepest: Most edits that were undone in a row.
        volume: Largest change of rest volume by one edit that takes nothing out and adds
            nothing, as a share.
        ratio: Smallest radius ratio ever.
        last: The last sweep, to cut along it again.
    """

    def __init__(
        self, raw: RawMesh, fixed: NDArray[np.bool_] | None, random: np.random.Generator
    ) -> None:
        self.mesh, self._replica = Mesh(raw, fixed), Mesh(raw, fixed)
        self.state, self.history = State(self.mesh, np.float64), EditHistory()
        self.random, self.burns = random, Burns()
        self.done: Counter[str] = Counter()
        self.missed: Counter[str] = Counter()
        self.faults: list[str] = []
        self.valid = look_at(self.mesh)
        self.most_parts, self.deepest, self.volume = self.valid.parts, 0, 0.0
        self.ratio = self.valid.ratio
        self.last: tuple[Reals, NDArray[np.int32]] | None = None
        self._seen = [(remembered(self.mesh), self.valid)]

    @property
    def places(self) -> Reals:
        """Current node positions [m], shape (node_rows, 3)."""
        return np.asarray(self.state.positions(self.mesh), dtype=np.float64)

    @property
    def living(self) -> NDArray[np.int64]:
        """Rows of the nodes that are there."""
        return np.flatnonzero(self.mesh.node_alive[: self.mesh.node_rows])

    @property
    def size(self) -> float:
        """Of the organ as it is now, along its longest axis [m]."""
        return float(np.ptp(self.places[self.living], axis=0).max())

    def displace(self, displacement: Reals) -> None:
        """Give the organ another shape; displacement [m] of shape (node_rows, 3)."""
        rows = self.mesh.node_rows
        for array in (self.state.displacement, self.state.previous):
            array[:rows] = np.where(self.mesh.node_alive[:rows, None], displacement, 0.0)

    def fault(self, what: str) -> None:
        """Write down what is wrong."""
        number = sum(self.done.values()) + sum(self.missed.values())
        self.faults.append(f"edit {number}: {what}")

    def carry_out(
        self,
        what: str,
        edit: TopologyEdit,
        kept: float = VOLUME_KEPT,
        still: NDArray[np.int64] | None = None,
    ) -> Validity:
        """Apply an edit that was planned, and check all that it owes.

        Args:
            what: What made it.
            edit: The plan.
            kept: Share of the rest volume that it may change, what it takes out or adds aside.
            still: Rows of nodes that must not be moved, fixed ones aside.
        """
        mesh, before = self.mesh, self.valid
        upright, rest = self._upright(), mesh.rest[: mesh.node_rows].copy()
        stays = self.living
        never = mesh.fixed[: mesh.node_rows].copy()
        if still is not None:
            never[still] = True
        gone = self._volume_of(edit.removed_elements) if not len(edit.added_elements) else 0.0
        change = self._apply(what, edit)
        after = self.valid = look_at(mesh)
        self._seen = [*self._seen[: len(self.history.done)], (remembered(mesh), after)]
        self.most_parts = max(self.most_parts, after.parts)
        self.ratio = min(self.ratio, after.ratio)
        for fault in after.faults:
            self.fault(f"after {what}: {fault}")
        born = self._volume_of(change.edit.added_elements[edit.added_parents == NO_PARENT])
        share = after.volume / before.volume - 1.0
        if abs(share + (gone - born) / before.volume) > kept:
            self.fault(f"{what} changed the rest volume by {share:.3g} of it")
        if not gone and not born:
            self.volume = max(self.volume, abs(share))
        moved = (mesh.rest[stays] != rest[stays]).any(axis=1)
        if np.isin(stays[moved], change.moved_nodes, invert=True).any():
            self.fault(f"{what} moved nodes that it does not name")
        if never[stays[moved]].any():
            self.fault(f"{what} moved fixed or held nodes at rest")
        copies, parents = change.copied_nodes, change.copy_parents
        if (mesh.fixed[copies] & ~mesh.fixed[parents]).any():
            self.fault(f"{what} made a node fixed")
        if upright and not self._upright():
            self.fault(f"{what} turned an element over in the deformed shape")
        return after

    def go_back(self, most: int) -> None:
        """Undo so many edits, or all there are."""
        steps = min(most, len(self.history.done))
        for _ in range(steps):
            self._move("undo")
        self.deepest = max(self.deepest, steps)

    def go_on(self, most: int) -> None:
        """Make so many undone edits again, or all there are."""
        for _ in range(min(most, len(self.history.undone))):
            self._move("redo")

    def finish(self) -> None:
        """Undo everything, make all of it again; the replica must be what the organ is."""
        self.go_back(len(self.history.done))
        self.go_on(len(self.history.undone))
        if remembered(self._replica) != remembered(self.mesh):
            self.fault("a replica that was told of every edit is not what the organ is")

    def _move(self, what: str) -> None:
        history = self.history
        kind = (history.done if what == "undo" else history.undone)[-1].edit.kind
        edit = history.undo(self.mesh) if what == "undo" else history.redo(self.mesh)
        self._apply(what, edit)
        now, (then, self.valid) = remembered(self.mesh), self._seen[len(history.done)]
        if now != then:
            other = ", ".join(name for name in then if now.get(name) != then[name])
            self.fault(f"{what} of a {kind}: not as it was before: {other}")
        if not np.isfinite(self.places[self.living]).all():
            self.fault(f"{what}: positions that are not finite")
        # What is bit for bit as it was is as valid as it was.
        if self.mesh.node_rows < LARGE and look_at(self.mesh) != self.valid:
            self.fault(f"{what} of a {kind}: found to be another organ than before")

    def _apply(self, what: str, edit: TopologyEdit) -> EditChange:
        mesh = self.mesh
        change = mesh.apply(edit)
        self.state.follow(mesh, change)
        self.history.record(change)
        if mesh.sheet_rows is None:
            self.burns.follow(mesh, change)
        self._replica.apply(change.edit)
        self.done[what] += 1
        return change

    def _volume_of(self, ids: NDArray[np.uint32]) -> float:
        rows, sheet = self.mesh.element_rows_of(ids), self.mesh.sheet_rows
        if sheet is not None:
            rows = rows[sheet.carries(rows)]
            areas = triangle_areas(self.mesh.rest, self.mesh.tets[rows, :3])
            return float(areas @ sheet.tissue[rows])
        corners = self.mesh.rest[self.mesh.tets[rows]]
        return float(np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6.0)

    def _upright(self) -> bool:
        if self.mesh.sheet_rows is not None:
            return True
        places, rows = self.places, self.mesh.element_rows
        tets = self.mesh.tets[:rows][self.mesh.element_alive[:rows]]
        a, b, c, d = (places[tets[:, k]] for k in range(4))
        return bool((np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) > 0.0).all())
