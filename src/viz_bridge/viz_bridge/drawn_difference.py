"""A second model beside the organ, coloured by how far it is from it, and the curves of that."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from tissue_sim.conversions import array_of, epoch_of, positions_from_state
from viz_bridge.cdr import Message
from viz_bridge.difference_colors import color_bar, difference_colors, scale_top
from viz_bridge.organ_surface import OrganSurface

SURFACES_KEPT = 16
"""Versions of the surface that are remembered: the second model may lag behind some edits."""

MILLIMETRES = 1e3
PARTS = ("outside", "inside")


class DrawnDifference:
    """Draws `tissue/difference`; a message is never drawn on another version than its own.

    The end of the colour scale is the next of 1, 2 and 5 times a power of ten above the largest
    95th percentile so far, so that colours of one scale can be compared over time.

    Attributes:
        drawn: Messages drawn.
        top: End of the scale [m].
    """

    def __init__(self, stream: rr.RecordingStream) -> None:
        """Draw into a stream."""
        self.drawn = 0
        self.top = 0.0
        self._stream = stream
        self._surfaces: OrderedDict[tuple[bytes, int], OrganSurface] = OrderedDict()
        self._on: tuple[bytes, int] | None = None

    def remember(self, epoch: bytes, surface: OrganSurface) -> None:
        """Keep the surface of a version for the messages that belong to it."""
        self._surfaces[epoch, surface.version] = surface
        while len(self._surfaces) > SURFACES_KEPT:
            self._surfaces.popitem(last=False)

    def take(self, message: Message) -> bool:
        """Draw a message at the time that is set; whether its version was known."""
        key = epoch_of(message), int(message.version)
        surface = self._surfaces.get(key)
        positions = positions_from_state(message)
        distance = array_of(message.scalar, np.float32)
        known = distance[np.isfinite(distance)]
        if surface is None or not len(known) or len(distance) != len(positions):
            return False
        self._log_scale(float(np.percentile(known, 95)), str(message.scalar_name))
        for name in PARTS:
            self._log_part(name, surface, positions, distance, whole=key != self._on)
        self._on = key
        for what, value in (
            ("mean", known.mean()), ("p95", np.percentile(known, 95)), ("largest", known.max()),
        ):  # fmt: skip
            curve = rr.Scalars(MILLIMETRES * float(value))
            self._stream.log(f"plots/difference/{what}", curve)
        self.drawn += 1
        return True

    def _log_scale(self, p95: float, title: str) -> None:
        top = scale_top(p95)
        if top > self.top:
            self.top = top
            self._stream.log("difference_legend", rr.Image(color_bar(top, f"{title} [mm]")))

    def _log_part(
        self,
        name: str,
        surface: OrganSurface,
        positions: NDArray[np.float32],
        distance: NDArray[np.float32],
        whole: bool,
    ) -> None:
        part, path = getattr(surface, name), f"difference/{name}"
        if not len(part.triangles):
            if whole:
                self._stream.log(path, rr.Clear(recursive=False))
            return
        vertices = part.vertices(positions)
        body = rr.Mesh3D.from_fields(
            vertex_positions=vertices,
            vertex_normals=part.normals(vertices),
            vertex_colors=difference_colors(distance[part.nodes], self.top),
            triangle_indices=part.triangles if whole else None,
        )
        self._stream.log(path, body)
