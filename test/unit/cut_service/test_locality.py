"""What plans keep of the whole organ is what looking at all of it would say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cut_service.errors import CutError
from cut_service.excerpt import Excerpt
from cut_service.organ import Organ, organ_of
from cut_service.planner import METHODS, plan
from cut_service.sweep_kernels import elements_in_box
from support.cut_scenes import bent, middle, new, rest, square
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.mesh import Mesh

ORGANS = ("block", "shaken", "wall", "shell")


def check_against_all_of_it(organ: Organ, mesh: Mesh, random: np.random.Generator) -> None:
    rows = mesh.element_rows
    tets, alive = mesh.tets[:rows], mesh.element_alive[:rows]
    a, b, c, d = (mesh.rest[tets[alive, k]] for k in range(4))
    volume = np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)).sum() / 6.0
    assert organ.version == mesh.version
    assert organ.volume == pytest.approx(volume, rel=1e-12)
    assert organ.elements == alive.sum()
    assert organ.parts == connected_components(tets, alive, mesh.node_rows)[0]
    for places in (rest(mesh), np.ascontiguousarray(bent(rest(mesh)))):
        survey = organ.grid.survey(places)
        living = places[mesh.node_alive[: mesh.node_rows]]
        assert survey.finite
        np.testing.assert_array_equal(survey.lower, living.min(axis=0))
        np.testing.assert_array_equal(survey.upper, living.max(axis=0))
        one, other = living[random.integers(len(living), size=2)]
        reach = random.choice([0.0, 0.5]) * (other - one)
        lower, upper = np.minimum(one, one + reach), np.maximum(one, one + reach)
        wanted = np.empty(rows, dtype=np.int32)
        wanted = wanted[: elements_in_box(places, tets, alive, lower, upper, wanted)]
        np.testing.assert_array_equal(organ.grid.near(survey, places, lower, upper), wanted)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(ORGANS))
def test_figures_of_the_organ_follow_cuts_and_undos(seed: int, name: str) -> None:
    random = np.random.default_rng(seed)
    mesh, history = new(name), EditHistory()
    size = np.ptp(rest(mesh), axis=0).max()
    organ = organ_of(mesh)
    for _ in range(5):
        for _ in range(random.integers(1, 4)):
            if history.done and random.random() < 0.3:
                history.record(mesh.apply(history.undo(mesh)))
                continue
            living = np.flatnonzero(mesh.node_alive[: mesh.node_rows])
            centre = rest(mesh)[random.choice(living)]
            sweep = square(centre, random.normal(size=3), random.choice([0.2, 0.5, 3.0]) * size)
            try:
                planned = plan(mesh, rest(mesh), sweep, METHODS[random.integers(len(METHODS))])
            except CutError:
                continue
            history.record(mesh.apply(planned.edit))
        assert organ_of(mesh) is organ
        check_against_all_of_it(organ, mesh, random)


def test_an_organ_that_missed_edits_is_looked_at_anew() -> None:
    mesh = new("shaken")
    organ = organ_of(mesh)
    planned = plan(mesh, rest(mesh), square(middle(mesh), np.array([1.0, 0.2, 0.1]), 1.0))
    mesh.apply(planned.edit)
    mesh.changes.clear()
    check_against_all_of_it(organ_of(mesh), mesh, np.random.default_rng(1))
    assert organ_of(mesh) is organ
    assert organ.parts == 2


def test_an_excerpt_has_all_around_what_it_was_asked_for() -> None:
    mesh = new("shaken")
    asked = np.array([40, 41, 300], dtype=np.int32)
    part = Excerpt(mesh, asked)
    rows = part.element_rows
    np.testing.assert_array_equal(part.nodes[part.tets[:rows]], mesh.tets[part.elements])
    np.testing.assert_array_equal(part.rest[: part.node_rows], mesh.rest[part.nodes])
    np.testing.assert_array_equal(part.element_ids[:rows], mesh.element_ids[part.elements])
    near = np.flatnonzero(np.isin(mesh.tets[part.elements], mesh.tets[asked]).any(axis=1))
    assert not part.outer[near].any()
    inner = np.unique(part.tets[:rows][~part.outer])
    for node in inner:
        around = part.elements[part.incident.of(int(node))]
        np.testing.assert_array_equal(around, mesh.incident.of(int(part.nodes[node])))
