"""Follows an organ through its messages, live or out of a bag: topology, edits, states, tools."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.conversions import epoch_of, positions_from_state, topology_to_mesh
from tissue_sim.edit_messages import edit_from_msg
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.replica import Replica
from viz_bridge.cdr import Message
from viz_bridge.session_events import SessionEvent, journal_events
from viz_bridge.tool_shapes import DrawnTools


class OrganFollower:
    """What is known of an organ from the messages taken so far.

    Attributes:
        replica: Mesh and newest shape.
        tools: Its tools.
        sim_time: Of the newest state or journal entry [s].
        frame: Likewise.
    """

    def __init__(self) -> None:
        self.replica = Replica(shapes_kept=2)
        self.tools = DrawnTools()
        self.sim_time = 0.0
        self.frame = 0

    def take_topology(self, message: Message) -> bool:
        """Take a keyframe; returns whether it replaced the mesh."""
        epoch, version = epoch_of(message), int(message.version)
        if not self.replica.wants_keyframe(epoch, version):
            return False
        return self.replica.take_keyframe(epoch, topology_to_mesh(message))

    def take_edit(self, message: Message) -> bool:
        """Take an edit; returns whether the mesh changed."""
        edit = edit_from_msg(message)
        return self.replica.take_edit(epoch_of(message), edit) is not None

    def take_state(self, message: Message) -> NDArray[np.float32] | None:
        """Take a state; its positions [m], shape (node_rows, 3), if they fit the mesh as it is."""
        positions = positions_from_state(message)
        fits = self.replica.take_state(
            epoch_of(message), int(message.version), int(message.frame), positions
        )
        if fits:
            self.sim_time, self.frame = float(message.sim_time), int(message.frame)
        return positions if fits else None

    def take_journal(self, message: Message) -> list[SessionEvent]:
        """Take a frame of the journal; what happened in it."""
        self.sim_time, self.frame = float(message.sim_time), int(message.frame)
        self.tools.take_journal(message)
        return journal_events(message, self.tools.kinds)

    @property
    def mesh(self) -> Mesh | None:
        """The mesh at its newest version."""
        return self.replica.mesh
