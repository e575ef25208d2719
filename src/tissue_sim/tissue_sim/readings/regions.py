"""Risk regions: tissue that tools should keep away from, by its nodes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.regions import label_of

LARGEST_MARGIN, LARGEST_LIMIT, LONGEST_NAME = 1.0, 1e12, 80
SAME_PLACE = 1e-9
"""Nodes nearer to each other than this at rest are the same node of an organ loaded again [m]."""


class RiskRegionError(ValueError):
    """A risk region that is not allowed."""


@dataclass(frozen=True)
class RiskRegion:
    """Tissue that tools should keep away from.

    Attributes:
        name: What people call it.
        nodes: Ids of its nodes, ascending, shape (n,).
        margin: What is nearer than this is warned of [m].
        stress_limit: Von Mises stress beyond which is warned of [Pa]; 0: none.
    """

    name: str
    nodes: NDArray[np.uint32]
    margin: float
    stress_limit: float = 0.0

    def checked(self) -> RiskRegion:
        """This region, if it is allowed.

        Raises:
            RiskRegionError: Naming what is wrong and what is allowed.
        """
        if not self.name.strip() or len(self.name) > LONGEST_NAME or not self.name.isprintable():
            raise RiskRegionError(
                f"the name {self.name!r} is not allowed; allowed: 1 to {LONGEST_NAME} characters"
            )
        for what, value, most, unit in (
            ("margin", self.margin, LARGEST_MARGIN, "m"),
            ("stress_limit", self.stress_limit, LARGEST_LIMIT, "Pa"),
        ):
            if not 0.0 <= value <= most:
                raise RiskRegionError(
                    f"risk region {self.name}: {what} = {value:g} is not allowed; "
                    f"allowed: 0 to {most:g} {unit}"
                )
        return self


def nodes_of_ids(mesh: Mesh, ids: NDArray[np.integer]) -> NDArray[np.uint32]:
    """Ids of nodes, ascending and each once.

    Raises:
        RiskRegionError: No living node has one of them.
    """
    unknown = ids[mesh.node_rows_of(ids) < 0]
    if len(unknown):
        raise RiskRegionError(f"{mesh.name} has no node {int(unknown[0])}")
    return np.unique(ids).astype(np.uint32)


def painted(mesh: Mesh, points: NDArray[np.float64], radius: float) -> NDArray[np.uint32]:
    """Ids of the nodes within a brush's radius of points painted on the tissue at rest.

    Args:
        mesh: The tissue.
        points: Points [m], shape (n, 3).
        radius: Of the brush [m].

    Raises:
        RiskRegionError: A number is not finite, or the radius not positive.
    """
    if not (np.isfinite(points).all() and np.isfinite(radius) and radius > 0.0):
        raise RiskRegionError("points must be finite and the brush's radius above 0 m")
    if not len(points):
        return np.empty(0, dtype=np.uint32)
    rest = mesh.rest[: mesh.node_rows]
    # A hair more: the tree leaves out what lies exactly at its bound.
    distance, _ = cKDTree(points).query(rest, distance_upper_bound=radius * (1.0 + 1e-12))
    within = np.isfinite(distance) & mesh.node_alive[: mesh.node_rows]
    return mesh.node_ids[: mesh.node_rows][within]


def nodes_of_region(mesh: Mesh, name: str) -> NDArray[np.uint32]:
    """Ids of the nodes of a region that the mesh brings, by its name or label.

    Raises:
        RegionError: The mesh has none of this name.
    """
    elements = mesh.element_rows
    label = label_of(name, mesh.regions[:elements], mesh.region_names)
    chosen = mesh.tets[:elements][
        (mesh.regions[:elements] == label) & mesh.element_alive[:elements]
    ]
    return mesh.node_ids[np.unique(chosen[chosen >= 0])]


class RiskRegions:
    """The risk regions of an organ, which copies made by cuts join.

    Attributes:
        by_name: The regions.
    """

    def __init__(self) -> None:
        """Begin with none."""
        self.by_name: dict[str, RiskRegion] = {}
        self._rows: dict[str, NDArray[np.int32]] = {}
        self._places: dict[str, NDArray[np.float64]] = {}
        self._version = 0

    def put(self, mesh: Mesh, region: RiskRegion) -> None:
        """Make a region, or put it in the place of the one of its name.

        Raises:
            RiskRegionError: It is not allowed.
        """
        nodes = nodes_of_ids(mesh, region.nodes)
        self._enter(mesh, replace(region, nodes=nodes))

    def remove(self, name: str) -> bool:
        """Remove a region; whether there was one."""
        self._rows.pop(name, None)
        self._places.pop(name, None)
        return self.by_name.pop(name, None) is not None

    def rows(self, name: str) -> NDArray[np.int32]:
        """Rows of the living nodes of a region, ascending."""
        return self._rows[name]

    def follow(self, mesh: Mesh) -> bool:
        """Take in the copies that edits have made of nodes; whether any region has changed."""
        if mesh.version == self._version:
            return False
        self._version = mesh.version
        changed, rows = False, mesh.node_rows
        alive = mesh.node_alive[:rows]
        ids, parents = mesh.node_ids[:rows][alive], mesh.node_parents[:rows][alive]
        for region in list(self.by_name.values()):
            nodes, before = region.nodes, self._rows[region.name]
            while True:  # A copy may itself have been copied.
                joined = np.union1d(nodes, ids[np.isin(parents, nodes)])
                if len(joined) == len(nodes):
                    break
                nodes = joined
            self._enter(mesh, replace(region, nodes=nodes))
            changed |= not np.array_equal(before, self._rows[region.name])
        return changed

    def carry(self, mesh: Mesh) -> list[str]:
        """Find the regions in another epoch's organ, by where their nodes are at rest.

        Returns:
            Names of those that are not in it; they are removed.
        """
        lost, self._version = [], mesh.version
        for name, region in list(self.by_name.items()):
            nodes = painted(mesh, self._places[name], SAME_PLACE)
            self.remove(name)
            if len(nodes):
                self._enter(mesh, replace(region, nodes=nodes))
            else:
                lost.append(name)
        return lost

    def _enter(self, mesh: Mesh, region: RiskRegion) -> None:
        self.by_name[region.name] = region.checked()
        rows = mesh.node_rows_of(region.nodes)
        rows = rows[rows >= 0]
        self._rows[region.name] = rows
        self._places[region.name] = mesh.rest[rows].copy()
