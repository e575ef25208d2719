"""A copy of the simulation's organ, followed from its topology, edits and states; no ROS inside."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import merge_nodes
from tissue_sim.geometry.edit import EditChange, EditError, TopologyEdit
from tissue_sim.geometry.mesh import Mesh

EARLY_EDITS = 1024
"""Edits kept while their keyframe has not come: as many as the topic keeps for late joiners."""


@dataclass(frozen=True)
class Shape:
    """Where the nodes were at one frame.

    Attributes:
        frame: Frame of the simulation.
        version: Version of the topology that `positions` belong to.
        positions: Node positions [m], float32, shape (node_rows, 3).
    """

    frame: int
    version: int
    positions: NDArray[np.float32]


class Replica:
    """The simulation's mesh at its newest version, and the shapes of the last frames.

    Messages may come in any order between topics. Edits that come before their keyframe wait for
    it. After a gap in the edits the replica is not `ready` until the next keyframe.

    Attributes:
        epoch: Epoch that is followed; empty before the first keyframe.
        mesh: The mesh, changed in place by edits; None before the first keyframe.
        ignored_states: States that belonged to another epoch or to a version that was not known in
            time.
        gaps: How often an edit was missing or did not apply.
    """

    def __init__(self, shapes_kept: int = 30) -> None:
        """Start empty.

        Args:
            shapes_kept: Number of frames whose shapes are kept.
        """
        self.epoch = b""
        self.mesh: Mesh | None = None
        self.ignored_states = 0
        self.gaps = 0
        self._gap = False
        self._shapes: OrderedDict[int, Shape] = OrderedDict()
        self._shapes_kept = shapes_kept
        self._changes: deque[EditChange] = deque()
        self._early_edits: deque[tuple[bytes, TopologyEdit]] = deque(maxlen=EARLY_EDITS)
        self._early_shape: tuple[bytes, Shape] | None = None

    @property
    def ready(self) -> bool:
        """Whether the mesh is up to date as far as is known, and a shape of it has come."""
        return self.mesh is not None and not self._gap and bool(self._shapes)

    @property
    def version(self) -> int:
        """Version of the mesh; 0 before the first keyframe."""
        return self.mesh.version if self.mesh is not None else 0

    @property
    def newest_frame(self) -> int:
        """The newest frame whose shape is known; 0 if there is none."""
        return next(reversed(self._shapes)) if self._shapes else 0

    @property
    def newest_version(self) -> int:
        """Version of the newest shape that has come; 0 if there is none."""
        return next(reversed(self._shapes.values())).version if self._shapes else 0

    @property
    def oldest_frame(self) -> int:
        """The oldest frame whose shape is kept; 0 if there is none."""
        return next(iter(self._shapes)) if self._shapes else 0

    def wants_keyframe(self, epoch: bytes, version: int) -> bool:
        """Whether a keyframe would tell anything new.

        A cheap question before converting a large message.
        """
        return epoch != self.epoch or self.mesh is None or (self._gap and version > self.version)

    def take_keyframe(self, epoch: bytes, mesh: Mesh) -> bool:
        """Start from a keyframe, unless what is here is as new; says whether it did.

        Args:
            epoch: Epoch of the keyframe.
            mesh: The mesh, at the keyframe's version. The replica owns it from now on.
        """
        if not self.wants_keyframe(epoch, mesh.version):
            return False
        if epoch != self.epoch:
            self._shapes.clear()
        self.epoch, self.mesh, self._gap = epoch, mesh, False
        # Older shapes cannot be carried over edits that were missed.
        self._shapes = OrderedDict(
            (f, s) for f, s in self._shapes.items() if s.version == mesh.version
        )
        self._changes.clear()
        waiting = [edit for e, edit in self._early_edits if e == epoch]
        self._early_edits.clear()
        for edit in sorted(waiting, key=lambda edit: edit.version):
            self.take_edit(epoch, edit)
        self._adopt_early_shape()
        return True

    def take_edit(self, epoch: bytes, edit: TopologyEdit) -> EditChange | None:
        """Apply an edit the simulation has applied.

        Returns:
            What it touched; None if it was known, is for another epoch, or has to wait for a
            keyframe.
        """
        if self.mesh is None or epoch != self.epoch:
            self._early_edits.append((epoch, edit))
            return None
        if edit.version <= self.mesh.version:
            return None
        if self._gap or edit.version != self.mesh.version + 1:
            self._miss(epoch, edit)
            return None
        try:
            change = self.mesh.apply(edit)
        except EditError:
            self._miss(epoch, edit)
            return None
        if self.mesh.version != edit.version:
            self._miss(epoch, edit)
            return None
        self._changes.append(change)
        self._adopt_early_shape()
        return change

    def take_state(
        self, epoch: bytes, version: int, frame: int, positions: NDArray[np.float32]
    ) -> bool:
        """Keep the shape of a frame. Returns whether it belongs to the mesh as it is now.

        Args:
            epoch: Epoch of the state.
            version: Version of the topology it belongs to.
            frame: Frame of the simulation.
            positions: Node positions [m], shape (node_rows, 3).
        """
        shape = Shape(frame, version, positions)
        if self._fits(epoch, shape):
            self._keep(shape)
            return True
        early = self.mesh is None or epoch != self.epoch or version > self.mesh.version
        if early:
            # Its edit or keyframe may be on the way.
            self._early_shape = (epoch, shape)
        self.ignored_states += 1
        return False

    def shape_at(self, frame: int = 0) -> Shape | None:
        """The shape at a frame, carried over all edits applied since, so that it fits the mesh.

        Args:
            frame: Frame wanted; 0 for the newest. A frame within those kept that did not arrive is
                stood in for by the next one.

        Returns:
            None if nothing is ready, or the frame is older or newer than those kept.
        """
        if not self.ready:
            return None
        if frame == 0:
            frame = self.newest_frame
        if not self.oldest_frame <= frame <= self.newest_frame:
            return None
        shape = next(s for f, s in self._shapes.items() if f >= frame)
        for change in self._changes:
            if change.edit.version > shape.version:
                shape = _carried(shape, change)
        return shape

    def _fits(self, epoch: bytes, shape: Shape) -> bool:
        mesh = self.mesh
        return (
            mesh is not None
            and epoch == self.epoch
            and shape.version == mesh.version
            and shape.positions.shape == (mesh.node_rows, 3)
        )

    def _keep(self, shape: Shape) -> None:
        if self._shapes and shape.frame <= self.newest_frame:
            return
        self._shapes[shape.frame] = shape
        while len(self._shapes) > self._shapes_kept:
            self._shapes.popitem(last=False)
        oldest = self._shapes[self.oldest_frame].version
        while self._changes and self._changes[0].edit.version <= oldest:
            self._changes.popleft()

    def _miss(self, epoch: bytes, edit: TopologyEdit) -> None:
        self.gaps += not self._gap
        self._gap = True
        self._early_edits.append((epoch, edit))

    def _adopt_early_shape(self) -> None:
        if self._early_shape is not None and self._fits(*self._early_shape):
            self._keep(self._early_shape[1])
            self._early_shape = None


def _carried(shape: Shape, change: EditChange) -> Shape:
    """The shape after an edit, as `State.follow` carries the simulation's."""
    old = shape.positions
    born = change.born_nodes
    made = np.concatenate([change.copied_nodes, born])
    new = np.empty((max(len(old), int(made.max(initial=-1)) + 1), 3), dtype=old.dtype)
    new[: len(old)] = old
    # Those without parent come last.
    back = len(change.returned_nodes) - len(born)
    returned, like = change.returned_nodes[:back], change.returned_like[:back]
    new[returned] = old[like] + change.returned_offsets[:back]
    new[born] = change.edit.born_rest
    if len(change.merged_nodes):
        merge_nodes(change, new)
    if len(change.moved_nodes):
        new[change.moved_nodes] = np.einsum(
            "ij,ijk->ik", change.moved_weights, new[change.moved_anchors].astype(np.float64)
        )
    stays = change.stays
    new[change.copied_nodes[stays]] = new[change.copy_parents[stays]]
    return Shape(shape.frame, change.edit.version, new)
