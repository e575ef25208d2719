"""Holds: nodes that follow the rigid motion of a tool, or of the patch that a tool pulls at.

A node belongs to the first hold that took it. Later holds that want it too wait for it and take it
over when it is released, from where it is then. Fixed nodes are never held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.incidence import among
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction import rigid
from tissue_sim.interaction.patch import Patch

Rows = NDArray[np.int32]

NOBODY = 0


def _no_rows() -> Rows:
    return np.empty(0, dtype=np.int32)


def _places_in(ordered: Rows, rows: Rows) -> NDArray[np.intp]:
    """Place of each row in ascending rows, -1 where it is not there."""
    if not len(ordered):
        return np.full(len(rows), -1)
    place = np.minimum(np.searchsorted(ordered, rows), len(ordered) - 1)
    return np.where(ordered[place] == rows, place, -1)


@dataclass
class Hold:
    """Nodes held by one tool.

    Attributes:
        id: Counts up from 1 within an epoch.
        tool: Id of the tool it follows.
        by_use: Whether pressing `use` made it, and releasing `use` ends it.
        rows: Rows of the nodes it moves, shape (n,).
        local: Their places in the axes of what moves them [m], shape (n, 3).
        waiting: Rows of nodes that an earlier hold has, shape (m,).
        patch: What moves them, if the tool holds by force; None: the tool itself.
    """

    id: int
    tool: str
    by_use: bool
    rows: Rows
    local: NDArray[np.float64]
    waiting: Rows
    patch: Patch | None = None

    def pose(self, poses: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Pose of what moves its nodes, given the poses of all tools, shape (7,)."""
        return poses[self.tool] if self.patch is None else self.patch.pose


class Holds:
    """All holds of a simulation.

    Attributes:
        owner: Id of the hold each node row belongs to, 0 for none, shape (node_capacity,).
        by_id: Holds in the order they were made.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.owner = np.zeros(mesh.node_capacity, dtype=np.int32)
        self.by_id: dict[int, Hold] = {}
        self._next = 1

    def __len__(self) -> int:
        return len(self.by_id)

    @property
    def count(self) -> int:
        """Nodes held."""
        return sum(len(hold.rows) for hold in self.by_id.values())

    @property
    def rows(self) -> Rows:
        """Rows of all nodes held, sorted."""
        # A node belongs to one hold only.
        return np.sort(np.concatenate([_no_rows(), *(hold.rows for hold in self.by_id.values())]))

    @property
    def patches(self) -> list[Patch]:
        """What tools that hold by force pull at."""
        return [hold.patch for hold in self.by_id.values() if hold.patch is not None]

    def forget_stiffness(self) -> None:
        """The tissue or the model is another one: patches sense anew how stiff it is."""
        for patch in self.patches:
            patch.forget()

    def of_tool(self, tool: str) -> list[Hold]:
        """The holds of a tool, oldest first."""
        return [hold for hold in self.by_id.values() if hold.tool == tool]

    def grab(
        self,
        wanted: Rows,
        positions: NDArray[np.float64],
        tool: str,
        pose: NDArray[np.float64],
        by_use: bool,
        by_force: bool = False,
    ) -> Hold:
        """Make a hold. Modifies `owner` in place.

        Args:
            wanted: Rows to hold; none of them fixed.
            positions: Their current positions [m], shape (len(wanted), 3).
            tool: Id of the tool.
            pose: Its pose, shape (7,).
            by_use: Whether pressing `use` made it.
            by_force: Whether its nodes follow a patch that the tool pulls at.
        """
        free = self.owner[wanted] == NOBODY
        hold = Hold(
            id=self._next,
            tool=tool,
            by_use=by_use,
            rows=wanted[free],
            local=rigid.to_local(pose, positions[free]),
            waiting=wanted[~free],
            patch=Patch(pose) if by_force else None,
        )
        self._next += 1
        self.by_id[hold.id] = hold
        self.owner[hold.rows] = hold.id
        return hold

    def release(
        self,
        hold: Hold,
        positions: NDArray[np.float64],
        poses: dict[str, NDArray[np.float64]],
    ) -> Rows:
        """End a hold; nodes others wait for go to the first of those. Modifies the holds in place.

        Args:
            hold: The hold.
            positions: Current positions of its nodes [m], shape (len(hold.rows), 3).
            poses: Poses of all tools.

        Returns:
            Rows of the nodes that are free now.
        """
        del self.by_id[hold.id]
        self.owner[hold.rows] = NOBODY
        for other in self.by_id.values():
            if not len(other.waiting):
                continue
            takes = np.isin(hold.rows, other.waiting) & (self.owner[hold.rows] == NOBODY)
            if takes.any():
                rows = hold.rows[takes]
                self._give(other, rows, rigid.to_local(other.pose(poses), positions[takes]))
        return hold.rows[self.owner[hold.rows] == NOBODY]

    def _give(self, hold: Hold, rows: Rows, local: NDArray[np.float64]) -> None:
        hold.rows = np.concatenate([hold.rows, rows])
        hold.local = np.concatenate([hold.local, local])
        hold.waiting = hold.waiting[~np.isin(hold.waiting, rows)]
        self.owner[rows] = hold.id
        if hold.patch is not None:
            hold.patch.forget()

    def follow(
        self,
        mesh: Mesh,
        change: EditChange,
        moved_positions: NDArray[np.float64],
        poses: dict[str, NDArray[np.float64]],
        merged_positions: NDArray[np.float64] | None = None,
    ) -> list[Hold]:
        """Carry the holds over an edit. Modifies them in place.

        A copy joins the hold of the node it was copied from, at the same place in the tool's axes:
        both lips of a cut made between the jaws are still between them, and nothing jumps. A new
        node with a place of its own is held there if all it lies between are held. A held
        node that snapping moved is held where it is now. Nodes that vanished leave their holds; a
        node they vanished into is held where it is now, by the hold it had or else by that of the
        first of them that was held.

        Args:
            mesh: The mesh, after the edit.
            change: What the edit touched.
            moved_positions: Current positions of `change.moved_nodes` after it [m], shape (m, 3).
            poses: Poses of all tools.
            merged_positions: Current positions of `change.merged_into` after it [m], shape (k, 3);
                needed if there are some.

        Returns:
            Holds that had nodes and have none left; they are released.
        """
        if len(self.owner) < mesh.node_capacity:
            self.owner = np.pad(self.owner, (0, mesh.node_capacity - len(self.owner)))
        if merged_positions is not None and len(change.merged_into):
            self._follow_merged(mesh, change, merged_positions, poses)
        emptied, concerned = [], self._concerned(change)
        for hold in list(self.by_id.values()):
            if hold.id not in concerned and len(hold.rows) and not len(hold.waiting):
                continue
            self._follow_moved(hold, change, moved_positions, hold.pose(poses))
            self._follow_placed(hold, change, moved_positions, hold.pose(poses))
            self._follow_copies(hold, change)
            alive = mesh.node_alive[hold.rows]
            self.owner[hold.rows[~alive]] = NOBODY
            hold.rows, hold.local = hold.rows[alive], hold.local[alive]
            hold.waiting = hold.waiting[mesh.node_alive[hold.waiting]]
            if not len(hold.rows) and not len(hold.waiting):
                del self.by_id[hold.id]
                emptied.append(hold)
        return emptied

    def _concerned(self, change: EditChange) -> set[int]:
        """Ids of the holds that have a node that moved, vanished or has a child, and 0."""
        rows = (change.moved_nodes, change.moved_anchors.ravel(), change.copy_parents,
                change.vanished_nodes)  # fmt: skip
        return set(self.owner[np.concatenate(rows)].tolist())

    @staticmethod
    def _follow_moved(
        hold: Hold,
        change: EditChange,
        positions: NDArray[np.float64],
        pose: NDArray[np.float64],
    ) -> None:
        order = np.argsort(hold.rows)
        place = _places_in(hold.rows[order], change.moved_nodes)
        moved = place >= 0
        if moved.any():
            hold.local[order[place[moved]]] = rigid.to_local(pose, positions[moved])

    def _follow_placed(
        self,
        hold: Hold,
        change: EditChange,
        positions: NDArray[np.float64],
        pose: NDArray[np.float64],
    ) -> None:
        new = among(change.moved_nodes, change.copied_nodes)
        if not new.any():
            return
        held = among(change.moved_anchors.ravel(), hold.rows).reshape(-1, 4)
        mine = new & (held | (change.moved_weights == 0.0)).all(axis=1)
        rows = change.moved_nodes[mine]
        hold.local = np.concatenate([hold.local, rigid.to_local(pose, positions[mine])])
        hold.rows = np.concatenate([hold.rows, rows])
        self.owner[rows] = hold.id

    def _follow_merged(
        self,
        mesh: Mesh,
        change: EditChange,
        positions: NDArray[np.float64],
        poses: dict[str, NDArray[np.float64]],
    ) -> None:
        merged, into = change.merged_nodes, change.merged_into
        for hold in self.by_id.values():
            pose = hold.pose(poses)
            mine = (self.owner[merged] == hold.id) & (self.owner[into] == NOBODY)
            rows, first = np.unique(into[mine & ~mesh.fixed[into]], return_index=True)
            if len(rows):
                places = positions[mine & ~mesh.fixed[into]][first]
                self._give(hold, rows, rigid.to_local(pose, places))
            order = np.argsort(hold.rows)
            place = _places_in(hold.rows[order], into)
            held = place >= 0
            if held.any():
                hold.local[order[place[held]]] = rigid.to_local(pose, positions[held])
        for hold in self.by_id.values():
            waits = into[among(merged, hold.waiting) & (self.owner[into] != NOBODY)]
            waits = waits[self.owner[waits] != hold.id]
            hold.waiting = np.union1d(hold.waiting, waits) if len(waits) else hold.waiting

    def _follow_copies(self, hold: Hold, change: EditChange) -> None:
        if not len(change.copied_nodes):
            return
        stays = change.stays
        order = np.argsort(hold.rows)
        place = _places_in(hold.rows[order], change.copy_parents)
        mine = (place >= 0) & stays
        if mine.any():
            rows = change.copied_nodes[mine]
            hold.local = np.concatenate([hold.local, hold.local[order[place[mine]]]])
            hold.rows = np.concatenate([hold.rows, rows])
            self.owner[rows] = hold.id
        waits = among(change.copy_parents, hold.waiting) & stays
        hold.waiting = np.concatenate([hold.waiting, change.copied_nodes[waits]])

    def place(
        self, mesh: Mesh, displacement: NDArray[np.floating], poses: dict[str, NDArray[np.float64]]
    ) -> None:
        """Put held nodes where their tools or patches are. Modifies `displacement` in place.

        Args:
            mesh: The mesh.
            displacement: Of all nodes [m], shape (node_capacity, 3).
            poses: Poses of all tools.
        """
        for hold in self.by_id.values():
            target = rigid.to_world(hold.pose(poses), hold.local)
            displacement[hold.rows] = target - mesh.rest[hold.rows]
