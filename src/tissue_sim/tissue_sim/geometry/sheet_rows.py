"""The rows of a sheet among the elements of a mesh: triangles, springs and walls of cuts.

A mesh keeps what tissue is made of in rows of four nodes. A triangle leaves the last place empty,
a spring the last two; so whatever follows the elements of a mesh under edits follows these as well.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.sheet import (
    CATEGORIES,
    CONNECTING,
    SURFACE,
    Sheet,
    SheetStiffness,
    triangle_areas,
)

NO_ROW = -1
WALL = len(CATEGORIES)
"""Kind of a triangle that is shown between the two sides of a wall that was cut."""


class SheetRows:
    """What the elements of a sheet are, by row.

    Attributes:
        kinds: `SURFACE` for a triangle, `CONNECTING`, `BENDING` or `ANGULAR` for a spring, `WALL`
            for a triangle that is only shown; uint8, shape (element_capacity,).
        tissue: Thickness of a triangle [m], volume of a spring's tissue [m^3], 0 for a wall,
            shape (element_capacity,).
        stiffness: Factors of stiffness by category.
    """

    def __init__(
        self, kinds: NDArray[np.uint8], tissue: NDArray[np.float64], stiffness: SheetStiffness
    ) -> None:
        self.kinds, self.tissue, self.stiffness = kinds, tissue, stiffness
        self._factors = np.array([getattr(stiffness, name) for name in CATEGORIES] + [0.0])
        self._seen: tuple[int, Sheet] | None = None

    @classmethod
    def of(cls, sheet: Sheet) -> tuple[SheetRows, NDArray[np.int32]]:
        """Rows of triangles, then of springs, then of walls; and their nodes, shape (n, 4)."""
        parts = (sheet.triangles, sheet.springs, sheet.walls)
        items = np.full((sum(map(len, parts)), 4), NO_ROW, dtype=np.int32)
        kinds, tissue = np.zeros(len(items), dtype=np.uint8), np.zeros(len(items))
        begin = 0
        filled = (
            (sheet.triangles, SURFACE, sheet.thickness), (sheet.springs, sheet.categories,
            sheet.volumes), (sheet.walls, WALL, 0.0),
        )  # fmt: skip
        for nodes, kind, amount in filled:
            rows = slice(begin, begin + len(nodes))
            items[rows, : nodes.shape[1]] = nodes
            kinds[rows], tissue[rows] = kind, amount
            begin += len(nodes)
        return cls(kinds, tissue, sheet.stiffness), items

    def copy(self, rows: int) -> SheetRows:
        """A copy of the first rows."""
        view = SheetRows(self.kinds[:rows].copy(), self.tissue[:rows].copy(), self.stiffness)
        view._seen = self._seen
        return view

    def grow(self, capacity: int) -> None:
        """Make place for more rows."""
        extra = capacity - len(self.kinds)
        if extra > 0:
            self.kinds = np.concatenate([self.kinds, np.zeros(extra, dtype=np.uint8)])
            self.tissue = np.concatenate([self.tissue, np.zeros(extra)])

    def enter(
        self, rows: NDArray[np.int32], parents: NDArray[np.int32], nodes: NDArray[np.int32]
    ) -> None:
        """Enter new rows.

        Springs share out the tissue of the spring that they take the place of. Triangles are as
        thick as the one they descend from; those that descend from a spring or a wall are walls.

        Args:
            rows: Rows of the new elements, shape (n,).
            parents: Rows of those they descend from, shape (n,).
            nodes: Nodes of the new elements, shape (n, 4).
        """
        if not len(rows):
            return
        is_spring = nodes[:, 2] == NO_ROW
        kind = self.kinds[parents]
        is_wall = ~is_spring & (kind != SURFACE)
        kinds = np.where(is_wall, WALL, kind)
        _, which, count = np.unique(parents[is_spring], return_inverse=True, return_counts=True)
        tissue = np.where(is_wall, 0.0, self.tissue[parents])
        tissue[is_spring] /= count[which]
        self.kinds[rows], self.tissue[rows] = kinds, tissue

    def enter_born(
        self, rows: NDArray[np.int32], kinds: NDArray[np.uint8], tissue: NDArray[np.float64]
    ) -> None:
        """Enter new rows that descend from none; kinds and tissue as the attributes."""
        self.kinds[rows], self.tissue[rows] = kinds, tissue

    def carries(self, rows: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which rows are triangles of tissue, shape (len(rows),)."""
        return np.asarray(self.kinds[rows] == SURFACE)

    def volumes(
        self, rows: NDArray[np.int32], rest: NDArray[np.float64], items: NDArray[np.int32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Volumes [m^3] that the stiffness and the mass of elements come from, shape (n,) each.

        A spring's stiffness is E V / l0^2 of the sum of the first over the elements at it, a node's
        mass density / 4 times the sum of the second.

        Args:
            rows: Rows of elements.
            rest: Rest positions [m], shape (node_capacity, 3).
            items: Nodes of all elements, shape (element_capacity, 4).
        """
        kinds, stiff = self.kinds[rows], self.tissue[rows]
        solid = kinds == SURFACE
        stiff[solid] *= triangle_areas(rest, items[rows[solid], :3])
        heavy = np.where(solid, stiff * (4.0 / 3.0), 0.0)
        return stiff * self._factors[kinds], heavy

    def sheet(self, version: int, items: NDArray[np.int32], alive: NDArray[np.bool_]) -> Sheet:
        """The sheet as it is at a version; made once for each that is asked for.

        Args:
            version: Of the mesh.
            items: Nodes of the elements in use, shape (element_rows, 4).
            alive: Which of them are there, shape (element_rows,).
        """
        if self._seen is None or self._seen[0] != version:
            self._seen = (version, self._sheet(items, alive))
        return self._seen[1]

    def order(
        self, alive: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Rows of the triangles, of the springs and of the walls that are there, ascending."""
        kinds = self.kinds[: len(alive)]
        triangles = np.flatnonzero(alive & (kinds == SURFACE))
        springs = np.flatnonzero(alive & (kinds >= CONNECTING) & (kinds < WALL))
        return triangles, springs, np.flatnonzero(alive & (kinds == WALL))

    def _sheet(self, items: NDArray[np.int32], alive: NDArray[np.bool_]) -> Sheet:
        kinds = self.kinds[: len(items)]
        triangles, springs, walls = self.order(alive)
        return Sheet(
            triangles=items[triangles, :3],
            thickness=self.tissue[triangles],
            springs=items[springs, :2],
            categories=kinds[springs],
            volumes=self.tissue[springs],
            stiffness=self.stiffness,
            walls=items[walls, :3],
        )
