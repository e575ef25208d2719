"""The infant heart as a mesh: made from its signed distance, or loaded from the data file.

Axes x anterior, y left, z superior (REP 103 for a body), metres. See docs/heart.md for the anatomy,
its dimensions and its limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.heart_anatomy import (
    BETWEEN_POOLS,
    LOWER_CORNER,
    SEPTUM,
    UPPER_CORNER,
    VESSELS,
)
from tissue_sim.geometry.heart_shape import (
    ASD_RADIUS,
    MILLIMETRE,
    VSD_RADIUS,
    Blood,
    heart_blood,
    heart_tissue,
)
from tissue_sim.geometry.implicit import half_space, tube
from tissue_sim.geometry.neighbourhood import by_neighbourhood
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.stuffing import stuff

CELL = 1.4e-3
"""Default lattice cell [m]; gives about 36,000 nodes."""

COARSEST_CELL = 2.0e-3
FINEST_CELL = 0.4e-3
LARGEST_DEFECT = 4.0e-3

SECONDS_PER_NODE = 1e-4
BYTES_PER_NODE = 3000
"""What a generated node costs, checks included, on two cores of a server of 2023."""

WORTH_MENTIONING = 150_000
"""Nodes from which on that is said before."""

REGIONS = {
    0: "left ventricle",
    1: "right ventricle",
    2: "ventricular septum",
    3: "left atrium",
    4: "right atrium",
    5: "atrial septum",
    6: "aorta",
    7: "pulmonary artery",
    8: "veins",
}

_NANOMETRE = 1e9
_RIM_DEPTH = 1.5
_DORSAL_PLANE = -17.5


def heart_mesh(
    cell: float = CELL, asd_radius: float = ASD_RADIUS, vsd_radius: float = VSD_RADIUS
) -> RawMesh:
    """Generate the heart.

    Args:
        cell: Size of the lattice cells [m]. Walls are 2.1 mm and more; a cell above 1.4 mm (two
            thirds of that) begins to leave holes in them.
        asd_radius: Radius of the atrial septal defect [m], zero for an intact septum.
        vsd_radius: Radius of the ventricular septal defect [m], zero for an intact septum.

    Returns:
        The mesh with regions (`REGIONS`) and the node sets "fixed", "dorsal attachment" and
        "<vessel> rim". Node positions are whole nanometres; the same arguments give the same bits.

    Raises:
        ValueError: A size is outside its range.
    """
    if not FINEST_CELL <= cell <= COARSEST_CELL:
        most, least = expected_nodes(FINEST_CELL), expected_nodes(COARSEST_CELL)
        raise ValueError(
            f"heart: cell is {cell} m, it must be from {FINEST_CELL} m (about {most:,} nodes) to "
            f"{COARSEST_CELL} m (about {least:,} nodes)"
        )
    for name, radius in (("asd_radius", asd_radius), ("vsd_radius", vsd_radius)):
        if not 0.0 <= radius <= LARGEST_DEFECT:
            raise ValueError(f"{name} is {radius} m, it must be from 0 to {LARGEST_DEFECT} m")

    def tissue(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return by_neighbourhood(
            lambda some: heart_tissue(some, asd_radius, vsd_radius) * MILLIMETRE, points
        )

    mesh = stuff(tissue, LOWER_CORNER * MILLIMETRE, UPPER_CORNER * MILLIMETRE, cell)
    points = _from_nanometres(np.rint(mesh.points * _NANOMETRE).astype(np.int32))
    tetrahedra = mesh.tetrahedra.astype(np.int64)
    centroids = points[tetrahedra].sum(axis=1) / 4.0
    regions = by_neighbourhood(lambda some: _regions(heart_blood(some)), centroids)
    return RawMesh(
        points=points,
        tetrahedra=tetrahedra,
        regions=regions,
        region_names=dict(REGIONS),
        node_sets=_node_sets(points, tetrahedra, regions),
        name="heart",
        source=f"heart_mesh(cell={cell}, asd_radius={asd_radius}, vsd_radius={vsd_radius})",
    )


def expected_nodes(cell: float) -> int:
    """About how many nodes a heart of such cells [m] has: those within, and more at its surface."""
    size = cell / MILLIMETRE
    return 1000 * round((61.4 / size + 27.4) / size**2)


def expected_cost(cell: float) -> str:
    """What generating a heart of such cells [m] takes, in words; "" if it is not worth them."""
    nodes = expected_nodes(cell) if FINEST_CELL <= cell <= COARSEST_CELL else 0
    if nodes < WORTH_MENTIONING:
        return ""
    seconds = round(nodes * SECONDS_PER_NODE, -1)
    return (
        f"a heart of {1e3 * cell:g} mm cells has about {nodes:,} nodes; to generate and check it "
        f"takes some {seconds:.0f} s on two free cores and {nodes * BYTES_PER_NODE / 1e9:.1f} GB "
        "of memory"
    )


def heart(
    cell: float = CELL, asd_radius: float = ASD_RADIUS, vsd_radius: float = VSD_RADIUS
) -> RawMesh:
    """The heart, from the data file if it has these sizes, otherwise from `heart_mesh`."""
    if (cell, asd_radius, vsd_radius) == (CELL, ASD_RADIUS, VSD_RADIUS):
        return load_heart()
    return heart_mesh(cell, asd_radius, vsd_radius)


def load_heart() -> RawMesh:
    """Load the committed heart, which `heart_mesh()` reproduces exactly."""
    file = files("tissue_sim") / "data" / "heart.npz"
    with file.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
        return _unpack(data)


def save_heart(mesh: RawMesh, path: Path) -> None:
    """Write a generated heart in the data file's compact form.

    Positions are stored as whole nanometres, which `heart_mesh` rounds to, so nothing is lost.
    """
    arrays: dict[str, Any] = {
        "points_nm": np.rint(mesh.points * _NANOMETRE).astype(np.int32),
        "tetrahedra": mesh.tetrahedra.astype(np.uint16 if len(mesh.points) < 65536 else np.uint32),
        "regions": mesh.regions.astype(np.uint8),
        "source": np.array(mesh.source),
        "set_names": np.array(list(mesh.node_sets)),
        "set_sizes": np.array([len(rows) for rows in mesh.node_sets.values()]),
        "set_rows": np.concatenate(list(mesh.node_sets.values())).astype(np.uint32),
    }
    np.savez_compressed(path, **arrays)


def _unpack(data: Mapping[str, NDArray[np.generic]]) -> RawMesh:
    ends = np.cumsum(data["set_sizes"])
    rows = np.split(data["set_rows"].astype(np.int64), ends[:-1])
    return RawMesh(
        points=_from_nanometres(data["points_nm"].astype(np.int32)),
        tetrahedra=data["tetrahedra"].astype(np.int64),
        regions=data["regions"].astype(np.int32),
        region_names=dict(REGIONS),
        node_sets={str(name): part for name, part in zip(data["set_names"], rows, strict=True)},
        name="heart",
        source=str(data["source"]),
    )


def _from_nanometres(points: NDArray[np.int32]) -> NDArray[np.float64]:
    return points.astype(np.float64) / _NANOMETRE


def _regions(blood: Blood) -> NDArray[np.int32]:
    """Give each place the region of the pool whose wall it most likely belongs to."""
    depth = {
        "left ventricle": blood.left["left ventricle"] - 1.5,
        "right ventricle": blood.right["right ventricle"],
        "left atrium": blood.left["left atrium"],
        "right atrium": blood.right["right atrium"],
        "aorta": blood.left["aorta"],
        "pulmonary artery": blood.right["pulmonary artery"],
        "veins": blood.veins - 0.4,
    }
    labels = {name: label for label, name in REGIONS.items()}
    names = list(depth)
    nearest = np.argmin(np.stack([depth[name] for name in names]), axis=0)
    region = np.array([labels[name] for name in names], dtype=np.int32)[nearest]
    between_ventricles = (blood.left["left ventricle"] < SEPTUM + 1.0) & (
        blood.right["right ventricle"] < SEPTUM + 1.0
    )
    between_atria = (blood.left["left atrium"] < BETWEEN_POOLS + 1.2) & (
        blood.right["right atrium"] < BETWEEN_POOLS + 1.2
    )
    ventricular = (region == labels["left ventricle"]) | (region == labels["right ventricle"])
    atrial = (region == labels["left atrium"]) | (region == labels["right atrium"])
    region[between_ventricles & ventricular] = labels["ventricular septum"]
    region[between_atria & atrial] = labels["atrial septum"]
    return region


def _node_sets(
    points: NDArray[np.float64], tetrahedra: NDArray[np.int64], regions: NDArray[np.int32]
) -> dict[str, NDArray[np.int64]]:
    """Name the nodes by which the chest holds the heart."""
    place = points / MILLIMETRE
    sets = {}
    for vessel in VESSELS:
        near_plane = half_space(place, vessel.end, vessel.end_direction) > -_RIM_DEPTH
        reach = vessel.line[-1, 3] + vessel.wall + 1.0
        end = vessel.line[-2:, :3]
        sets[f"{vessel.name} rim"] = np.flatnonzero(near_plane & (tube(place, end, reach) < 0.0))
    atrial = np.zeros(len(points), dtype=bool)
    atrial[tetrahedra[regions == 3]] = True
    sets["dorsal attachment"] = np.flatnonzero(atrial & (place[:, 0] < _DORSAL_PLANE))
    fixed = np.unique(np.concatenate(list(sets.values())))
    return {"fixed": fixed, **sets}
