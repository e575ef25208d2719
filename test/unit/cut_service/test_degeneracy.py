"""Removing degeneracies: what it promises of elements, of the cut and of the volume."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cut_service.degeneracy import DIVIDED
from cut_service.degeneracy_kernels import element_length
from cut_service.errors import CutError
from cut_service.organ import organ_of
from cut_service.planner import Plan, Settings, plan
from support.cut_scenes import SIDE, bent, middle, new, quality, rest, square
from support.valid_mesh import check_valid
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.spring_mass import SpringMass
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import radius_ratios

LEFT = Settings(remove_degeneracies=False)


def lengths(mesh: Mesh) -> NDArray[np.float64]:
    """sqrt(3 / sum of 1 / l^2) at the worst corner of each living element [m]."""
    rows = mesh.element_rows
    tets = mesh.tets[:rows][mesh.element_alive[:rows]]
    places = mesh.rest[tets]
    square_of = ((places[:, :, None] - places[:, None]) ** 2).sum(axis=-1)
    inverse = 1.0 / np.where(np.eye(4) > 0, np.inf, square_of)
    return np.sqrt(3.0 / inverse.sum(axis=2).max(axis=1))


def lacking(mesh: Mesh, method: str) -> int:
    """Elements with less than is wanted."""
    share = DIVIDED if method == "subdivide" else 1.0
    how, edge = Settings(), organ_of(new("shaken")).mean_edge
    short = lengths(mesh) < share * how.wanted_length * edge
    return int((short | (quality(mesh) < share * how.wanted_ratio)).sum())


def cut(name: str, how: Settings, method: str = "split", cuts: int = 4) -> tuple[Mesh, list[Plan]]:
    """The same cuts, whatever the settings, right through and across each other."""
    random = np.random.default_rng(4)
    mesh, made = new(name), []
    for _ in range(cuts):
        sweep = square(middle(mesh), random.normal(size=3), 1.0)
        planned = plan(mesh, rest(mesh), sweep, method, settings=how)
        mesh.apply(planned.edit)
        made.append(planned)
    check_valid(mesh)
    return mesh, made


def test_the_length_of_an_element_is_the_reference_formula() -> None:
    mesh = new("shaken")
    wanted = lengths(mesh)
    for row in (0, 17, 400):
        assert element_length(mesh.rest, mesh.tets[row]) == pytest.approx(wanted[row], rel=1e-12)


@pytest.mark.parametrize("method", ["split", "subdivide"])
def test_elements_are_better_and_the_cut_is_where_it_was(method: str) -> None:
    left, before = cut("shaken", LEFT, method, 1)
    mended, after = cut("shaken", Settings(), method, 1)
    found, remaining = after[0].report.degenerate
    assert found > 0
    assert remaining < 0.5 * found
    assert lacking(mended, method) < 0.5 * lacking(left, method)
    assert before[0].report.degenerate == (0, 0)
    edge = SIDE / 7
    shifted = after[0].report.distance_after[0] - before[0].report.distance_after[0]
    assert shifted < 0.02 * edge
    assert after[0].report.faces_split == before[0].report.faces_split


def test_a_stable_step_is_longer_than_with_degeneracies_left() -> None:
    steps = []
    for how in (LEFT, Settings()):
        mesh, _ = cut("shaken", how)
        steps.append(SpringMass(mesh, Material(), {}).longest_time_step())
    assert steps[1] > 1.2 * steps[0]


def test_new_nodes_stay_on_the_sweep_and_the_volume_is_kept() -> None:
    mesh = new("shaken")
    shape = bent(rest(mesh))
    sweep = square(0.5 * (shape.min(axis=0) + shape.max(axis=0)), np.array([1.0, 0.2, 0.5]), 1.0)
    how = Settings(vertex_share=0.0)
    edit = plan(mesh, shape, sweep, "subdivide", settings=how).edit
    as_they_were = plan(
        mesh, shape, sweep, "subdivide", settings=replace(how, remove_degeneracies=False)
    ).edit
    made = edit.moved_nodes >= 1 << 31
    assert made.sum() == (as_they_were.moved_nodes >= 1 << 31).sum()
    places = np.einsum(
        "ij,ijk->ik", edit.moved_weights, shape[mesh.node_rows_of(edit.moved_anchors)]
    )
    assert sweep.distance(places[made]).max() < 1e-12
    before = check_valid(mesh).volume
    mesh.apply(edit)
    assert check_valid(mesh).volume == pytest.approx(before, rel=1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["block", "shaken", "shell"]))
def test_no_element_gets_worse_than_the_floor_at_rest_or_deformed(seed: int, name: str) -> None:
    random = np.random.default_rng(seed)
    mesh = new(name)
    shape = np.ascontiguousarray(
        rest(mesh) + random.uniform(0, 0.3) * (bent(rest(mesh)) - rest(mesh))
    )
    centre = shape[random.integers(mesh.node_rows)]
    sweep = square(centre, random.normal(size=3), random.choice([0.01, 0.03, 1.0]))
    try:
        planned = plan(mesh, shape, sweep)
    except CutError:
        return
    edit = planned.edit
    floor = Settings().quality_floor
    moved = mesh.node_rows_of(edit.moved_nodes)
    anchors = mesh.node_rows_of(edit.moved_anchors)
    for places in (rest(mesh), shape):
        after = places.copy()
        after[moved] = np.einsum("ij,ijk->ik", edit.moved_weights, places[anchors])
        tets = mesh.tets[: mesh.element_rows]
        old, now = ratios(places, tets), ratios(after, tets)
        assert (now >= np.minimum(floor, old) - 1e-9).all()


def ratios(places: NDArray[np.float64], tets: NDArray[np.int32]) -> NDArray[np.float64]:
    return radius_ratios(np.ascontiguousarray(places), tets)
