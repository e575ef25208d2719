"""Who may open the page: those with one of the session's two tokens, to take part or to watch.

viser has no access control of its own. A page on a loopback port can still be reached by any web
page the person has open (DNS rebinding, cross-site websockets), so every request's Host and Origin
are checked and a token printed at start is demanded once; a cookie carries it afterwards.
"""

from __future__ import annotations

import asyncio
import http
import ipaddress
import re
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

TOKEN, OBSERVER_TOKEN = "tissue_token", "tissue_observer"
"""Cookies; their names end with the port, which browsers do not tell apart."""

OBSERVE = "/observe"
"""Path of those who only watch."""

NAMED = re.compile(r"/as/([A-Za-z][A-Za-z0-9_]{0,30})/?")
"""Path of a person who gives a name."""

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
EVERYWHERE = ("0.0.0.0", "::")

Handler = Callable[[Any, Request], Any]


@dataclass(frozen=True)
class Visitor:
    """Whom a connection belongs to.

    Attributes:
        name: Name they gave, or "person" or "observer".
        observer: Whether they may only watch.
    """

    name: str
    observer: bool


VISITOR: ContextVar[Visitor] = ContextVar("visitor")
"""Who is at the other end, in everything that the event loop does for a connection."""


class PageGuard:
    """Decides which requests reach the page, and as whom.

    Attributes:
        token: Secret of those who take part; in the address printed at start.
        observer_token: Secret of those who only watch; in the other one.
    """

    def __init__(
        self, host: str = "127.0.0.1", token: str | None = None, observer_token: str | None = None
    ) -> None:
        """Guard a page.

        Args:
            host: Address it listens on.
            token: Secret; default a fresh random one.
            observer_token: Likewise.
        """
        self._everywhere = host in EVERYWHERE
        own = (socket.gethostname(), socket.getfqdn()) if self._everywhere else (_bracketed(host),)
        self._hosts = tuple(dict.fromkeys((*LOOPBACK, *own)))
        self.token = token or secrets.token_urlsafe(16)
        self.observer_token = observer_token or secrets.token_urlsafe(16)
        self._ready = threading.Event()

    def addresses(self, host: str, port: int) -> tuple[str, str]:
        """What to open to take part, and what to open to watch."""
        name = socket.gethostname() if host in EVERYWHERE else _bracketed(host)
        page = f"http://{name}:{port}"
        return f"{page}/?token={self.token}", f"{page}{OBSERVE}?token={self.observer_token}"

    def refusal(self, headers: Headers, target: str) -> str:
        """Why a request is refused; empty if it is let in.

        Args:
            headers: Request headers.
            target: Path and query of the request.
        """
        host, *more = headers.get_all("Host") or [""]
        if more or not self._is_ours(_name(host)):
            return f"this page answers only to {', '.join(self._hosts)}, not to host '{host}'"
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return f"a page from '{origin}' may not use this one"
        path = urlsplit(target).path
        given = _given_tokens(headers, target)
        if any(_same(token, self.token) for token in given):
            return ""
        if not any(_same(token, self.observer_token) for token in given):
            return "open the address with ?token=... that was printed when the page started"
        return "" if path == OBSERVE else f"with this token the page is at {OBSERVE}, to watch"

    def wrap(self, inner: Handler | None) -> Handler:
        """A request handler that lets the guard speak first."""

        async def handler(connection: Any, request: Request) -> Response | None:
            try:
                why = self.refusal(request.headers, request.path)
            except ValueError as error:
                return _answer(http.HTTPStatus.BAD_REQUEST, f"it cannot be understood ({error})")
            if why:
                return _answer(http.HTTPStatus.FORBIDDEN, why)
            target = urlsplit(request.path)
            if "token" in parse_qs(target.query):
                return self._remember(request)
            if request.headers.get("Upgrade") != "websocket" and _visitor(target.path) is not None:
                request.path = "/"
            answer = inner(connection, request) if inner is not None else None
            return await answer if isinstance(answer, Awaitable) else answer

        return handler

    @contextmanager
    def installed(self, greet: Callable[[Any], None] | None = None, **more: Any) -> Iterator[None]:
        """Guard every websockets server started inside the block; viser offers no hook.

        What such a server does for a connection finds in `VISITOR` whom it belongs to. Those who
        come before the block is over wait for its end.

        Args:
            greet: Called with every connection that is let in, before it is served.
            more: Further options of `websockets.asyncio.server.serve`.
        """
        serve = websockets.asyncio.server.serve

        def guarded(attend: Callable[[Any], Any], *args: Any, **options: Any) -> Any:
            async def introduced(connection: Any) -> None:
                path = urlsplit(connection.request.path).path
                VISITOR.set(_visitor(path) or Visitor("person", False))
                while not self._ready.is_set():
                    await asyncio.sleep(0.01)
                if greet is not None:
                    greet(connection)
                await attend(connection)

            options["process_request"] = self.wrap(options.get("process_request"))
            return serve(introduced, *args, **{**options, **more})

        websockets.asyncio.server.serve = guarded  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            self._ready.set()
            websockets.asyncio.server.serve = serve  # type: ignore[misc]

    def _is_ours(self, name: str) -> bool:
        # A page that an attacker's name server sends here asks for the attacker's host name.
        return name in self._hosts or (self._everywhere and _is_address(name))

    def _remember(self, request: Request) -> Response:
        target = urlsplit(request.path)
        given = parse_qs(target.query)["token"][0]
        takes_part = _same(given, self.token)
        cookie, path = (TOKEN, "/") if takes_part else (OBSERVER_TOKEN, OBSERVE)
        name = f"{cookie}_{_port(request.headers)}"
        headers = Headers(
            {
                "Location": target.path,
                "Set-Cookie": f"{name}={given}; HttpOnly; SameSite=Strict; Path={path}",
                "Content-Length": "0",
                "Connection": "close",
            }
        )
        return Response(http.HTTPStatus.SEE_OTHER, "See Other", headers, b"")


def check_host(host: str) -> None:
    """Refuse an address that nothing can listen on.

    Raises:
        ValueError: It is none of this machine's.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as trial:
            trial.bind(address)
    except (OSError, UnicodeError) as error:
        raise ValueError(
            f"a page cannot listen on {host!r} ({error}); allowed: 127.0.0.1, another address of "
            f"this machine, or 0.0.0.0 for all of them"
        ) from None


def _same(given: str, secret: str) -> bool:
    return secrets.compare_digest(given.encode(), secret.encode())


def _visitor(path: str) -> Visitor | None:
    """Who comes by a path; None: it is no page of ours, such as a picture."""
    if path == OBSERVE:
        return Visitor("observer", True)
    named = NAMED.fullmatch(path)
    return Visitor(named[1], False) if named else None


def _given_tokens(headers: Headers, target: str) -> list[str]:
    """The token in the address, or else those in the cookies."""
    given = parse_qs(urlsplit(target).query).get("token")
    if given:
        return given[:1]
    # Not http.cookies: browsers send the cookies of all ports of a machine, and that parser gives
    # up at the first one of another program that is not written as it should be.
    pairs = (pair.partition("=") for pair in "; ".join(headers.get_all("Cookie")).split(";"))
    cookies = {name.strip(): value.strip() for name, _, value in pairs}
    names = [f"{name}_{_port(headers)}" for name in (TOKEN, OBSERVER_TOKEN)]
    return [cookies[name] for name in names if name in cookies]


def _name(host: str) -> str:
    return host.rsplit(":", 1)[0] if host.count(":") == 1 or "]:" in host else host


def _port(headers: Headers) -> str:
    host = headers.get("Host", "")
    return host[len(_name(host)) + 1 :] or "80"


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def _answer(status: http.HTTPStatus, text: str) -> Response:
    body = f"Refused: {text}.\n".encode()
    headers = Headers(
        {
            "Content-Type": "text/plain; charset=utf-8",
            "Content-Length": str(len(body)),
            "Connection": "close",
        }
    )
    return Response(status, status.phrase, headers, body)
