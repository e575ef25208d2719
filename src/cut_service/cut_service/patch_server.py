"""The service `tissue/add_patch` of the node `cut_service`, and tools that lay patches."""

from __future__ import annotations

import uuid
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Pose
from numpy.typing import NDArray
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from tissue_interfaces.msg import Tool, ToolList
from tissue_interfaces.srv import AddPatch, ApplyEdit

from cut_service.errors import CutError
from cut_service.followed import PATIENCE, Followed
from cut_service.internal_errors import internal_error
from cut_service.ledger import Ledger
from cut_service.patching import PatchCode, PatchError, PatchPlan, Wanted, plan_patch
from cut_service.waiting import Until
from tissue_sim import conversions, edit_messages, qos
from tissue_sim.frames import UnknownFrameError
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.interaction import rigid
from tissue_sim.interaction.tools import PATCH, ToolSpec, outline

TOOLS_COME = 2.0
"""Longest wait for the list of tools when a request names one [s]."""


@dataclass(frozen=True)
class Outcome:
    """The answer to one request."""

    code: PatchCode
    message: str
    version: int = 0
    plan: PatchPlan | None = None
    patch_id: int = 0
    name: str = ""
    nodes: NDArray[np.uint32] | None = None
    hold: int = 0


class PatchServer:
    """Plans patches on the node's replica and asks the simulation to add them."""

    def __init__(
        self, node: Node, group: CallbackGroup, followed: Followed, remembered: int
    ) -> None:
        """Serve `tissue/add_patch`; arguments as for `SutureServer`."""
        self._node, self._followed = node, followed
        self._ledger: Ledger[Outcome] = Ledger(remembered)
        self._tools: dict[str, Tool] = {}
        node.create_subscription(
            ToolList, "tissue/tools", self._on_tools, qos.LATCHED, callback_group=group
        )
        node.create_service(AddPatch, "tissue/add_patch", self._on_request, callback_group=group)

    async def _on_tools(self, message: ToolList) -> None:
        before = self._tools
        self._tools = {tool.id: tool for tool in message.tools}
        pressed = [
            tool
            for tool in message.tools
            if tool.kind == PATCH and tool.pressed and tool.id in before
            and tool.state != Tool.FROZEN and not before[tool.id].pressed
        ]  # fmt: skip
        for tool in pressed:
            await self._lay(tool)

    async def _lay(self, tool: Tool) -> None:
        """Lay a patch of a tool's shape where the tool is."""

        async def work(request_id: str) -> Outcome:
            pose = conversions.pose_array(tool.pose)
            spec = ToolSpec(tool.id, tool.kind, tool.shape, tuple(tool.size))
            corners = rigid.to_world(pose, outline(spec))
            normal = rigid.to_world(pose, np.array([[0.0, 1.0, 0.0]]))[0] - pose[:3]
            return await self._add(Wanted(corners, normal, tool=tool.id), 0, tool.id, request_id)

        await self._answered(uuid.uuid4().hex, work)

    async def _on_request(
        self, request: AddPatch.Request, response: AddPatch.Response
    ) -> AddPatch.Response:
        outcome = await self._once(request)
        response.success = outcome.code == PatchCode.NONE
        response.message, response.error_code = outcome.message, int(outcome.code)
        response.version, response.hold_id = outcome.version, outcome.hold
        response.patch_id, response.patch_name = outcome.patch_id, outcome.name
        plan = outcome.plan
        if plan is not None and outcome.nodes is not None:
            response.nodes, response.elements = plan.nodes, plan.elements
            response.area, response.edge_used = float(plan.area), float(plan.edge)
            response.quality_min, response.quality_mean = plan.quality
            response.overlap = plan.overlap
            conversions.fill(response.rim_nodes, outcome.nodes[plan.rim])
        return response

    async def _once(self, request: AddPatch.Request) -> Outcome:
        request.request_id = request.request_id or uuid.uuid4().hex
        return await self._answered(request.request_id, lambda _: self._carry_out(request))

    async def _answered(
        self, request_id: str, work: Callable[[str], Awaitable[Outcome]]
    ) -> Outcome:
        """The outcome of a request; a repeat gets that of the first, done or not."""
        answer = await self._ledger.once(
            request_id, lambda: self._outcome(work(request_id)), PATIENCE
        )
        return answer or Outcome(
            PatchCode.SIMULATION_LOST, "the first request with this id is not answered yet"
        )

    async def _outcome(self, work: Awaitable[Outcome]) -> Outcome:
        try:
            outcome = await work
        except PatchError as error:
            outcome = Outcome(error.code, str(error))
        except CutError as error:
            outcome = Outcome(error.code_in(PatchCode, PatchCode.REFUSED), str(error))
        except Exception as error:
            # Whatever went wrong, the client is answered and the service goes on.
            message = internal_error(self._node, "tissue/add_patch", error)
            outcome = Outcome(PatchCode.REFUSED, message)
        self._node.get_logger().info(f"patch: {outcome.message}")
        return outcome

    async def _carry_out(self, request: AddPatch.Request) -> Outcome:
        wanted = self._wanted(request)
        await self._refuse_unknown(wanted.tool)
        return await self._add(wanted, request.state_frame, request.author, request.request_id)

    async def _add(self, wanted: Wanted, frame: int, author: str, request_id: str) -> Outcome:
        named = await self._followed.shape_at(frame)
        epoch = self._followed.replica.epoch
        made = await self._followed.make(
            lambda mesh, shape: plan_patch(mesh, shape.positions, wanted),
            named if frame else None, epoch, author, request_id,
        )  # fmt: skip
        # Whoever has the answer may name at once what was made.
        await self._followed.newer_than(made.answer.version - 1, epoch)
        return self._done(made.plan, wanted.tool, made.answer)

    def _wanted(self, request: AddPatch.Request) -> Wanted:
        """What is wanted, in the organ's frame."""
        flat = _numbers(request.outline, 2, "outline", "two per corner")
        corners = _numbers(request.corners, 3, "corners", "three per corner")
        if bool(len(flat)) == bool(len(corners)):
            raise PatchError(
                PatchCode.INVALID,
                f"{len(flat)} corners in outline and {len(corners)} in corners; allowed: one of "
                "them",
            )
        normal = None
        if len(flat):
            pose = _pose(request.pose)
            corners = rigid.to_world(pose, np.column_stack([flat, np.zeros(len(flat))]))
            normal = rigid.to_world(pose, np.array([[0.0, 0.0, 1.0]]))[0] - pose[:3]
        frames = self._followed.frames()
        frame = request.header.frame_id or frames.organ
        try:
            if normal is not None:
                ends = np.stack([corners[0], corners[0] + normal])
                ends = frames.points_in_organ(frame, ends)
                normal = ends[1] - ends[0]
            corners = frames.points_in_organ(frame, corners)
        except UnknownFrameError as error:
            raise PatchError(PatchCode.UNKNOWN_FRAME, str(error)) from None
        return Wanted(
            corners, normal, float(request.thickness), float(request.young_modulus),
            float(request.density), float(request.edge_length), request.name, request.tool,
        )  # fmt: skip

    async def _refuse_unknown(self, tool: str) -> None:
        if not tool:
            return
        if not await Until(lambda: tool in self._tools, TOOLS_COME):
            raise PatchError(
                PatchCode.UNKNOWN_TOOL,
                f"there is no tool {tool!r}; known tools: {', '.join(self._tools) or 'none'}",
            )

    def _done(self, planned: PatchPlan, tool: str, answer: ApplyEdit.Response) -> Outcome:
        edit: TopologyEdit = edit_messages.edit_from_msg(answer.applied)
        patch = edit.added_patches[0]
        words = planned.in_words(patch.name, tool if answer.hold_id else "")
        return Outcome(
            PatchCode.NONE, words, answer.version, planned, patch.id,
            patch.name, edit.born_nodes.copy(), int(answer.hold_id),
        )  # fmt: skip


def _numbers(values: object, width: int, name: str, allowed: str) -> NDArray[np.float64]:
    numbers = conversions.array_of(values, np.float64)
    if numbers.size % width:
        raise PatchError(PatchCode.INVALID, f"{numbers.size} numbers in {name}; allowed: {allowed}")
    return np.asarray(numbers.reshape(-1, width).copy())


def _pose(message: Pose) -> NDArray[np.float64]:
    try:
        return rigid.checked_pose(conversions.pose_array(message))
    except rigid.PoseError as error:
        raise PatchError(PatchCode.INVALID, str(error)) from None
