"""The error of a fit is the thesis' difference over the worst; what is lost is worse than that."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from support.fit_problems import block_problem
from support.sheets import connected
from tissue_sim.compare.comparison import compare
from tissue_sim.compare.difference import mean_distance
from tissue_sim.compare.fit.problem import Case, Evaluation, Problem, case_of
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.interaction import held_along
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject, parse_subject
from tissue_sim.compare.trajectory import TrajectoryError, only_held, simulate
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kernels import distances


@pytest.fixture(scope="module")
def block() -> Problem:
    return block_problem()


def at(problem: Problem, **values: float) -> Evaluation:
    return problem.evaluate(problem.space.encode(values))


def with_subject(problem: Problem, text: str, *ranges: str) -> Problem:
    return Problem(problem.organ, parse_subject(text), Space.parse(*ranges), problem.cases)


@settings(max_examples=25, deadline=None)
@given(some.integers(0, 2**32 - 1), some.sampled_from([np.float32, np.float64]))
def test_the_mean_distance_is_that_of_numpy(seed: int, dtype: type[np.floating]) -> None:
    rng = np.random.default_rng(seed)
    frames, nodes = rng.integers(1, 6), rng.integers(1, 9)
    ours, theirs = rng.normal(size=(2, frames, nodes, 3)).astype(dtype)
    rows = rng.choice(nodes, size=rng.integers(1, nodes + 1), replace=False)
    apart = np.linalg.norm(ours[:, rows].astype(float) - theirs[:, rows], axis=2)
    found = distances.mean_distance(ours, theirs, rows)
    assert found == pytest.approx(apart.mean(), rel=1e-14)


def test_a_model_is_no_distance_from_itself(block: Problem) -> None:
    itself = with_subject(block, "quasi_static:step=1.25@2", "step=0.5..1.9")
    (case,) = block.cases
    reference = simulate(itself.subject, block.organ, case.interaction)
    itself = replace(itself, cases=(case_of(block.organ, case.interaction, reference),))
    evaluation = itself.evaluate(itself.space.encode({"step": 1.25}))
    assert evaluation.error == 0.0
    assert (evaluation.stable, evaluation.steps, evaluation.reason) == (True, 2.0, "")


def test_tissue_that_does_not_follow_is_the_worst(block: Problem) -> None:
    """Springs that may be 90 % longer before anything moves: only what is held does."""
    loose = with_subject(block, "relaxation", "linear_factor=0.5..0.9")
    assert at(loose, linear_factor=0.9).error == pytest.approx(1.0, rel=1e-12)


def test_the_error_is_that_of_a_comparison(block: Problem) -> None:
    (case,) = block.cases
    subject = block.subject.with_values({"step": 0.4})
    (target,) = compare(block.organ, case.interaction, case.reference, [subject]).targets
    evaluation = at(block, step=0.4, **{"material.young_modulus": 5e3})
    assert evaluation.error == pytest.approx(target.relative, rel=1e-6)


def test_the_errors_of_several_interactions_are_averaged(block: Problem) -> None:
    def pulled_back(case: Case) -> Case:
        interaction = case.interaction.scaled(-0.5, "push")
        return case_of(
            block.organ, interaction, simulate(parse_subject("lr@3"), block.organ, interaction)
        )

    (pull,) = block.cases
    push = pulled_back(pull)
    apart = [replace(block, cases=cases) for cases in ((pull,), (push,), (pull, push))]
    errors = [problem.evaluate(np.array([0.3, 0.3])).error for problem in apart]
    assert errors[2] == pytest.approx(0.5 * (errors[0] + errors[1]), rel=1e-12)
    assert 0.0 < errors[0] != errors[1] > 0.0


def test_springs_of_two_categories_are_two_values() -> None:
    """With forces that no step normalises, surfaces and what connects them count on their own."""
    organ = Organ("shell", connected(fixed=True))
    top = np.flatnonzero(organ.rest[:, 2] > 0.019)
    pull = np.linspace(0.0, 0.004, 6)[:, None] * np.array([1.0, 0.0, 1.0])
    interaction = held_along(organ, "pull", 30.0, top, pull)
    subject = parse_subject(
        "quasi_static:force_step=0.05,keep_until_rest=0,springs.stiffness=1,springs.connecting=2@3"
    )
    case = case_of(organ, interaction, simulate(subject, organ, interaction))
    space = Space.parse("springs.stiffness=0.1..10:log", "springs.connecting=0.1..10:log")
    problem = Problem(organ, subject, space, (case,))
    both = {"springs.stiffness": 1.0, "springs.connecting": 2.0}
    assert at(problem, **both).error < 1e-7
    errors = [at(problem, **{**both, name: 0.5 * both[name]}).error for name in both]
    assert min(errors) > 1e-3
    assert errors[0] != pytest.approx(errors[1], rel=0.1)


def test_every_spring_gets_its_stiffness_at_both_of_its_ends(block: Problem) -> None:
    network = SpringNetwork(block.organ.mesh, block.organ.material, np.float64)
    stiffness = np.random.default_rng(2).random(network.rows)
    network.set_stiffness(stiffness)
    wanted = np.zeros(block.organ.mesh.node_rows)
    for end in network.springs.ends[: network.rows].T:
        np.add.at(wanted, end, stiffness)
    nodes = np.arange(len(wanted), dtype=np.int32)
    assert network.node_stiffness(nodes) == pytest.approx(wanted, rel=1e-12)


def test_a_model_that_is_lost_is_worse_the_sooner_it_is(block: Problem) -> None:
    wild = with_subject(
        block, "quasi_static:keep_until_rest=0,springs.stiffness=1@2", "force_step=0.1..1000:log"
    )
    lost = [at(wild, force_step=step) for step in (0.5, 1000.0)]
    for evaluation in lost:
        assert not evaluation.stable
        assert 1.0 < evaluation.error <= 2.0
        assert "of 8" in evaluation.reason
        assert "lost in frame" in evaluation.reason
    assert lost[0].error < lost[1].error


def test_values_that_do_not_go_together_are_refused_with_their_reason(block: Problem) -> None:
    both = with_subject(
        block, "quasi_static:keep_until_rest=0@2", "force_step=0..1", "momentum=0..0.5"
    )
    refused = at(both, force_step=0.5, momentum=0.2)
    assert (refused.error, refused.stable, refused.steps) == (2.0, False, 0.0)
    assert "momentum = 0.2; allowed with it: momentum = 0" in refused.reason
    assert at(both, force_step=0.0, momentum=0.2).stable


def test_a_worker_gets_the_same_problem(block: Problem) -> None:
    copy = pickle.loads(pickle.dumps(block))
    assert copy.evaluate(np.array([0.2, 0.7])) == block.evaluate(np.array([0.2, 0.7]))
    assert copy.identity == block.identity


def test_evaluations_keep_every_bit_in_json(block: Problem) -> None:
    evaluation = block.evaluate(np.array([1 / 3, 0.1]))
    assert Evaluation.from_json(json.loads(json.dumps(evaluation.to_json()))) == evaluation


def test_identities_tell_problems_apart(block: Problem) -> None:
    (case,) = block.cases
    others = {
        "model": with_subject(block, "lr", "step=0.2..1.5"),
        "effort": replace(block, subject=parse_subject("quasi_static@3")),
        "values": replace(block, subject=block.subject.with_values({"levels": 3})),
        "space": replace(block, space=Space.parse("step=0.2..1.4", "levels=1..3")),
        "cases": replace(block, cases=(case, case)),
    }
    for name, problem in others.items():
        assert problem.identity[name] != block.identity[name]
    measured = replace(case, reference=only_held(block.organ, case.interaction))
    assert measured.digest != case.digest
    assert replace(case, interaction=case.interaction.scaled(1.5)).digest != case.digest


def test_parts_that_do_not_go_together_are_refused(block: Problem) -> None:
    (case,) = block.cases
    with pytest.raises(ValueError, match="effort 4 ms a frame depends on the machine"):
        replace(block, subject=parse_subject("quasi_static@4ms"))
    with pytest.raises(ValueError, match="there is no case"):
        replace(block, cases=())
    with pytest.raises(ValueError, match="has no value 'momentum'"):
        replace(block, subject=Subject("lr"), space=Space.parse("momentum=0..0.5"))
    with pytest.raises(ValueError, match="another topology"):
        replace(block, organ=block_problem(nodes=3).organ)
    with pytest.raises(ValueError, match="nothing follows what is held"):
        case_of(block.organ, case.interaction, only_held(block.organ, case.interaction))
    short = replace(case.reference, displacement=case.reference.displacement[:-1])
    with pytest.raises(TrajectoryError, match="has 7 at 30 Hz"):
        case_of(block.organ, case.interaction, short)
    with pytest.raises(TrajectoryError, match="has 7 frames of 64 nodes"):
        mean_distance(short, case.reference)
