"""The generated heart: reproducible, sound for simulation and cutting, and right inside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from support.blood_pools import VOXEL, VoxelHeart
from support.tet_topology import (
    boundary,
    component_count,
    dihedral_angles,
    euler_characteristic,
    is_cut_regular,
    is_manifold,
)
from tissue_sim.geometry.heart import (
    CELL,
    REGIONS,
    expected_nodes,
    heart,
    heart_mesh,
    load_heart,
    save_heart,
)
from tissue_sim.geometry.heart_anatomy import LEFT_VENTRICLE_CENTRE, VESSELS, Vessel
from tissue_sim.geometry.quality import radius_ratios, signed_volumes
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.renumber import neighbour_distance
from tissue_sim.geometry.scene_geometry import announcement, load

CHAMBERS = {
    "left ventricle": LEFT_VENTRICLE_CENTRE,
    "right ventricle": np.array([13.0, -3.0, -8.0]),
    "left atrium": np.array([-11.0, 8.0, 12.0]),
    "right atrium": np.array([-4.0, -13.0, 10.0]),
    "aorta": np.array([2.5, -4.5, 14.0]),
    "pulmonary artery": np.array([11.5, 4.0, 15.0]),
}
"""A place in the blood of each [mm]."""
LEFT = ("left ventricle", "left atrium", "aorta")
RIGHT = ("right ventricle", "right atrium", "pulmonary artery")


@pytest.fixture(scope="module")
def mesh() -> RawMesh:
    return load_heart()


@pytest.fixture(scope="module")
def intact() -> VoxelHeart:
    return VoxelHeart(heart_mesh(asd_radius=0.0, vsd_radius=0.0))


def test_the_generator_reproduces_the_committed_file_exactly(mesh: RawMesh) -> None:
    made = heart_mesh()
    assert np.array_equal(made.points, mesh.points)
    assert np.array_equal(made.tetrahedra, mesh.tetrahedra)
    assert np.array_equal(made.regions, mesh.regions)
    assert made.source == mesh.source
    assert made.node_sets.keys() == mesh.node_sets.keys()
    for name, rows in made.node_sets.items():
        assert np.array_equal(rows, mesh.node_sets[name])


def test_saving_loses_nothing(mesh: RawMesh, tmp_path: Path) -> None:
    save_heart(mesh, tmp_path / "heart.npz")
    with np.load(tmp_path / "heart.npz", allow_pickle=False) as data:
        assert np.array_equal(data["points_nm"] / 1e9, mesh.points)
        assert np.array_equal(data["tetrahedra"], mesh.tetrahedra)


def test_size_is_that_of_the_thesis_and_of_an_infant(mesh: RawMesh) -> None:
    assert 33_000 < len(mesh.points) < 38_000
    extent = np.ptp(mesh.points, axis=0)
    assert extent == pytest.approx([0.0465, 0.0526, 0.0721], abs=1e-3)
    tissue = signed_volumes(mesh.points, mesh.tetrahedra).sum()
    assert tissue == pytest.approx(30.5e-6, rel=0.05)


def test_elements_are_good(mesh: RawMesh) -> None:
    assert signed_volumes(mesh.points, mesh.tetrahedra).min() > 0.0
    assert radius_ratios(mesh.points, mesh.tetrahedra).min() > 0.1
    angles = dihedral_angles(mesh.points, mesh.tetrahedra)
    assert angles.min() > 10.7
    assert angles.max() < 164.8


def test_mesh_is_cut_regular_manifold_and_in_one_piece(mesh: RawMesh) -> None:
    assert component_count(mesh.tetrahedra) == 1
    assert is_cut_regular(mesh.tetrahedra)
    assert is_manifold(boundary(mesh.tetrahedra))


def test_surface_has_exactly_the_handles_of_the_anatomy(mesh: RawMesh) -> None:
    """A pool with n open vessels makes n - 1 handles, each septal defect one more."""
    left = sum(vessel.side == "left" for vessel in VESSELS)
    right = sum(vessel.side == "right" for vessel in VESSELS)
    handles = (left - 1) + (right - 1) + 2
    assert euler_characteristic(boundary(mesh.tetrahedra)) == 2 - 2 * handles


def test_without_defects_left_and_right_blood_never_meet(intact: VoxelHeart) -> None:
    pools = intact.pools()
    left = {pools.at(CHAMBERS[name]) for name in LEFT}
    right = {pools.at(CHAMBERS[name]) for name in RIGHT}
    assert len(left) == len(right) == 1
    assert len({0, pools.outside} | left | right) == 4


def test_without_defects_there_is_no_other_hollow(intact: VoxelHeart) -> None:
    volumes = np.bincount(intact.pools().labels.ravel())[1:] * VOXEL**3
    assert np.sum(volumes > 1.0) == 3  # left, right, outside
    assert 8e3 < np.sort(volumes)[-3] < np.sort(volumes)[-2] < 16e3


@pytest.mark.parametrize("vessel", VESSELS, ids=lambda vessel: vessel.name)
def test_each_vessel_opens_its_own_pool_only(vessel: Vessel, intact: VoxelHeart) -> None:
    pools = intact.pools(unplugged=(vessel.name,))
    own, other = (LEFT, RIGHT) if vessel.side == "left" else (RIGHT, LEFT)
    assert {pools.at(CHAMBERS[name]) for name in own} == {pools.outside}
    assert pools.outside not in {pools.at(CHAMBERS[name]) for name in other}


@pytest.mark.parametrize(
    ("asd_radius", "vsd_radius"), [(3.0e-3, 0.0), (0.0, 2.6e-3), (3.0e-3, 2.6e-3)]
)
def test_any_septal_defect_joins_left_and_right_blood(asd_radius: float, vsd_radius: float) -> None:
    pools = VoxelHeart(heart(asd_radius=asd_radius, vsd_radius=vsd_radius)).pools()
    joined = {pools.at(place) for place in CHAMBERS.values()}
    assert len(joined) == 1
    assert joined.isdisjoint({0, pools.outside})


def test_every_region_is_there_and_where_it_belongs(mesh: RawMesh) -> None:
    assert mesh.region_names == REGIONS
    counts = np.bincount(mesh.regions, minlength=len(REGIONS))
    assert counts.min() > 1000
    assert len(mesh.regions) == len(mesh.tetrahedra)
    centroids = mesh.points[mesh.tetrahedra].mean(axis=1)
    middle = {
        name: centroids[mesh.regions == label].mean(axis=0) for label, name in REGIONS.items()
    }
    assert middle["left ventricle"][1] > middle["ventricular septum"][1]
    assert middle["ventricular septum"][1] > middle["right ventricle"][1]
    assert middle["left atrium"][1] > middle["atrial septum"][1] > middle["right atrium"][1]
    assert middle["right ventricle"][0] > middle["left ventricle"][0] > middle["left atrium"][0]
    assert middle["aorta"][2] > middle["left atrium"][2] > middle["left ventricle"][2]


def test_fixed_nodes_hold_the_heart_at_its_vessels_and_its_back(mesh: RawMesh) -> None:
    sets = mesh.node_sets
    parts = [rows for name, rows in sets.items() if name != "fixed"]
    assert np.array_equal(sets["fixed"], np.unique(np.concatenate(parts)))
    assert len(sets["fixed"]) < 0.1 * len(mesh.points)
    for vessel in VESSELS:
        rim = mesh.points[sets[f"{vessel.name} rim"]] * 1e3
        assert len(rim) > 50
        assert np.linalg.norm(rim.mean(axis=0) - vessel.end, axis=-1) < 2.0
    assert mesh.points[sets["dorsal attachment"], 0].max() < -0.017


def test_a_coarser_heart_has_fewer_nodes() -> None:
    coarse = heart(cell=2.0e-3)
    assert len(coarse.points) < 0.6 * len(load_heart().points)
    assert signed_volumes(coarse.points, coarse.tetrahedra).min() > 0.0
    assert is_manifold(boundary(coarse.tetrahedra))


def test_the_cell_of_a_scenes_heart_is_checked_and_the_mesh_ready_to_simulate() -> None:
    geometry = load("heart", parameters={"cell": 1.8e-3})
    assert geometry.mesh.node_rows == pytest.approx(expected_nodes(1.8e-3), rel=0.05)
    assert not geometry.report.mended
    assert not geometry.report.warnings
    tets = geometry.raw.tetrahedra
    assert is_cut_regular(tets)
    assert (np.diff(tets.min(axis=1)) >= 0).all()
    assert neighbour_distance(tets) < 0.05 * geometry.mesh.node_rows
    with pytest.raises(ValueError, match=r"cell is 0\.0003 m, it must be from 0\.0004 m \(about 1"):
        load("heart", parameters={"cell": 0.3e-3})
    with pytest.raises(ValueError, match="for filling a surface file, heart is a generated shape"):
        load("heart", cell=1.8e-3)


def test_what_a_fine_heart_costs_is_said_before_it_is_made() -> None:
    assert len(load_heart().points) == pytest.approx(expected_nodes(CELL), rel=0.02)
    assert announcement("heart") == announcement("wall", {"rows": 5}) == ""
    assert announcement("heart", {"cell": CELL}) == announcement("heart", {"cell": 0.1e-3}) == ""
    assert "0.6 mm cells has about 360,000 nodes" in announcement("heart", {"cell": 0.6e-3})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"cell": 0.0}, "cell"),
        ({"cell": 0.01}, "cell"),
        ({"asd_radius": -1e-3}, "asd_radius"),
        ({"vsd_radius": 0.02}, "vsd_radius"),
        ({"cell": float("nan")}, "cell"),
    ],
)
def test_sizes_out_of_range_are_refused(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        heart(**({"cell": CELL} | arguments))
