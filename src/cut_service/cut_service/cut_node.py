"""Node `cut_service`: plans cuts on its own copy of the organ, off the simulation's clock."""

from __future__ import annotations

import sys
import time
import uuid

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from tissue_interfaces import msg as messages
from tissue_interfaces.srv import ApplyEdit, Cut

from cut_service.closure_server import ClosureServer
from cut_service.cut_parameters import SPECS, CutParameters
from cut_service.errors import CutCode, CutError
from cut_service.followed import Followed
from cut_service.hole_book import HoleBook
from cut_service.internal_errors import internal_error
from cut_service.ledger import Ledger
from cut_service.organ import organ_of
from cut_service.outcome import Outcome
from cut_service.patch_server import PatchServer
from cut_service.planner import SHEET_METHOD, Plan, Report, Settings, plan
from cut_service.strokes import Pick, Strip, Strokes
from cut_service.suture_server import SutureServer
from cut_service.sweep import Sweep
from cut_service.tissue_watch import TissueWatch
from cut_service.waiting import Until
from cut_service.warm_up import warm_up
from cut_service.watch_parameters import WATCH_SPECS
from tissue_sim import conversions, edit_messages, node_main, qos
from tissue_sim.frames import Frames, UnknownFrameError, frame_specs
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.replica import Replica, Shape

WAKE_PERIOD = 0.05
"""How often the executor wakes to notice deadlines [s]."""

SILENT_AFTER = 2.0
"""Without a state for this long the simulation counts as silent [s]."""

TRIES = 3
"""How often an edit is sent while the simulation does not answer."""


class CutNode(Node):
    """Follows the simulation's organ, plans cuts on it and asks the simulation to apply them."""

    def __init__(self) -> None:
        super().__init__("cut_service")
        frame_names = node_main.names_under(self, "frames")
        self._values = node_main.declare(self, [*SPECS, *WATCH_SPECS, *frame_specs(frame_names)])
        self._settings = CutParameters.of(self._values)
        self._frames = Frames.from_parameters("organ", self._values)
        self._replica = Replica(self._settings.shapes_kept)
        self._strokes = Strokes(self._replica, self._settings.settings, self.get_logger().info)
        self._ledger: Ledger[Outcome] = Ledger(self._settings.requests_remembered)
        self._counts = {"applied": 0, "failed": 0, "replanned": 0}
        self._last: Outcome | None = None
        self._last_state = -np.inf
        self._watch = TissueWatch(
            self, self._replica, self._settings.settings, self._settings.answer_timeout,
            lambda: self._frames.organ,
        )  # fmt: skip
        seconds = warm_up()
        group = ReentrantCallbackGroup()
        self.create_subscription(
            messages.Topology, "tissue/topology", self._on_topology, qos.LATCHED
        )
        self.create_subscription(messages.TopologyEdit, "tissue/edits", self._on_edit, qos.EDITS)
        self.create_subscription(messages.TissueState, "tissue/state", self._on_state, qos.STATE)
        self._apply = self.create_client(ApplyEdit, "tissue/apply_edit", callback_group=group)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self.create_subscription(
            messages.CutRequest, "tissue/cut_request", self._on_cut_request, qos.CUT_REQUEST,
            callback_group=group,
        )  # fmt: skip
        self.create_service(Cut, "tissue/cut", self._on_cut, callback_group=group)
        self._followed = followed = Followed(
            self._replica, lambda: self._frames, self._shape_at, self._ask, self._newer_than
        )
        book = HoleBook()
        self._sutures = SutureServer(
            self, group, followed, self._settings.requests_remembered, book
        )
        self._closure = ClosureServer(self, group, followed, book)
        self._patches = PatchServer(self, group, followed, self._settings.requests_remembered)
        self.create_timer(WAKE_PERIOD, lambda: None)
        self.create_timer(1.0, self._publish_diagnostics)
        self.get_logger().info(f"ready (kernels compiled in {seconds:.1f} s)")

    # Following the organ

    def _on_topology(self, message: messages.Topology) -> None:
        epoch = conversions.epoch_of(message)
        if not self._replica.wants_keyframe(epoch, message.version):
            return
        restarted = bool(self._replica.epoch) and epoch != self._replica.epoch
        self._frames = Frames.from_parameters(message.header.frame_id, self._values)
        self._replica.take_keyframe(epoch, conversions.topology_to_mesh(message))
        self._look_at_organ()
        self.get_logger().info(
            f"{'the simulation restarted: ' if restarted else ''}attached to {message.organ}, "
            f"epoch {epoch.hex()[:8]}, version {message.version}"
        )

    def _on_edit(self, message: messages.TopologyEdit) -> None:
        edit = edit_messages.edit_from_msg(message)
        change = self._replica.take_edit(conversions.epoch_of(message), edit)
        if change is not None:
            self._look_at_organ()
            self._watch.on_edit(change)

    def _look_at_organ(self) -> None:
        """Look at what is new of the organ now, and not when a request waits for its plan."""
        mesh = self._replica.mesh
        if mesh is not None and mesh.sheet_rows is None:
            organ_of(mesh)

    def _on_state(self, message: messages.TissueState) -> None:
        self._last_state = time.monotonic()
        self._replica.take_state(
            conversions.epoch_of(message), message.version, message.frame,
            conversions.positions_from_state(message),
        )  # fmt: skip
        self._watch.on_state(message)

    # Requests

    async def _on_cut(self, request: Cut.Request, response: Cut.Response) -> Cut.Response:
        outcome = await self._once(request.request_id, request.sweep, request.method, "")
        response.success = outcome.code == CutCode.NONE
        response.message, response.error_code = outcome.message, int(outcome.code)
        response.version = outcome.version
        if outcome.plan is not None:
            response.report = _report(outcome.plan.report, outcome.apply_ms)
        return response

    async def _on_cut_request(self, message: messages.CutRequest) -> None:
        epoch = conversions.epoch_of(message)
        attached = await Until(lambda: self._replica.epoch == epoch, self._settings.tissue_timeout)
        if not attached:
            self.get_logger().warning(
                f"dropped a cut by {message.tool}: it is of epoch {epoch.hex()[:8]}, "
                f"followed is {self._replica.epoch.hex()[:8] or 'none yet'}"
            )
            return
        if message.stroke:
            await self._strokes.take(self._strip(message, epoch), self._cut_strip)
        else:
            await self._once(message.request_id, message.sweep, "", message.tool)

    def _strip(self, message: messages.CutRequest, epoch: bytes) -> Strip:
        return Strip(
            message.stroke, message.strip, message.ends, message.tool, epoch,
            message.sweep.state_frame, np.array(message.sweep.vertices),
            np.array(message.sweep.triangles),
        )  # fmt: skip

    async def _cut_strip(
        self, pick: Pick, frame: int, epoch: bytes, tool: str, request_id: str
    ) -> Outcome:
        """Cut along what a stroke has passed, on the newest shape, which must know of its pose."""
        replica = self._replica
        await Until(
            lambda: replica.ready and replica.newest_frame >= frame, self._settings.tissue_timeout
        )
        outcome = await self._cut_along(pick, None, epoch, "", tool, request_id)
        self._last = outcome
        return outcome

    async def _once(
        self, request_id: str, sweep: messages.Sweep, method: str, author: str
    ) -> Outcome:
        """The outcome of a request; a repeat gets that of the first, done or not."""
        patience = self._settings.attempts * (
            self._settings.answer_timeout + 2 * self._settings.tissue_timeout
        )
        request_id = request_id or uuid.uuid4().hex
        answer = await self._ledger.once(
            request_id, lambda: self._answered(request_id, sweep, method, author), patience
        )
        return answer or Outcome(
            CutCode.SIMULATION_LOST, "the first request with this id is still being worked on"
        )

    async def _answered(
        self, request_id: str, sweep: messages.Sweep, method: str, author: str
    ) -> Outcome:
        try:
            outcome = await self._cut(request_id, sweep, method, author)
        except CutError as error:
            outcome = Outcome(error.code, str(error))
        except Exception as error:
            # Whatever went wrong, the client is answered and the service goes on.
            outcome = Outcome(CutCode.REFUSED, internal_error(self, "tissue/cut", error))
        self._last = outcome
        self._counts["failed" if outcome.code else "applied"] += 1
        by = f" by {author}" if author else ""
        self.get_logger().info(f"cut{by}: {outcome.message}")
        return outcome

    async def _cut(
        self, request_id: str, message: messages.Sweep, method: str, author: str
    ) -> Outcome:
        drawn = Sweep.from_arrays(message.vertices, message.triangles)
        shape: Shape | None = await self._shape_at(message.state_frame)
        epoch = self._replica.epoch
        sweep = self._in_organ(drawn, message.header.frame_id)

        def pick(_mesh: Mesh, _shape: Shape) -> tuple[Sweep, Settings]:
            return sweep, self._settings.settings

        return await self._cut_along(pick, shape, epoch, method, author, request_id)

    async def _cut_along(
        self,
        pick: Pick,
        shape: Shape | None,
        epoch: bytes,
        method: str,
        author: str,
        request_id: str,
    ) -> Outcome:
        def replanned() -> None:
            self._counts["replanned"] += 1

        made = await self._followed.make(
            lambda mesh, on: self._plan(mesh, on, pick, method), shape, epoch,
            author or self.get_name(), request_id, attempts=self._settings.attempts,
            on_stale=replanned,
        )  # fmt: skip
        answer = made.answer
        return Outcome(
            CutCode.NONE, _in_words(made.plan), answer.version, made.plan, answer.apply_ms
        )

    async def _newer_than(self, version: int, epoch: bytes) -> None:
        replica = self._replica
        await Until(
            lambda: replica.version > version or replica.epoch != epoch,
            self._settings.tissue_timeout,
        )

    async def _shape_at(self, frame: int) -> Shape:
        """The organ's shape at a frame; waits for it when it has not come yet."""
        replica = self._replica
        found = await Until(
            lambda: replica.ready and replica.newest_frame >= frame,
            self._settings.tissue_timeout,
        )
        shape = replica.shape_at(frame)
        if shape is not None:
            return shape
        if not replica.ready:
            raise CutError(
                CutCode.NO_TISSUE, "no topology or state of the tissue has been received yet"
            )
        gone = "is no longer kept" if found else "has not come"
        raise CutError(
            CutCode.STATE_FRAME_GONE,
            f"state frame {frame} {gone}; kept: {replica.oldest_frame} to {replica.newest_frame}",
        )

    def _in_organ(self, sweep: Sweep, frame_id: str) -> Sweep:
        try:
            vertices = self._frames.points_in_organ(frame_id, sweep.vertices)
        except UnknownFrameError as error:
            raise CutError(CutCode.UNKNOWN_FRAME, str(error)) from None
        return Sweep(np.ascontiguousarray(vertices), sweep.triangles)

    def _plan(self, mesh: Mesh, shape: Shape, pick: Pick, method: str) -> Plan:
        default = self._settings.method if mesh.sheet_rows is None else SHEET_METHOD
        sweep, settings = pick(mesh, shape)
        return plan(
            mesh, shape.positions, sweep, method or default, settings=settings,
            held=self._watch.held_nodes(),
        )  # fmt: skip

    async def _ask(self, planned: TopologyEdit, epoch: bytes) -> ApplyEdit.Response:
        """The simulation's answer to an edit."""
        patience = self._settings.answer_timeout
        if not await Until(self._apply.service_is_ready, self._settings.tissue_timeout):
            raise CutError(
                CutCode.SIMULATION_LOST,
                f"nobody serves {self._apply.srv_name}; nothing was changed",
            )
        stamp = self.get_clock().now().to_msg()
        edit = edit_messages.edit_to_msg(planned, epoch, self._frames.organ, stamp)
        futures: list[Future] = []
        # A request can be lost with a simulation that was killed. The edit's request id makes it
        # safe to send it again: a repeat is answered, not applied.
        for _ in range(TRIES):
            futures.append(self._apply.call_async(ApplyEdit.Request(edit=edit)))
            if await Until(lambda: any(f.done() for f in futures), patience / TRIES):
                break
        answered = [future for future in futures if future.done()]
        for future in futures:
            self._apply.remove_pending_request(future)
        if answered:
            return answered[0].result()
        self._followed.refuse_other_epoch(epoch)
        raise CutError(
            CutCode.SIMULATION_LOST, f"the simulation did not answer within {patience:g} s"
        )

    # Reporting

    def _publish_diagnostics(self) -> None:
        replica, last = self._replica, self._last
        level, text = DiagnosticStatus.OK, "following"
        if replica.mesh is None:
            level, text = DiagnosticStatus.WARN, "waiting for the tissue's topology"
        elif time.monotonic() - self._last_state > SILENT_AFTER:
            level, text = DiagnosticStatus.WARN, "the simulation is silent"
        elif not replica.ready:
            level, text = DiagnosticStatus.WARN, "waiting for a keyframe: edits were missed"
        values: dict[str, object] = {
            "epoch": replica.epoch.hex(),
            "version": replica.version,
            "frame": replica.newest_frame,
            "states ignored": replica.ignored_states,
            "gaps in edits": replica.gaps,
            **{f"cuts {what}": number for what, number in self._counts.items()},
            "strokes": self._strokes.finished,
            "last stroke": self._strokes.last,
            "last stroke in figures": self._strokes.last_figures,
        }
        if last is not None:
            values["last cut"] = last.message
            values["last code"] = last.code.name
        if last is not None and last.plan is not None:
            report = last.plan.report
            values["last plan [ms]"] = f"{report.plan_ms:.3f}"
            values["last apply [ms]"] = f"{last.apply_ms:.3f}"
            values["last faces split"] = report.faces_split
            values["last nodes added"] = report.nodes_added
            values["last method"] = report.method
            values["last elements removed"] = report.elements_removed
            values["last elements added"] = report.elements_added
            values["last volume change [mm^3]"] = f"{1e9 * report.volume_change:.6g}"
        status = DiagnosticStatus(
            level=level,
            name=f"{self.get_fully_qualified_name()}: cutting",
            message=text,
            hardware_id="",
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        watch = self._watch.status(self.get_fully_qualified_name())
        closure = self._closure.status(self.get_fully_qualified_name())
        array = DiagnosticArray(status=[watch, closure, status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def _in_words(planned: Plan) -> str:
    report = planned.report
    exchanged = ""
    if report.elements_removed:
        exchanged = f"{report.elements_removed} elements removed, {report.elements_added} added, "
    return (
        f"{report.faces_split} faces {'bared' if report.method == 'remove' else 'split'}, "
        f"{exchanged}{report.nodes_added} nodes added, "
        f"{report.nodes_moved} moved, {report.components} "
        f"{'part' if report.components == 1 else 'parts'}, "
        f"{1e3 * report.distance_after[0]:.3g} mm from the sweep, "
        f"planned in {report.plan_ms:.1f} ms"
        f"{'; ' if report.notes else ''}{report.notes}"
    )


def _report(report: Report, apply_ms: float) -> messages.CutReport:
    return messages.CutReport(
        faces_split=report.faces_split,
        nodes_added=report.nodes_added,
        nodes_moved=report.nodes_moved,
        components=report.components,
        sweep_distance_mean=float(report.distance_after[0]),
        sweep_distance_max=float(report.distance_after[1]),
        volume_change=float(report.volume_change),
        plan_ms=float(report.plan_ms),
        apply_ms=float(apply_ms),
    )


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return node_main.run(CutNode, args)


if __name__ == "__main__":
    sys.exit(main())
