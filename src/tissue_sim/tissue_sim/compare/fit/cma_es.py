"""CMA-ES by the library `cma`: an evolution strategy that learns the shape of the valley."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.fit.strategy import LARGEST, check_settings

QUIET = {"verbose": -9, "verb_disp": 0, "verb_log": 0}
SAME = 1e-7
"""Errors that differ by less are the same: it is what rounding does to them in single precision."""

LEAST_SIZE = 2
"""The library does not support one coordinate: a second one is carried along that nobody reads."""


class CmaEs:
    """Normally distributed candidates around a mean; steps, scales and directions are learnt.

    The candidates stay in the unit cube by the library's smooth transformation of bounds.

    Limitations: made for real numbers; on the plateaus of whole numbers it stops early.

    References:
        N. Hansen, The CMA evolution strategy: a tutorial, 2016, arXiv 1604.00772; N. Hansen, Y.
        Akimoto, P. Baudis, CMA-ES/pycma, doi 10.5281/zenodo.2559634.
    """

    def __init__(
        self,
        size: int,
        seed: int,
        population: int = 12,
        start: NDArray[np.float64] | None = None,
        width: float = 0.3,
    ) -> None:
        """Start with a wide distribution.

        Args:
            size: Number of coordinates.
            seed: Of all random numbers, from 0.
            population: Number of candidates in a generation.
            start: Mean of the first generation, shape (size,); None: the middle of the cube.
            width: Standard deviation of the first generation.

        Raises:
            ValueError: A number is out of range.
        """
        check_settings(
            seed=(seed, 0, LARGEST), population=(population, 4, LARGEST), width=(width, 1e-6, 1)
        )
        import cma  # brings matplotlib and scipy.stats: one or two seconds

        self.settings: dict[str, Any] = {
            "algorithm": "cma_es", "seed": seed, "population": population, "width": width,
            "start": None if start is None else list(map(float, start)),
            "library": f"cma {cma.__version__}",
        }  # fmt: skip
        self._size = size
        mean = np.full(max(size, LEAST_SIZE), 0.5)
        if start is not None:
            mean[:size] = start
        rng = np.random.Generator(np.random.PCG64(seed))
        options = {
            "bounds": [0.0, 1.0], "popsize": population, "randn": _normal(rng), "seed": np.nan,
            "tolfun": SAME, **QUIET,
        }  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._strategy = cma.CMAEvolutionStrategy(mean, width, options)
        self._asked: list[NDArray[np.float64]] = []
        self._told: list[list[float]] = []

    @property
    def finished(self) -> bool:
        """Whether one of the library's criteria is met, such as that errors no longer differ."""
        return bool(self._strategy.stop())

    def ask(self) -> NDArray[np.float64]:
        """Draw a generation."""
        self._asked = self._strategy.ask()
        return np.array(self._asked)[:, : self._size]

    def tell(self, candidates: NDArray[np.float64], errors: NDArray[np.float64]) -> None:
        """Move the distribution to the better ones.

        Raises:
            ValueError: These are not the candidates of the last `ask`.
        """
        if not np.array_equal(candidates, np.array(self._asked)[:, : self._size]):
            raise ValueError("CMA-ES is told errors of candidates that it did not ask for")
        self._strategy.tell(self._asked, errors.tolist())
        self._told.append(errors.tolist())

    def state(self) -> dict[str, Any]:
        """The errors of all generations: with them the same generations come again."""
        return {"errors": self._told}

    def restore(self, state: dict[str, Any]) -> None:
        """Draw the same generations and tell the same errors; only for a strategy that is new.

        Raises:
            ValueError: This is no state of such a strategy.
        """
        try:
            generations = np.array(state["errors"], dtype=np.float64)
            for errors in generations.reshape(-1, self.settings["population"]):
                self.tell(self.ask(), errors)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"no state of CMA-ES: {error!r}") from error


def _normal(rng: np.random.Generator) -> Any:
    """Random numbers of its own for the library, which takes numpy's global ones otherwise."""
    return lambda *shape: rng.standard_normal(shape)
