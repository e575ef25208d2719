"""The stiffness against a patch: learned from motions, bounded by what was sensed."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tissue_sim.interaction.patch_stiffness import SMALLEST_SHARE, LearnedStiffness

seeds = st.integers(0, 2**32 - 1)


def positive(random: np.random.Generator) -> np.ndarray:
    """A symmetric positive definite matrix whose scales differ as those of metres and radians."""
    square = random.normal(size=(6, 6)) * np.array([30.0] * 3 + [0.3] * 3)
    matrix: np.ndarray = square.T @ square + np.diag([100.0] * 3 + [0.01] * 3)
    return matrix


def sensing(sensed: np.ndarray) -> LearnedStiffness:
    learned = LearnedStiffness()
    learned.sense(*np.linalg.eigh(sensed))
    return learned


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_linear_tissue_is_known_after_motions_in_all_directions(seed: int) -> None:
    random = np.random.default_rng(seed)
    tissue = positive(random)
    learned = sensing(tissue + positive(random))
    for motion in np.linalg.qr(random.normal(size=(6, 6)))[0] * ([0.01] * 3 + [1.0] * 3):
        learned.learn(motion, -tissue @ motion)
    scale = np.sqrt(np.diag(tissue))
    assert np.abs((learned.matrix - tissue) / np.outer(scale, scale)).max() < 1e-6


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_whatever_forces_say_the_stiffness_stays_between_none_and_what_was_sensed(
    seed: int,
) -> None:
    random = np.random.default_rng(seed)
    sensed = positive(random)
    learned = sensing(sensed)
    for _ in range(10):
        learned.learn(random.normal(size=6) * 1e-3, random.normal(size=6) * 10.0)
    root = np.linalg.cholesky(sensed)
    share = np.linalg.solve(root, np.linalg.solve(root, learned.matrix).T)
    values = np.linalg.eigvalsh(0.5 * (share + share.T))
    assert values.min() > 0.99 * SMALLEST_SHARE
    assert values.max() < 1.0 + 1e-9


def test_forgetting_goes_back_to_what_was_sensed() -> None:
    sensed = np.diag([100.0] * 3 + [0.1] * 3)
    learned = sensing(sensed)
    np.testing.assert_allclose(learned.matrix, sensed)
    motion = np.array([1e-3, 0, 0, 0, 0, 0])
    learned.learn(motion, np.array([-0.03, 0, 0, 0, 0, 0]))
    np.testing.assert_allclose(learned.matrix[0, 0], 30.0)
    learned.forget()
    learned.sense(*np.linalg.eigh(sensed))
    np.testing.assert_allclose(learned.matrix, sensed)
