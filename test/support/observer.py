"""A node in the test's process that watches one organ and asks things of it."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.client import Client
from rclpy.context import Context
from rclpy.node import Node
from tissue_interfaces import msg as messages
from tissue_interfaces.srv import ApplyEdit, Cut

from cut_service.sweep import Sweep
from support.fake_simulation import wait_for
from tissue_sim import conversions, edit_messages, journal_messages, qos
from tissue_sim.frame import JournalEntry, ToolSample
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.replica import Replica

FRAME = "organ"
PATIENCE = 120.0
"""Longest wait for something that may have to compile its kernels first [s]."""


class Observer(Node):
    """Follows status, tools, journal, topology, edits and states of one namespace.

    Attributes:
        entries: The whole journal as it was heard.
        replica: The organ, followed as every node does.
        status: The newest status; None before there is one.
        tools: The newest list of tools by id.
        diagnostics: The newest finding by its full name.
    """

    def __init__(self, context: Context, namespace: str = "") -> None:
        super().__init__("observer", context=context, namespace=namespace)
        self.entries: list[JournalEntry] = []
        self.replica = Replica()
        self.status: messages.Status | None = None
        self.tools: dict[str, messages.Tool] = {}
        self.diagnostics: dict[str, Any] = {}
        listen = self.create_subscription
        listen(messages.Topology, "tissue/topology", self._on_topology, qos.LATCHED)
        listen(messages.TopologyEdit, "tissue/edits", self._on_edit, qos.EDITS)
        listen(messages.TissueState, "tissue/state", self._on_state, qos.STATE)
        listen(messages.Journal, "tissue/journal", self._on_journal, qos.JOURNAL)
        listen(messages.Status, "tissue/status", self._on_status, qos.LATCHED)
        listen(messages.ToolList, "tissue/tools", self._on_tools, qos.LATCHED)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.DIAGNOSTICS)
        self.cuts: Client = self.create_client(Cut, "tissue/cut")
        self.edits: Client = self.create_client(ApplyEdit, "tissue/apply_edit")

    # What was seen

    @property
    def epoch(self) -> bytes:
        """Epoch of the newest status; empty before there is one."""
        return conversions.epoch_of(self.status) if self.status is not None else b""

    @property
    def ready(self) -> bool:
        """Whether the simulation runs."""
        return self.status is not None and self.status.state == messages.Status.READY

    @property
    def mesh(self) -> Mesh:
        """The organ as it is known here."""
        assert self.replica.mesh is not None
        return self.replica.mesh

    @property
    def positions(self) -> NDArray[np.float32]:
        """The newest shape [m], shape (node_rows, 3)."""
        shape = self.replica.shape_at()
        assert shape is not None
        return shape.positions

    def frames(self, epoch: bytes) -> list[int]:
        """Frames of an epoch whose journal was heard."""
        return [entry.frame for entry in list(self.entries) if entry.epoch == epoch]

    def samples(self, tool: str) -> list[ToolSample]:
        """A tool as it was used in each frame."""
        return [s for entry in list(self.entries) for s in entry.inputs.tools if s.tool == tool]

    def finding(self, name: str) -> str:
        """Message of the newest finding with this name; empty: there is none."""
        return self.diagnostics[name].message if name in self.diagnostics else ""

    # What can be asked

    def wait_ready(self) -> bytes:
        """Wait for the running simulation and its shape; gives the epoch."""
        wait_for(lambda: self.ready and self.replica.ready, PATIENCE, "a running simulation")
        return self.epoch

    def wait_frames(self, count: int) -> None:
        """Wait for some more frames."""
        goal = len(self.entries) + count
        wait_for(lambda: len(self.entries) >= goal, 60.0, f"{count} frames")

    def cut(self, sweep: Sweep, request_id: str) -> Cut.Response:
        """Cut, and ask again while there is no answer: a killed service cannot answer.

        The request's id makes sure that it is done once.
        """
        wait_for(self.cuts.service_is_ready, PATIENCE, "tissue/cut")
        stamp = self.get_clock().now().to_msg()
        message = conversions.sweep_message(sweep.vertices, sweep.triangles, 0, FRAME, stamp)
        request = Cut.Request(sweep=message, request_id=request_id)
        return self._insist(self.cuts, request)

    def apply(self, edit: messages.TopologyEdit) -> ApplyEdit.Response:
        """Ask the simulation to apply an edit."""
        wait_for(self.edits.service_is_ready, PATIENCE, "tissue/apply_edit")
        return self._insist(self.edits, ApplyEdit.Request(edit=edit))

    @staticmethod
    def _insist(client: Client, request: Any) -> Any:
        futures = []
        for _ in range(30):
            futures.append(client.call_async(request))
            with suppress(TimeoutError):
                wait_for(lambda: any(future.done() for future in futures), 2.0)
                return next(future for future in futures if future.done()).result()
        raise TimeoutError(f"{client.srv_name} does not answer")

    # Callbacks

    def _on_topology(self, message: messages.Topology) -> None:
        epoch = conversions.epoch_of(message)
        if self.replica.wants_keyframe(epoch, message.version):
            self.replica.take_keyframe(epoch, conversions.topology_to_mesh(message))

    def _on_edit(self, message: messages.TopologyEdit) -> None:
        self.replica.take_edit(conversions.epoch_of(message), edit_messages.edit_from_msg(message))

    def _on_state(self, message: messages.TissueState) -> None:
        self.replica.take_state(
            conversions.epoch_of(message), message.version, message.frame,
            conversions.positions_from_state(message),
        )  # fmt: skip

    def _on_journal(self, message: messages.Journal) -> None:
        self.entries.append(journal_messages.entry_from_msg(message))

    def _on_status(self, message: messages.Status) -> None:
        self.status = message

    def _on_tools(self, message: messages.ToolList) -> None:
        self.tools = {tool.id: tool for tool in message.tools}

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.diagnostics.update({status.name: status for status in message.status})
