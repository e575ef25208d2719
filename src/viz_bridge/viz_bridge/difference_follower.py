"""Follows a session through its messages, with a second model beside it, and compares the two."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.subject import Subject
from tissue_sim.conversions import epoch_of, nanoseconds_of, positions_from_state, topology_to_mesh
from tissue_sim.edit_messages import edit_from_msg
from tissue_sim.frame import JournalEntry
from tissue_sim.journal_messages import entry_from_msg
from tissue_sim.replica import Replica
from viz_bridge.joining import NEEDED, held_rows, scene_in_the_middle
from viz_bridge.second_model import SecondModel, checked_subject, merged, only_moves
from viz_bridge.session_shapes import SessionShapes

PATIENCE = 10
"""Frames of the journal that may come before the shape of a frame counts as lost."""


@dataclass(frozen=True)
class Compared:
    """How far the second model is from the session in one frame.

    Attributes:
        entry: The frame.
        stamp: When it began [ns since 1970].
        positions: Of the second model [m], float32, shape (node_rows, 3).
        distance: Of each node from where it is in the session [m], float32, shape (node_rows,);
            nan: it is no more.
        mean: Mean over the nodes [m].
        p95: 95th percentile of the nodes [m].
        largest: Largest of a node [m].
        relative: Mean distance of all frames so far over that of tissue that does not follow the
            tools at all; nan while nothing has moved.
    """

    entry: JournalEntry
    stamp: int
    positions: NDArray[np.float32]
    distance: NDArray[np.float32]
    mean: float
    p95: float
    largest: float
    relative: float


class DifferenceFollower:
    """Takes a session's messages; `advance` plays what has come of its journal.

    From the first frame on the second model repeats the journal exactly. Who joins later, or has
    lost a frame, starts from the session's newest shape.

    Attributes:
        subject: The second model.
        second: What plays it; None: not yet.
        compared: Frames compared.
        unseen: Frames played whose shape in the session was not known.
        joined: Frame of the session at which the second model began; 0: at its start.
        problem: Why the second model does not follow; empty: it does.
    """

    def __init__(self, subject: Subject, keep_up: bool = False) -> None:
        """Wait for a session.

        Args:
            subject: The second model.
            keep_up: Whether frames in which tools only move are passed over while newer ones wait.

        Raises:
            ValueError: The subject cannot follow a session.
        """
        self.subject = checked_subject(subject)
        self.second: SecondModel | None = None
        self.compared = self.unseen = self.joined = 0
        self.problem = ""
        self._keep_up = keep_up
        self._replica = Replica(shapes_kept=2)
        self._first: Any = None
        self._latched: dict[str, Any] = {}
        self._waiting: deque[tuple[JournalEntry, int]] = deque()
        self._shapes = SessionShapes()
        self._newest: tuple[JournalEntry, int] | None = None
        self._totals = np.zeros(2)
        self._refused: tuple[bytes, int] | None = None
        self._takers: dict[str, Callable[[Any], None]] = {
            "tissue/topology": self._take_topology,
            "tissue/edits": self._take_edit,
            "tissue/state": self._take_state,
            "tissue/journal": self._take_journal,
        }

    @property
    def waiting(self) -> int:
        """Frames of the journal that have not been played."""
        return len(self._waiting)

    @property
    def lag(self) -> float:
        """How far the second model is behind the journal [s]."""
        if self._newest is None or not self._waiting:
            return 0.0
        return (self._newest[1] - self._waiting[0][1]) / 1e9

    def take(self, topic: str, message: Any) -> None:
        """Take a message of the session.

        Args:
            topic: Relative to the session's namespace.
            message: As rclpy gives it.
        """
        taker = self._takers.get(topic)
        if taker is not None:
            taker(message)
        else:
            self._latched[topic] = message

    def _take_topology(self, message: Any) -> None:
        epoch, version = epoch_of(message), int(message.version)
        if not self._replica.wants_keyframe(epoch, version):
            return
        self._first = message if version == 1 else None
        self._replica.take_keyframe(epoch, topology_to_mesh(message))

    def _take_edit(self, message: Any) -> None:
        self._replica.take_edit(epoch_of(message), edit_from_msg(message))

    def _take_state(self, message: Any) -> None:
        positions = positions_from_state(message)
        epoch, frame = epoch_of(message), int(message.frame)
        self._replica.take_state(epoch, int(message.version), frame, positions)
        self._shapes.put(epoch, frame, positions)

    def _take_journal(self, message: Any) -> None:
        entry = entry_from_msg(message)
        before = self._newest[0] if self._newest is not None else None
        if before is not None and (entry.epoch, entry.frame) != (before.epoch, before.frame + 1):
            # What has been lost is in the shape that the second model begins with anew.
            self._waiting.clear()
            self.second = None
        self._newest = (entry, nanoseconds_of(message.header.stamp))
        self._waiting.append(self._newest)

    def advance(self) -> tuple[bool, Compared | None]:
        """Play the next frame that waits: whether there was one, and what came of it."""
        second = self.second or self._begin()
        if second is None or not self._waiting or not self._shape_has_come():
            return False, None
        while self._may_pass_over(second):
            passed = self._waiting.popleft()[0]
            following, stamp = self._waiting[0]
            self._waiting[0] = merged(passed, following), stamp
        entry, stamp = self._waiting.popleft()
        return True, self._play(second, entry, stamp)

    def _shape_has_come(self) -> bool:
        entry = self._waiting[0][0]
        return self._shapes.has_come(entry.epoch, entry.frame) or len(self._waiting) > PATIENCE

    def _may_pass_over(self, second: SecondModel) -> bool:
        in_time = second.simulation.model.time_step is not None
        if not self._keep_up or in_time or len(self._waiting) < 2:
            return False
        (entry, _), (following, _) = self._waiting[0], self._waiting[1]
        has_come = self._shapes.has_come(following.epoch, following.frame)
        return only_moves(entry.inputs) and has_come

    def _play(self, second: SecondModel, entry: JournalEntry, stamp: int) -> Compared | None:
        frame = second.play(entry, self._shapes.before(entry.epoch, entry.frame))
        if frame.journal.version != entry.version:
            refused = [answer.message for answer in frame.answers if not answer.success]
            self.problem = (
                f"{self.subject.name} did not follow to version {entry.version}"
                f"{': ' if refused else ''}{'; '.join(refused)}"
            )
            self.second = None
            return None
        self.problem = frame.lost
        # The shape of this frame stays: a tool may take nodes of it in the next one.
        self._shapes.forget_before(entry.epoch, entry.frame)
        shape = self._shapes.at(entry.epoch, entry.frame)
        if shape is None or len(shape) != len(frame.positions):
            self.unseen += 1
            return None
        return self._compare(second, entry, stamp, frame.positions.copy(), shape)

    def _compare(
        self,
        second: SecondModel,
        entry: JournalEntry,
        stamp: int,
        positions: NDArray[np.float32],
        shape: NDArray[np.float32],
    ) -> Compared:
        mesh = second.simulation.mesh
        alive = mesh.node_alive[: mesh.node_rows]
        apart = np.linalg.norm(positions.astype(np.float64) - shape, axis=1)
        moved = np.linalg.norm(second.simulation.state.displacement[: mesh.node_rows], axis=1)
        of_living = apart[alive]
        # Tissue that does not follow stays where it is at rest, but for what is held.
        self._totals += apart[alive].mean(), (moved * second.free_nodes())[alive].mean()
        self.compared += 1
        total, worst = self._totals.tolist()
        return Compared(
            entry, stamp, positions,
            np.where(alive, apart, np.nan).astype(np.float32),
            float(of_living.mean()), float(np.percentile(of_living, 95)), float(of_living.max()),
            total / worst if worst > 0.0 else float("nan"),
        )  # fmt: skip

    # Where it begins

    def _begin(self) -> SecondModel | None:
        """Build the second model; None: what it needs has not come, or it is not possible."""
        if not self._waiting or self._waiting[0][0].epoch != self._replica.epoch:
            return None
        entry = self._waiting[0][0]
        self.joined = 0
        try:
            if entry.frame == 1 and self._first is not None:
                mesh = topology_to_mesh(self._first)
                self.second = SecondModel.from_start(self.subject, entry, mesh)
            else:
                self.second = self._join()
        except ValueError as error:
            self._refused = (self._replica.epoch, self._replica.version)
            self.problem = f"{self.subject.name} cannot follow: {error}"
        if self.second is not None:
            self.compared = self.unseen = 0
            self._totals[:] = 0.0
            self.problem = ""
        return self.second

    def _join(self) -> SecondModel | None:
        """Begin in the middle: with the newest shape, once the journal of its frame has come."""
        replica, latched = self._replica, self._latched
        shape, mesh = replica.shape_at(0), replica.mesh
        if shape is None or mesh is None or not set(NEEDED) <= set(latched):
            return None
        if (replica.epoch, replica.version) == self._refused:
            return None
        while len(self._waiting) > 1 and self._waiting[0][0].frame < shape.frame:
            self._waiting.popleft()
        entry = self._waiting[0][0]
        # Edits that are in the mesh already must not come again.
        if entry.frame != shape.frame or entry.version != mesh.version or len(self._waiting) < 2:
            return None
        mesh = deepcopy(mesh)
        displacement = (shape.positions - mesh.rest[: mesh.node_rows]).astype(np.float32)
        scene = scene_in_the_middle(latched, [e.sim_time for e, _ in self._waiting], displacement)
        held = held_rows(latched, replica.epoch, mesh)
        second = SecondModel.from_shape(self.subject, scene, entry, mesh, held)
        self._waiting.popleft()
        self.joined = entry.frame
        return second
