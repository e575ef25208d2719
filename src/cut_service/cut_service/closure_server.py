"""The service `tissue/closure` and the topic `tissue/holes` of the node `cut_service`."""

from __future__ import annotations

import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from numpy.typing import NDArray
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from tissue_interfaces.msg import Hole as HoleMsg
from tissue_interfaces.msg import Holes
from tissue_interfaces.srv import Closure

from cut_service.errors import CutError
from cut_service.followed import Followed
from cut_service.hole_book import ClosureCode, ClosureError, HoleBook, Looked, look_at
from cut_service.internal_errors import internal_error
from tissue_sim import conversions, qos
from tissue_sim.frames import UnknownFrameError
from tissue_sim.hole_messages import hole_to_msg
from tissue_sim.replica import Shape

PERIOD = 1.0
"""How often holes are looked at unasked [s]."""

SHARE = 0.1
"""Most of the node's time that this takes: what is asked for comes first."""


class ClosureServer:
    """Names holes on the node's replica and says how far they are closed."""

    def __init__(
        self, node: Node, group: CallbackGroup, followed: Followed, book: HoleBook
    ) -> None:
        """Serve `tissue/closure` and publish `tissue/holes` while there are any.

        Args:
            node: The node.
            group: Callback group of handlers that wait.
            followed: What it knows of the organ.
            book: Where holes are remembered.
        """
        self._node, self._followed, self._book = node, followed, book
        self._publisher = node.create_publisher(Holes, "tissue/holes", qos.LATCHED)
        self._last: list[Looked] = []
        self._published = (b"", 0)
        self._look_again = -np.inf
        self._seconds = 0.0
        node.create_service(Closure, "tissue/closure", self._on_closure, callback_group=group)
        node.create_timer(PERIOD, self._look_unasked)

    async def _on_closure(
        self, request: Closure.Request, response: Closure.Response
    ) -> Closure.Response:
        code, text = ClosureCode.NONE, ""
        try:
            shape = await self._followed.shape_at(request.state_frame)
            found = self._carry_out(request, shape)
            response.holes = [_message(looked) for looked in found]
            response.version, response.frame = shape.version, shape.frame
            text = "; ".join(map(str, found)) or "no hole is named"
            if request.name and found[0].closure is None:
                code, text = ClosureCode.HOLE_LOST, found[0].problem
        except ClosureError as error:
            code, text = error.code, str(error)
        except CutError as error:
            code, text = error.code_in(ClosureCode, ClosureCode.INVALID), str(error)
        except Exception as error:
            # Whatever went wrong, the client is answered and the service goes on.
            code = ClosureCode.INVALID
            text = internal_error(self._node, "tissue/closure", error)
        response.success, response.message = code == ClosureCode.NONE, text
        response.error_code = int(code)
        self._node.get_logger().info(f"closure: {text}")
        return response

    def _carry_out(self, request: Closure.Request, shape: Shape) -> list[Looked]:
        mesh, epoch = self._followed.mesh(), self._followed.replica.epoch
        numbers = conversions.array_of(request.positions, np.float64)
        if numbers.size:
            positions = self._in_organ(numbers, request.header.frame_id)
            hole = self._book.name(
                epoch, mesh, shape.positions, request.name, positions, request.reach, request.depth
            )
            self._look_again = -np.inf
            return [look_at(hole, mesh, shape.positions)]
        if request.name:
            return [look_at(self._book.hole(epoch, request.name), mesh, shape.positions)]
        holes = self._book.of(epoch)
        return [look_at(hole, mesh, shape.positions) for hole in holes.values()]

    def _in_organ(self, numbers: NDArray[np.float64], frame_id: str) -> NDArray[np.float64]:
        if numbers.size % 3:
            raise ClosureError(
                ClosureCode.INVALID, f"{numbers.size} coordinates; allowed: three per position"
            )
        frames = self._followed.frames()
        try:
            return frames.points_in_organ(frame_id or frames.organ, numbers.reshape(-1, 3).copy())
        except UnknownFrameError as error:
            raise ClosureError(ClosureCode.UNKNOWN_FRAME, str(error)) from None

    def _look_unasked(self) -> None:
        """Look at all holes and publish what is found, if there is anything new to look at."""
        replica = self._followed.replica
        holes = self._book.of(replica.epoch)
        shape = replica.shape_at(0) if holes and time.monotonic() >= self._look_again else None
        if replica.mesh is None or shape is None:
            if not holes:
                self._last = []
            return
        if self._published == (replica.epoch, shape.frame) and len(self._last) == len(holes):
            return
        begun = time.perf_counter()
        mesh = replica.mesh
        self._last = [look_at(hole, mesh, shape.positions) for hole in holes.values()]
        message = Holes(version=shape.version, frame=shape.frame)
        message.header = conversions.header(
            self._followed.frames().organ, self._node.get_clock().now().to_msg()
        )
        message.epoch = conversions.epoch_field(replica.epoch)
        message.holes = [_message(looked) for looked in self._last]
        self._publisher.publish(message)
        self._published = (replica.epoch, shape.frame)
        self._seconds = time.perf_counter() - begun
        self._look_again = time.monotonic() + (1.0 / SHARE - 1.0) * self._seconds

    def status(self, name: str) -> DiagnosticStatus:
        """How far holes are closed, for the diagnostics of a node."""
        values: dict[str, str] = {"last look [ms]": f"{1e3 * self._seconds:.3f}"}
        for looked in self._last:
            hole, found = looked.hole.name, looked.closure
            if found is None:
                values[f"{hole}: problem"] = looked.problem
                continue
            values[f"{hole}: covered [%]"] = f"{100.0 * found.covered:.1f}"
            values[f"{hole}: widest gap [mm]"] = f"{1e3 * found.gap:.3f}"
            if np.isfinite(found.edge_gap):
                values[f"{hole}: patch from edge [mm]"] = f"{1e3 * found.edge_gap:.3f}"
            values[f"{hole}: area [mm^2]"] = f"{1e6 * found.area:.2f}"
            values[f"{hole}: open [mm^2]"] = f"{1e6 * found.open_area:.2f}"
        return DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=f"{name}: closure",
            message="; ".join(map(str, self._last)) or "no hole is named",
            hardware_id="",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )


def _message(looked: Looked) -> HoleMsg:
    return hole_to_msg(looked.hole, looked.closure, looked.lost, looked.problem)
