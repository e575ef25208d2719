"""Services answer whatever goes wrong, and what nobody foresaw is logged with where it was."""

from __future__ import annotations

import asyncio
from typing import Any
from unittest.mock import MagicMock

import pytest
from tissue_interfaces.msg import Tool, ToolList
from tissue_interfaces.srv import AddPatch, Closure, Suture

from cut_service.closure_server import ClosureServer
from cut_service.errors import CutCode, CutError
from cut_service.followed import Followed
from cut_service.hole_book import HoleBook
from cut_service.patch_server import PatchServer
from cut_service.suture_server import SutureServer
from tissue_sim.frames import Frames
from tissue_sim.interaction.tools import PATCH
from tissue_sim.replica import Replica


class World:
    """The services of a node without a simulation; looking at the tissue fails as wanted."""

    def __init__(self, failure: Exception) -> None:
        self.node = MagicMock()

        async def fail(*_: Any) -> Any:
            raise failure

        frames = Frames.from_parameters("organ", {})
        followed = Followed(Replica(4), lambda: frames, fail, fail, fail)
        book = HoleBook()
        self.closure = ClosureServer(self.node, MagicMock(), followed, book)
        self.sutures = SutureServer(self.node, MagicMock(), followed, 4, book)
        self.patches = PatchServer(self.node, MagicMock(), followed, 4)

    def answers(self) -> list[Any]:
        flat = [0.0, 0, 0, 0.01, 0, 0, 0, 0.01, 0]
        return [
            asyncio.run(self.closure._on_closure(Closure.Request(), Closure.Response())),
            asyncio.run(self.sutures._on_suture(Suture.Request(action=4), Suture.Response())),
            asyncio.run(
                self.patches._on_request(AddPatch.Request(corners=flat), AddPatch.Response())
            ),
        ]

    @property
    def errors(self) -> list[str]:
        return [call.args[0] for call in self.node.get_logger().error.call_args_list]


def test_what_nobody_foresaw_is_answered_and_logged_with_its_traceback() -> None:
    world = World(KeyError("a row"))
    for answer in world.answers():
        assert not answer.success
        assert answer.error_code
        assert answer.message == "internal error: KeyError: 'a row'"
    assert len(world.errors) == 3
    for text in world.errors:
        assert "Traceback" in text
        assert "in fail" in text


def test_without_tissue_every_service_says_so() -> None:
    world = World(CutError(CutCode.NO_TISSUE, "nothing has been received yet"))
    for answer in world.answers():
        assert (answer.success, answer.error_code) == (False, type(answer).NO_TISSUE)
    assert world.errors == []


@pytest.mark.parametrize("size", [[], [0.03, 0.02, 0.01]])
def test_a_tool_whose_patch_cannot_be_made_does_not_end_the_node(size: list[float]) -> None:
    world = World(RuntimeError("not asked"))
    tool = Tool(id="layer", kind=PATCH, shape="rectangle", size=size)
    asyncio.run(world.patches._on_tools(ToolList(tools=[tool])))
    pressed = Tool(id="layer", kind=PATCH, shape="rectangle", size=size, pressed=True)
    asyncio.run(world.patches._on_tools(ToolList(tools=[pressed])))
    (text,) = world.errors
    assert "Traceback" in text
