"""A search that was interrupted finds what it would have found, bit for bit."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.fit_problems import block_problem
from tissue_sim.compare.fit.checkpoint import CheckpointError, Generation
from tissue_sim.compare.fit.cma_es import CmaEs
from tissue_sim.compare.fit.evolutionary import Evolutionary
from tissue_sim.compare.fit.problem import Evaluation, Problem
from tissue_sim.compare.fit.search import FitResult, best_of, search
from tissue_sim.compare.fit.space import Space
from tissue_sim.compare.fit.strategy import Strategy
from tissue_sim.compare.fit.workers import Serial, Workers
from tissue_sim.compare.subject import parse_subject

GENERATIONS = 5


class Counting(Workers):
    """Evaluates, and counts; stops the search in the middle of a generation if it is told to."""

    def __init__(self, problem: Problem, most: int = 10_000) -> None:
        self.problem, self.most, self.seen = problem, most, 0

    def evaluate(self, candidates: NDArray[np.float64]) -> list[Evaluation]:
        evaluations = []
        for candidate in candidates:
            if self.seen == self.most:
                raise KeyboardInterrupt
            self.seen += 1
            evaluations.append(self.problem.evaluate(candidate))
        return evaluations


@pytest.fixture(scope="module")
def block() -> Problem:
    return block_problem()


def strategy(name: str, seed: int = 5) -> Strategy:
    return Evolutionary(2, seed, 8) if name == "ea" else CmaEs(2, seed, 6)


@pytest.fixture(scope="module")
def whole(block: Problem) -> Callable[[str], FitResult]:
    """Results of searches that nobody interrupted."""
    found = {
        name: search(block, strategy(name), Serial(block), GENERATIONS) for name in ("ea", "cma")
    }
    return found.__getitem__


def interrupt_after(generation: int) -> Callable[[Generation], None]:
    def told(done: Generation) -> None:
        if done.number == generation:
            raise KeyboardInterrupt

    return told


@pytest.mark.parametrize("name", ["ea", "cma"])
def test_a_search_gets_closer(whole: Callable[[str], FitResult], name: str) -> None:
    result = whole(name)
    best = [generation.best for generation in result.history]
    assert best == sorted(best, reverse=True)
    assert best[-1] < best[0]
    assert result.best.error == best[-1] == min(entry.error for entry in result.evaluations)
    assert [generation.number for generation in result.history] == [1, 2, 3, 4, 5]
    assert sum(generation.played for generation in result.history) == len(result.evaluations)


@pytest.mark.parametrize("name", ["ea", "cma"])
@pytest.mark.parametrize("generation", [1, 3])
def test_interrupted_between_generations(
    block: Problem, whole: Callable[[str], FitResult], tmp_path: Path, name: str, generation: int
) -> None:
    file = tmp_path / "fits" / "checkpoint.json"
    with pytest.raises(KeyboardInterrupt):
        search(block, strategy(name), Serial(block), GENERATIONS, file, interrupt_after(generation))
    told: list[int] = []
    result = search(
        block, strategy(name), Serial(block), GENERATIONS, file, lambda g: told.append(g.number)
    )
    assert result == whole(name)
    assert told == list(range(generation + 1, GENERATIONS + 1))


@pytest.mark.parametrize("name", ["ea", "cma"])
def test_interrupted_in_the_middle_of_a_generation_again_and_again(
    block: Problem, whole: Callable[[str], FitResult], tmp_path: Path, name: str
) -> None:
    """Each start gets through one generation and some candidates of the next."""
    file, starts = tmp_path / "checkpoint.json", 0
    while True:
        starts += 1
        try:
            result = search(block, strategy(name), Counting(block, 10), GENERATIONS, file)
        except KeyboardInterrupt:
            continue
        break
    assert result == whole(name)
    assert starts > 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["checkpoint.json"]


def test_a_search_that_is_done_can_be_asked_for_more(
    block: Problem, whole: Callable[[str], FitResult], tmp_path: Path
) -> None:
    file = tmp_path / "checkpoint.json"
    search(block, strategy("ea"), Serial(block), 2, file)
    idle = Counting(block, 0)
    assert len(search(block, strategy("ea"), idle, 2, file).history) == 2
    assert search(block, strategy("ea"), Serial(block), GENERATIONS, file) == whole("ea")


def test_checkpoints_do_not_depend_on_where_a_search_was_interrupted(
    block: Problem, tmp_path: Path
) -> None:
    one, other = tmp_path / "one.json", tmp_path / "other.json"
    search(block, strategy("cma"), Serial(block), 3, one)
    for generations in (1, 2, 3):
        search(block, strategy("cma"), Serial(block), generations, other)
    assert one.read_bytes() == other.read_bytes()


def test_another_search_does_not_go_on_from_a_checkpoint(block: Problem, tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.json"
    search(block, strategy("ea"), Serial(block), 1, file)
    before = file.read_bytes()
    softer = Problem(block.organ, parse_subject("lr@2"), Space.parse("step=0.2..1.5"), block.cases)
    for problem, other, says in (
        (block, strategy("ea", seed=4), 'strategy: .*"seed": 5.* there, .*"seed": 4.* here'),
        (block, strategy("cma"), 'strategy: .*"evolutionary".* there, .*"cma_es".* here'),
        (softer, Evolutionary(1, 5, 8), 'model: "quasi_static" there, "lr" here'),
        (block_problem(nodes=3), strategy("ea"), "organ: .*cases: "),
    ):
        with pytest.raises(CheckpointError, match=f"another fit .*{says}"):
            search(problem, other, Serial(problem), 2, file)
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '{"kind": "tissue bench"}', '{"kind": "fit checkpoint", "format": 0}'],
)
def test_files_that_are_no_checkpoints_are_refused(
    block: Problem, tmp_path: Path, text: str
) -> None:
    file = tmp_path / "checkpoint.json"
    file.write_text(text)
    with pytest.raises(CheckpointError, match=r"checkpoint\.json is no checkpoint of a fit"):
        search(block, strategy("ea"), Serial(block), 1, file)
    assert file.read_text() == text


def test_values_that_come_up_again_are_not_evaluated_again(block: Problem) -> None:
    """Four whole numbers are four evaluations, however often they are asked for."""
    levels = Problem(block.organ, block.subject, Space.parse("levels=1..4"), block.cases)
    workers = Counting(levels)
    result = search(levels, Evolutionary(1, 1, 20), workers, GENERATIONS)
    assert workers.seen == len(result.evaluations) <= 4
    assert [generation.played for generation in result.history][1:] == [0] * (GENERATIONS - 1)


def test_a_model_that_is_lost_is_the_best_only_if_all_are() -> None:
    def outcome(error: float, stable: bool) -> Evaluation:
        return Evaluation((0.0,), {"step": error}, error, stable, 1.0, "" if stable else "lost")

    lost, wild, wilder = outcome(1.2, False), outcome(3.0, True), outcome(4.0, True)
    assert best_of([lost, wilder, wild]) is wild
    assert best_of([outcome(1.9, False), lost]) is lost


def test_a_strategy_that_is_finished_ends_the_search(block: Problem) -> None:
    step = Problem(
        block.organ, parse_subject("quasi_static:step=0.7@2"), Space.parse("step=0.5..1"),
        block.cases,
    )  # fmt: skip
    result = search(step, CmaEs(1, 1, 8), Serial(step), 500)
    assert result.finished
    assert len(result.history) < 100


def test_results_are_plain_values(whole: Callable[[str], FitResult]) -> None:
    result = whole("ea")
    content: dict[str, Any] = json.loads(json.dumps(result.to_json()))
    assert content["best"]["values"] == result.best.values
    assert len(content["history"]) == GENERATIONS


def test_no_generations_are_too_few(block: Problem) -> None:
    with pytest.raises(ValueError, match="0 generations are too few"):
        search(block, strategy("ea"), Serial(block), 0)
