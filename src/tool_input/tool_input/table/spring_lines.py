"""The springs of the organ as lines, by category."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import viser
from numpy.typing import NDArray

from tissue_sim.elastic.sheet_springs import categories_of, sheet_edges
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import CATEGORIES
from tool_input.table.contour_bands import surface_edges
from tool_input.table.surface_parts import Color
from tool_input.table.tissue_frame import Surface, TissueFrame

MOST_LINES = 12_000
"""Lines of one category that are drawn: of more, every so many-th."""

COLORS: dict[str, Color] = {
    "surface": (232, 196, 120),
    "connecting": (88, 176, 240),
    "inside": (88, 176, 240),
    "bending": (140, 214, 126),
    "angular": (226, 128, 214),
}

THICKNESS = 1.5
"""[pixels]"""


@dataclass(frozen=True)
class SpringGroup:
    """The springs of one category that are drawn.

    Attributes:
        name: The category; "inside" are edges of tetrahedra that are not on the surface.
        count: How many springs of it there are.
        ends: Node rows at both ends of those that are drawn, shape (n, 2).
    """

    name: str
    count: int
    ends: NDArray[np.int64]

    @classmethod
    def of(cls, name: str, ends: NDArray[np.integer]) -> SpringGroup:
        """All of a category, or an even choice of so many as can be drawn."""
        every = -(-len(ends) // MOST_LINES)
        return cls(name, len(ends), ends[:: max(every, 1)].astype(np.int64))


@lru_cache(maxsize=2)
def spring_groups(surface: Surface, mesh: Mesh) -> tuple[SpringGroup, ...]:
    """The springs of a mesh by category; of tetrahedra, their edges.

    Made once for all windows.

    Args:
        surface: The outside of the mesh as it is now.
        mesh: The mesh.
    """
    if mesh.sheet is not None:
        edges = sheet_edges(mesh.sheet)
        of = categories_of(mesh, edges)
        groups = [SpringGroup.of(name, edges[of == n]) for n, name in enumerate(CATEGORIES)]
    else:
        rows = mesh.element_rows
        tetrahedra = mesh.tets[:rows][mesh.element_alive[:rows]].astype(np.int64)
        corners = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
        outside = surface.nodes[surface_edges(surface).edges]
        inside = np.setdiff1d(_keys(tetrahedra[:, corners].reshape(-1, 2)), _keys(outside))
        ends = np.stack([inside >> 32, inside & 0xFFFFFFFF], axis=1)
        groups = [SpringGroup.of("surface", outside), SpringGroup.of("inside", ends)]
    return tuple(group for group in groups if group.count)


def _keys(ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number for each pair, whatever its order."""
    keys: NDArray[np.int64] = ends.min(axis=1) << 32 | ends.max(axis=1)
    return keys


class SpringLines:
    """The springs in one window."""

    def __init__(self, api: viser.SceneApi) -> None:
        """Begin without lines, in viser's scene of the window."""
        self._api = api
        self._groups: tuple[SpringGroup, ...] = ()
        self._lines: dict[str, viser.LineSegmentsHandle] = {}

    @property
    def legend(self) -> tuple[tuple[str, Color], ...]:
        """What the colours mean: a text for each, and its colour."""
        return tuple(
            (
                f"{group.name}: {group.count:,}"
                + (f", {len(group.ends):,} drawn" if len(group.ends) < group.count else ""),
                COLORS[group.name],
            )
            for group in self._groups
        )

    def show(self, frame: TissueFrame, positions: NDArray[np.float32]) -> None:
        """Draw the springs.

        Args:
            frame: The tissue.
            positions: Where its nodes are in the page's units, shape (node_rows, 3).
        """
        self._groups = spring_groups(frame.surface, frame.mesh)
        for name in set(self._lines) - {group.name for group in self._groups}:
            self._lines.pop(name).remove()
        for group in self._groups:
            points = positions[group.ends]
            if group.name in self._lines:
                self._lines[group.name].points = points
            else:
                self._lines[group.name] = self._api.add_line_segments(
                    f"/springs/{group.name}", points, colors=COLORS[group.name],
                    thickness=THICKNESS, thickness_units="screen",
                )  # fmt: skip

    def hide(self) -> None:
        """Draw none."""
        self._groups = ()
        for line in self._lines.values():
            line.remove()
        self._lines.clear()
