"""A simulation that does not move: topology, edits, state and `apply_edit`, for tests of others."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from tissue_interfaces.msg import TissueState, Topology, TopologyEdit
from tissue_interfaces.srv import ApplyEdit

from support.spinner import Spinner
from tissue_sim import conversions, edit_messages, qos
from tissue_sim.geometry.edit import EditError, StaleEditError
from tissue_sim.geometry.edit import TopologyEdit as Edit
from tissue_sim.geometry.mesh import Mesh

FRAME = "organ"


class FakeSimulation(Node):
    """Applies edits to a mesh at rest."""

    def __init__(self, mesh: Mesh, context: Context, rate: float = 50.0) -> None:
        super().__init__("tissue_sim", context=context)
        self.mesh = mesh
        self.epoch = uuid.uuid4().bytes
        self.frame = 0
        self.applied: list[Edit] = []
        self.before_apply: Callable[[], None] = lambda: None
        self.refuse_with = 0
        self._topology = self.create_publisher(Topology, "tissue/topology", qos.LATCHED)
        self._edits = self.create_publisher(TopologyEdit, "tissue/edits", qos.EDITS)
        self._state = self.create_publisher(TissueState, "tissue/state", qos.STATE)
        self.create_service(ApplyEdit, "tissue/apply_edit", self._on_apply)
        self.create_timer(1.0 / rate, self._tick)
        self.publish_keyframe()

    def publish_keyframe(self) -> None:
        """Publish the topology as it is."""
        stamp = self.get_clock().now().to_msg()
        self._topology.publish(conversions.mesh_to_topology(self.mesh, self.epoch, FRAME, stamp))

    def restart(self, mesh: Mesh) -> None:
        """Begin a new epoch with another mesh."""
        self.mesh, self.epoch, self.frame = mesh, uuid.uuid4().bytes, 0
        self.publish_keyframe()

    def apply(self, edit: Edit) -> Edit:
        """Apply an edit and tell everyone."""
        applied = self.mesh.apply(edit).edit
        self.applied.append(applied)
        stamp = self.get_clock().now().to_msg()
        self._edits.publish(edit_messages.edit_to_msg(applied, self.epoch, FRAME, stamp))
        return applied

    def _tick(self) -> None:
        self.frame += 1
        message = TissueState(version=self.mesh.version, frame=self.frame)
        message.header.frame_id = FRAME
        message.header.stamp = self.get_clock().now().to_msg()
        message.epoch = conversions.epoch_field(self.epoch)
        positions = self.mesh.rest[: self.mesh.node_rows].astype(np.float32)
        conversions.fill_state(message, positions)
        self._state.publish(message)

    def _on_apply(
        self, request: ApplyEdit.Request, response: ApplyEdit.Response
    ) -> ApplyEdit.Response:
        self.before_apply()
        edit = edit_messages.edit_from_msg(request.edit)
        try:
            if self.refuse_with:
                response.error_code, response.message = self.refuse_with, "refused by the test"
                return response
            if conversions.epoch_of(request.edit) != self.epoch:
                raise StaleEditError("another epoch")
            applied = self.apply(edit)
            response.version = applied.version
            stamp = self.get_clock().now().to_msg()
            response.applied = edit_messages.edit_to_msg(applied, self.epoch, FRAME, stamp)
            response.success = True
            response.apply_ms = 1.0
        except StaleEditError as error:
            response.error_code, response.message = ApplyEdit.Response.STALE, str(error)
        except EditError as error:
            response.error_code, response.message = ApplyEdit.Response.INVALID, str(error)
        return response


@contextmanager
def spinning(domain: int, factory: Callable[[Context], Node]) -> Iterator[Any]:
    """A node spun by a thread of its own, in a context of its own."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = factory(context)
    spinner = Spinner(node)
    try:
        yield node
    finally:
        spinner.stop()


def wait_for(holds: Callable[[], bool], seconds: float = 30.0, what: str = "it") -> None:
    """Poll until something holds.

    Raises:
        TimeoutError: It does not hold in time.
    """
    deadline = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError(f"waited {seconds:g} s for {what}")
        time.sleep(0.01)
