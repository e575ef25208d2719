"""The service `tissue/suture` of the node `cut_service`."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from tissue_interfaces.srv import Suture

from cut_service.errors import CutError
from cut_service.followed import PATIENCE, Followed, Made
from cut_service.hole_book import ClosureError, HoleBook
from cut_service.internal_errors import internal_error
from cut_service.ledger import Ledger
from cut_service.rim import patch_of, plan_rim
from cut_service.suturing import (
    FARTHEST_REACH,
    Sewing,
    SutureCode,
    SutureError,
    chosen,
    plan_removal,
    plan_sewing,
    plan_tightening,
    pulls,
)
from tissue_sim import conversions
from tissue_sim.frames import UnknownFrameError
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.holes import HoleLostError
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sutures import Sutures
from tissue_sim.replica import Shape


@dataclass(frozen=True)
class Outcome:
    """The answer to one request: of which sutures, and what each pulls with [N]."""

    code: SutureCode
    message: str
    version: int = 0
    sutures: Sutures | None = None
    forces: tuple[float, ...] = ()
    group: int = 0


@dataclass(frozen=True)
class _Planned:
    edit: TopologyEdit
    sutures: Sutures


class SutureServer:
    """Plans sutures on the node's replica and asks the simulation to apply them."""

    def __init__(
        self,
        node: Node,
        group: CallbackGroup,
        followed: Followed,
        remembered: int,
        book: HoleBook,
    ) -> None:
        """Serve `tissue/suture`.

        Args:
            node: The node.
            group: Callback group of handlers that wait.
            followed: What it knows of the organ.
            remembered: Requests whose answers are kept.
            book: Holes that have a name.
        """
        self._node, self._followed, self._book = node, followed, book
        self._ledger: Ledger[Outcome] = Ledger(remembered)
        node.create_service(Suture, "tissue/suture", self._on_suture, callback_group=group)

    async def _on_suture(
        self, request: Suture.Request, response: Suture.Response
    ) -> Suture.Response:
        outcome = await self._once(request)
        response.success = outcome.code == SutureCode.NONE
        response.message, response.error_code = outcome.message, int(outcome.code)
        response.version, response.made_group = outcome.version, outcome.group
        if outcome.sutures is not None:
            conversions.fill(response.made, outcome.sutures.ids)
            conversions.fill(response.lengths, outcome.sutures.lengths)
            conversions.fill(response.forces, np.array(outcome.forces))
        return response

    async def _once(self, request: Suture.Request) -> Outcome:
        request.request_id = request.request_id or uuid.uuid4().hex
        answer = await self._ledger.once(
            request.request_id, lambda: self._answered(request), PATIENCE
        )
        return answer or Outcome(
            SutureCode.SIMULATION_LOST, "the first request with this id is not answered yet"
        )

    async def _answered(self, request: Suture.Request) -> Outcome:
        try:
            outcome = await self._carry_out(request)
        except SutureError as error:
            outcome = Outcome(error.code, str(error))
        except CutError as error:
            outcome = Outcome(error.code_in(SutureCode, SutureCode.REFUSED), str(error))
        except Exception as error:
            # Whatever went wrong, the client is answered and the service goes on.
            message = internal_error(self._node, "tissue/suture", error)
            outcome = Outcome(SutureCode.REFUSED, message)
        self._node.get_logger().info(f"suture: {outcome.message}")
        return outcome

    async def _carry_out(self, request: Suture.Request) -> Outcome:
        plan = self._planner(request)
        wanted = await self._followed.shape_at(request.state_frame)
        epoch = self._followed.replica.epoch
        if request.action == Suture.Request.LIST:
            return self._listed(request, wanted)
        made = await self._followed.make(
            plan, wanted if request.state_frame else None, epoch, request.author,
            request.request_id,
        )  # fmt: skip
        # Whoever has the answer may name at once what was made.
        await self._followed.newer_than(made.answer.version - 1, epoch)
        return self._done(made)

    def _planner(self, request: Suture.Request) -> Callable[[Mesh, Shape], _Planned]:
        """What to plan, checked as far as that goes without the tissue."""
        actions = Suture.Request
        ids = conversions.array_of(request.sutures, np.uint32).copy()
        if request.action in (actions.SEW, actions.SEW_RIM):
            numbers = conversions.array_of(request.positions, np.float64)
            if numbers.size % 3:
                raise SutureError(
                    SutureCode.INVALID, f"{numbers.size} coordinates; allowed: three per position"
                )
            wanted = Sewing(
                numbers.reshape(-1, 3).copy(), request.spacing, request.running, request.reach,
                request.stiffness, request.length,
            )  # fmt: skip
            if request.action == actions.SEW_RIM:
                return lambda mesh, shape: self._sewing_rim(mesh, shape, wanted, request)
            return lambda mesh, shape: self._sewing(mesh, shape, wanted, request.header.frame_id)
        if request.action not in (actions.TIGHTEN, actions.REMOVE, actions.LIST):
            raise SutureError(
                SutureCode.INVALID, f"unknown action {request.action}; allowed: 0 to 4"
            )

        def plan(mesh: Mesh, shape: Shape) -> _Planned:
            sutures = chosen(mesh.sutures, ids, int(request.group))
            if request.action == actions.REMOVE:
                return _Planned(plan_removal(mesh, sutures), sutures)
            edit = plan_tightening(mesh, shape.positions, sutures, request.length)
            return _Planned(edit, replace(sutures, lengths=edit.changed_lengths))

        return plan

    def _sewing(self, mesh: Mesh, shape: Shape, wanted: Sewing, frame_id: str) -> _Planned:
        here = replace(wanted, positions=self._in_organ(wanted, frame_id))
        return _planned(mesh, plan_sewing(mesh, shape.positions, here))

    def _sewing_rim(
        self, mesh: Mesh, shape: Shape, wanted: Sewing, request: Suture.Request
    ) -> _Planned:
        here = replace(wanted, positions=self._in_organ(wanted, request.header.frame_id))
        patch = patch_of(mesh, int(request.patch), request.patch_name)
        if request.hole:
            if len(wanted.positions):
                raise SutureError(
                    SutureCode.INVALID, "both positions and a hole; allowed: either of them"
                )
            try:
                hole = self._book.hole(self._followed.replica.epoch, request.hole)
                loop = hole.loop(mesh, shape.positions)
            except (ClosureError, HoleLostError) as error:
                raise SutureError(SutureCode.UNKNOWN_HOLE, str(error)) from None
            # Its edge is on the tissue: how far the next node is depends on the mesh only.
            here = replace(here, positions=loop, reach=wanted.reach or FARTHEST_REACH)
        return _planned(mesh, plan_rim(mesh, shape.positions, patch, here))

    def _in_organ(self, wanted: Sewing, frame_id: str) -> NDArray[np.float64]:
        try:
            frames = self._followed.frames()
            return frames.points_in_organ(frame_id or frames.organ, wanted.positions)
        except UnknownFrameError as error:
            raise SutureError(SutureCode.UNKNOWN_FRAME, str(error)) from None

    def _done(self, made: Made[_Planned]) -> Outcome:
        edit, answer = made.edit, made.answer
        sutures, group = made.plan.sutures, 0
        if len(edit.added_sutures):
            ids = conversions.array_of(answer.applied.added_sutures, np.uint32)
            groups = conversions.array_of(answer.applied.suture_groups, np.uint32)
            sutures = replace(sutures, ids=ids.copy(), groups=groups.copy())
            group = int(groups[0]) if len(groups) > 1 and (groups == groups[0]).all() else 0
        forces = pulls(sutures, made.shape.positions)
        text = f"{edit.kind}: {len(sutures)} stitches, {forces.sum():.3g} N at this shape"
        return Outcome(
            SutureCode.NONE, text, answer.version, sutures, tuple(forces.tolist()), group
        )

    def _listed(self, request: Suture.Request, shape: Shape) -> Outcome:
        mesh = self._followed.mesh()
        ids = conversions.array_of(request.sutures, np.uint32)
        group = int(request.group)
        found = chosen(mesh.sutures, ids, group) if len(ids) or group else mesh.sutures
        forces = pulls(found, shape.positions)
        text = f"{len(found)} stitches pull with {forces.sum():.3g} N"
        return Outcome(SutureCode.NONE, text, mesh.version, found, tuple(forces.tolist()), group)


def _planned(mesh: Mesh, edit: TopologyEdit) -> _Planned:
    made = Sutures(
        edit.added_sutures, mesh.node_rows_of(edit.suture_nodes), edit.suture_lengths,
        edit.suture_stiffness, edit.suture_groups,
    )  # fmt: skip
    return _Planned(edit, made)
