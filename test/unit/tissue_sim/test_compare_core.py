"""Interactions, efforts, subjects, trajectories and differences: closed forms and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skfem
from hypothesis import given, settings
from hypothesis import strategies as st
from skfem.helpers import ddot, sym_grad, trace

from support.pulled_block import PULL, block_organ, pull_of, top_of
from tissue_sim.compare.comparison import compare
from tissue_sim.compare.difference import difference
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.interaction import Interaction, InteractionError, held_along
from tissue_sim.compare.machine import on_machine, thesis_steps
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.spring_constants import SpringConstants
from tissue_sim.compare.subject import Subject, parse_subject
from tissue_sim.compare.trajectory import Trajectory, TrajectoryError, only_held, simulate
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.stiffness import lame_constants
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.sheet import CONNECTING

RNG = np.random.default_rng(11)


@pytest.fixture(scope="module")
def organ() -> Organ:
    return block_organ()


@pytest.fixture(scope="module")
def pull(organ: Organ) -> Interaction:
    return pull_of(organ)


def moved(organ: Organ, displacement: np.ndarray, **more: Any) -> Trajectory:
    """A trajectory made by hand, shape (frames, nodes, 3)."""
    frames = len(displacement)
    return Trajectory(
        "by hand", 30.0, displacement.astype(np.float32), np.ones(frames, dtype=np.int64),
        np.zeros(frames), frames, organ.digest, **more,
    )  # fmt: skip


def random_walk(organ: Organ, frames: int = 5) -> np.ndarray:
    return RNG.normal(0.0, 0.003, (frames, organ.mesh.node_rows, 3))


# Interactions


def test_an_interaction_is_read_back_as_it_was_written(pull: Interaction, tmp_path: Path) -> None:
    pull.save(tmp_path / "pull.npz")
    again = Interaction.load(tmp_path / "pull.npz")
    assert (again.name, again.rate_hz, again.organ) == (pull.name, pull.rate_hz, pull.organ)
    for name in ("nodes", "held", "displacement"):
        np.testing.assert_array_equal(getattr(again, name), getattr(pull, name))
        assert getattr(again, name).dtype == getattr(pull, name).dtype


def test_what_is_let_go_is_held_no_more(organ: Organ) -> None:
    held = np.array([True, True, False, True])
    again = held_along(organ, "regrab", 30.0, top_of(organ), np.tile(PULL, (4, 1)), held)
    assert [len(again.held_rows(frame)) > 0 for frame in range(4)] == held.tolist()
    assert not again.displacement[2].any()
    assert again.amplitude == pytest.approx(0.01)
    assert again.scaled(0.5).amplitude == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"organ": "of another"}, "another topology .* than block .* 64 nodes"),
        ({"rate_hz": 0.5}, "allowed: 1 to 1000"),
        ({"held": np.zeros((6, 16), dtype=np.bool_)}, "holds nothing"),
        ({"held": np.zeros((0, 16), dtype=np.bool_)}, "has 0 frames"),
        ({"displacement": np.full((6, 16, 3), np.nan)}, "not finite"),
        ({"nodes": np.arange(16, dtype=np.int32)}, "holds nodes that are fixed"),
    ],
)
def test_interactions_that_cannot_be_played_are_refused(
    organ: Organ, pull: Interaction, changed: dict[str, Any], said: str
) -> None:
    with pytest.raises(InteractionError, match=said):
        simulate(Subject("relaxation"), organ, replace(pull, **changed))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"name": "x"}, "has no format, rate_hz, .*; it holds name"),
        ({"format": 99, **dict.fromkeys(("name", "rate_hz", "nodes", "held", "displacement",
                                         "organ"), 0)}, "has format 99; this version reads 1"),
        (b"no archive", "is no interaction"),
        (b"", "is no interaction"),
    ],
)  # fmt: skip
def test_files_that_hold_no_interaction_say_what_they_hold(
    tmp_path: Path, content: dict[str, Any] | bytes, said: str
) -> None:
    path = tmp_path / "other.npz"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.savez(path, **content)
    with pytest.raises(InteractionError, match=said):
        Interaction.load(path)


# Efforts and subjects


@pytest.mark.parametrize(
    ("text", "effort", "words"),
    [
        ("2.9", Effort(steps=2.9), "2.9 steps a frame"),
        ("4ms", Effort(seconds=0.004), "4 ms a frame"),
        (" 0.5 ms ", Effort(seconds=0.0005), "0.5 ms a frame"),
        ("rest", Effort(to_rest=1e-9), "to rest"),
        ("time", Effort(), "as its time step asks"),
    ],
)
def test_efforts_are_read(text: str, effort: Effort, words: str) -> None:
    assert Effort.parse(text) == effort
    assert str(effort) == words
    assert Effort.parse(effort.text) == effort
    assert effort.reproducible == ("ms" not in text)


@pytest.mark.parametrize("text", ["", "0", "-1", "nan", "1e9", "2 s", "..", "0.001ms", "steps"])
def test_impossible_efforts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"effort '.*' is not possible; allowed: steps a frame"):
        Effort.parse(text)


def test_a_subject_is_read_and_written() -> None:
    subject = parse_subject("my own=quasi_static:step=1.2, levels=1000,springs.stiffness=3@2.5")
    assert (subject.name, subject.model) == ("my own", "quasi_static")
    assert subject.values == {"step": 1.2, "levels": 1000.0, "springs.stiffness": 3.0}
    assert subject.parameters == {"step": 1.2, "levels": 1000.0}
    assert subject.constants() == SpringConstants(stiffness=3.0)
    assert subject.effort == Effort(steps=2.5)
    assert parse_subject(subject.text) == subject


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("jelly", "there is no model 'jelly'; allowed: chain_mail, finite_element"),
        ("lr:stiffness=1", "no parameter 'stiffness'; allowed: .*springs.stiffness"),
        ("lr:step", "'step' has no value; write MODEL"),
        ("lr:step=much", "'much' of step is no number"),
        ("lr:step=5", "step = 5 is out of range; allowed: 0.01 to 1.99"),
        ("lr:levels=2.5", "must be a whole number"),
        ("lr:material.colour=1", "there is no material.colour; allowed: material.young_modulus"),
        ("lr:springs.length=1", "there is no springs.length; allowed: springs.stiffness"),
        ("lr:springs.stiffness=-1", "springs.stiffness = -1 is out of range"),
        ("lr:springs.per_element=0.5", "allowed: 0 or 1"),
        ("lr@fast", "effort 'fast' is not possible"),
        ("", "there is no model ''"),
    ],
)
def test_subjects_that_make_no_sense_are_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse_subject(text)


def test_a_subject_has_a_material_of_its_own(organ: Organ) -> None:
    subject = parse_subject("lr:material.young_modulus=1234")
    assert subject.material(organ) == replace(organ.material, young_modulus=1234.0)


# How much a model does


@given(st.floats(0.02, 5.0))
@settings(max_examples=12, deadline=None, derandomize=True)
def test_fractions_of_steps_are_carried_over(share: float) -> None:
    organ = block_organ(3)
    interaction = pull_of(organ, 20)
    moved = simulate(Subject("relaxation", effort=Effort(steps=share)), organ, interaction)
    wanted = np.floor(share * np.arange(1, 21) + 1e-6)
    np.testing.assert_array_equal(np.cumsum(moved.steps), wanted)
    assert moved.steps.max() - moved.steps.min() <= 1


def test_a_model_in_time_makes_the_steps_of_its_time_step(organ: Organ, pull: Interaction) -> None:
    subject = parse_subject("spring_mass:time_step=0.0005,mass_scaling=1@time")
    played = simulate(subject, organ, pull)
    assert played.steps.sum() == int(pull.seconds / 0.0005)


def test_a_time_a_frame_makes_a_step_at_least(organ: Organ, pull: Interaction) -> None:
    played = simulate(parse_subject("relaxation@0.01ms"), organ, pull)
    assert played.steps.min() >= 1


def test_the_same_steps_give_the_same_bits(organ: Organ, pull: Interaction) -> None:
    subject = parse_subject("quasi_static@2.3")
    one, other = (simulate(subject, organ, pull).displacement for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_finite_elements_to_rest_are_those_of_another_library(
    organ: Organ, pull: Interaction
) -> None:
    """scikit-fem's matrix of the same mesh, solved directly in every frame."""
    lam, mu = lame_constants(organ.material)
    mesh = organ.mesh
    there = skfem.MeshTet(organ.rest.T.copy(), mesh.tets[: mesh.element_rows].T.astype(np.int64))
    basis = skfem.Basis(there, skfem.ElementVector(skfem.ElementTetP1()))

    @skfem.BilinearForm
    def elasticity(u, v, _):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        return lam * trace(sym_grad(u)) * trace(sym_grad(v)) + 2 * mu * ddot(
            sym_grad(u), sym_grad(v)
        )

    K, dofs = elasticity.assemble(basis), basis.nodal_dofs
    played = simulate(parse_subject("finite_element:tolerance=1e-8@rest"), organ, pull)
    for frame in range(pull.frames):
        x = np.zeros(K.shape[0])
        x[dofs[:, pull.nodes]] = pull.displacement[frame].T
        given_dofs = dofs[:, np.union1d(np.flatnonzero(mesh.fixed[: mesh.node_rows]), pull.nodes)]
        u = skfem.solve(*skfem.condense(K, x=x, D=given_dofs.ravel()))[dofs].T
        assert np.abs(played.displacement[frame] - u).max() < 2e-6 * pull.amplitude
    assert played.is_stable


class Explodes:
    """A model that doubles its displacement, and has none that is a number in the end."""

    time_step = None
    idle = False

    def __init__(self, organ: Organ, last: float) -> None:
        self.springs = SpringNetwork(organ.mesh, organ.material)
        self._last, self._count = last, 0

    def prescribed_changed(self, state: Any, rows: Any) -> None:
        pass

    def step(self, state: Any) -> None:
        self._count += 1
        state.displacement[0] = self._last if self._count > 3 else 0.001 * self._count


@pytest.mark.parametrize("last", [np.nan, np.inf, 5.0])
def test_a_model_that_is_lost_counts_as_tissue_that_does_not_follow(
    organ: Organ, pull: Interaction, last: float
) -> None:
    model: Any = Explodes(organ, last)
    played = simulate(Subject("relaxation", label="lost"), organ, pull, model=model)
    assert (played.stable, played.is_stable) == (3, False)
    worst = only_held(organ, pull)
    np.testing.assert_array_equal(played.displacement[3:], worst.displacement[3:])
    np.testing.assert_allclose(played.displacement[:3, 0, 0], [0.001, 0.002, 0.003])
    assert np.isfinite(played.displacement).all()


def test_steps_beyond_the_stable_one_are_noticed(organ: Organ, pull: Interaction) -> None:
    """Explicit steps far longer than 2 / the highest frequency grow without bound."""
    subject = parse_subject("spring_mass:time_step=0.01,mass_scaling=2@30")
    assert not simulate(subject, organ, pull).is_stable


def test_the_time_of_a_frame_knows_frames_without_steps(organ: Organ) -> None:
    steps = np.array([0, 1, 0, 1, 0, 0])
    one = replace(
        moved(organ, np.zeros((6, 64, 3))), steps=steps, seconds=np.where(steps, 0.006, 1e-7)
    )
    assert one.steps_per_frame == pytest.approx(1 / 3)
    assert one.ms_per_frame == pytest.approx(2.0)
    assert one.ms_per_frame == pytest.approx(replace(one, stable=6).ms_per_frame)


# Trajectories


def test_only_what_is_held_moves(organ: Organ, pull: Interaction) -> None:
    worst = only_held(organ, pull).displacement
    np.testing.assert_allclose(worst[:, pull.nodes], pull.displacement, rtol=1e-6)
    others = np.setdiff1d(np.arange(64), pull.nodes)
    assert not worst[:, others].any()


def test_a_trajectory_is_read_back_as_it_was_written(organ: Organ, tmp_path: Path) -> None:
    one = moved(organ, random_walk(organ), rows=np.array([1, 5], dtype=np.int32))
    one.save(tmp_path / "one.npz")
    again = Trajectory.load(tmp_path / "one.npz")
    for name in ("displacement", "steps", "seconds", "rows"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))
    assert replace(again, **{n: getattr(one, n) for n in
                             ("displacement", "steps", "seconds", "rows")}) == one  # fmt: skip


@pytest.mark.parametrize("content", [b"", b"no archive"])
def test_files_that_hold_no_trajectory_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.npz").write_bytes(content)
    with pytest.raises(TrajectoryError, match="is no trajectory"):
        Trajectory.load(tmp_path / "x.npz")


# Differences


def test_a_shift_is_its_own_length(organ: Organ) -> None:
    reference, shift = random_walk(organ), np.array([0.003, 0.0, 0.004])
    apart = difference(organ, moved(organ, reference + shift), moved(organ, reference))
    for values in (apart.frame_mean, apart.frame_p95, apart.frame_largest, apart.node_mean,
                   apart.node_largest, [apart.mean, apart.p95, apart.largest]):  # fmt: skip
        np.testing.assert_allclose(values, 0.005, rtol=1e-5)


def test_differences_are_those_of_numpy(organ: Organ) -> None:
    one, other = (moved(organ, random_walk(organ)) for _ in range(2))
    apart = difference(organ, one, other)
    distance = np.linalg.norm(
        one.displacement.astype(np.float64) - other.displacement, axis=2
    )  # (frames, nodes)
    assert apart.mean == pytest.approx(distance.mean())
    assert apart.largest == pytest.approx(distance.max())
    np.testing.assert_allclose(apart.frame_p95, np.percentile(distance, 95, axis=1), rtol=1e-6)
    np.testing.assert_allclose(apart.node_mean, distance.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(apart.node_largest, distance.max(axis=0), rtol=1e-6)
    assert difference(organ, other, one).mean == apart.mean


def test_of_a_measurement_only_measured_nodes_count(organ: Organ) -> None:
    rows = np.array([3, 7, 20], dtype=np.int32)
    target, reference = random_walk(organ), random_walk(organ)
    unknown = np.setdiff1d(np.arange(64), rows)
    garbage = reference.copy()
    garbage[:, unknown] = 1e3
    apart, same = (
        difference(organ, moved(organ, target), moved(organ, r, rows=rows))
        for r in (garbage, reference)
    )
    assert apart.mean == same.mean
    assert np.isnan(apart.node_mean[unknown]).all()
    assert np.isfinite(apart.node_mean[rows]).all()
    assert np.isnan(apart.volume_error).all()


@pytest.mark.parametrize("stretch", [-0.2, 0.1, 1.0])
def test_the_volume_error_of_a_scaling_is_its_cube(organ: Organ, stretch: float) -> None:
    still = np.zeros((2, 64, 3))
    scaled = moved(organ, still + stretch * organ.rest)
    apart = difference(organ, scaled, moved(organ, still))
    np.testing.assert_allclose(apart.volume_error, (1 + stretch) ** 3 - 1, rtol=1e-5)
    assert apart.largest_volume_error == pytest.approx(abs((1 + stretch) ** 3 - 1), rel=1e-5)


def test_trajectories_that_cannot_be_compared_are_refused(organ: Organ) -> None:
    one = moved(organ, np.zeros((2, 64, 3)))
    with pytest.raises(TrajectoryError, match=r"another topology .* than block"):
        difference(organ, one, replace(one, organ="other"))
    with pytest.raises(TrajectoryError, match=r"2 frames at 30 Hz, .* 2 at 60 Hz"):
        difference(organ, one, replace(one, rate_hz=60.0))


# Comparisons


def test_a_model_compared_with_itself_is_the_first_of_the_ranking(
    organ: Organ, pull: Interaction
) -> None:
    subject = parse_subject("quasi_static@3")
    told: list[tuple[str, int, int]] = []
    found = compare(
        organ, pull, subject, [parse_subject("relaxation@1"), subject],
        lambda *progress: told.append(progress),
    )  # fmt: skip
    assert [target.subject.model for target in found.ranking] == ["quasi_static", "relaxation"]
    assert found.ranking[0].relative == 0.0
    assert found.ranking[1].relative > 0.0
    assert found.worst.mean == pytest.approx(
        difference(organ, only_held(organ, pull), found.reference).mean
    )
    assert [name for name, done, frames in told if done == frames] == [
        "quasi_static", "relaxation", "quasi_static"
    ]  # fmt: skip


def test_a_subject_that_makes_no_sense_is_refused_before_anything_moves(
    organ: Organ, pull: Interaction
) -> None:
    with pytest.raises(ValueError, match="there is no model 'jelly'"):
        compare(organ, pull, Subject("lr"), [Subject("jelly")], lambda *_: pytest.fail("moved"))


# Springs with constants of their own


def two_tets() -> Mesh:
    """Two tetrahedra that share the face of nodes 1, 2 and 3."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=np.float64)
    return Mesh(RawMesh(points, np.array([[0, 1, 2, 3], [1, 2, 3, 4]])))


@pytest.mark.parametrize(("per_element", "shared"), [(0.0, 5.0), (1.0, 10.0)])
def test_edges_have_one_spring_or_one_of_each_element(per_element: float, shared: float) -> None:
    network = SpringConstants(5.0, per_element, node_mass=0.25).network(two_tets(), Material())
    found = {
        tuple(sorted(ends)): stiffness
        for ends, stiffness in zip(
            network.springs.ends[: network.rows].tolist(),
            network.springs.stiffness[: network.rows].tolist(),
            strict=True,
        )
    }
    inside = {(1, 2), (1, 3), (2, 3)}
    outside = {(0, 1), (0, 2), (0, 3), (1, 4), (2, 4), (3, 4)}
    assert found == dict.fromkeys(inside, shared) | dict.fromkeys(outside, 5.0)
    np.testing.assert_array_equal(network.masses[:5], 0.25)


def test_categories_of_springs_have_constants_of_their_own() -> None:
    organ = load_organ(
        "wall", parameters={"columns": 4, "rows": 5}, geometry_kind="connected_surfaces"
    )
    network = SpringConstants(2.0, connecting=3.0).network(organ.mesh, organ.material)
    stiffness = network.springs.stiffness[: network.rows]
    connecting = network.categories[: network.rows] == CONNECTING
    assert organ.mesh.sheet is not None
    assert connecting.sum() == organ.mesh.sheet.count(CONNECTING) > 0
    np.testing.assert_array_equal(stiffness, np.where(connecting, 6.0, 2.0))


def test_stiffer_springs_with_smaller_steps_move_alike(organ: Organ, pull: Interaction) -> None:
    """Held nodes are placed, so only step x stiffness matters (THESIS.md, section 7)."""
    shapes = [
        simulate(
            parse_subject(
                f"quasi_static:keep_until_rest=0,force_step={step},springs.stiffness={stiffness}@3"
            ),
            organ, pull,
        ).displacement
        for step, stiffness in ((0.02, 5.0), (0.01, 10.0))
    ]  # fmt: skip
    assert np.abs(shapes[0]).max() > 1e-3
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-8)


# The thesis' machine


@pytest.mark.parametrize(
    ("text", "kind", "steps"),
    [
        ("quasi_static", "volume", 1.9),
        ("quasi_static", "connected_surfaces", 3.0),
        ("lr:levels=10000", "volume", 2.0),
        ("lr", "volume", 0.67),
        ("relaxation", "volume", 3.5),
        ("spring_mass", "volume", 2.9),
        ("finite_element", "volume", 0.4),
    ],
)
def test_the_thesis_machine_has_the_rates_of_its_table(text: str, kind: str, steps: float) -> None:
    organ = load_organ("wall", parameters={"columns": 4, "rows": 5}, geometry_kind=kind)
    assert thesis_steps(parse_subject(text), organ) == steps
    assert on_machine("thesis", parse_subject(text), organ, 60.0).effort.steps == steps / 2


def test_machines_and_rates_that_nobody_has_are_refused(organ: Organ) -> None:
    with pytest.raises(ValueError, match="there is no machine 'new'; allowed: thesis"):
        on_machine("new", Subject("lr"), organ, 30.0)
    with pytest.raises(ValueError, match="no frame rate of chain_mail: give it an effort"):
        on_machine("thesis", Subject("chain_mail"), organ, 30.0)
