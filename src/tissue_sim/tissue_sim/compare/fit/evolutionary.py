"""The thesis' evolutionary algorithm (THESIS.md, section 6)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.fit.strategy import LARGEST, check_settings


class Evolutionary:
    """Tournament selection, recombination to the mean, small mutations; the best survives.

    A child is its parent or, with the probability `crossover`, the mean of two; with the
    probability `mutation` a normally distributed number is added to each of its coordinates. The
    parents are the winners of tournaments. The best of a generation lives on in the next one and is
    not evaluated again.

    What the thesis does not say, and we chose: tournaments of two, mutations of 0.2 of the range in
    the first generation and 0.85 times that in each further one. See docs/search.md.
    """

    def __init__(
        self,
        size: int,
        seed: int,
        population: int = 40,
        start: NDArray[np.float64] | None = None,
        crossover: float = 0.5,
        mutation: float = 0.5,
        rivals: int = 2,
        width: float = 0.2,
        shrink: float = 0.85,
    ) -> None:
        """Start with a population scattered over the unit cube.

        Args:
            size: Number of coordinates.
            seed: Of all random numbers, from 0.
            population: Number of individuals; 20 to 45 in the thesis.
            start: A point that is one of the first, shape (size,); None: none.
            crossover: Share of children that have two parents.
            mutation: Share of children that are mutated.
            rivals: Individuals in a tournament.
            width: Standard deviation of a mutation in the first generation of children.
            shrink: What multiplies it from one generation to the next.

        Raises:
            ValueError: A number is out of range.
        """
        check_settings(
            seed=(seed, 0, LARGEST), population=(population, 4, LARGEST),
            rivals=(rivals, 1, population), crossover=(crossover, 0, 1), mutation=(mutation, 0, 1),
            width=(width, 1e-6, 1), shrink=(shrink, 0.1, 1),
        )  # fmt: skip
        self.settings: dict[str, Any] = {
            "algorithm": "evolutionary", "seed": seed, "population": population,
            "crossover": crossover, "mutation": mutation, "rivals": rivals, "width": width,
            "shrink": shrink, "start": None if start is None else list(map(float, start)),
        }  # fmt: skip
        self._size, self._population, self._rivals = size, population, rivals
        self._crossover, self._mutation = crossover, mutation
        self._width, self._shrink = width, shrink
        self._start = start
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._generation = 0
        self._people = np.empty((0, size))
        self._errors = np.empty(0)

    @property
    def finished(self) -> bool:
        """Never: it ends when nobody asks any more."""
        return False

    def ask(self) -> NDArray[np.float64]:
        """The first population, then the children of each generation."""
        if self._generation == 0:
            scattered = self._rng.random((self._population, self._size))
            if self._start is not None:
                scattered[0] = self._start
            return scattered
        return self._children(self._population - 1)

    def tell(self, candidates: NDArray[np.float64], errors: NDArray[np.float64]) -> None:
        """Let the children, and the best of those before them, be the next generation."""
        people, known = np.array(candidates), np.array(errors, dtype=np.float64)
        if self._generation:
            best = int(np.argmin(self._errors))
            people = np.concatenate([self._people[best : best + 1], people])
            known = np.concatenate([self._errors[best : best + 1], known])
        self._people, self._errors = people, known
        self._generation += 1

    def state(self) -> dict[str, Any]:
        """Population, its errors and the state of the random numbers."""
        return {
            "generation": self._generation,
            "people": self._people.tolist(),
            "errors": self._errors.tolist(),
            "random": self._rng.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from there.

        Raises:
            ValueError: This is no state of such a strategy.
        """
        try:
            people = np.array(state["people"], dtype=np.float64).reshape(-1, self._size)
            errors = np.array(state["errors"], dtype=np.float64)
            generation, random = int(state["generation"]), state["random"]
            self._rng.bit_generator.state = random
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"no state of the evolutionary algorithm: {error!r}") from error
        if len(people) != len(errors) or len(people) != (self._population if generation else 0):
            raise ValueError(f"a state with {len(people)} individuals is not one of this strategy")
        self._people, self._errors, self._generation = people, errors, generation

    def _children(self, count: int) -> NDArray[np.float64]:
        mother, father = self._winners(count), self._winners(count)
        paired = self._rng.random(count) < self._crossover
        mutated = self._rng.random(count) < self._mutation
        added = self._rng.normal(0.0, self._mutation_width, (count, self._size))
        children = np.where(paired[:, None], 0.5 * (mother + father), mother)
        children += np.where(mutated[:, None], added, 0.0)
        clipped: NDArray[np.float64] = children.clip(0.0, 1.0)
        return clipped

    def _winners(self, count: int) -> NDArray[np.float64]:
        """The best of `rivals` individuals drawn for each of `count` tournaments."""
        drawn = self._rng.integers(len(self._people), size=(count, self._rivals))
        best = self._errors[drawn].argmin(axis=1)
        return self._people[drawn[np.arange(count), best]]

    @property
    def _mutation_width(self) -> float:
        return self._width * self._shrink ** (self._generation - 1)
