"""The mouse page: who may open it, and what a drag asks for."""

from __future__ import annotations

import asyncio
import http.cookiejar
import urllib.error
import urllib.request
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tool_input.page import OperatingPage, swept_rectangle


class Recorder:
    """Writes down what the page asks for."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...]]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: self.calls.append((name, arguments))

    @property
    def names(self) -> list[str]:
        return [name for name, _ in self.calls]


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def page(recorder: Recorder) -> Iterator[OperatingPage]:
    page = OperatingPage(recorder, ("lr", "relaxation"), port=0)
    vertices = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.02]], dtype=np.float32)
    page.show_topology(vertices, np.array([[0, 1, 2], [0, 1, 3]], dtype=np.uint32))
    yield page
    page.close()


def drag(page: OperatingPage, phase: str, start: Any, end: Any, client: int = 0) -> None:
    """What viser calls when somebody drags, with points in metres."""
    eye = page._to_page(np.array([0.05, 0.05, 0.5]))
    event = SimpleNamespace(
        phase=phase,
        client_id=client,
        start_position=page._to_page(np.array(start)),
        end_position=page._to_page(np.array(end)),
        client=SimpleNamespace(camera=SimpleNamespace(position=eye)),
    )
    asyncio.run(page._dragged(event))


def status_of(address: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers)) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def test_only_the_printed_address_opens_the_page(page: OperatingPage) -> None:
    bare = page.address.split("?")[0]
    assert status_of(bare) == 403
    assert status_of(bare + "?token=guess") == 403
    assert status_of(page.address, Host="attacker.example") == 403
    assert status_of(page.address, Origin="http://attacker.example") == 403
    opener = urllib.request.build_opener(
        urllib.request.HTTPCookieProcessor(http.cookiejar.CookieJar())
    )
    with opener.open(page.address) as answer:
        assert answer.status == 200
        assert "token" not in answer.url
        assert b"<html" in answer.read()[:2000].lower()


def test_a_drag_grabs_pulls_and_lets_go_where_the_mouse_is(
    page: OperatingPage, recorder: Recorder
) -> None:
    drag(page, "start", [0.02, 0.03, 0.0], [0.021, 0.03, 0.0])
    drag(page, "update", [0.02, 0.03, 0.0], [0.04, 0.05, 0.01])
    drag(page, "end", [0.02, 0.03, 0.0], [0.04, 0.05, 0.01])
    assert recorder.names == ["grab", "pull", "pull", "pull", "let_go"]
    np.testing.assert_allclose(recorder.calls[0][1][0], [0.02, 0.03, 0.0], atol=1e-8)
    np.testing.assert_allclose(recorder.calls[2][1][0], [0.04, 0.05, 0.01], atol=1e-8)


def test_a_second_window_cannot_take_over_a_drag(page: OperatingPage, recorder: Recorder) -> None:
    drag(page, "start", [0, 0, 0], [0, 0, 0], client=0)
    drag(page, "update", [0, 0, 0], [0.01, 0, 0], client=1)
    assert recorder.names == ["grab", "pull"]


def test_a_dropped_connection_lets_go(page: OperatingPage, recorder: Recorder) -> None:
    drag(page, "start", [0, 0, 0], [0, 0, 0], client=3)
    page._left(SimpleNamespace(client_id=3))
    assert recorder.names[-1] == "let_go"


def test_a_drawn_line_cuts_along_the_view(page: OperatingPage, recorder: Recorder) -> None:
    page._mode.value = "cut"
    drag(page, "start", [0.04, 0.05, 0.0], [0.04, 0.05, 0.0])
    drag(page, "end", [0.04, 0.05, 0.0], [0.06, 0.05, 0.0])
    assert recorder.names == ["cut"]
    corners = recorder.calls[0][1][0]
    depth = page._depth.value / 1e3
    np.testing.assert_allclose(corners[:, 2], [depth / 2, depth / 2, -depth, -depth], atol=1e-8)
    np.testing.assert_allclose(corners[:, 0], [0.04, 0.06, 0.06, 0.04], atol=1e-8)


def test_a_line_along_the_view_cuts_nothing() -> None:
    with pytest.raises(ValueError, match="across the view"):
        swept_rectangle(np.zeros(3), np.array([0, 0, 0.01]), np.array([0, 0, 1.0]), 0.01)
