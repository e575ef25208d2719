"""rerun's viewer as a process of our own, reachable from this machine only."""

from __future__ import annotations

import socket
import subprocess
import time
from importlib.util import find_spec
from pathlib import Path

LOOPBACK = "127.0.0.1"


class ViewerError(RuntimeError):
    """The viewer did not start; the message says why."""


def viewer_binary() -> Path:
    """The viewer itself.

    The wheel's `rerun` command is a wrapper whose child outlives a kill, so it is not used.

    Raises:
        ViewerError: The installation has none.
    """
    spec = find_spec("rerun_cli")
    if spec is not None and spec.origin is not None:
        for name in ("rerun", "rerun.exe"):
            path = Path(spec.origin).with_name(name)
            if path.is_file():
                return path
    raise ViewerError("rerun's viewer is not installed: pip install rerun-sdk")


def free_port() -> int:
    """A TCP port nobody listens on."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


class ViewerProcess:
    """A running viewer.

    Attributes:
        url: Where recordings are sent to.
        page: Address of the web page; empty for a window.
    """

    def __init__(self, web: bool = False, port: int = 0, page_port: int = 0) -> None:
        """Start it and wait until it listens.

        Args:
            web: Serve a page instead of opening a window.
            port: Where it takes recordings; 0: any free one.
            page_port: Of the page; 0: any free one.

        Raises:
            ViewerError: It did not start.
        """
        self.port = port or free_port()
        self.url = f"rerun+http://{LOOPBACK}:{self.port}/proxy"
        self.page = ""
        command = [str(viewer_binary()), "--bind", LOOPBACK, "--port", str(self.port)]
        if web:
            page_port = page_port or free_port()
            command += ["--serve-web", "--web-viewer-port", str(page_port)]
            self.page = f"http://{LOOPBACK}:{page_port}/?url={self.url.replace(':', '%3A')}"
        self.process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        self._wait_until_it_listens(20.0)

    def stop(self) -> None:
        """End it, also where it has been stopped by a signal."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(timeout=10)
        if self.process.stderr is not None:
            self.process.stderr.close()

    def _wait_until_it_listens(self, timeout: float) -> None:
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            if self.process.poll() is not None:
                raise ViewerError(
                    f"rerun's viewer ended with code {self.process.returncode}: "
                    f"{self._last_words()} (without a display choose sink web or file)"
                )
            with socket.socket() as probe:
                probe.settimeout(0.2)
                if probe.connect_ex((LOOPBACK, self.port)) == 0:
                    return
            time.sleep(0.05)
        self.stop()
        raise ViewerError(f"rerun's viewer did not listen within {timeout:g} s")

    def _last_words(self) -> str:
        if self.process.stderr is None:
            return ""
        lines = self.process.stderr.read().decode(errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.strip()), "")
