"""A window of the page without a browser: the same requests and messages, and nothing drawn."""

from __future__ import annotations

import http.cookiejar
import socket
import struct
import urllib.request
from typing import Any

import msgspec
import viser
import zstandard
from websockets.sync.client import connect

CAMERA = {
    "wxyz": (0.0, 1.0, 0.0, 0.0), "position": (0.0, 0.0, 3.0), "fov": 1.0, "near": 0.1,
    "far": 100.0, "image_height": 400, "image_width": 600, "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 1.0, 0.0),
}  # fmt: skip
"""A camera above the organ that looks straight down."""


class PageClient:
    """One window.

    Attributes:
        nodes: Properties of the scene's nodes by name, as far as they were received.
        labels: Labels and texts of the controls received.
        notices: Notifications received.
        received: Batches received.
    """

    def __init__(self, address: str, receive_buffer: int = 0) -> None:
        """Open a window.

        Args:
            address: The page's address, with token.
            receive_buffer: What the system keeps of what was not read [bytes]; 0: as it likes.
        """
        self.nodes: dict[str, dict[str, Any]] = {}
        self.labels: list[str] = []
        self.notices: list[str] = []
        self.received = 0
        jar = http.cookiejar.CookieJar()
        opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar))
        with opener.open(address) as answer:
            page = answer.url
        cookies = "; ".join(f"{cookie.name}={cookie.value}" for cookie in jar)
        self._socket = connect(
            page.replace("http", "ws"),
            additional_headers={"Cookie": cookies},
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            compression=None,
            max_size=None,
            max_queue=1,
        )
        if receive_buffer:
            channel = self._socket.socket
            channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.send("ViewerCameraMessage", **CAMERA)

    def send(self, kind: str, **fields: Any) -> None:
        """Send a message of viser's."""
        self._socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def drag(self, phase: str, node: str, start: Any, end: Any, modifier: str = "") -> None:
        """Drag on a node of the scene, points in the page's units."""
        self.send(
            "SceneNodeDragMessage", phase=phase, name=node, instance_index=None,
            start_position=list(start), start_screen_pos=[0.5, 0.5], end_position=list(end),
            end_screen_pos=[0.5, 0.5], button="left", modifier=modifier or None,
            owner=self.nodes.get(node, {}).get("owner", ""),
        )  # fmt: skip

    def receive(self, seconds: float = 0.05) -> bool:
        """Take in the next batch, if it comes in time; whether it did."""
        try:
            raw = self._socket.recv(timeout=seconds)
        except TimeoutError:
            return False
        assert isinstance(raw, bytes)
        self.received += 1
        _, size = struct.unpack("<QQ", raw[:16])
        inner = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(raw[16 : 16 + size]))
        begin = (16 + size + 7) // 8 * 8
        arrays = []
        for length in inner["binaryBufferLengths"]:
            arrays.append(raw[begin : begin + length])
            begin += (length + 7) // 8 * 8
        for message in inner["messages"]:
            self._take(message, arrays)
        return True

    def close(self) -> None:
        """Close the window."""
        self._socket.close()

    def drop(self) -> None:
        """Lose the connection without a word."""
        self._socket.socket.shutdown(socket.SHUT_RDWR)

    def fall_silent(self) -> None:
        """Answer nothing any more, not even pings, with the connection open: a pulled cable."""
        self._socket.protocol.receive_data = lambda data: None  # type: ignore[method-assign]

    def _take(self, message: dict[str, Any], arrays: list[bytes]) -> None:
        name = message.get("name", "")
        found = message.get("props") or message.get("updates") or {}
        if message["type"].startswith(("Mesh", "SceneNodeUpdate")) and name:
            known = self.nodes.setdefault(name, {"owner": message.get("owner", "")})
            for key, value in found.items():
                known[key] = _filled(value, arrays)
        elif message["type"] == "NotificationShowMessage":
            self.notices.append(str(found.get("body", "")))
        elif message["type"].startswith("Gui"):
            self.labels += [str(found[key]) for key in ("label", "_markdown") if key in found]


def _filled(value: Any, arrays: list[bytes]) -> Any:
    if isinstance(value, dict) and "__binary_index" in value:
        return arrays[value["__binary_index"]]
    return value
