"""One window of the page in a real browser: what it shows, and a person's hands on it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tissue_sim.geometry.rays import crossings
from tool_input.browser.camera import Camera

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Response

SIZE = (1100, 420)
"""Width and height of a window [pixels]: the panel leaves room for the organ beside it."""
PATIENCE = 120.0
"""Longest wait for what the page has to show or to say [s]."""
REST_SECONDS = 1.0
"""A camera that has not moved for so long will not move by itself."""
STEP_SECONDS = 0.03
"""Between two moves of the mouse: about what a hand's mouse sends while the page keeps up."""

_ORGAN = """() => Object.entries(watch.meshes)
    .filter(([name, mesh]) => name.startsWith("/organ") && mesh.visible && mesh.faces)
    .map(([name, mesh]) => [name, Array.from(mesh.vertices), Array.from(mesh.faces)])"""


@dataclass(frozen=True)
class Part:
    """One mesh of the organ, as the page has it.

    Attributes:
        name: Its name in the scene.
        vertices: In the page's units, shape (n, 3).
        faces: Rows of `vertices`, shape (m, 3).
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


class Window:
    """A window of its own person: its cookies and its connection are shared with no other."""

    def __init__(self, browser: Browser, size: tuple[int, int] = SIZE) -> None:
        """Open an empty window.

        Args:
            browser: Whose window it is.
            size: Width and height of what it shows [pixels].
        """
        self._context = browser.new_context(viewport={"width": size[0], "height": size[1]})
        self._context.set_default_timeout(PATIENCE * 1e3)
        self.page = self._context.new_page()
        script = resources.files("tool_input") / "data" / "browser_watch.js"
        self.page.add_init_script(script=script.read_text(encoding="utf-8"))

    def open(self, address: str) -> Response | None:
        """Go to an address; gives the answer of the server."""
        return self.page.goto(address)

    def close(self) -> None:
        """Close it: its connection ends."""
        self._context.close()

    # What it shows

    def until(
        self, find: Callable[[], Any], what: str, patience: float = PATIENCE, step: float = 0.05
    ) -> Any:
        """The first result that counts as true.

        Raises:
            TimeoutError: There was none in time.
        """
        deadline = time.monotonic() + patience
        while not (found := find()):
            if time.monotonic() > deadline:
                raise TimeoutError(f"the page did not show {what} within {patience:g} s")
            self.page.wait_for_timeout(step * 1e3)
        return found

    def wait_drawn(self, patience: float = PATIENCE) -> None:
        """Wait until the page has drawn an organ, and take away what viser lays over it."""
        self.until(
            lambda: self.page.evaluate(
                "() => window.watch && watch.camera && watch.frames.length > 0 "
                "&& Object.values(watch.meshes).some((mesh) => mesh.visible && mesh.faces)"
            ),
            "an organ",
            patience,
        )
        self.until(self._rests, "the organ from where it stays")
        self.page.evaluate(
            "() => document.querySelectorAll('.mantine-Notification-closeButton')"
            ".forEach((button) => button.click())"
        )

    def _rests(self) -> bool:
        """Whether the camera has stopped where the page puts it at first."""
        before = self.page.evaluate("() => watch.camera")
        self.page.wait_for_timeout(REST_SECONDS * 1e3)
        return bool(self.page.evaluate("() => watch.camera") == before)

    @property
    def camera(self) -> Camera:
        """From where it is seen."""
        return Camera.told(self.page.evaluate("() => watch.camera"))

    def organ(self) -> list[Part]:
        """The meshes of the organ that are shown, the one with the most triangles first."""
        parts = [
            Part(name, np.array(vertices).reshape(-1, 3), np.array(faces).reshape(-1, 3))
            for name, vertices, faces in self.page.evaluate(_ORGAN)
        ]
        return sorted(parts, key=lambda part: -len(part.faces))

    def free(self, pixel: Sequence[float]) -> bool:
        """Whether nothing lies over the scene at a pixel."""
        return bool(
            self.page.evaluate(
                "([x, y]) => document.elementFromPoint(x, y)?.tagName === 'CANVAS'", list(pixel)
            )
        )

    def tissue_at(self, place: ArrayLike) -> NDArray[np.float64]:
        """The pixel at which a person would take hold of the organ.

        Args:
            place: Where in the organ's bounding box, each from 0 to 1 along its axes, shape (3,).

        Returns:
            Of the vertices that are in sight the pixel of the nearest, shape (2,).

        Raises:
            ValueError: Nothing of the organ is in sight.
        """
        parts = self.organ()
        firsts = np.cumsum([0, *(len(part.vertices) for part in parts)])
        vertices = np.concatenate([part.vertices for part in parts])
        faces = np.concatenate(
            [part.faces + first for part, first in zip(parts, firsts, strict=False)]
        )
        camera, lower, upper = self.camera, vertices.min(axis=0), vertices.max(axis=0)
        wanted = lower + np.asarray(place, dtype=np.float64) * (upper - lower)
        size = float(np.linalg.norm(upper - lower))
        for row in np.argsort(np.linalg.norm(vertices - wanted, axis=1)):
            pixel = camera.pixels(vertices[row : row + 1])[0]
            far = crossings(vertices, faces, camera.position, camera.ray(pixel)).distance
            away = float(np.linalg.norm(vertices[row] - camera.position))
            if len(far) and abs(far[0] - away) < 0.01 * size and self.free(pixel):
                return np.asarray(pixel)
        raise ValueError("nothing of the organ is in sight")

    def text(self) -> str:
        """All that can be read beside the scene."""
        return str(self.page.inner_text("body"))

    def said(self) -> list[dict[str, Any]]:
        """What the page has sent, but for where its camera is."""
        sent = self.page.evaluate("() => watch.sent.map(([_, message]) => message)")
        return [message for message in sent if message["type"] != "ViewerCameraMessage"]

    # A person's hands

    def move(self, pixel: ArrayLike) -> None:
        """Move the mouse there at once."""
        x, y = np.asarray(pixel, dtype=float)
        self.page.mouse.move(x, y)

    def press(self, pixel: ArrayLike, button: str = "left") -> None:
        """Press a button of the mouse there."""
        self.move(pixel)
        self.page.mouse.down(button=button)  # type: ignore[arg-type]

    def release(self, button: str = "left") -> None:
        """Release a button of the mouse where it is."""
        self.page.mouse.up(button=button)  # type: ignore[arg-type]

    def pull(self, start: ArrayLike, end: ArrayLike, steps: int = 10) -> None:
        """Move the mouse on a straight line as a hand does, with what is pressed."""
        a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
        for step in range(1, steps + 1):
            self.move(a + (b - a) * step / steps)
            self.page.wait_for_timeout(STEP_SECONDS * 1e3)

    def drag(self, start: ArrayLike, end: ArrayLike, steps: int = 10) -> None:
        """Press, move on a straight line, release."""
        self.press(start)
        self.pull(start, end, steps)
        self.release()

    def key(self, key: str) -> None:
        """Press and release a key."""
        self.page.keyboard.press(key)

    def click(self, label: str) -> None:
        """Click the button with this label."""
        self.page.get_by_role("button", name=label, exact=True).first.click()

    def forge(self, message: dict[str, Any]) -> None:
        """Send a message over the page's connection that the page itself would not send."""
        self.page.evaluate(
            "(message) => watch.worker.postMessage({type: 'send', message})", message
        )
