"""Who gets to the page, and as whom."""

from __future__ import annotations

import asyncio
import socket
from types import SimpleNamespace
from typing import Any

import pytest
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from tool_input.page_guard import VISITOR, PageGuard, Visitor

HERE = "127.0.0.1:8080"


@pytest.fixture
def guard() -> PageGuard:
    return PageGuard(token="to-act", observer_token="to-watch")


def asked(guard: PageGuard, target: str, **headers: str) -> tuple[Response | None, Request]:
    """What a request is answered, and the request as it is passed on."""
    request = Request(target, Headers(Host=HERE, **headers))
    return asyncio.run(guard.wrap(None)(None, request)), request


def test_nobody_comes_in_without_a_token(guard: PageGuard) -> None:
    for target in ("/", "/observe", "/as/anna", "/?token=guess", "/?token=%C3%BC", "/?token="):
        assert "token" in guard.refusal(Headers(Host=HERE), target), target
        answer, _ = asked(guard, target)
        assert answer is not None
        assert answer.status_code == 403
    cookie = Headers(Host=HERE, Cookie="tissue_token_8080=guess; tissue_observer_8080=guess")
    assert "token" in guard.refusal(cookie, "/")


def test_a_token_becomes_a_cookie_and_leaves_the_address(guard: PageGuard) -> None:
    for target, cookie, path in (
        ("/?token=to-act", "tissue_token_8080=to-act", "Path=/"),
        ("/as/anna?token=to-act", "tissue_token_8080=to-act", "Path=/"),
        ("/observe?token=to-watch", "tissue_observer_8080=to-watch", "Path=/observe"),
    ):
        answer, _ = asked(guard, target)
        assert answer is not None
        assert answer.status_code == 303
        assert answer.headers["Location"] == target.partition("?")[0]
        said = answer.headers["Set-Cookie"].split("; ")
        assert said[0] == cookie
        assert {path, "HttpOnly", "SameSite=Strict"} <= set(said)


def test_the_observers_token_opens_nothing_but_watching(guard: PageGuard) -> None:
    cookie = "tissue_observer_8080=to-watch"
    assert guard.refusal(Headers(Host=HERE, Cookie=cookie), "/observe") == ""
    for target in ("/", "/as/anna", "/observe/", "/observer", "//observe"):
        refusal = guard.refusal(Headers(Host=HERE, Cookie=cookie), target)
        assert "to watch" in refusal, target
    both = f"{cookie}; tissue_token_8080=to-act"
    for target in ("/", "/observe", "/as/anna"):
        assert guard.refusal(Headers(Host=HERE, Cookie=both), target) == ""


def test_sessions_on_two_ports_do_not_take_each_others_cookies(guard: PageGuard) -> None:
    headers = Headers(Host="127.0.0.1:9090", Cookie="tissue_token_8080=to-act")
    assert guard.refusal(headers, "/") != ""


@pytest.mark.parametrize(
    "other", ['seen={"a": 1}', "a,b=1", "x/y=2", "flag", 'name="a; b"', "=", ""]
)
def test_cookies_of_other_programs_of_the_machine_lock_nobody_out(
    guard: PageGuard, other: str
) -> None:
    """Browsers send those of all its ports, however they are written."""
    own = "tissue_token_8080=to-act"
    for cookie in (f"{other}; {own}", f"{own}; {other}"):
        assert guard.refusal(Headers(Host=HERE, Cookie=cookie), "/") == "", cookie


def test_requests_that_cannot_be_understood_are_refused(guard: PageGuard) -> None:
    for target, headers in (("//[x?token=to-act", {}), ("/?token=to-act", {"Origin": "http://["})):
        answer, _ = asked(guard, target, **headers)
        assert answer is not None
        assert (answer.status_code, b"understood" in answer.body) == (400, True)
    two = Headers(Host=HERE)
    two["Host"] = "attacker.example"
    assert guard.refusal(two, "/?token=to-act") != ""


def test_pages_of_other_sites_are_refused_even_with_the_cookie(guard: PageGuard) -> None:
    headers = Headers(Host=HERE, Cookie="tissue_token_8080=to-act", Origin=f"http://{HERE}")
    assert guard.refusal(headers, "/") == ""
    del headers["Origin"]
    headers["Origin"] = "http://attacker.example"
    assert "attacker.example" in guard.refusal(headers, "/")
    for host in ("attacker.example:8080", "[::1].evil:80", "192.168.7.7:8080", ""):
        assert "answers only to" in guard.refusal(Headers(Host=host), "/?token=to-act"), host
    assert guard.refusal(Headers(Host="[::1]:8080"), "/?token=to-act") == ""


def test_a_page_for_other_machines_answers_to_its_addresses_and_names_alone() -> None:
    one = PageGuard("192.168.7.7", "to-act")
    assert one.refusal(Headers(Host="192.168.7.7:8080"), "/?token=to-act") == ""
    assert one.refusal(Headers(Host="192.168.7.8:8080"), "/?token=to-act") != ""
    assert one.refusal(Headers(Host="192.168.7.7:8080"), "/") != ""
    for everywhere in ("0.0.0.0", "::"):
        guard = PageGuard(everywhere, "to-act", "to-watch")
        for host in ("10.1.2.3:80", "[fe80::1]:8080", f"{socket.gethostname()}:8080"):
            assert guard.refusal(Headers(Host=host), "/?token=to-act") == "", host
        # Only a name can be made to point here by somebody else.
        assert guard.refusal(Headers(Host="attacker.example"), "/?token=to-act") != ""
        act, watch = guard.addresses(everywhere, 8080)
        assert act == f"http://{socket.gethostname()}:8080/?token=to-act"
        assert watch == f"http://{socket.gethostname()}:8080/observe?token=to-watch"


def test_every_path_of_a_person_is_the_same_page(guard: PageGuard) -> None:
    for target in ("/as/anna", "/observe"):
        _, request = asked(guard, target, Cookie="tissue_token_8080=to-act")
        assert request.path == "/"
    _, request = asked(guard, "/as/anna", Cookie="tissue_token_8080=to-act", Upgrade="websocket")
    assert request.path == "/as/anna"
    _, request = asked(guard, "/picture.png", Cookie="tissue_token_8080=to-act")
    assert request.path == "/picture.png"


@pytest.mark.parametrize(
    ("path", "visitor"),
    [
        ("/", Visitor("person", False)),
        ("/as/anna", Visitor("anna", False)),
        ("/as/an%20na", Visitor("person", False)),
        ("/as/7", Visitor("person", False)),
        ("/observe", Visitor("observer", True)),
    ],
)
def test_all_that_is_done_for_a_connection_knows_whose_it_is(
    guard: PageGuard, monkeypatch: pytest.MonkeyPatch, path: str, visitor: Visitor
) -> None:
    served: list[Any] = []
    monkeypatch.setattr(
        websockets.asyncio.server, "serve", lambda *given, **_: served.append(given)
    )
    found: list[Visitor] = []

    async def look() -> None:
        found.append(VISITOR.get())

    async def attend(_: Any) -> None:
        await asyncio.create_task(look())

    with guard.installed():
        websockets.asyncio.server.serve(attend, "127.0.0.1", 0)
    (introduced, *_), connection = served[0], SimpleNamespace(request=SimpleNamespace(path=path))
    asyncio.run(introduced(connection))
    assert found == [visitor]
