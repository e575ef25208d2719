"""The versioned tetrahedral mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import (
    PROVISIONAL,
    EditChange,
    EditError,
    StaleEditError,
    TopologyEdit,
    refuse_malformed,
)
from tissue_sim.geometry.incidence import Incidence, among, sorted_unique
from tissue_sim.geometry.look_up import any_changed, living_rows
from tissue_sim.geometry.quality import count_flat
from tissue_sim.geometry.raw_mesh import RawMesh

NO_ROW = -1


class Mesh:
    """A tetrahedral mesh that edits change in place, with permanent ids and spare capacity.

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
        incident: Element rows at each node row.
        version: Grows with every edit; 1 when built.
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
        nodes, elements = len(raw.points), len(raw.tetrahedra)
        node_capacity = int(nodes * (1 + spare)) + 1024
        element_capacity = int(elements * (1 + spare)) + 1024
        self.name, self.source = raw.name, raw.source
        self.region_names = dict(raw.region_names)
        self.version = 1
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
        self.tets[:elements] = raw.tetrahedra
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
        self.incident = Incidence.build(
            self.tets[:elements], self.element_alive[:elements], node_capacity
        )
        # Compile or load the kernels of `apply` now rather than in the frame of the first cut.
        none = np.empty((0, 4), dtype=np.int32)
        self.incident.rewire(none[:, 0], none, none)
        self.incident.of_all(none[:, 0])

    @property
    def node_capacity(self) -> int:
        """Rows the node arrays have room for."""
        return len(self.rest)

    @property
    def element_capacity(self) -> int:
        """Rows the element arrays have room for."""
        return len(self.tets)

    def node_rows_of(self, ids: NDArray[np.uint32]) -> NDArray[np.int32]:
        """Rows of nodes by permanent id, same shape as `ids`; -1 where no living node has it."""
        return self._rows_of(ids, self.node_rows, self.node_alive)

    def element_rows_of(self, ids: NDArray[np.uint32]) -> NDArray[np.int32]:
        """Rows of elements by permanent id, same shape; -1 where no living element has it."""
        return self._rows_of(ids, self.element_rows, self.element_alive)

    @staticmethod
    def _rows_of(ids: NDArray[np.uint32], rows: int, alive: NDArray[np.bool_]) -> NDArray[np.int32]:
        # Within a session the id of a row is the row itself: rows never move and only grow
        # (compaction starts a new epoch). All look-ups go through here: this stays one decision.
        candidates = np.ascontiguousarray(ids)
        found = np.empty(candidates.shape, dtype=np.int32)
        living_rows(candidates.reshape(-1), rows, alive, found.reshape(-1))
        return found

    def apply(self, edit: TopologyEdit) -> EditChange:
        """Apply an edit in time proportional to it. Modifies the mesh in place.

        On an error nothing at all is changed.

        Raises:
            StaleEditError: Something in the read set changed after the edit's base version.
            EditError: The edit is malformed, names unknown ids, or would leave an element without
                positive rest volume or a copied node without an element.
        """
        refuse_malformed(edit)
        self._refuse_stale(edit)
        nodes = self._Names(edit.copied_nodes, self.node_rows, "node")
        added = self._Names(edit.added_elements, self.element_rows, "element")
        moved = self._known(edit.moved_nodes, self.node_rows_of, "moved node")
        anchors = self._known(edit.moved_anchors, self.node_rows_of, "anchor node")
        parents = self._known(edit.copy_parents, self.node_rows_of, "parent node")
        rewritten = self._known(edit.rewritten_elements, self.element_rows_of, "rewritten element")
        removed = self._known(edit.removed_elements, self.element_rows_of, "removed element")
        born_of = self._known(edit.added_parents, self.element_rows_of, "parent element")
        rewritten_to = self._known(
            nodes.permanent(edit.rewritten_nodes), lambda i: self._old_or_new(i, nodes), "node"
        )
        added_to = self._known(
            nodes.permanent(edit.added_nodes), lambda i: self._old_or_new(i, nodes), "node"
        )
        self._refuse_fixed(moved)
        self._refuse_loose_copies(nodes.rows, rewritten_to, added_to)
        self._reserve(len(nodes.rows), len(added.rows))

        elements = np.concatenate([rewritten, removed, added.rows]).astype(np.int32)
        if len(sorted_unique(elements)) != len(elements):
            raise EditError("an element is rewritten or removed twice in one edit")
        old = self.tets[elements].copy()
        new = np.concatenate([rewritten_to, np.full((len(removed), 4), NO_ROW), added_to])
        new = new.astype(np.int32)
        old_moved_rest = self.rest[moved].copy()
        neighbours = self.incident.of_all(moved)

        self.rest[moved] = edit.moved_rest
        self.rest[nodes.rows] = self.rest[parents]
        affected = neighbours[~among(neighbours, elements)]
        try:
            self._refuse_flat(np.concatenate([self.tets[affected], new[new[:, 0] != NO_ROW]]))
        except EditError:
            self.rest[moved] = old_moved_rest
            self.rest[nodes.rows] = 0.0
            raise

        self.version += 1
        self._enter_nodes(nodes.rows, parents)
        self._enter_elements(added.rows, born_of, removed)
        self._rewire(elements, old, new)
        touched = np.concatenate([old.ravel(), new.ravel(), self.tets[neighbours].ravel(), moved])
        touched = sorted_unique(touched[touched != NO_ROW])
        self.node_versions[touched] = self.version
        self.element_versions[elements] = self.version
        self.element_versions[neighbours] = self.version
        self._bury_orphans(touched)
        applied = replace(
            edit,
            version=self.version,
            copied_nodes=nodes.rows.astype(np.uint32),
            rewritten_nodes=self.node_ids[rewritten_to],
            added_elements=added.rows.astype(np.uint32),
            added_nodes=self.node_ids[added_to],
        )
        return EditChange(
            applied, moved, anchors, edit.moved_weights, old_moved_rest,
            nodes.rows, parents, elements, old, new, neighbours, touched,
        )  # fmt: skip

    class _Names:
        """Permanent rows for ids of new things, provisional in a plan, permanent in a replica."""

        def __init__(self, ids: NDArray[np.uint32], first: int, what: str) -> None:
            self.first = first
            offset = np.asarray(ids, dtype=np.int64)
            self.provisional = bool(len(offset)) and int(offset[0]) >= PROVISIONAL
            expected = np.arange(len(offset)) + (PROVISIONAL if self.provisional else first)
            if not np.array_equal(offset, expected):
                raise EditError(
                    f"new {what} ids must count up from {PROVISIONAL} in a plan, "
                    f"or from {first}, the next free row, in an applied edit"
                )
            self.rows = np.arange(first, first + len(offset), dtype=np.int32)

        def permanent(self, ids: NDArray[np.uint32]) -> NDArray[np.int64]:
            wide = np.asarray(ids, dtype=np.int64)
            return np.where(wide >= PROVISIONAL, wide - PROVISIONAL + self.first, wide)

    def _old_or_new(self, ids: NDArray[np.int64], new: _Names) -> NDArray[np.int32]:
        is_new = (ids >= new.first) & (ids < new.first + len(new.rows))
        return np.where(is_new, ids, self.node_rows_of(np.where(is_new, 0, ids))).astype(np.int32)

    @staticmethod
    def _known(
        ids: NDArray[np.integer], rows_of: Callable[..., NDArray[np.int32]], what: str
    ) -> NDArray[np.int32]:
        rows = rows_of(ids)
        if (rows == NO_ROW).any():
            missing = np.unique(np.asarray(ids)[rows == NO_ROW])[:5]
            raise EditError(f"the edit names a {what} that is not there: id {missing.tolist()}")
        return rows

    def _refuse_stale(self, edit: TopologyEdit) -> None:
        if not 0 < edit.base_version <= self.version:
            raise StaleEditError(
                f"planned on version {edit.base_version}; the tissue is at {self.version}"
            )
        for ids, rows_of, versions, what in (
            (edit.read_nodes, self.node_rows_of, self.node_versions, "node"),
            (edit.read_elements, self.element_rows_of, self.element_versions, "element"),
        ):
            rows = rows_of(ids)
            if not any_changed(rows, versions, edit.base_version):
                continue
            changed = (rows == NO_ROW) | (versions[rows] > edit.base_version)
            raise StaleEditError(
                f"{int(changed.sum())} {what}s that the plan has read, {what} "
                f"{int(ids[changed][0])} among them, changed after version {edit.base_version}"
            )

    def _refuse_fixed(self, moved: NDArray[np.int32]) -> None:
        if self.fixed[moved].any():
            ids = self.node_ids[moved[self.fixed[moved]]][:5]
            raise EditError(f"fixed nodes cannot be moved: id {ids.tolist()}")

    @staticmethod
    def _refuse_loose_copies(
        copies: NDArray[np.int32], rewritten: NDArray[np.int32], added: NDArray[np.int32]
    ) -> None:
        if not len(copies):
            return
        named = np.concatenate([rewritten.ravel(), added.ravel()])
        uses = np.bincount(named[named >= copies[0]] - copies[0], minlength=len(copies))
        if not uses.all():
            raise EditError(f"{int((uses == 0).sum())} copied nodes would belong to no element")

    def _refuse_flat(self, tets: NDArray[np.int32]) -> None:
        flat = count_flat(self.rest, tets)
        if flat:
            raise EditError(f"{flat} elements would have no positive rest volume")

    def _reserve(self, nodes: int, elements: int) -> None:
        def longer(array: NDArray[Any], rows: int, fill: float) -> NDArray[Any]:
            extra = np.full((rows - len(array), *array.shape[1:]), fill, dtype=array.dtype)
            return np.concatenate([array, extra])

        if self.node_rows + nodes > self.node_capacity:
            rows = self.node_capacity + max(nodes, self.node_capacity // 4)
            for name, fill in (
                ("rest", 0), ("fixed", False), ("node_file_ids", -1), ("node_parents", 0),
                ("node_alive", False), ("node_versions", 1),
            ):  # fmt: skip
                setattr(self, name, longer(getattr(self, name), rows, fill))
            self.node_ids = np.arange(rows, dtype=np.uint32)
            self.incident.grow(rows)
        if self.element_rows + elements > self.element_capacity:
            rows = self.element_capacity + max(elements, self.element_capacity // 4)
            for name, fill in (
                ("tets", NO_ROW), ("element_file_ids", -1), ("element_alive", False),
                ("element_versions", 1), ("regions", 0),
            ):  # fmt: skip
                setattr(self, name, longer(getattr(self, name), rows, fill))
            self.element_ids = np.arange(rows, dtype=np.uint32)

    def _enter_nodes(self, rows: NDArray[np.int32], parents: NDArray[np.int32]) -> None:
        self.node_alive[rows] = True
        self.node_parents[rows] = self.node_ids[parents]
        self.node_file_ids[rows] = -1
        self.fixed[rows] = self.fixed[parents]
        self.node_rows += len(rows)

    def _enter_elements(
        self, rows: NDArray[np.int32], parents: NDArray[np.int32], removed: NDArray[np.int32]
    ) -> None:
        self.element_alive[rows] = True
        self.element_file_ids[rows] = -1
        self.regions[rows] = self.regions[parents]
        self.element_alive[removed] = False
        self.element_rows += len(rows)

    def _rewire(
        self, elements: NDArray[np.int32], old: NDArray[np.int32], new: NDArray[np.int32]
    ) -> None:
        self.incident.rewire(elements, old, new)
        kept = new[:, 0] != NO_ROW
        self.tets[elements[kept]] = new[kept]

    def _bury_orphans(self, nodes: NDArray[np.int32]) -> None:
        self.node_alive[nodes[self.incident.count[nodes] == 0]] = False
