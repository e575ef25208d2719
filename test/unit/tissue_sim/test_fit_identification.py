"""A model that is fitted to itself is found again (THESIS.md, section 7)."""

from __future__ import annotations

import pytest

from support.fit_problems import block_problem
from tissue_sim.compare.fit.cma_es import CmaEs
from tissue_sim.compare.fit.evolutionary import Evolutionary
from tissue_sim.compare.fit.problem import Problem, case_of
from tissue_sim.compare.fit.search import FitResult, search
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.fit.workers import Serial
from tissue_sim.compare.subject import parse_subject
from tissue_sim.compare.trajectory import simulate

THESIS = "quasi_static:force_step=0.2,levels=1000,keep_until_rest=0,springs.stiffness=0.2@2"
"""The thesis' check: step and stiffness 0.2 and 0.2."""

VALLEY = ("force_step=0.03..1:log", "springs.stiffness=0.02..2:log")
LR = "lr:step=0.8,linear_factor=0.02@2"


def itself(text: str, *ranges: str) -> Problem:
    """A model that is to be found again, from other values."""
    block = block_problem(nodes=3, frames=4)
    subject = parse_subject(text)
    (case,) = block.cases
    reference = simulate(subject, block.organ, case.interaction)
    case = case_of(block.organ, case.interaction, reference)
    return Problem(block.organ, subject, Space.parse(*ranges), (case,))


def found_by(name: str, problem: Problem, seed: int) -> FitResult:
    size = problem.space.size
    strategy = Evolutionary(size, seed, 30) if name == "ea" else CmaEs(size, seed)
    return search(problem, strategy, Serial(problem), 30 if name == "ea" else 45)


@pytest.mark.parametrize(("name", "closer_than"), [("ea", 1e-3), ("cma", 1e-6)])
def test_step_and_stiffness_are_found_up_to_their_product(name: str, closer_than: float) -> None:
    best = found_by(name, itself(THESIS, *VALLEY), 1).best
    assert best.error < closer_than
    product = best.values["force_step"] * best.values["springs.stiffness"]
    assert product == pytest.approx(0.2 * 0.2, rel=10 * closer_than)


@pytest.mark.parametrize(("name", "closer_than"), [("ea", 1e-3), ("cma", 1e-6)])
def test_values_without_a_valley_are_found_themselves(name: str, closer_than: float) -> None:
    problem = itself(LR, "step=0.1..1.9", "linear_factor=0.002..0.5:log")
    best = found_by(name, problem, 1).best
    assert best.error < closer_than
    assert best.values["step"] == pytest.approx(0.8, rel=30 * closer_than)
    assert best.values["linear_factor"] == pytest.approx(0.02, rel=30 * closer_than)


@pytest.mark.parametrize("name", ["ea", "cma"])
def test_the_same_seed_finds_the_same(name: str) -> None:
    problem = itself(THESIS, *VALLEY)

    def run(seed: int) -> FitResult:
        strategy = Evolutionary(2, seed, 8) if name == "ea" else CmaEs(2, seed)
        return search(problem, strategy, Serial(problem), 3)

    assert run(1) == run(1)
    assert run(1) != run(2)
