"""The versioned mesh: tetrahedra, or a sheet of triangles and springs."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import EditChange, TopologyEdit
from tissue_sim.geometry.edit_check import NO_ROW, CheckedEdit, check_edit
from tissue_sim.geometry.incidence import Incidence, sorted_unique
from tissue_sim.geometry.look_up import living_rows
from tissue_sim.geometry.patch_edit import Patching
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import Sheet
from tissue_sim.geometry.sheet_rows import SheetRows
from tissue_sim.geometry.sutures import Sutures

CHANGES_KEPT = 32


class Mesh:
    """A tetrahedral mesh that edits change in place, with permanent ids and spare capacity.

    Tissue can also be a sheet; then its elements are triangles, whose last node is -1, and springs,
    whose last two are (`geometry.sheet_rows`).

    Rows are where things lie in memory; ids are what everyone but kernels uses. A removed node or
    element leaves a tombstone (`*_alive` false). Rows never move within a session, so Gauss-Seidel
    order is stable. Arrays are longer than the rows in use: use [:node_rows] and [:element_rows].

    Attributes:
        rest: Rest positions [m], float64, shape (node_capacity, 3).
        fixed: Nodes that never move, shape (node_capacity,).
        node_ids: Permanent id of each node row, shape (node_capacity,).
        node_file_ids: Id in the file, -1 for nodes made by edits.
        node_parents: Id of the node it was copied from, its own for an original.
        node_alive: Nodes that exist.
        node_versions: Version that last changed each node.
        tets: Node rows of each element, shape (element_capacity, 4), positively oriented at rest.
        element_ids: Permanent id of each element row, shape (element_capacity,).
        element_file_ids: Id in the file, -1 for elements made by edits.
        element_alive: Elements that exist.
        element_versions: Version that last changed each element.
        regions: Region label of each element.
        region_names: Names of region labels.
        fibres: Unit vector along the fibres of each element at rest, zero where it has none,
            float32, shape (element_capacity, 3).
        incident: Element rows at each node row.
        sheet_rows: What the elements of a sheet are; None: tetrahedra.
        sutures: Stitches between nodes.
        patches: Soft sheets that edits have added.
        version: Grows with every edit; 1 when built.
        changes: What the last edits touched, the newest last: for those who keep figures of the
            mesh and follow it from time to time.
    """

    def __init__(
        self, raw: RawMesh, fixed: NDArray[np.bool_] | None = None, spare: float = 0.25
    ) -> None:
        """Build from a checked raw mesh.

        Args:
            raw: A mesh that `geometry.check` let pass: every row becomes a permanent id.
            fixed: Nodes that never move, shape (node_count,); default none.
            spare: Share of spare rows.
        """
        nodes = len(raw.points)
        items: NDArray[np.integer] = raw.tetrahedra
        self.sheet_rows: SheetRows | None = None
        if raw.sheet is not None:
            self.sheet_rows, items = SheetRows.of(raw.sheet)
        elements = len(items)
        node_capacity = int(nodes * (1 + spare)) + 1024
        element_capacity = int(elements * (1 + spare)) + 1024
        self.name, self.source = raw.name, raw.source
        self.region_names = dict(raw.region_names)
        self.sutures, self.patches = raw.sutures, raw.patches
        self.version = 1
        self.changes: deque[EditChange] = deque(maxlen=CHANGES_KEPT)
        self.node_rows, self.element_rows = nodes, elements
        self.rest = np.zeros((node_capacity, 3))
        self.rest[:nodes] = raw.points
        self.fixed = np.zeros(node_capacity, dtype=np.bool_)
        if fixed is not None:
            self.fixed[:nodes] = fixed
        self.node_ids = np.arange(node_capacity, dtype=np.uint32)
        self.node_file_ids = np.full(node_capacity, -1, dtype=np.int64)
        self.node_file_ids[:nodes] = (
            raw.node_file_ids if len(raw.node_file_ids) else np.arange(nodes)
        )
        self.node_parents = self.node_ids.copy()
        self.node_alive = np.zeros(node_capacity, dtype=np.bool_)
        self.node_alive[:nodes] = True
        self.node_versions = np.ones(node_capacity, dtype=np.int64)
        self.tets = np.full((element_capacity, 4), NO_ROW, dtype=np.int32)
        self.tets[:elements] = items
        if self.sheet_rows is not None:
            self.sheet_rows.grow(element_capacity)
        self.element_ids = np.arange(element_capacity, dtype=np.uint32)
        self.element_file_ids = np.full(element_capacity, -1, dtype=np.int64)
        self.element_file_ids[:elements] = (
            raw.element_file_ids if len(raw.element_file_ids) else np.arange(elements)
        )
        self.element_alive = np.zeros(element_capacity, dtype=np.bool_)
        self.element_alive[:elements] = True
        self.element_versions = np.ones(element_capacity, dtype=np.int64)
        self.regions = np.zeros(element_capacity, dtype=np.int32)
        if len(raw.regions):
            self.regions[:elements] = raw.regions
        self.fibres = np.zeros((element_capacity, 3), dtype=np.float32)
        if len(raw.fibres):
            self.fibres[:elements] = raw.fibres
        self.incident = Incidence.build(
            self.tets[:elements], self.element_alive[:elements], node_capacity
        )
        # Compile or load the kernels of `apply` now rather than in the frame of the first cut.
        none = np.empty((0, 4), dtype=np.int32)
        self.incident.rewire(none[:, 0], none, none)
        self.incident.of_all(none[:, 0])

    @property
    def sheet(self) -> Sheet | None:
        """Triangles and springs as they are now, made when asked for; None: tetrahedra."""
        if self.sheet_rows is None:
            return None
        rows = self.element_rows
        return self.sheet_rows.sheet(self.version, self.tets[:rows], self.element_alive[:rows])

    def place_items(
        self,
        items: NDArray[np.int32],
        alive: NDArray[np.bool_],
        kinds: NDArray[np.uint8],
        tissue: NDArray[np.float64],
    ) -> None:
        """Put the elements of a sheet into given rows, as a keyframe has them.

        Args:
            items: Nodes of each row, -1 for none, shape (n, 4).
            alive: Rows that exist.
            kinds: As `SheetRows.kinds`.
            tissue: As `SheetRows.tissue`.
        """
        if self.sheet_rows is None:
            raise ValueError(f"{self.name} is made of tetrahedra and has no rows of a sheet")
        rows = len(items)
        self._reserve(np.empty(0, dtype=np.int32), np.arange(rows, dtype=np.int32))
        self.element_rows = rows
        self.tets[:rows], self.element_alive[:rows] = items, alive
        self.sheet_rows = SheetRows(kinds, tissue, self.sheet_rows.stiffness)
        self.sheet_rows.grow(self.element_capacity)
        self.incident = Incidence.build(items, alive, self.node_capacity)

    @property
    def node_capacity(self) -> int:
        """Rows the node arrays have room for."""
        return len(self.rest)

    @property
    def element_capacity(self) -> int:
        """Rows the element arrays have room for."""
        return len(self.tets)

    def node_rows_of(self, ids: NDArray[np.integer]) -> NDArray[np.int32]:
        """Rows of nodes by permanent id, same shape as `ids`; -1 where no living node has it."""
        return self._rows_of(ids, self.node_rows, self.node_alive)

    def element_rows_of(self, ids: NDArray[np.uint32]) -> NDArray[np.int32]:
        """Rows of elements by permanent id, same shape; -1 where no living element has it."""
        return self._rows_of(ids, self.element_rows, self.element_alive)

    @staticmethod
    def _rows_of(
        ids: NDArray[np.integer], rows: int, alive: NDArray[np.bool_]
    ) -> NDArray[np.int32]:
        # Within a session the id of a row is the row itself: rows never move and only grow
        # (compaction starts a new epoch). All look-ups go through here: this stays one decision.
        candidates = np.ascontiguousarray(ids)
        found = np.empty(candidates.shape, dtype=np.int32)
        living_rows(candidates.reshape(-1), rows, alive, found.reshape(-1))
        return found

    def check(self, edit: TopologyEdit) -> CheckedEdit:
        """Find out whether an edit can be applied, and what it would do; changes nothing.

        Raises:
            StaleEditError: Something in the read set changed after the edit's base version.
            EditError: The edit is malformed, names unknown ids, or would leave an element without
                positive rest volume or a copied node without an element.
        """
        return check_edit(self, edit)

    def apply(self, edit: TopologyEdit, checked: CheckedEdit | None = None) -> EditChange:
        """Apply an edit in time proportional to it. Modifies the mesh in place.

        On an error nothing at all is changed.

        Args:
            edit: The edit.
            checked: What `check` made of it; of use if the mesh has not changed since.

        Raises:
            StaleEditError, EditError: As `check` does.
        """
        if checked is None or checked.edit is not edit or checked.version != self.version:
            checked = self.check(edit)
        copies, parents, moved = checked.copied_nodes, checked.copy_parents, checked.moved_nodes
        back, like, born = checked.returned_nodes, checked.returned_like, checked.born_nodes
        self._reserve(np.concatenate([copies, born]), checked.added)
        old_moved_rest, offsets = self.rest[moved], self.rest[back] - self.rest[like]
        self.rest[born] = edit.born_rest
        self.rest[moved] = edit.moved_rest
        self.rest[copies] = self.rest[parents]
        self.rest[moved] = edit.moved_rest  # copies too that do not stay with their parents
        self.version += 1
        self._enter_nodes(copies, parents, back)
        self._enter_born(born)
        self._take_patches(checked.patching)
        self._enter_elements(checked)
        elements, old, new = checked.elements, checked.old_elements, checked.new_elements
        self._rewire(elements, old, new)
        if self.sheet_rows is not None:
            descends = checked.added_parents != NO_ROW
            added, made = checked.added[descends], checked.added[~descends]
            self.sheet_rows.enter(added, checked.added_parents[descends], self.tets[added])
            self.sheet_rows.enter_born(made, edit.born_kinds, edit.born_tissue)
        vanished = self._bury_orphans(checked.nodes)
        lost, released, nodes = self._sew(checked)
        self.node_versions[nodes] = self.version
        self.element_versions[elements] = self.version
        self.element_versions[checked.neighbours] = self.version
        change = EditChange(
            checked.applied, moved, checked.moved_anchors, edit.moved_weights, old_moved_rest,
            copies, parents, elements, old, new, checked.neighbours, nodes, vanished,
            checked.merged_nodes, checked.merged_into, np.concatenate([back, born]),
            np.concatenate([like, born]), np.concatenate([offsets, np.zeros((len(born), 3))]), lost,
            released, checked.stitching.old_lengths, born,
        )  # fmt: skip
        self.changes.append(change)
        return change

    def _sew(self, checked: CheckedEdit) -> tuple[Sutures, NDArray[np.uint32], NDArray[np.int32]]:
        """Put the sutures in force; those lost, ids of those released, and all nodes touched."""
        after, removed = checked.stitching.after, checked.stitching.removed
        if not len(after):
            self.sutures = after
            return removed, after.ids, checked.nodes
        whole = self.node_alive[after.nodes].all(axis=1)
        released, self.sutures = (after.at(np.flatnonzero(part)) for part in (~whole, whole))
        if not len(released):
            return removed, released.ids, checked.nodes
        ends = released.nodes.ravel()
        nodes = sorted_unique(np.concatenate([checked.nodes, ends[self.node_alive[ends]]]))
        return removed.joined(released), released.ids, nodes

    def _reserve(self, copies: NDArray[np.int32], added: NDArray[np.int32]) -> None:
        def longer(array: NDArray[Any], rows: int, fill: float) -> NDArray[Any]:
            extra = np.full((rows - len(array), *array.shape[1:]), fill, dtype=array.dtype)
            return np.concatenate([array, extra])

        nodes, elements = len(copies), len(added)
        if _end(copies, 0) > self.node_capacity:
            rows = self.node_capacity + max(nodes, self.node_capacity // 4)
            for name, fill in (
                ("rest", 0), ("fixed", False), ("node_file_ids", -1), ("node_parents", 0),
                ("node_alive", False), ("node_versions", 1),
            ):  # fmt: skip
                setattr(self, name, longer(getattr(self, name), rows, fill))
            self.node_ids = np.arange(rows, dtype=np.uint32)
            self.incident.grow(rows)
        if _end(added, 0) > self.element_capacity:
            rows = self.element_capacity + max(elements, self.element_capacity // 4)
            for name, fill in (
                ("tets", NO_ROW), ("element_file_ids", -1), ("element_alive", False),
                ("element_versions", 1), ("regions", 0), ("fibres", 0),
            ):  # fmt: skip
                setattr(self, name, longer(getattr(self, name), rows, fill))
            self.element_ids = np.arange(rows, dtype=np.uint32)
            if self.sheet_rows is not None:
                self.sheet_rows.grow(rows)

    def _enter_nodes(
        self, rows: NDArray[np.int32], parents: NDArray[np.int32], back: NDArray[np.int32]
    ) -> None:
        self.node_alive[rows] = True
        self.node_parents[rows] = self.node_ids[parents]
        self.node_file_ids[rows] = -1
        self.fixed[rows] = self.fixed[parents]
        self.node_alive[back] = True
        # What a redo makes again has its rows already.
        self.node_rows = _end(rows, self.node_rows)

    def _enter_born(self, rows: NDArray[np.int32]) -> None:
        self.node_alive[rows] = True
        self.node_parents[rows] = self.node_ids[rows]
        self.node_file_ids[rows] = -1
        self.fixed[rows] = False
        self.node_rows = _end(rows, self.node_rows)

    def _take_patches(self, patching: Patching) -> None:
        for gone in patching.removed:
            del self.region_names[gone.label]
        if patching.added is not None:
            self.region_names[patching.added.label] = patching.added.name
        self.patches = patching.after

    def _enter_elements(self, checked: CheckedEdit) -> None:
        rows, parents = checked.added, checked.added_parents
        self.element_alive[rows] = True
        self.element_file_ids[rows] = -1
        self.regions[rows] = self.regions[parents]
        self.fibres[rows] = self.fibres[parents]
        if checked.patching.added is not None:
            made = rows[parents == NO_ROW]
            self.regions[made], self.fibres[made] = checked.patching.added.label, 0.0
        self.element_alive[checked.removed] = False
        self.element_alive[checked.returned_elements] = True
        self.element_rows = _end(rows, self.element_rows)

    def _rewire(
        self, elements: NDArray[np.int32], old: NDArray[np.int32], new: NDArray[np.int32]
    ) -> None:
        self.incident.rewire(elements, old, new)
        kept = new[:, 0] != NO_ROW
        self.tets[elements[kept]] = new[kept]

    def _bury_orphans(self, nodes: NDArray[np.int32]) -> NDArray[np.int32]:
        """Rows of the nodes that are no more."""
        gone = nodes[(self.incident.count[nodes] == 0) & self.node_alive[nodes]]
        self.node_alive[gone] = False
        return gone


def _end(rows: NDArray[np.int32], least: int) -> int:
    """One past the last of some rows, or `least` if that is more."""
    return max(least, int(rows.max()) + 1) if len(rows) else least
