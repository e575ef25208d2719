"""The two strategies do what they say, find what is there, and go on where they were."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tissue_sim.compare.fit.cma_es import CmaEs
from tissue_sim.compare.fit.evolutionary import Evolutionary
from tissue_sim.compare.fit.strategy import Strategy

BOTH = pytest.mark.parametrize("kind", [Evolutionary, CmaEs])
HIDDEN = np.array([0.31, 0.77])
Make = Callable[..., Strategy]
Errors = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def distance(candidates: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grows as a mean distance does: in proportion, and not alike in all directions."""
    return np.linalg.norm((candidates - HIDDEN) * [1.0, 0.3], axis=1)


def rosenbrock(candidates: NDArray[np.float64]) -> NDArray[np.float64]:
    """A curved valley, scaled into the unit cube; 0 at (3/4, 3/4)."""
    x, y = (4.0 * candidates - 2.0).T
    return 100.0 * (y - x * x) ** 2 + (1.0 - x) ** 2


def run(strategy: Strategy, generations: int, errors: Errors = distance) -> list[float]:
    """The smallest error of each generation that was told."""
    told = []
    for _ in range(generations):
        if strategy.finished:
            break
        candidates = strategy.ask()
        assert ((candidates >= 0.0) & (candidates <= 1.0)).all()
        values = errors(candidates)
        strategy.tell(candidates, values)
        told.append(float(values.min()))
    return told


def through_json(state: dict[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps(state))


def global_state() -> tuple[bytes, int]:
    """State of numpy's global random numbers, which the library would take by itself."""
    state = np.random.get_state(legacy=False)["state"]  # noqa: NPY002
    return state["key"].tobytes(), state["pos"]


def population(strategy: Evolutionary) -> NDArray[np.float64]:
    return np.array(strategy.state()["people"])


@pytest.mark.parametrize("seed", range(5))
def test_the_evolutionary_algorithm_finds_what_is_hidden(seed: int) -> None:
    assert min(run(Evolutionary(2, seed), 30)) < 1e-3


@pytest.mark.parametrize("seed", range(5))
def test_cma_es_finds_what_is_hidden_and_ends_by_itself(seed: int) -> None:
    assert min(run(CmaEs(2, seed), 100)) < 1e-6
    assert min(run(CmaEs(2, seed), 200, rosenbrock)) < 1e-6
    strategy = CmaEs(2, seed)
    run(strategy, 200)
    assert strategy.finished


@BOTH
def test_one_value_can_be_looked_for(kind: Make) -> None:
    strategy = kind(1, 3)
    assert strategy.ask().shape[1] == 1
    assert min(run(kind(1, 3), 60, lambda c: np.abs(c[:, 0] - 0.3))) < 1e-6


def test_children_are_their_parents_or_the_mean_of_two() -> None:
    for crossover in (0.0, 1.0):
        strategy = Evolutionary(3, 1, 20, crossover=crossover, mutation=0.0)
        run(strategy, 1, lambda c: c.sum(axis=1))
        parents = population(strategy)
        pairs = 0.5 * (parents[:, None] + parents[None, :]).reshape(-1, 3)
        allowed = {row.tobytes() for row in (pairs if crossover else parents)}
        assert all(child.tobytes() in allowed for child in strategy.ask())


def test_half_of_the_children_have_two_parents_and_half_are_mutated() -> None:
    strategy = Evolutionary(2, 1, 4000)
    run(strategy, 1)
    unchanged = {row.tobytes() for row in population(strategy)}
    share = np.mean([child.tobytes() in unchanged for child in strategy.ask()])
    # A quarter has neither; a few of those with two parents have the same one twice.
    assert share == pytest.approx(0.25, abs=0.03)


def test_mutations_are_of_the_width_and_narrow_with_the_generations() -> None:
    strategy = Evolutionary(1, 1, 4000, crossover=0.0, mutation=1.0, width=0.01, shrink=0.5)
    run(strategy, 1, lambda c: np.zeros(len(c)))
    strategy.restore({**strategy.state(), "people": [[0.5]] * 4000})
    widths = []
    for _ in range(3):
        children = strategy.ask()
        widths.append(children.std())
        strategy.tell(np.full((3999, 1), 0.5), np.zeros(3999))
    assert widths == pytest.approx([0.01, 0.005, 0.0025], rel=0.05)


def test_tournaments_prefer_the_better_half() -> None:
    """Of two drawn at random, the winner is among the better half in three cases of four."""
    strategy = Evolutionary(1, 1, 4000, crossover=0.0, mutation=0.0)
    run(strategy, 1, lambda c: c[:, 0])
    median = np.median(population(strategy))
    assert np.mean(strategy.ask() < median) == pytest.approx(0.75, abs=0.03)


def test_the_best_survives_and_is_not_evaluated_again() -> None:
    strategy = Evolutionary(2, 1, 20)
    first = strategy.ask()
    strategy.tell(first, distance(first))
    best = first[distance(first).argmin()]
    children = strategy.ask()
    assert len(children) == 19
    strategy.tell(children, np.full(19, 9.0))
    assert (population(strategy)[0] == best).all()
    assert min(strategy.state()["errors"]) == distance(first).min()


@BOTH
def test_the_seed_decides_and_nothing_else(kind: Make) -> None:
    one, same, other = (kind(2, seed) for seed in (1, 1, 2))
    before = global_state()
    assert run(one, 4) == run(same, 4) != run(other, 4)
    assert global_state() == before


@BOTH
@pytest.mark.parametrize("generations", [0, 1, 2, 7])
def test_a_restored_strategy_goes_on_bit_for_bit(kind: Make, generations: int) -> None:
    strategy = kind(2, 11)
    run(strategy, generations)
    restored = kind(2, 11)
    restored.restore(through_json(strategy.state()))
    for _ in range(3):
        candidates = strategy.ask()
        assert (restored.ask() == candidates).all()
        strategy.tell(candidates, distance(candidates))
        restored.tell(candidates, distance(candidates))
    assert restored.state() == strategy.state()


@BOTH
def test_settings_are_plain_values_that_tell_strategies_apart(kind: Make) -> None:
    start = np.array([0.2, 0.9])
    settings = [kind(2, 1).settings, kind(2, 2).settings, kind(2, 1, 20).settings]
    settings += [kind(2, 1, start=start).settings, kind(2, 1, width=0.05).settings]
    assert len({json.dumps(entry) for entry in settings}) == 5


def test_a_start_is_where_a_strategy_begins() -> None:
    start = np.array([0.2, 0.9])
    assert (Evolutionary(2, 1, start=start).ask()[0] == start).all()
    near = CmaEs(2, 1, start=start, width=0.01).ask()
    assert np.abs(near - start).max() < 0.1


@BOTH
@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"population": 3}, "population = 3 is out of range; allowed: 4"),
        ({"seed": -1}, "seed = -1"),
        ({"width": 0.0}, "width = 0"),
    ],
)
def test_settings_out_of_range_are_refused(kind: Make, settings: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        kind(**{"size": 2, "seed": 1, **settings})


@BOTH
@pytest.mark.parametrize("state", [{}, {"errors": "none"}, {"errors": [[1.0, 2.0]]}])
def test_what_is_no_state_is_refused(kind: Make, state: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="state"):
        kind(2, 1).restore(state)


def test_cma_es_is_told_what_it_asked_for() -> None:
    strategy = CmaEs(2, 1)
    candidates = strategy.ask()
    with pytest.raises(ValueError, match="did not ask for"):
        strategy.tell(candidates[::-1], distance(candidates))
