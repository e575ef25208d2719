"""Voxels over a mesh: they give as ChainMail does, carry nodes, and come apart where it is cut."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from support.elastic_scenes import (
    MATERIAL,
    NO_ROWS,
    apply,
    block_mesh,
    build,
    double,
    hold,
    release,
    split_edit,
    steps,
    top_ball,
)
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.voxel_chain_mail import LinkLimits, VoxelChainMail
from tissue_sim.elastic.voxel_lattice import VoxelLattice
from tissue_sim.elastic.voxel_mail import VoxelMail
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import block

SIZE, NODES = 0.06, 7
STEP = SIZE / (NODES - 1)
CROOKED = 0.0073
"""Spacing with no plane of the mesh in a plane of the grid."""


def voxel_mail(mesh: Mesh, **values: float) -> tuple[VoxelMail, State]:
    springs, state = double(mesh)
    model, _ = build("voxel_chain_mail", mesh, springs, state, **values)
    assert isinstance(model, VoxelMail)
    return model, state


def links(lattice: VoxelLattice) -> NDArray[np.int64]:
    """Ends of all links, both ways, shape (n, 2)."""
    ends = [
        (row, int(other))
        for row in range(lattice.rows)
        for other in lattice.neighbour[row, : lattice.degree[row]]
    ]
    return np.array(ends)


def parts(lattice: VoxelLattice) -> int:
    """Parts of the lattice that no link joins."""
    ends, living = links(lattice), lattice.place[: lattice.rows, 0] >= 0
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(lattice.rows, lattice.rows))
    return connected_components(graph)[0] - int((~living).sum())


def most_beyond(model: VoxelMail, share: float = 0.3) -> float:
    """How far the worst link between voxels that are not prescribed is beyond its limits [m]."""
    ends = links(model.lattice)
    ends = ends[~model._prescribed[ends].any(axis=1)]
    w = model.displacement[ends[:, 1]] - model.displacement[ends[:, 0]]
    return float((np.abs(w) - share * model.lattice.spacing).max())


def test_on_a_mesh_that_is_the_grid_it_is_chain_mail_on_a_grid() -> None:
    model, state = voxel_mail(block_mesh(NODES), spacing=STEP, relaxations=0)
    assert model.lattice.rows == NODES**3
    limits = LinkLimits((0.7 * STEP,) * 3, (1.3 * STEP,) * 3, (0.3 * STEP,) * 3)
    fixed = np.zeros((NODES,) * 3, dtype=np.bool_)
    fixed[:, :, 0] = True
    grid = VoxelChainMail((NODES,) * 3, (STEP,) * 3, limits, fixed, np.float64)
    places = np.rint(model.mesh.rest[: NODES**3] / STEP).astype(int)
    rows = grid.rows(places)
    random = np.random.default_rng(2)
    for place in ((3, 3, 6), (0, 6, 4), (5, 1, 2)):
        held = hold(model, state, np.flatnonzero((places == place).all(axis=1)), model.mesh)
        for pull in random.uniform(-0.0055, 0.0055, (3, 3)):
            state.displacement[held] = pull
            model.step(state)
            grid.move(place, pull)
            np.testing.assert_allclose(
                state.displacement[: NODES**3], grid.displacement[rows], atol=1e-12
            )
        release(model, state, model.mesh)
        model.step(state)
        grid.release()
    assert np.abs(grid.displacement).max() > 0.002


def test_links_keep_their_limits_and_held_nodes_go_where_they_are_put() -> None:
    mesh = block_mesh(NODES)
    model, state = voxel_mail(mesh, spacing=CROOKED)
    held = hold(model, state, top_ball(mesh), mesh)
    random = np.random.default_rng(3)
    for pull in random.normal(0, 0.004, (6, 3)):
        wanted = np.tile(pull, (len(held), 1))
        state.displacement[held] = wanted
        model.step(state)
        assert most_beyond(model) < 1e-12
        np.testing.assert_array_equal(state.displacement[held], wanted)
        assert not state.displacement[mesh.fixed].any()
    release(model, state, mesh)
    steps(model, state, 400)
    assert model.idle
    assert np.abs(state.displacement).max() < 2e-6


@pytest.mark.parametrize("cut", [False, True])
def test_voxels_carry_a_linear_motion_to_all_nodes(cut: bool) -> None:
    mesh = block_mesh(NODES, fixed=False)
    model, state = voxel_mail(mesh, spacing=CROOKED)
    if cut:
        apply(mesh, model, state, split_edit(mesh, 0.03, above=0.02))
    lattice = model.lattice
    L = np.array([[0.1, -0.2, 0.05], [0.0, 0.3, 0.1], [-0.1, 0.02, 0.2]])
    at = lattice.origin + lattice.place[: lattice.rows] * lattice.spacing
    model.displacement[: lattice.rows] = at @ L.T
    rows = mesh.node_rows
    carried = model.displacement[lattice.corner[:rows]] * lattice.weight[:rows, :, None]
    np.testing.assert_allclose(carried.sum(axis=1), mesh.rest[:rows] @ L.T, atol=1e-12)


@pytest.mark.parametrize("spacing", [STEP, CROOKED, 0.021])
def test_nothing_passes_a_cut(spacing: float) -> None:
    mesh = block_mesh(NODES, fixed=False)
    model, state = voxel_mail(mesh, spacing=spacing)
    assert parts(model.lattice) == 1
    apply(mesh, model, state, split_edit(mesh, 0.03, above=0.02))
    assert parts(model.lattice) == 1
    mesh = block_mesh(NODES, fixed=False)
    model, state = voxel_mail(mesh, spacing=spacing)
    apply(mesh, model, state, split_edit(mesh, 0.03))
    assert parts(model.lattice) == 2
    beyond = mesh.rest[mesh.tets[: mesh.element_rows]][:, :, 0].mean(axis=1) > 0.03
    side = np.unique(mesh.tets[: mesh.element_rows][beyond])
    held = hold(model, state, side[mesh.rest[side, 2] > 0.055], mesh)
    for frame in range(1, 20):
        state.displacement[held] = [0.002 * frame, 0.0, 0.001 * frame]
        model.step(state)
    other = np.setdiff1d(np.arange(mesh.node_rows), side)
    assert not state.displacement[other].any()
    assert np.linalg.norm(state.displacement[side], axis=1).min() > 0.02


def test_parts_closer_than_the_spacing_do_not_hold_each_other() -> None:
    plate = block(7, 7, 2, SIZE, SIZE, 0.004)
    raised = plate.points + np.array([0, 0, 0.005])
    raw = RawMesh(
        np.concatenate([plate.points, raised]),
        np.concatenate([plate.tetrahedra, plate.tetrahedra + len(raised)]),
    )
    mesh = Mesh(raw)
    model, state = voxel_mail(mesh, spacing=0.012)
    assert parts(model.lattice) == 2
    held = hold(model, state, [len(raised) + 10], mesh)
    state.displacement[held] = [0, 0, 0.02]
    steps(model, state, 50)
    assert state.displacement[len(raised) : 2 * len(raised)].any(axis=1).all()
    assert not state.displacement[: len(raised)].any()


def test_voxels_that_followed_edits_are_those_of_a_lattice_made_afresh() -> None:
    mesh = block_mesh(NODES)
    model, state = voxel_mail(mesh, spacing=CROOKED)
    apply(mesh, model, state, split_edit(mesh, 0.02, above=0.02))
    apply(mesh, model, state, shifted(mesh))
    apply(mesh, model, state, split_edit(mesh, 0.04))
    apply(
        mesh, model, state,
        TopologyEdit(mesh.version, removed_elements=np.arange(300, 420, dtype=np.uint32)),
    )  # fmt: skip
    old = model.lattice
    fresh, _ = voxel_mail(mesh, spacing=CROOKED)
    new = fresh.lattice
    # Grids may start elsewhere only if the organ's ends moved; these edits keep them.
    living = np.flatnonzero(mesh.node_alive[: mesh.node_rows])
    np.testing.assert_array_equal(old.weight[living], new.weight[living])
    partner = np.full(old.rows, -1)
    alive = np.flatnonzero(mesh.element_alive[: mesh.element_rows])
    for e in alive:
        count = int(old._boxes.extent[e].prod())
        assert count == new._boxes.extent[e].prod()
        ours = old._slots.voxel[old._boxes.start[e] :][:count]
        theirs = new._slots.voxel[new._boxes.start[e] :][:count]
        assert np.isin(partner[ours], [-1]).sum() + (partner[ours] == theirs).sum() == count
        partner[ours] = theirs
    known = partner >= 0
    np.testing.assert_array_equal(known, old.place[: old.rows, 0] >= 0)
    assert len(np.unique(partner[known])) == known.sum() == (new.place[: new.rows, 0] >= 0).sum()
    renamed = {(int(partner[a]), int(partner[b])) for a, b in links(old)}
    assert renamed == {(int(a), int(b)) for a, b in links(new)}
    np.testing.assert_array_equal(partner[old.corner[living]], new.corner[living])


def shifted(mesh: Mesh) -> TopologyEdit:
    """Move the rest position of a few inner nodes, as snapping does."""
    nodes = np.flatnonzero(~mesh.fixed[: mesh.node_rows])[100:110]
    elements = [int(mesh.incident.of(int(node))[0]) for node in nodes]
    anchors = mesh.tets[elements]
    weights = np.where(anchors == nodes[:, None], 0.85, 0.05)
    return TopologyEdit(
        mesh.version,
        moved_nodes=nodes.astype(np.uint32),
        moved_rest=np.einsum("ij,ijk->ik", weights, mesh.rest[anchors]),
        moved_anchors=anchors.astype(np.uint32),
        moved_weights=weights,
    )


def test_it_takes_over_a_smooth_shape_to_within_a_share_of_the_spacing() -> None:
    mesh = block_mesh(NODES)
    springs, state = double(mesh)
    rest = mesh.rest[: mesh.node_rows]
    bend = 0.01 * (rest[:, 2] / SIZE) ** 2
    state.displacement[: mesh.node_rows, 0] = bend
    model = registry.build("voxel_chain_mail", mesh, MATERIAL, {"relaxations": 0}, springs)
    model.prescribed_changed(state, NO_ROWS)
    model.step(state)
    assert np.abs(state.displacement[: mesh.node_rows, 0] - bend).max() < 0.0015


def test_the_spacing_has_a_default_and_limits() -> None:
    mesh = block_mesh(5)
    springs = SpringNetwork(mesh, MATERIAL)
    model = registry.build("voxel_chain_mail", mesh, MATERIAL, springs=springs)
    assert isinstance(model, VoxelMail)
    table = springs.springs
    mean = table.length[: springs.rows][table.alive[: springs.rows]].mean()
    assert model.lattice.spacing == pytest.approx(mean)
    with pytest.raises(
        ValueError, match=r"spacing = 1e-06 m makes .* points, .*; allowed: 0, 0.00"
    ):
        registry.build("voxel_chain_mail", mesh, MATERIAL, {"spacing": 1e-6})
    with pytest.raises(ValueError, match=r"spacing = -1 is out of range; allowed: 0 to 0.1 m"):
        registry.build("voxel_chain_mail", mesh, MATERIAL, {"spacing": -1.0})
