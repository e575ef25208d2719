"""Quick ways to evaluate tubes and to order faces are what the plain ways are, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tissue_sim.geometry.faces import order_of_triples
from tissue_sim.geometry.implicit import tube
from tissue_sim.geometry.neighbourhood import by_neighbourhood

Reals = NDArray[np.float64]


def plain_tube(points: Reals, line: Reals, radii: Reals) -> Reals:
    """Least distance to all cones, in the order of operations that the heart's bits rest on."""
    nearest = np.full(len(points), np.inf)
    for start, end, r0, r1 in zip(line[:-1], line[1:], radii[:-1], radii[1:], strict=True):
        a, p = end - start, points - start
        share = (p[:, 0] * a[0] + p[:, 1] * a[1] + p[:, 2] * a[2]) / (
            a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
        )
        share = np.clip(share, 0.0, 1.0)
        q = p - share[:, None] * a
        length = np.sqrt(q[:, 0] * q[:, 0] + q[:, 1] * q[:, 1] + q[:, 2] * q[:, 2])
        nearest = np.minimum(nearest, length - (r0 + share * (r1 - r0)))
    return nearest


@pytest.mark.parametrize("spread", [0.5, 5.0, 50.0])
def test_a_tube_is_the_least_distance_to_its_cones_bit_for_bit(spread: float) -> None:
    random = np.random.default_rng(3)
    line = np.cumsum(random.normal(0.0, 2.0, (30, 3)), axis=0)
    radii = random.uniform(0.5, 4.0, 30)
    points = line[12] + random.normal(0.0, spread, (1000, 3))
    assert np.array_equal(tube(points, line, radii), plain_tube(points, line, radii))


def test_taking_places_by_neighbourhood_changes_no_bit() -> None:
    random = np.random.default_rng(4)
    points = random.uniform(-30.0, 30.0, (40_000, 3))
    line = random.normal(0.0, 15.0, (8, 3))
    near = by_neighbourhood(lambda some: tube(some, line, 2.0), points)
    assert np.array_equal(near, tube(points, line, 2.0))
    same = by_neighbourhood(lambda some: some[:, 0] + 0.0, np.ones((20_000, 3)))
    assert (same == 1.0).all()


@pytest.mark.parametrize(
    ("count", "nodes"), [(0, 1), (1, 9), (4000, 3), (20_000, 5000), (9, 10**6)]
)
def test_triples_are_ordered_as_a_stable_sort_orders_them(count: int, nodes: int) -> None:
    triples = np.random.default_rng(5).integers(0, nodes, (count, 3))
    expected = np.lexsort((triples[:, 2], triples[:, 1], triples[:, 0]))
    assert np.array_equal(order_of_triples(triples), expected)
