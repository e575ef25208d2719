"""The page a person works on: the deforming organ in a browser, to grab, pull and cut."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import viser
from numpy.typing import NDArray

from tool_input.page_guard import PageGuard

TISSUE = (196, 92, 84)
ORGAN_SIZE = 2.0
"""The organ's largest extent on the page in its own units; viser's camera suits this size."""

HELP = """
**Drag on the tissue** to act, drag beside it to turn the view, scroll to zoom.

- *grab*: pulls the tissue in the plane of the view
- *cut*: drag a line; the cut follows it along your view, as deep as set below
"""


class Actions(Protocol):
    """What the page asks for; called in the page's event loop, so each must return at once."""

    def grab(self, point: NDArray[np.float64]) -> None:
        """Start to hold the tissue at a point [m], shape (3,)."""

    def pull(self, point: NDArray[np.float64]) -> None:
        """Move the hold to a point [m], shape (3,)."""

    def let_go(self) -> None:
        """End the hold."""

    def cut(self, vertices: NDArray[np.float64]) -> None:
        """Cut along a rectangle, corners in order [m], shape (4, 3)."""

    def set_radius(self, radius: float) -> None:
        """Set the grab radius [m]."""

    def set_model(self, name: str) -> None:
        """Change the elastic model."""

    def pause(self, paused: bool) -> None:
        """Pause or go on."""

    def reset(self) -> None:
        """Put the organ back to its start."""

    def undo(self) -> None:
        """Take back the newest edit of the tissue."""

    def redo(self) -> None:
        """Make the edit again that was undone last."""


def swept_rectangle(
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    eye: NDArray[np.float64],
    depth: float,
) -> NDArray[np.float64]:
    """The rectangle a line drawn on the screen sweeps along the view.

    Args:
        start: One end of the line [m], shape (3,).
        end: The other end [m], shape (3,).
        eye: Where the camera is [m], shape (3,).
        depth: How far the rectangle reaches below the line [m]; it begins half that far above.

    Returns:
        Corners in order [m], shape (4, 3).

    Raises:
        ValueError: The line has no length, or points along the view.
    """
    view = (start + end) / 2 - eye
    view = view / np.linalg.norm(view)
    along = end - start
    if np.linalg.norm(np.cross(along, view)) < 1e-6:
        raise ValueError("a cut needs a line drawn across the view; drag further")
    return np.array(
        [start - view * depth / 2, end - view * depth / 2, end + view * depth, start + view * depth]
    )


@dataclass
class _Drag:
    """One drag in progress."""

    client: int
    mode: str
    start: NDArray[np.float64]
    end: NDArray[np.float64]


class OperatingPage:
    """A viser server that shows one organ and turns the mouse into actions.

    The page only shows and asks: what is asked goes through `Actions`.
    """

    def __init__(
        self,
        actions: Actions,
        models: tuple[str, ...],
        host: str = "127.0.0.1",
        port: int = 8080,
        guard: PageGuard | None = None,
    ) -> None:
        """Open the page.

        Args:
            actions: Who carries out what the person asks for.
            models: Elastic models on offer.
            host: Address to listen on.
            port: Port; the next free one is taken when it is in use.
            guard: Who may open it.
        """
        self._actions = actions
        self._guard = guard or PageGuard()
        self._scale, self._centre = 1.0, np.zeros(3)
        self._mesh: viser.MeshHandle | None = None
        self._drag: _Drag | None = None
        self._line: viser.SceneNodeHandle | None = None
        with self._guard.installed():
            self.server = viser.ViserServer(host=host, port=port, label="tissue_sim", verbose=False)
        self.server.scene.set_up_direction("+z")
        self.server.gui.configure_theme(dark_mode=True)
        self.server.on_client_disconnect(self._left)
        self._add_controls(models)

    @property
    def address(self) -> str:
        """Where to point a browser, token included."""
        return (
            f"http://{self.server.get_host()}:{self.server.get_port()}/?token={self._guard.token}"
        )

    def show_topology(self, vertices: NDArray[np.float32], triangles: NDArray[np.uint32]) -> None:
        """Show another surface.

        Args:
            vertices: Positions of the surface's nodes [m], shape (n, 3).
            triangles: Rows of `vertices`, shape (m, 3).
        """
        if self._mesh is None:
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            self._centre = ((low + high) / 2).astype(np.float64)
            self._scale = ORGAN_SIZE / max(float((high - low).max()), 1e-9)
        self._mesh = self.server.scene.add_mesh_simple(
            "/organ", self._to_page(vertices), triangles, color=TISSUE, side="double"
        )
        self._mesh.on_drag("left")(self._dragged)

    def show_positions(self, vertices: NDArray[np.float32]) -> None:
        """Show the same surface deformed.

        Args:
            vertices: Positions [m] in the order of `show_topology`, shape (n, 3).
        """
        if self._mesh is not None:
            self._mesh.vertices = self._to_page(vertices)

    def show_status(self, text: str) -> None:
        """Tell the person something: Markdown."""
        if self._status.content != text:
            self._status.content = text

    def close(self) -> None:
        """Close the page."""
        self.server.stop()

    def _add_controls(self, models: tuple[str, ...]) -> None:
        gui = self.server.gui
        self._status = gui.add_markdown("Waiting for the simulation ...")
        self._mode = gui.add_button_group("Tool", ("grab", "cut"))
        radius = gui.add_slider("Grab radius [mm]", min=1.0, max=20.0, step=0.5, initial_value=5.0)
        self._depth = gui.add_slider(
            "Cut depth [mm]", min=1.0, max=60.0, step=1.0, initial_value=12.0
        )
        model = gui.add_dropdown("Model", models)
        paused = gui.add_checkbox("Paused", initial_value=False)
        undo, redo = gui.add_button("Undo"), gui.add_button("Redo")
        reset = gui.add_button("Reset")
        gui.add_markdown(HELP)
        radius.on_update(lambda _: self._actions.set_radius(radius.value / 1e3))
        model.on_update(lambda _: self._actions.set_model(model.value))
        paused.on_update(lambda _: self._actions.pause(paused.value))
        undo.on_click(lambda _: self._actions.undo())
        redo.on_click(lambda _: self._actions.redo())
        reset.on_click(lambda _: self._actions.reset())

    def _to_page(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        return ((points - self._centre) * self._scale).astype(np.float32)

    def _to_organ(self, point: tuple[float, ...] | NDArray[np.floating]) -> NDArray[np.float64]:
        return np.asarray(point, dtype=np.float64) / self._scale + self._centre

    async def _dragged(self, event: viser.SceneNodeDragEvent[viser.MeshHandle]) -> None:
        point = self._to_organ(event.end_position)
        if event.phase == "start":
            self._begin(event.client_id, self._to_organ(event.start_position), point)
        drag = self._drag
        if drag is None or drag.client != event.client_id:
            return
        drag.end = point
        if drag.mode == "grab":
            self._actions.pull(point)
        else:
            self._show_line(drag)
        if event.phase == "end":
            self._finish(drag, self._to_organ(event.client.camera.position))

    def _begin(self, client: int, start: NDArray[np.float64], end: NDArray[np.float64]) -> None:
        if self._drag is None:
            self._drag = _Drag(client, self._mode.value, start, end)
            if self._drag.mode == "grab":
                self._actions.grab(start)

    def _finish(self, drag: _Drag, eye: NDArray[np.float64]) -> None:
        self._drag = None
        self._hide_line()
        if drag.mode == "grab":
            self._actions.let_go()
            return
        try:
            self._actions.cut(swept_rectangle(drag.start, drag.end, eye, self._depth.value / 1e3))
        except ValueError as error:
            self.show_status(str(error))

    def _show_line(self, drag: _Drag) -> None:
        ends = self._to_page(np.array([[drag.start, drag.end]]))
        self._line = self.server.scene.add_line_segments(
            "/cut", ends, colors=(255, 255, 255), thickness=3.0, thickness_units="screen"
        )

    def _hide_line(self) -> None:
        if self._line is not None:
            self._line.remove()
            self._line = None

    def _left(self, client: viser.ClientHandle) -> None:
        """A window was closed or its connection dropped: what it held is let go."""
        drag = self._drag
        if drag is not None and drag.client == client.client_id:
            self._drag = None
            self._hide_line()
            if drag.mode == "grab":
                self._actions.let_go()
