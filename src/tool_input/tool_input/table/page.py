"""The page of the operating table: who comes gets a window, who goes lets go."""

from __future__ import annotations

import contextlib
import io
import socket
import warnings
from typing import Any

import viser

from tool_input.page_guard import VISITOR, PageGuard, Visitor, check_host
from tool_input.table.desk import Desk
from tool_input.table.person import Person
from tool_input.table.window import Window

TOLD_SECONDS = 8.0
"""How long a notification stays."""

BACKLOG = 1 << 18
"""[bytes] What the system may keep for a window that is slow to read: a frame or two of the heart.
What changes while that waits replaces what changed before, so a slow window misses frames and is
not late."""

EYE, LOOK_AT = (1.3, -2.5, 1.7), (0.3, 0.15, 0.0)
"""Where everybody looks from at first, and to, in the page's units: the organ is 2 large, and the
controls are on the right."""

PING_SECONDS, PONG_SECONDS = 5.0, 10.0
"""[s] How often a window is asked whether it is still there, and how long its answer may take: a
cable that is pulled says nothing."""

FIELD_OF_VIEW = 0.87
"""From the window's lower to its upper edge [rad]: from there the organ fills most of it."""


class TablePage:
    """A server of windows, one for everybody who opens its address."""

    def __init__(
        self,
        desk: Desk,
        host: str = "127.0.0.1",
        port: int = 8080,
        guard: PageGuard | None = None,
    ) -> None:
        """Open the page.

        Args:
            desk: What connects everybody to the simulation.
            host: Address to listen on.
            port: Port; the next free one is taken when it is in use.
            guard: Who may open it; default one with fresh tokens.

        Raises:
            ValueError: The page cannot listen there.
        """
        check_host(host)
        # A window that was lost a moment ago is drawn once more.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        self._desk = desk
        self._guard = guard or PageGuard(host)
        self._windows: dict[int, Window] = {}
        served = self._guard.installed(
            _keep_short, ping_interval=PING_SECONDS, ping_timeout=PONG_SECONDS
        )
        # viser prints an address without the token, which opens nothing.
        with served, contextlib.redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(
                host=host, port=port, label="tissue_sim", verbose=False
            )
            self._server.gui.configure_theme(dark_mode=True, show_share_button=False)
            camera = self._server.initial_camera
            camera.position, camera.look_at = EYE, LOOK_AT
            self._server.initial_camera.fov = FIELD_OF_VIEW
            self._server.on_client_connect(self._came)
            self._server.on_client_disconnect(self._went)

    @property
    def addresses(self) -> tuple[str, str]:
        """What to open to take part, and what to open to watch; tokens included."""
        return self._guard.addresses(self._server.get_host(), self._server.get_port())

    @property
    def persons(self) -> list[Person]:
        """Everybody who has a window."""
        return [window.person for window in self._windows.values()]

    def draw(self) -> None:
        """Show everybody the newest frame."""
        frame = self._desk.frame() if self._windows else None
        if frame is not None:
            for window in self._windows.values():
                window.person.attempt(window.draw, frame)

    def repeat_poses(self) -> None:
        """Publish once more where everybody's tools are."""
        for person in self.persons:
            person.tools.repeat()

    def close(self) -> None:
        """Close every window, and the page."""
        for client in list(self._windows):
            self._shut(client)
        self._server.stop()

    async def _came(self, client: viser.ClientHandle) -> None:
        visitor = VISITOR.get()
        self._desk.soon(lambda: self._open(client, visitor))

    async def _went(self, client: viser.ClientHandle) -> None:
        self._desk.soon(lambda: self._shut(client.client_id))

    def _open(self, client: viser.ClientHandle, visitor: Visitor) -> None:
        def tell(text: str) -> None:
            self._desk.node.get_logger().info(f"{name}: {text}")
            if client.client_id in self._windows:
                client.add_notification("", text, auto_close_seconds=TOLD_SECONDS)

        taken = {person.name for person in self.persons}
        names = (f"{visitor.name}-{number}" for number in range(1, len(taken) + 2))
        name = next(name for name in names if name not in taken)
        person = Person(name, self._desk, tell, visitor.observer)
        self._windows[client.client_id] = Window(client, person)
        self._desk.node.get_logger().info(f"{name} has come")

    def _shut(self, client: int) -> None:
        window = self._windows.pop(client, None)
        if window is not None:
            window.person.attempt(window.close)
            self._desk.node.get_logger().info(f"{window.person.name} has gone")


def _keep_short(connection: Any) -> None:
    """Let little wait for a window that is slow to read."""
    channel = connection.transport.get_extra_info("socket")
    channel.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BACKLOG)
