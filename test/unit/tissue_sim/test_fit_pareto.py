"""The Pareto front of speed and error, and landscapes of the error."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from numpy.typing import NDArray

from support.fit_problems import block_problem
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.fit.evolutionary import Evolutionary
from tissue_sim.compare.fit.landscape import landscape
from tissue_sim.compare.fit.pareto import SpeedFront, SpeedPoint, pareto_front, speed_front
from tissue_sim.compare.fit.problem import Evaluation, Problem, case_of
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.fit.strategy import Strategy
from tissue_sim.compare.fit.workers import Serial
from tissue_sim.compare.subject import parse_subject
from tissue_sim.compare.trajectory import simulate

POINTS = some.lists(some.tuples(some.integers(0, 6), some.integers(0, 6)), max_size=12)
"""Whole numbers, so that there are ties."""


def dominates(one: tuple[int, int], other: tuple[int, int]) -> bool:
    return one != other and one[0] <= other[0] and one[1] <= other[1]


@given(POINTS)
def test_the_front_is_what_nothing_dominates(points: list[tuple[int, int]]) -> None:
    front = [points[row] for row in pareto_front(points)]
    free = {point for point in points if not any(dominates(other, point) for other in points)}
    assert set(front) == free
    assert len(front) == len(free), "of equal points one"
    assert front == sorted(front)


@given(POINTS, some.randoms(use_true_random=False))
def test_the_front_does_not_depend_on_the_order(
    points: list[tuple[int, int]], random: Random
) -> None:
    shuffled = random.sample(points, len(points))
    assert [points[row] for row in pareto_front(points)] == [
        shuffled[row] for row in pareto_front(shuffled)
    ]


def point(steps: float, error: float, stable: bool = True) -> SpeedPoint:
    return SpeedPoint(steps, 1.0, Evaluation((0.5,), {"step": 1.0}, error, stable, steps))


def test_the_fewest_steps_within_a_tolerance() -> None:
    found = SpeedFront(
        (point(0.5, 1.2, False), point(1, 0.4), point(2, 0.5), point(3, 0.2), point(4, 0.2))
    )
    assert [entry.steps for entry in found.front] == [1, 3]
    assert found.fewest_steps_within(2.0).steps == found.fewest_steps_within(0.4).steps == 1
    assert found.fewest_steps_within(0.3).steps == 3
    with pytest.raises(ValueError, match=r"within 0.1 of the worst.*0.2, with 3 steps a frame"):
        found.fewest_steps_within(0.1)
    assert json.loads(json.dumps(found.to_json()))["front"] == [1, 3]


@pytest.fixture(scope="module")
def block() -> Problem:
    """What two steps a frame with a step of 1 come to has to be found."""
    problem = block_problem()
    (case,) = problem.cases
    subject = parse_subject("quasi_static:step=1,levels=2@2")
    reference = simulate(subject, problem.organ, case.interaction)
    space = Space.parse("step=0.5..1.5", "levels=1..4")
    cases = (case_of(problem.organ, case.interaction, reference),)
    return Problem(problem.organ, subject, space, cases)


def test_each_effort_is_fitted_from_the_best_of_the_one_before(
    block: Problem, tmp_path: Path
) -> None:
    starts: list[NDArray[np.float64] | None] = []
    told: list[tuple[float, int]] = []

    def strategy_of(start: NDArray[np.float64] | None) -> Strategy:
        starts.append(start)
        return Evolutionary(2, 1, 8, start)

    found = speed_front(
        block,
        [2, 0.5, 1],
        strategy_of,
        Serial,
        3,
        tmp_path,
        lambda s, g: told.append((s, g.number)),
    )
    assert [entry.steps for entry in found.points] == [0.5, 1, 2]
    assert starts[0] is None
    assert [tuple(start) for start in starts[1:] if start is not None] == [
        entry.best.unit for entry in found.points[:2]
    ]
    assert told == [(steps, number) for steps in (0.5, 1, 2) for number in (1, 2, 3)]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "steps_0.5.json", "steps_1.json", "steps_2.json",
    ]  # fmt: skip
    # What the reference itself does is closest to it.
    assert found.points[2].best.error == min(entry.best.error for entry in found.points)
    again = speed_front(block, [0.5, 1, 2], strategy_of, Serial, 3, tmp_path)
    assert [entry.best for entry in again.points] == [entry.best for entry in found.points]
    with pytest.raises(ValueError, match="no effort to fit at"):
        speed_front(block, [], strategy_of, Serial, 3)


def test_a_landscape_is_lowest_where_the_model_is_itself(block: Problem) -> None:
    rows: list[tuple[int, int]] = []
    found = landscape(
        block, Serial(block), "levels", "step", 11, on_row=lambda *done: rows.append(done)
    )
    assert found.first_values.tolist() == [1, 2, 3, 4], "whole numbers, each once"
    assert found.second_values == pytest.approx(np.linspace(0.5, 1.5, 11))
    levels, step, error = found.lowest
    assert (levels, error < 1e-6) == (2.0, True)
    assert step == pytest.approx(1.0)
    assert rows == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert found.stable.all()
    alone = block.evaluate(block.space.encode({"levels": 2.0, "step": 0.7}))
    assert found.error[1, 2] == pytest.approx(alone.error, rel=1e-6)


def test_a_landscape_of_step_and_stiffness_is_a_valley(block: Problem) -> None:
    """Held nodes are put where they are, so only the product of the two matters."""
    text = "quasi_static:force_step=0.1,keep_until_rest=0,springs.stiffness=1@2"
    subject = parse_subject(text)
    (case,) = block.cases
    reference = simulate(subject, block.organ, case.interaction)
    space = Space.parse("force_step=0.01..1:log", "springs.stiffness=0.1..10:log", "levels=1..30")
    cases = (case_of(block.organ, case.interaction, reference),)
    problem = Problem(block.organ, subject, space, cases)
    found = landscape(
        problem, Serial(problem), "force_step", "springs.stiffness", 5, {"levels": 30}
    )
    assert found.others == {"levels": 30}
    for shift in range(-4, 5):
        same_product = np.fliplr(found.error).diagonal(shift)
        assert same_product == pytest.approx(np.full(len(same_product), same_product[0]), abs=1e-5)
    assert np.fliplr(found.error).diagonal().max() < 1e-5
    assert found.error[0, 0] > 0.1
    content = json.loads(json.dumps(found.to_json()))
    assert content["first"]["log"] is True
    assert np.array(content["error"]).shape == (5, 5)


def test_landscapes_over_what_is_not_there_are_refused(block: Problem) -> None:
    workers = Serial(block)
    with pytest.raises(ValueError, match="no landscape over step and step; allowed: two of step, "):
        landscape(block, workers, "step", "step")
    with pytest.raises(ValueError, match="allowed: two of step, levels"):
        landscape(block, workers, "step", "momentum")
    with pytest.raises(ValueError, match="1 points a side"):
        landscape(block, workers, "step", "levels", 1)
    three = replace(
        block, space=Space.parse("step=0.5..1.5", "levels=1..4", "springs.stiffness=1..2")
    )
    with pytest.raises(ValueError, match=r"springs\.stiffness = 5 is out of bounds"):
        landscape(three, Serial(three), "step", "levels", 3, {"springs.stiffness": 5.0})


def test_an_effort_replaces_that_of_the_problem(block: Problem) -> None:
    assert block.subject.effort == Effort(steps=2.0)
    found = speed_front(block, [3], lambda start: Evolutionary(2, 1, 4, start), Serial, 1)
    assert found.points[0].best.steps == 3.0
