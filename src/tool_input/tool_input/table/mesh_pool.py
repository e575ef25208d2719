"""The meshes in a window that show parts of the organ's surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from tool_input.table.surface_parts import SurfacePart

OnMesh = Callable[[viser.MeshHandle], None]

_NOWHERE, _NOTHING = np.zeros((3, 3), dtype=np.float32), np.array([[0, 1, 2]], dtype=np.uint32)
"""Vertices and triangles of a mesh that shows nothing: an empty one has no extent, which viser
cannot bear. It is not made invisible: viser would end a drag on it, and hides and shows meshes a
frame before it draws their new shapes, so that parts of two moments would be seen together."""

STILL = 1e-4
"""What has moved by less since it was shown is not shown again, in the page's units: a twentieth of
a pixel where the organ is a thousand wide. Most of an organ stands still while a part is pulled."""


@dataclass(frozen=True)
class Look:
    """How all meshes look.

    Attributes:
        flat: Whether each triangle has a shade of its own.
        lines: Whether only edges are drawn.
        opacity: Of a veil, below 1; None: opaque.
        both_sides: Whether triangles are seen from behind.
    """

    flat: bool = False
    lines: bool = False
    opacity: float | None = None
    both_sides: bool = False


class MeshPool:
    """One mesh for each part. Meshes are never removed, so that a drag on one goes on."""

    def __init__(self, api: viser.SceneApi, folder: str, on_mesh: OnMesh | None = None) -> None:
        """Begin without meshes.

        Args:
            api: viser's scene of the window.
            folder: Name of the scene's node that they belong to, such as "/organ".
            on_mesh: Called with each mesh that is made.
        """
        self._api = api
        self._folder = folder
        self._on_mesh = on_mesh
        self._meshes: list[viser.MeshHandle] = []
        self._parts: Sequence[SurfacePart] = ()

    def show(
        self, parts: Sequence[SurfacePart], positions: NDArray[np.float32], look: Look
    ) -> None:
        """Show other parts.

        Args:
            parts: The parts.
            positions: Where the nodes are in the page's units, shape (node_rows, 3).
            look: How they look.
        """
        self._parts = parts
        while len(self._meshes) < len(parts):
            self._add()
        for mesh, part in zip(self._meshes, parts, strict=False):
            mesh.color = part.color
            mesh.wireframe, mesh.flat_shading = look.lines, look.flat and not look.lines
            mesh.opacity, mesh.side = look.opacity, "double" if look.both_sides else "front"
            mesh.faces = part.triangles if len(part.triangles) else _NOTHING
        for mesh in self._meshes[len(parts) :]:
            mesh.vertices, mesh.faces = _NOWHERE, _NOTHING
        self.move(positions)

    def move(self, positions: NDArray[np.float32]) -> None:
        """Show the same parts elsewhere; see `show`."""
        for mesh, part in zip(self._meshes, self._parts, strict=False):
            vertices = part.vertices(positions) if len(part.triangles) else _NOWHERE
            if not _shown(mesh.vertices, vertices):
                mesh.vertices = vertices

    def _add(self) -> None:
        mesh = self._api.add_mesh_simple(
            f"{self._folder}/{len(self._meshes)}", _NOWHERE, _NOTHING,
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
        self._meshes.append(mesh)
        if self._on_mesh is not None:
            self._on_mesh(mesh)


def _shown(before: NDArray[np.float32], now: NDArray[np.float32]) -> bool:
    """Whether nobody would see a difference between two sets of vertices."""
    return before.shape == now.shape and bool(np.abs(now - before).max() < STILL)
