"""The three ways of cutting tetrahedra: what each promises, and that all leave valid meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cut_service.crossings import EDGE_BETWEEN, PARTED
from cut_service.errors import CutCode, CutError
from cut_service.planner import METHODS, Plan, Settings, plan
from cut_service.sweep import Sweep
from cut_service.sweep_kernels import EDGES
from support.cut_scenes import SIDE, bent, heart, middle, new, quality, raw_organ, rest, square
from support.valid_mesh import check_valid
from tissue_sim.elastic.model import State
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh

ORGANS = ("block", "shaken", "wall", "shell")
NO_SNAP = Settings(snap=False)


class Organ:
    """A mesh with a shape that cuts carry along."""

    def __init__(self, mesh: Mesh, deformed: bool = False) -> None:
        self.mesh, self.state = mesh, State(mesh, np.float64)
        if deformed:
            rows = mesh.node_rows
            self.state.displacement[:rows] = 0.3 * (bent(rest(mesh)) - rest(mesh))
            self.state.previous[:rows] = 0.2 * (bent(rest(mesh)) - rest(mesh))
        self.shape = check_valid(mesh)
        self.was_fine = self.volumes().min() > 0

    @property
    def places(self) -> NDArray[np.float64]:
        return np.asarray(self.state.positions(self.mesh), dtype=np.float64)

    def volumes(self) -> NDArray[np.float64]:
        """Of the elements as they are deformed."""
        rows = self.mesh.element_rows
        tets = self.mesh.tets[:rows][self.mesh.element_alive[:rows]]
        a, b, c, d = (self.places[tets[:, k]] for k in range(4))
        return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0

    def cut(self, sweep: Sweep, method: str, how: Settings | None = None) -> Plan | None:
        """Cut, and check all that every cut owes; None: the sweep meets nothing."""
        try:
            planned = plan(self.mesh, self.places, sweep, method, settings=how)
        except CutError as error:
            if not error.code.nothing_to_cut:
                raise
            return None
        before, report = self.shape, planned.report
        self.state.follow(self.mesh, self.mesh.apply(planned.edit))
        self.shape = check_valid(self.mesh)
        assert self.shape.components == report.components
        change = self.shape.volume - before.volume
        assert change == pytest.approx(report.volume_change, abs=1e-9 * before.volume)
        if method == "subdivide":
            assert abs(change) < 1e-9 * before.volume
        elif method == "remove":
            assert change < 0
        if self.was_fine:
            assert self.volumes().min() > 0
        return planned


def cut_many(seed: int, name: str, methods: tuple[str, ...], cuts: int) -> Organ:
    """Cut an organ, deformed or not, at random, with sweeps from scratches to right through."""
    random = np.random.default_rng(seed)
    organ = Organ(new(name), bool(random.integers(2)))
    size = np.ptp(rest(organ.mesh), axis=0).max()
    for _ in range(cuts):
        living = np.flatnonzero(organ.mesh.node_alive[: organ.mesh.node_rows])
        centre = organ.places[random.choice(living)]
        half = random.choice([0.05, 0.2, 0.5, 3.0]) * size
        sweep = square(centre, random.normal(size=3), half, random.uniform(0, 6))
        how = Settings(snap=bool(random.integers(2)))
        organ.cut(sweep, methods[random.integers(len(methods))], how)
    return organ


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(ORGANS))
def test_dividing_again_and_again_leaves_a_valid_mesh(seed: int, name: str) -> None:
    cut_many(seed, name, ("subdivide",), 5)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(ORGANS))
def test_removing_leaves_a_valid_mesh_as_good_as_it_was(seed: int, name: str) -> None:
    organ = cut_many(seed, name, ("remove",), 3)
    assert quality(organ.mesh).min() >= quality(new(name)).min()


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(ORGANS))
def test_cuts_of_any_kind_across_others_leave_a_valid_mesh(seed: int, name: str) -> None:
    cut_many(seed, name, METHODS, 6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(ORGANS))
def test_wavy_sweeps_that_cross_themselves_leave_a_valid_mesh(seed: int, name: str) -> None:
    random = np.random.default_rng(seed)
    organ = Organ(new(name), bool(random.integers(2)))
    size = np.ptp(organ.places, axis=0).max()
    for _ in range(3):
        blade = np.linspace(-1, 1, 4)[:, None] * random.normal(size=3) * size
        step, bend = random.normal(size=(2, 3)) * size * np.array([[0.15], [0.1]])
        poses = [
            organ.places.mean(axis=0) + random.choice([0.1, 0.4, 1.0]) * blade
            + (k - 2.5) * step + np.sin(1.3 * k) * bend + 0.02 * size * random.normal(size=(4, 3))
            for k in range(6)
        ]  # fmt: skip
        first = np.array([4 * k + i for k in range(5) for i in range(3)])[:, None]
        triangles = np.concatenate([first + np.array(corner) for corner in ([0, 1, 4], [1, 5, 4])])
        sweep = Sweep.from_arrays(np.concatenate(poses), triangles)
        method = METHODS[random.integers(len(METHODS))]
        organ.cut(sweep, method, Settings(bool(random.integers(2))))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(ORGANS))
def test_a_plane_right_through_leaves_nothing_on_both_of_its_sides(seed: int, name: str) -> None:
    random = np.random.default_rng(seed)
    organ = Organ(new(name))
    normal = random.normal(size=3)
    normal /= np.linalg.norm(normal)
    centre = middle(organ.mesh) + random.uniform(-0.2, 0.2, 3) * np.ptp(rest(organ.mesh), axis=0)
    # Without `smallest_piece` even a crumb is cut free.
    how = Settings(snap=bool(random.integers(2)), smallest_piece=1)
    if organ.cut(square(centre, normal, 1.0), "subdivide", how) is None:
        return
    mesh = organ.mesh
    tets = mesh.tets[: mesh.element_rows]
    alive = mesh.element_alive[: mesh.element_rows]
    height = (rest(mesh) - centre) @ normal
    edges = rest(new(name))[new(name).tets[: new(name).element_rows][:, EDGES]]
    longest = np.linalg.norm(edges[:, :, 1] - edges[:, :, 0], axis=-1).max()
    slack = Settings().vertex_share * longest
    _, part = connected_components(tets, alive, mesh.node_rows)
    for k in range(organ.shape.components):
        own = height[part == k]
        assert own.min() > -slack or own.max() < slack
    assert organ.shape.components >= 2


@pytest.mark.parametrize("name", ["block", "shaken", "wall"])
@pytest.mark.parametrize("method", METHODS)
def test_a_cut_that_separates_an_organ_leaves_two_parts(name: str, method: str) -> None:
    organ = Organ(new(name))
    planned = organ.cut(square(middle(organ.mesh), np.array([1.0, 0.2, 0.1]), 1.0), method)
    assert planned is not None
    assert planned.report.method == planned.edit.kind == method
    assert organ.shape.components == 2


def test_the_cut_lies_on_the_sweep_but_for_old_nodes_close_to_it() -> None:
    organ = Organ(new("shaken"), deformed=True)
    sweep = square(organ.places.mean(axis=0), np.array([1.0, 0.4, 0.2]), 1.0)
    exact = plan(organ.mesh, organ.places, sweep, "subdivide", settings=Settings(vertex_share=0.0))
    made = exact.edit.moved_nodes >= 1 << 31
    anchors = organ.mesh.node_rows_of(exact.edit.moved_anchors)
    places = np.einsum("ij,ijk->ik", exact.edit.moved_weights, organ.places[anchors])
    assert made.sum() > 100
    assert sweep.distance(places[made]).max() < 1e-12
    # Their rest positions are the same points of the tissue.
    back = np.einsum("ij,ijk->ik", exact.edit.moved_weights, rest(organ.mesh)[anchors])
    np.testing.assert_allclose(back[made], exact.edit.moved_rest[made], atol=1e-15)

    edge = SIDE / 7 * np.sqrt(3) * 1.6
    apart = plan(organ.mesh, organ.places, sweep, "subdivide", settings=NO_SNAP).report
    snapped = plan(organ.mesh, organ.places, sweep, "subdivide").report
    assert apart.distance_after[1] < Settings().vertex_share * edge
    assert snapped.distance_before == apart.distance_after
    assert snapped.distance_after[0] < 0.1 * snapped.distance_before[0]
    assert snapped.faces_split == apart.faces_split
    split = plan(organ.mesh, organ.places, sweep).report
    assert snapped.distance_after[0] < split.distance_after[0]


def test_a_partial_cut_keeps_a_rim_and_covers_the_sweep() -> None:
    organ = Organ(new("shaken"))
    before, element = organ.shape, SIDE / 6
    centre = middle(organ.mesh) + np.array([0.4 * element, 0, 0])
    centre[2] = rest(organ.mesh)[:, 2].max()
    sweep = square(centre, np.eye(3)[0], 0.6 * SIDE, 0.0)
    planned = organ.cut(sweep, "subdivide")
    assert planned is not None
    assert organ.shape.components == 1
    grown = organ.shape.surface_triangles - before.surface_triangles
    assert grown > 2 * planned.report.faces_split  # some triangles of the surface are divided
    # The sweep in the tissue is covered but for an element's width along its own border.
    lips = Sweep.from_arrays(planned.lips, np.arange(3 * len(planned.lips)))
    first = sweep.vertices[0]
    across, along = sweep.vertices[1] - first, sweep.vertices[3] - first
    grid = np.linspace(0, 1, 41)[1:-1]
    u, v = (share.reshape(-1, 1) for share in np.meshgrid(grid, grid))
    samples = first + u * across + v * along
    lower, upper = rest(organ.mesh).min(axis=0), rest(organ.mesh).max(axis=0)
    samples = samples[((samples > lower) & (samples < upper)).all(axis=1)]
    gaps = lips.distance(samples)
    assert gaps.max() < 1.5 * element
    assert (gaps < 0.05 * element).mean() > 0.6


def test_a_bent_sweep_is_followed_and_its_fold_is_not_passed_twice() -> None:
    organ = Organ(new("shaken"))
    x = middle(organ.mesh)
    blade = np.array([[-1.0, -1.0, 0.0], [-1.0, 1.0, 0.0]]) * SIDE
    path = [[-0.8, 0, 0.25], [0.0, 0, -0.2], [0.8, 0, 0.3]]
    poses = [x + blade * [0, 1, 1] + np.array(step) * SIDE for step in path]
    corners = np.concatenate(poses)
    sweep = Sweep.from_arrays(corners, [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]])
    planned = organ.cut(sweep, "subdivide")
    assert planned is not None
    assert organ.shape.components == 2
    assert planned.report.distance_after[0] < 0.01 * SIDE


def test_triangles_of_a_sweep_may_face_either_way() -> None:
    organ = Organ(new("shaken"))
    sweep = square(middle(organ.mesh), np.array([1.0, 0.3, 0.2]), 1.0)
    turned = Sweep.from_arrays(sweep.vertices, [[0, 1, 2], [0, 3, 2]])
    one = plan(organ.mesh, organ.places, sweep, "subdivide").report
    two = plan(organ.mesh, organ.places, turned, "subdivide").report
    assert (one.faces_split, one.nodes_added) == (two.faces_split, two.nodes_added)


def test_new_nodes_and_elements_take_after_their_parents() -> None:
    raw = raw_organ("shaken")
    lower = raw.points[:, 2] < raw.points[:, 2].min() + 0.4 * SIDE
    organ = Organ(new("shaken", lower))
    mesh = organ.mesh
    mesh.regions[: mesh.element_rows] = np.arange(mesh.element_rows) % 7
    mesh.fibres[: mesh.element_rows] = np.random.default_rng(2).normal(size=(mesh.element_rows, 3))
    sweep = square(middle(mesh), np.array([1.0, 0.3, 0.2]), 1.0)
    planned = plan(mesh, organ.places, sweep, "subdivide")
    anchors = mesh.node_rows_of(planned.edit.moved_anchors)
    weights = planned.edit.moved_weights
    change = mesh.apply(planned.edit)
    organ.state.follow(mesh, change)
    made = np.isin(change.moved_nodes, change.copied_nodes)
    between = (mesh.fixed[anchors] | (weights == 0.0)).all(axis=1)
    np.testing.assert_array_equal(mesh.fixed[change.moved_nodes[made]], between[made])
    assert between[made].any()
    assert not between[made].all()
    assert not mesh.fixed[change.moved_nodes[~made]].any()
    born = mesh.element_rows_of(change.edit.added_elements)
    of = change.edit.added_parents.astype(int)
    np.testing.assert_array_equal(mesh.regions[born], mesh.regions[of])
    np.testing.assert_array_equal(mesh.fibres[born], mesh.fibres[of])
    assert np.array_equal(organ.state.prescribed[: mesh.node_rows], mesh.fixed[: mesh.node_rows])


def test_displacement_and_velocity_of_new_nodes_lie_between_those_of_the_edge() -> None:
    organ = Organ(new("shaken"), deformed=True)
    mesh, state = organ.mesh, organ.state
    old = {name: getattr(state, name).copy() for name in ("displacement", "previous")}
    sweep = square(organ.places.mean(axis=0), np.array([1.0, 0.3, 0.2]), 1.0)
    edit = plan(mesh, organ.places, sweep, "subdivide").edit
    anchors = mesh.node_rows_of(edit.moved_anchors)
    change = mesh.apply(edit)
    state.follow(mesh, change)
    made = np.isin(change.moved_nodes, change.copied_nodes)
    for name, before in old.items():
        wanted = np.einsum("ij,ijk->ik", edit.moved_weights, before[anchors])
        now = getattr(state, name)[change.moved_nodes]
        np.testing.assert_allclose(now[made], wanted[made], atol=1e-15)


def test_removing_reports_what_is_lost_and_refuses_to_remove_everything() -> None:
    organ = Organ(new("block"))
    before = organ.shape.volume
    planned = organ.cut(square(middle(organ.mesh), np.array([1.0, 0.2, 0.1]), 1.0), "remove")
    assert planned is not None
    assert planned.report.volume_change == pytest.approx(organ.shape.volume - before, rel=1e-9)
    assert planned.report.elements_removed == len(planned.edit.removed_elements)
    lower, upper = rest(organ.mesh).min(axis=0), rest(organ.mesh).max(axis=0)
    corners: list[list[float]] = []
    triangles: list[list[int]] = []
    for z in np.linspace(lower[2], upper[2], 25):
        k = len(corners)
        corners += [[-1, -1, z], [1, -1, z], [1, 1, z], [-1, 1, z]]
        triangles += [[k, k + 1, k + 2], [k, k + 2, k + 3]]
    with pytest.raises(CutError, match="would leave no tissue") as caught:
        plan(organ.mesh, organ.places, Sweep.from_arrays(corners, triangles), "remove")
    assert caught.value.code == CutCode.REFUSED


@pytest.mark.parametrize("method", METHODS)
def test_a_sweep_beside_the_organ_misses(method: str) -> None:
    mesh = new("block")
    sweep = square(middle(mesh) + np.array([3 * SIDE, 0, 0]), np.eye(3)[0], 1.0)
    with pytest.raises(CutError, match="crosses no tissue") as caught:
        plan(mesh, rest(mesh), sweep, method)
    assert caught.value.code == CutCode.MISSED


def test_a_sweep_along_the_surface_or_inside_one_element_divides_nothing() -> None:
    mesh = new("block")
    top = middle(mesh)
    top[2] = rest(mesh)[:, 2].max()
    inside = rest(mesh)[mesh.tets[100]].mean(axis=0)
    for sweep in (square(top, np.eye(3)[2], 1.0), square(inside, np.ones(3), 1e-3 * SIDE)):
        with pytest.raises(CutError) as caught:
            plan(mesh, rest(mesh), sweep, "subdivide")
        assert caught.value.code == CutCode.MISSED


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(ORGANS))
def test_cuts_of_any_kind_can_be_undone_and_made_again(seed: int, name: str) -> None:
    random = np.random.default_rng(seed)
    mesh, history = new(name), EditHistory()
    size = np.ptp(rest(mesh), axis=0).max()
    seen = [remembered(mesh)]
    for _ in range(4):
        living = np.flatnonzero(mesh.node_alive[: mesh.node_rows])
        centre = rest(mesh)[random.choice(living)]
        sweep = square(centre, random.normal(size=3), random.choice([0.2, 0.5]) * size)
        try:
            planned = plan(mesh, rest(mesh), sweep, METHODS[random.integers(len(METHODS))])
        except CutError:
            continue
        history.record(mesh.apply(planned.edit))
        seen.append(remembered(mesh))
    for wanted in seen[-2::-1]:
        history.record(mesh.apply(history.undo(mesh)))
        assert remembered(mesh) == wanted
    check_valid(mesh)
    for wanted in seen[1:]:
        history.record(mesh.apply(history.redo(mesh)))
        assert remembered(mesh) == wanted
    check_valid(mesh)


def remembered(mesh: Mesh) -> list[bytes]:
    """All that lives in a mesh, bit for bit."""
    nodes = np.flatnonzero(mesh.node_alive)
    elements = np.flatnonzero(mesh.element_alive)
    arrays = [nodes, mesh.rest[nodes], mesh.fixed[nodes], elements, mesh.tets[elements]]
    arrays += [mesh.incident.of(int(node)) for node in nodes[::7]]
    return [array.tobytes() for array in arrays]


def test_every_way_to_part_four_corners_is_known() -> None:
    assert PARTED.sum() == 7
    assert sorted(bin(mask).count("1") for mask in np.flatnonzero(PARTED)) == [3] * 4 + [4] * 3
    assert sorted(EDGE_BETWEEN[np.triu_indices(4, 1)]) == list(range(6))


def test_cuts_of_the_heart_are_valid(shared_meshes: Path) -> None:
    random = np.random.default_rng(3)
    organ = Organ(Mesh(heart(shared_meshes)))
    for method in ("subdivide", "remove"):
        before = organ.shape
        living = np.flatnonzero(organ.mesh.node_alive[: organ.mesh.node_rows])
        centre = organ.places[random.choice(living)]
        planned = organ.cut(square(centre, random.normal(size=3), 0.012), method)
        assert planned is not None
        assert organ.shape.surface_triangles > before.surface_triangles
        if method == "subdivide":
            assert planned.report.distance_after[0] < 1e-5
