"""The organ in one window, in the view that its person has chosen."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tissue_sim.readings.fields import DISPLACEMENT
from tool_input.table.color_bar import color_bar, legend
from tool_input.table.contour_bands import contour_bands, surface_edges
from tool_input.table.lighting import light
from tool_input.table.mesh_pool import Look, MeshPool, OnMesh
from tool_input.table.page_scene import PageScene
from tool_input.table.scalar_scale import LEAST_TOPS, UNKNOWN, AutoScale, Scale, band_colors
from tool_input.table.scalar_source import quantity_values, unit_of
from tool_input.table.spring_lines import SpringLines
from tool_input.table.surface_parts import Color, SurfacePart, lifted, tissue_parts
from tool_input.table.tissue_frame import Surface, TissueFrame
from tool_input.table.views import SMOOTH, VIEWS, View, view_named

RECOLOR_PERIOD = 0.1
"""Colours follow a quantity no faster than this [s]; the shape follows the tissue every frame."""

VEIL = 0.16
"""Opacity of the surface where the springs behind it are seen."""

EDGE_COLOR: Color = (24, 26, 32)
EDGE_LIFT = 0.002
"""How far edges are drawn over the surface, in the page's units: in it they would flicker."""


class OrganView:
    """Draws the organ in one window. What can be dragged are its meshes, whatever the view.

    Attributes:
        view: What is shown.
        scale: The range of its colours; None: they are those of tissue.
        fixed_scale: The range they shall have; None: it follows the values.
    """

    def __init__(
        self,
        scene: PageScene,
        on_mesh: OnMesh | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin with nothing drawn, in the view "smooth".

        Args:
            scene: The window's scene.
            on_mesh: Called once with every mesh that shows tissue, when it is made: to listen to
                drags on it. Meshes come when they are needed and are never removed.
            clock: Seconds.
        """
        self.view: View = VIEWS[SMOOTH]
        self.scale: Scale | None = None
        self.fixed_scale: Scale | None = None
        self._scene = scene
        self._clock = clock
        light(scene.api)
        self._meshes = MeshPool(scene.api, "/organ", on_mesh)
        self._edges = MeshPool(scene.api, "/edges")
        self._springs = SpringLines(scene.api)
        self._auto = AutoScale(clock=clock)
        self._drawn: tuple[Surface, View, Scale | None] | None = None
        self._epoch = b""
        self._values: NDArray[np.float64] | None = None
        self._colored_at = 0.0
        self._bar = ""

    @property
    def bar(self) -> str:
        """What the colours mean, as HTML; empty: they are those of tissue."""
        return self._bar

    def choose(self, name: str) -> None:
        """Choose a view, one of `VIEWS`.

        Raises:
            ValueError: There is no such view.
        """
        view = view_named(name)
        if view.quantity != self.view.quantity:
            self._auto = AutoScale(LEAST_TOPS[unit_of(view.quantity)], self._clock)
            self._values = None
            self.scale = self.fixed_scale = None
        self.view = view

    def show(self, frame: TissueFrame) -> None:
        """Draw the tissue at one frame."""
        if frame.epoch != self._epoch:
            self._epoch, self._values = frame.epoch, None
        positions = self._scene.to_page(frame.positions)
        same = self._drawn == (frame.surface, self.view, self.fixed_scale)
        if self.view.quantity:
            self._show_quantity(frame, positions, same)
        elif same:
            self._meshes.move(positions)
        else:
            self._bar = ""
            opacity = VEIL if self.view.springs else None
            self._show_parts(tissue_parts(frame.surface, frame.mesh), frame, positions, opacity)
        self._show_lines(frame, positions, same)
        self._drawn = (frame.surface, self.view, self.fixed_scale)

    def _show_quantity(
        self, frame: TissueFrame, positions: NDArray[np.float32], same: bool
    ) -> None:
        if same and self._clock() - self._colored_at < RECOLOR_PERIOD:
            self._meshes.move(positions)
            return
        values = quantity_values(self.view.quantity, frame, self._values)
        if same and self._values is not None and np.array_equal(values, self._values, True):
            self._meshes.move(positions)
            return
        self._values, self._colored_at = values, self._clock()
        shown = values[frame.surface.nodes]
        self.scale = scale = self.fixed_scale or self._auto.follow(shown)
        colors = band_colors(self.view.quantity)
        edges = surface_edges(frame.surface)
        parts = contour_bands(edges, shown, scale.levels, colors, UNKNOWN)
        self._show_parts(parts, frame, positions)
        known = shown[np.isfinite(shown)]
        largest = float(known.max()) if len(known) else None
        unit = unit_of(self.view.quantity)
        self._bar = color_bar(self.view.quantity, unit, scale, colors, largest)

    def _show_parts(
        self,
        parts: tuple[SurfacePart, ...],
        frame: TissueFrame,
        positions: NDArray[np.float32],
        opacity: float | None = None,
    ) -> None:
        sheet = frame.mesh.sheet_rows is not None
        self._meshes.show(
            parts, positions, Look(self.view.flat, self.view.lines, opacity, both_sides=sheet)
        )

    def _show_lines(self, frame: TissueFrame, positions: NDArray[np.float32], same: bool) -> None:
        if self.view.springs:
            self._springs.show(frame, positions)
            self._bar = legend(self._springs.legend)
        elif not same:
            self._springs.hide()
        if self.view.edges:
            raised = lifted(frame.surface, positions, EDGE_LIFT)
            if same:
                self._edges.move(raised)
            else:
                triangles = frame.surface.nodes[frame.surface.triangles]
                part = SurfacePart.of_nodes(EDGE_COLOR, triangles)
                self._edges.show((part,), raised, Look(lines=True))
        elif not same:
            self._edges.show((), positions, Look(lines=True))


def warm_up() -> None:
    """Compile or load what draws a surface, before anybody waits for it."""
    surface = Surface(np.arange(3), np.array([[0, 1, 2]], dtype=np.uint32))
    colors = band_colors(DISPLACEMENT)
    contour_bands(surface_edges(surface), np.arange(3.0), Scale(0.0, 1.0).levels, colors, UNKNOWN)
    lifted(surface, np.eye(3, dtype=np.float32), EDGE_LIFT)
