"""Volume meshes of closed surfaces: what lies inside is filled with tetrahedra in seconds.

Isosurface stuffing of the signed distance whose sign is the generalised winding number, so that
surfaces that intersect themselves, as real segmentations do, are filled like clean ones. Walls
thinner than an element, which the lattice could miss, are thickened to about one.

Limitations: elements have one size; the report says what was thickened and compares the volumes;
walls thinner than about one and a half elements can show small holes;
sharp edges are rounded off; gaps narrower than an element can close. A surface knows no regions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.errors import MeshError
from tissue_sim.geometry.mending import label
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.stuffing import StuffedMesh, stuff
from tissue_sim.geometry.winding import (
    in_parallel,
    signed_distances,
    surface_tree,
    winding_numbers,
)

MOST_NODES = 40_000
"""Most nodes of a mesh whose element size nobody chose: what runs in real time."""

_FEWEST_NODES = 10_000
_CELLS_PER_WALL = 3.0
_THINNEST = 0.95
"""Walls are thickened to this many elements; the lattice could miss thinner ones."""

_DEPTHS = 12
_ROOT_STEPS = 3
_MOST_LATTICE_NODES = 8_000_000
_OPEN = 0.01
"""Share of edges that may be open or turned; the winding number bridges small holes."""


class Filled(NamedTuple):
    """A volume mesh made from a surface.

    Attributes:
        raw: The mesh.
        said: What was done and found, one sentence each.
    """

    raw: RawMesh
    said: tuple[str, ...]


def fill_surface(raw: RawMesh, cell: float | None = None) -> Filled:
    """Fill a closed surface with tetrahedra.

    Args:
        raw: A surface that `check.mend` let pass.
        cell: Element size [m]. By default such that a wall of mean thickness gets three elements,
            but not so small that it takes more than 40,000 nodes, nor coarser than 10,000 need.

    Raises:
        MeshError: The surface is open or its triangles disagree about the outside.
        ValueError: The element size makes no sense.
    """
    if not len(raw.triangles):
        raise MeshError(f"{label(raw)}: there is no surface to fill")
    said: list[str] = []
    surface = _Surface(raw, outward_triangles(raw, said))
    if cell is None:
        mesh, cell = _fill_by_default(surface)
    else:
        mesh = _stuff(surface, _checked_cell(surface, cell))
    said += _what_was_done(surface, mesh, cell)
    out = RawMesh(
        points=mesh.points,
        tetrahedra=mesh.tetrahedra.astype(np.int64),
        name=raw.name,
        source=raw.source,
    )
    return Filled(out, tuple(said))


class _Surface:
    """A surface to fill and what is known about it.

    Attributes:
        raw: Where it came from.
        triangles: Node rows, normals outward, shape (triangle_count, 3).
        tree: For distances and winding numbers.
        volume: Enclosed volume [m^3].
        areas: Areas of the triangles [m^2], shape (triangle_count,).
        is_closed: Whether every edge has as many triangles one way as the other.
    """

    def __init__(self, raw: RawMesh, triangles: NDArray[np.int64]) -> None:
        self.raw = raw
        self.triangles = triangles
        self.tree = surface_tree(raw.points, triangles)
        self.volume, _ = _measure(raw.points[triangles])
        self.areas = 0.5 * np.linalg.norm(_normals(raw.points[triangles]), axis=1)
        edge_of, ways = _edges(triangles)
        self.is_closed = not np.bincount(edge_of, weights=ways).any()
        self._thickness: NDArray[np.float64] | None = None

    @property
    def area(self) -> float:
        """Area of the surface [m^2]."""
        return float(self.areas.sum())

    def thickness(self) -> NDArray[np.float64]:
        """Thickness of the tissue under each triangle [m], as far as it is below two mean walls.

        Found by looking at a few depths whether they are still inside. Shape (triangle_count,).
        """
        if self._thickness is None:
            corners = self.raw.points[self.triangles]
            normals = _normals(corners)
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
            deepest = 4.0 * self.volume / self.area
            depths = deepest * np.arange(1, _DEPTHS + 1) / _DEPTHS
            thickness = np.full(len(corners), deepest)
            inside = np.arange(len(corners))
            for depth in depths:
                below = corners[inside].mean(axis=1) - depth * normals[inside]
                is_out = in_parallel(winding_numbers, self.tree, below) <= 0.5
                thickness[inside[is_out]] = depth
                inside = inside[~is_out]
            self._thickness = thickness
        return self._thickness

    def offsets(self, cell: float) -> NDArray[np.float64]:
        """How far to move each node outwards so that walls become an element thick [m]."""
        wanted = np.maximum(0.5 * (_THINNEST * cell - self.thickness()), 0.0)
        nodes = self.triangles.ravel()
        count = len(self.raw.points)
        weights = np.repeat(self.areas, 3)
        total = np.bincount(nodes, weights=weights, minlength=count)
        moved = np.bincount(nodes, weights=weights * np.repeat(wanted, 3), minlength=count)
        return np.asarray(moved / np.maximum(total, 1e-300))

    def predicted_nodes(self, cell: float) -> float:
        """Two lattice nodes per cell and 1.3 more per cell area of surface (measured)."""
        thickened = self.volume + float(
            (self.areas * self.offsets(cell)[self.triangles].mean(axis=1)).sum()
        )
        return 2.0 * thickened / cell**3 + 1.3 * self.area / cell**2


def _what_was_done(surface: _Surface, mesh: StuffedMesh, cell: float) -> list[str]:
    filled = float(signed_volumes(mesh.points, mesh.tetrahedra).sum())
    said = [
        f"the surface of {len(surface.triangles)} triangles was filled with "
        f"{len(mesh.tetrahedra)} tetrahedra of {1e3 * cell:.3g} mm ({len(mesh.points)} nodes); "
        f"volume {1e6 * filled:.4g} ml of {1e6 * surface.volume:.4g} ml, mean wall "
        f"{2e3 * surface.volume / surface.area:.3g} mm"
    ]
    offsets = surface.offsets(cell)
    share = float(surface.areas[offsets[surface.triangles].max(axis=1) > 0].sum()) / surface.area
    if share > 0:
        said.append(
            f"walls thinner than {_THINNEST} elements were thickened, {100 * share:.0f} % of the "
            f"surface by up to {1e3 * offsets.max():.2g} mm, and can show small holes; smaller "
            "elements follow them better"
        )
    if len(mesh.thickened):
        said.append(f"at {len(mesh.thickened)} more places tissue was thickened by under a cell")
    return said


def _normals(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normals of triangles, of twice their area [m^2], shape (triangle_count, 3)."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _measure(corners: NDArray[np.float64]) -> tuple[float, float]:
    """Enclosed volume [m^3] and area [m^2] of triangles."""
    normals = _normals(corners)
    middle = corners.mean(axis=(0, 1))
    volume = float(np.einsum("ij,ij->", corners[:, 0] - middle, normals)) / 6.0
    return volume, float(np.linalg.norm(normals, axis=1).sum()) / 2.0


def _edges(triangles: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Number of each triangle side's edge, and 1 or -1 by the way it runs along it."""
    directed = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    low, high = directed.min(axis=1), directed.max(axis=1)
    _, edge_of = np.unique(low * (int(high.max()) + 1) + high, return_inverse=True)
    return edge_of.ravel(), np.where(directed[:, 0] < directed[:, 1], 1.0, -1.0)


def outward_triangles(raw: RawMesh, said: list[str]) -> NDArray[np.int64]:
    """Triangles with normals out of the tissue.

    Raises:
        MeshError: The surface is too open or turned for inside and outside to make sense.
    """
    edge_of, ways = _edges(raw.triangles)
    uses = np.bincount(edge_of)
    balance = np.bincount(edge_of, weights=ways)
    is_open = uses % 2 == 1
    turned = (balance != 0) & ~is_open
    for bad, what, cure in (
        (is_open, "open", "close its holes"),
        (turned, "between triangles that disagree which side is out", "make its normals agree"),
    ):
        count = int(bad.sum())
        if count > _OPEN * len(uses):
            raise MeshError(
                f"{label(raw)}: the surface does not enclose a volume: {count} of {len(uses)} "
                f"edges are {what}; {cure} first"
            )
        if count:
            said.append(
                f"{count} edges are {what}; inside was taken where most of the surface agrees"
            )
    volume, area = _measure(raw.points[raw.triangles])
    if abs(volume) <= 1e-9 * area**1.5:
        raise MeshError(f"{label(raw)}: the surface encloses no volume")
    if volume > 0:
        return raw.triangles
    said.append("all triangles pointed inwards and were turned")
    return raw.triangles[:, ::-1]


def _checked_cell(surface: _Surface, cell: float) -> float:
    size = np.ptp(surface.raw.points, axis=0)
    smallest = float(np.prod(size) * 2 / _MOST_LATTICE_NODES) ** (1 / 3)
    largest = float(size.max()) / 4
    if not smallest <= cell <= largest:
        raise ValueError(
            f"{surface.raw.name}: elements of {cell:g} m make no sense for a surface of "
            f"{' x '.join(f'{s:.3g}' for s in size)} m; allowed: {smallest:.2g} to {largest:.2g} m"
        )
    return cell


def _cell_for(surface: _Surface, nodes: float) -> float:
    """Element size at which a mesh has about so many nodes."""
    low, high = np.log(1e-3 * surface.volume ** (1 / 3)), np.log(10 * surface.volume ** (1 / 3))
    for _ in range(30):
        middle = 0.5 * (low + high)
        if surface.predicted_nodes(float(np.exp(middle))) > nodes:
            low = middle
        else:
            high = middle
    return float(np.exp(high))


def _fill_by_default(surface: _Surface) -> tuple[StuffedMesh, float]:
    """Fill with the default size, coarser until the mesh is small enough."""
    finest = _cell_for(surface, 0.92 * MOST_NODES)
    coarsest = _cell_for(surface, _FEWEST_NODES)
    wanted = 2.0 * surface.volume / surface.area / _CELLS_PER_WALL
    cell = _checked_cell(surface, min(max(wanted, finest), coarsest))
    while True:
        mesh = _stuff(surface, cell)
        excess = len(mesh.points) / MOST_NODES
        if excess <= 1.0:
            return mesh, cell
        cell *= 1.02 * excess**0.5


def _stuff(surface: _Surface, cell: float) -> StuffedMesh:
    at_nodes = surface.offsets(cell)
    offsets = at_nodes[surface.triangles][surface.tree.order]
    reach = 2.0 * cell + float(at_nodes.max())

    def distance(places: NDArray[np.float64]) -> NDArray[np.float64]:
        return in_parallel(
            signed_distances, surface.tree, places, reach, offsets, surface.is_closed
        )

    points = surface.raw.points
    margin = 1.5 * cell + float(at_nodes.max())
    lower, upper = points.min(axis=0) - margin, points.max(axis=0) + margin
    try:
        return stuff(distance, lower, upper, cell, root_steps=_ROOT_STEPS)
    except ValueError as error:
        name = label(surface.raw)
        raise MeshError(f"{name}: the surface could not be filled: {error}") from error
