"""Fitness landscapes: the error over two values, as in the thesis' pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.fit.problem import Problem
from tissue_sim.compare.fit.space import FitParameter
from tissue_sim.compare.fit.workers import Workers


@dataclass(frozen=True)
class Landscape:
    """The error on a grid of two values; along logarithmic ones the ratios are equal.

    Attributes:
        first, second: What the values are.
        first_values: Values of the first, ascending, shape (m,).
        second_values: Values of the second, ascending, shape (n,).
        error: Error relative to the worst, shape (m, n).
        stable: Whether the model was never lost, shape (m, n).
        others: What the other values of the space were.
    """

    first: FitParameter
    second: FitParameter
    first_values: NDArray[np.float64]
    second_values: NDArray[np.float64]
    error: NDArray[np.float64]
    stable: NDArray[np.bool_]
    others: dict[str, float]

    @property
    def lowest(self) -> tuple[float, float, float]:
        """First value, second value and error of the lowest point."""
        row, column = np.unravel_index(int(self.error.argmin()), self.error.shape)
        return (
            float(self.first_values[row]), float(self.second_values[column]),
            float(self.error[row, column]),
        )  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; `error` and `stable` as one list for each first value."""
        return {
            "first": _axis(self.first, self.first_values),
            "second": _axis(self.second, self.second_values),
            "error": self.error.tolist(),
            "stable": self.stable.tolist(),
            "others": self.others,
        }


def landscape(
    problem: Problem,
    workers: Workers,
    first: str,
    second: str,
    points: int = 25,
    others: Mapping[str, float] | None = None,
    on_row: Callable[[int, int], None] | None = None,
) -> Landscape:
    """Evaluate a grid over two values of a problem's space.

    Args:
        problem: Whose error it is.
        workers: What evaluates candidates of this problem.
        first: Name of the value along its first side.
        second: Name of the value along its second side.
        points: Points along each side, from bound to bound; fewer if there are not as many whole
            numbers.
        others: Values of the rest of the space, such as the best that a search found; None: those
            in the middle.
        on_row: Told how many first values are done, and how many there are.

    Raises:
        ValueError: The space has no such two values, or another one is out of bounds.
    """
    space = problem.space
    if first == second or not {first, second} <= set(space.names):
        raise ValueError(
            f"no landscape over {first} and {second}; allowed: two of {', '.join(space.names)}"
        )
    if points < 2:
        raise ValueError(f"a landscape of {points} points a side shows nothing; allowed: from 2")
    middle = space.decode(np.full(space.size, 0.5))
    fixed = {name: (others or {}).get(name, middle[name]) for name in space.names}
    row, column = (space.names.index(name) for name in (first, second))
    rows, columns = (_values(space.parameters[place], points) for place in (row, column))
    error = np.empty((len(rows), len(columns)))
    stable = np.empty(error.shape, dtype=np.bool_)
    for number, value in enumerate(rows):
        candidates = np.array(
            [space.encode({**fixed, first: value, second: other}) for other in columns]
        )
        evaluations = workers.evaluate(candidates)
        error[number] = [evaluation.error for evaluation in evaluations]
        stable[number] = [evaluation.stable for evaluation in evaluations]
        if on_row is not None:
            on_row(number + 1, len(rows))
    rest = {name: value for name, value in fixed.items() if name not in (first, second)}
    return Landscape(
        space.parameters[row], space.parameters[column], rows, columns, error, stable, rest
    )


def _values(parameter: FitParameter, points: int) -> NDArray[np.float64]:
    return np.unique([parameter.value(place) for place in np.linspace(0.0, 1.0, points)])


def _axis(parameter: FitParameter, values: NDArray[np.float64]) -> dict[str, Any]:
    return {"name": parameter.name, "log": parameter.log, "values": values.tolist()}
