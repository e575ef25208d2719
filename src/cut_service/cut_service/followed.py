"""What the services of the node `cut_service` share: the organ, and how an edit of it is made."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from tissue_interfaces.srv import ApplyEdit

from cut_service.errors import CutCode, CutError
from cut_service.waiting import Until
from tissue_sim.frames import Frames
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.replica import Replica, Shape

ATTEMPTS = 3
"""How often a request is planned when the tissue changes meanwhile."""

PAUSE_WHEN_BUSY = 0.25
"""Wait before a busy simulation is asked again [s]."""

PATIENCE = 30.0
"""Longest wait of a repeated request for the first one's answer [s]."""


class HasEdit(Protocol):
    """A plan."""

    @property
    def edit(self) -> TopologyEdit:
        """What the simulation is asked for."""


Planned = TypeVar("Planned", bound=HasEdit)


@dataclass(frozen=True)
class Made(Generic[Planned]):
    """A plan that the simulation has applied.

    Attributes:
        plan: The plan.
        edit: Its edit, as the simulation was asked for it.
        shape: The shape it was made on.
        answer: The simulation's answer.
    """

    plan: Planned
    edit: TopologyEdit
    shape: Shape
    answer: ApplyEdit.Response


@dataclass(frozen=True)
class Followed:
    """What the node does for all of its services.

    Attributes:
        replica: The organ.
        frames: Frames that are known now.
        shape_at: The organ's shape at a frame, 0: the newest; waits for it.
        ask: The simulation's answer to an edit, of an epoch.
        newer_than: Waits for a version after the one given, of an epoch.
    """

    replica: Replica
    frames: Callable[[], Frames]
    shape_at: Callable[[int], Awaitable[Shape]]
    ask: Callable[[TopologyEdit, bytes], Awaitable[ApplyEdit.Response]]
    newer_than: Callable[[int, bytes], Awaitable[None]]

    def mesh(self) -> Mesh:
        """The organ's mesh.

        Raises:
            CutError: None has been received yet.
        """
        if self.replica.mesh is None:
            raise CutError(CutCode.NO_TISSUE, "no topology of the tissue has been received yet")
        return self.replica.mesh

    async def make(
        self,
        plan: Callable[[Mesh, Shape], Planned],
        shape: Shape | None,
        epoch: bytes,
        author: str,
        request_id: str,
        *,
        attempts: int = ATTEMPTS,
        on_stale: Callable[[], Any] = lambda: None,
    ) -> Made[Planned]:
        """Plan, ask the simulation, and plan again on the newest shape when the tissue changed.

        Args:
            plan: Makes a plan on a shape of the mesh.
            shape: What to plan on first; None: the newest.
            epoch: Epoch that the request is for.
            author: Client id for the edit.
            request_id: Of the request; later attempts have one of their own.
            attempts: How often it is planned.
            on_stale: Called when a plan came too late or the simulation is busy.

        Raises:
            CutError: The simulation restarted, refused the edit, does not answer, or the tissue
                changed under every plan.
        """
        message = ""
        for attempt in range(1, attempts + 1):
            shape = shape or await self.shape_at(0)
            self.refuse_other_epoch(epoch)
            planned = plan(self.mesh(), shape)
            edit = replace(
                planned.edit, base_frame=shape.frame, author=author,
                request_id=request_id if attempt == 1 else f"{request_id}~{attempt}",
            )  # fmt: skip
            answer = await self.ask(edit, epoch)
            if answer.success:
                return Made(planned, edit, shape, answer)
            message = answer.message
            if answer.error_code not in (ApplyEdit.Response.STALE, ApplyEdit.Response.BUSY):
                raise CutError(CutCode.REFUSED, f"the simulation refused the edit: {message}")
            on_stale()
            if answer.error_code == ApplyEdit.Response.BUSY:
                await Until(lambda: False, PAUSE_WHEN_BUSY)
            else:
                await self.newer_than(edit.base_version, epoch)
            shape = None
        raise CutError(
            CutCode.STALE,
            f"the tissue changed under {attempts} plans; nothing was changed ({message})",
        )

    def refuse_other_epoch(self, epoch: bytes) -> None:
        """Refuse to go on with a request for an organ that is no more.

        Raises:
            CutError: The simulation restarted.
        """
        if self.replica.epoch != epoch:
            raise CutError(
                CutCode.SIMULATION_LOST,
                "the simulation restarted meanwhile; nothing was changed",
            )
