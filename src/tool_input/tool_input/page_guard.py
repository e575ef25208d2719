"""Who may open the page: only this machine's browser, with the session's token.

viser has no access control of its own. A page on a loopback port can still be reached by any web
page the person has open (DNS rebinding, cross-site websockets), so every request's Host and Origin
are checked and the token printed at start is demanded once; a cookie carries it afterwards.
"""

from __future__ import annotations

import http
import secrets
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from http.cookies import SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

COOKIE = "tissue_token"
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")

Handler = Callable[[Any, Request], Any]


class PageGuard:
    """Decides which requests reach the page.

    Attributes:
        token: Secret of this session; part of the address printed at start.
    """

    def __init__(self, hosts: tuple[str, ...] = LOOPBACK, token: str | None = None) -> None:
        """Allow some host names.

        Args:
            hosts: Host names a request may name, without port.
            token: Secret; default a fresh random one.
        """
        self.hosts = hosts
        self.token = token or secrets.token_urlsafe(16)

    def refusal(self, headers: Headers, target: str) -> str:
        """Why a request is refused; empty if it is let in.

        Args:
            headers: Request headers.
            target: Path and query of the request.
        """
        host = headers.get("Host", "")
        if self._name(host) not in self.hosts:
            return f"this page answers only to {', '.join(self.hosts)}, not to host '{host}'"
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return f"a page from '{origin}' may not use this one"
        if not secrets.compare_digest(self._given_token(headers, target), self.token):
            return "open the address with ?token=... that was printed when the page started"
        return ""

    def wrap(self, inner: Handler | None) -> Handler:
        """A request handler that lets the guard speak first."""

        async def handler(connection: Any, request: Request) -> Response | None:
            why = self.refusal(request.headers, request.path)
            if why:
                return self._answer(http.HTTPStatus.FORBIDDEN, why)
            if "token" in parse_qs(urlsplit(request.path).query):
                return self._remember()
            answer = inner(connection, request) if inner is not None else None
            return await answer if isinstance(answer, Awaitable) else answer

        return handler

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Guard every websockets server started inside the block; viser offers no hook."""
        serve = websockets.asyncio.server.serve

        def guarded(*args: Any, **options: Any) -> Any:
            options["process_request"] = self.wrap(options.get("process_request"))
            return serve(*args, **options)

        websockets.asyncio.server.serve = guarded  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]

    @staticmethod
    def _name(host: str) -> str:
        return host.rsplit(":", 1)[0] if host.count(":") == 1 or "]:" in host else host

    @staticmethod
    def _given_token(headers: Headers, target: str) -> str:
        given = parse_qs(urlsplit(target).query).get("token")
        if given:
            return given[0]
        cookies = SimpleCookie("; ".join(headers.get_all("Cookie")))
        return cookies[COOKIE].value if COOKIE in cookies else ""

    def _remember(self) -> Response:
        cookie = f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
        headers = Headers(
            {"Location": "/", "Set-Cookie": cookie, "Content-Length": "0", "Connection": "close"}
        )
        return Response(http.HTTPStatus.SEE_OTHER, "See Other", headers, b"")

    @staticmethod
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
