"""Closure of a hole: against closed forms for discs, squares, slits and saddles."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh.triangles import closest_point

from tissue_sim.geometry.closure import (
    LoopError,
    Pieces,
    area_vector,
    checked_loop,
    disc_of,
    measure,
)
from tissue_sim.geometry.closure_kernels import nearest_places

Reals = NDArray[np.float64]

R = 0.01
"""Radius of the hole [m]."""

NOTHING = np.empty((0, 3, 3))


def ring(radius: float = R, number: int = 120, height: float = 0.0) -> Reals:
    angles = 2.0 * np.pi * np.arange(number) / number
    up = np.full(number, height)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), up], axis=1)


def fan(corners: Reals) -> Reals:
    """Triangles from the middle of a ring to its sides, shape (n, 3, 3)."""
    middle = np.broadcast_to(corners.mean(axis=0), corners.shape)
    return np.stack([middle, corners, np.roll(corners, -1, axis=0)], axis=1)


def pieces(triangles: Reals, thickness: float = 0.0, owner: int = 1) -> Pieces:
    count = len(triangles)
    owners = np.full(count, owner, dtype=np.int32)
    return Pieces(triangles, owners, np.full(count, thickness))


def rectangle(width: float, depth: float, height: float = 0.0, x: float = 0.0) -> Reals:
    flat = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * [width, depth] + [x, -0.5 * depth]
    return np.column_stack([flat, np.full(4, height)])


def test_an_open_hole_is_not_covered_and_as_wide_as_it_is() -> None:
    open_hole = measure(ring(), 0.005, Pieces(), NOTHING)
    assert open_hole.covered == 0.0
    assert open_hole.area == pytest.approx(np.pi * R**2, rel=2e-3)
    assert open_hole.gap == pytest.approx(2 * R, abs=open_hole.sampling)
    assert np.linalg.norm(open_hole.gap_at) < 2 * open_hole.sampling
    assert open_hole.edge_gap == np.inf
    assert open_hole.open_area == open_hole.area


def test_the_widest_circle_fits_around_the_centre_that_is_told() -> None:
    # An equilateral triangle: only one circle is the widest, and its centre is no sample.
    angles = np.radians([90.0, 210.0, 330.0])
    corners = R * np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=1)
    middle = np.array([0.0123, -0.0456, 0.0789])
    found = measure(corners + middle, 0.005, Pieces(), NOTHING)
    assert found.gap == pytest.approx(R, abs=0.3 * found.sampling)
    assert np.linalg.norm(found.gap_at - middle) < 0.3 * found.sampling


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_smaller_disc_covers_the_square_of_its_share_and_leaves_a_ring(share: float) -> None:
    found = measure(ring(), 0.005, pieces(fan(ring(share * R, height=0.002))), NOTHING)
    assert found.covered == pytest.approx(share**2, abs=3e-3)
    assert found.shares == {1: found.by_patches}
    assert found.gap == pytest.approx((1 - share) * R, abs=found.sampling)
    # Along the edge the patch is as far away as the ring is wide, and 2 mm above.
    assert found.edge_gap == pytest.approx(np.hypot((1 - share) * R, 0.002), rel=1e-3)
    assert found.open_area == pytest.approx(np.pi * R**2 * (1 - share**2), abs=3e-3 * np.pi * R**2)


def test_half_a_hole_is_half_covered_and_the_widest_circle_is_half_as_wide() -> None:
    found = measure(ring(), 0.005, pieces(fan(rectangle(2 * R, 3 * R))), NOTHING)
    assert found.covered == pytest.approx(0.5, abs=2e-3)
    assert found.gap == pytest.approx(R, abs=found.sampling)
    assert found.gap_at == pytest.approx([-0.5 * R, 0.0, 0.0], abs=found.sampling)
    assert found.edge_gap == pytest.approx(R, rel=1e-3)


def test_half_a_thickness_beside_a_patch_counts_as_covered() -> None:
    thick = 0.002
    found = measure(ring(), 0.005, pieces(fan(ring(0.5 * R)), thick), NOTHING)
    assert found.covered == pytest.approx(((0.5 * R + 0.5 * thick) / R) ** 2, abs=3e-3)
    whole = measure(ring(), 0.005, pieces(fan(ring(R - 0.4 * thick)), thick), NOTHING)
    assert whole.covered == pytest.approx(1.0)
    assert whole.gap == 0.0
    assert whole.open_area == pytest.approx(0.0, abs=1e-15)
    assert whole.edge_gap == pytest.approx(0.4 * thick, rel=1e-2)


def test_what_is_beyond_the_depth_or_beside_the_hole_covers_nothing() -> None:
    for side in (-1.0, 1.0):
        for away, share in ((0.0049, 1.0), (0.0051, 0.0)):
            lid = fan(ring(2 * R, height=side * away))
            assert measure(ring(), 0.005, pieces(lid), NOTHING).covered == pytest.approx(share)
    beside = fan(ring(height=0.001) + np.array([2.1 * R, 0.0, 0.0]))
    assert measure(ring(), 0.005, pieces(beside), NOTHING).covered == 0.0


def test_two_patches_share_a_hole_and_what_both_cover_counts_once() -> None:
    left, right = fan(rectangle(2 * R, 3 * R, x=-2 * R)), fan(rectangle(2 * R, 3 * R, x=-0.5 * R))
    both = Pieces(
        np.concatenate([left, right]),
        np.repeat(np.array([3, 7], dtype=np.int32), 4),
        np.zeros(8),
    )
    found = measure(ring(), 0.005, both, NOTHING)
    assert found.shares == {3: pytest.approx(0.5, abs=2e-3), 7: pytest.approx(0.5, abs=2e-3)}
    assert found.covered == pytest.approx(1.0)


def test_tissue_counts_where_it_fills_the_hole_and_not_where_it_lies_above() -> None:
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (0, 3)]) * R
    sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    box = corners[[[s[a], s[b], s[c]] for s in sides for a, b, c in ((0, 1, 2), (0, 2, 3))]]
    found = measure(ring(), 0.005, Pieces(), box)
    assert found.by_tissue == pytest.approx(0.5, abs=2e-3)
    assert found.by_patches == 0.0
    assert measure(ring(), 0.005, Pieces(), box + np.array([0, 0, 2 * R])).covered == 0.0
    # Where patch and tissue both are, the patch counts.
    patched = measure(ring(), 0.005, pieces(fan(ring(2 * R))), box)
    assert patched.by_patches == pytest.approx(1.0)
    assert patched.by_tissue == 0.0


def test_figures_do_not_depend_on_place_direction_or_first_corner() -> None:
    patch = fan(ring(0.6 * R, height=0.001))
    before = measure(ring(), 0.005, pieces(patch), NOTHING)
    turn, way = Rotation.from_rotvec([0.4, -1.1, 0.7]), np.array([0.3, -0.2, 0.5])

    def moved(places: Reals) -> Reals:
        return np.asarray(turn.apply(places.reshape(-1, 3)).reshape(places.shape) + way)

    for loop in (ring(), ring()[::-1], np.roll(ring(), 17, axis=0)):
        after = measure(moved(loop), 0.005, pieces(moved(patch)), NOTHING)
        assert after.covered == pytest.approx(before.covered, abs=3e-3)
        assert after.gap == pytest.approx(before.gap, abs=2 * before.sampling)
        assert after.area == pytest.approx(before.area, rel=2e-3)


def test_the_disc_of_a_saddle_is_as_large_as_the_saddle() -> None:
    loop = ring()
    loop[:, 2] = 0.3 * (loop[:, 0] ** 2 - loop[:, 1] ** 2) / R
    # z = c (x^2 - y^2) is harmonic; its area in r < R is a closed form.
    slope = 0.6
    exact = 2 * np.pi * R**2 / (3 * slope**2) * ((1 + slope**2) ** 1.5 - 1)
    assert float(disc_of(loop).areas.sum()) == pytest.approx(exact, rel=3e-3)


def test_a_tilted_plane_is_spanned_exactly_and_smoothly() -> None:
    disc = disc_of(rectangle(R, 2 * R) @ Rotation.from_rotvec([0.5, 0.2, 0.0]).as_matrix().T)
    assert np.abs(disc.grid.heights[disc.grid.inside]).max() < 1e-12
    assert float(disc.areas.sum()) == pytest.approx(2 * R**2, rel=3e-3)


def test_the_error_shrinks_with_the_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    patch, share = pieces(fan(ring(0.7 * R))), 0.49
    errors = []
    for samples in (16, 64, 256):
        monkeypatch.setattr("tissue_sim.geometry.closure.SAMPLES", samples)
        places = [ring() @ Rotation.from_rotvec([0, 0, k]).as_matrix() for k in range(4)]
        found = [measure(loop, 0.005, patch, NOTHING) for loop in places]
        errors.append(
            max(
                np.sqrt(np.mean([(one.covered - share) ** 2 for one in found])),
                np.sqrt(np.mean([(one.gap - 0.3 * R) ** 2 for one in found])) / (100 * R),
            )
        )
    # The corners of a grid that is twice as fine are half as far off, and there are more of them.
    assert all(later < 0.5 * earlier for earlier, later in pairwise(errors))
    assert errors[-1] < 1e-3


def test_lips_drawn_together_close_a_hole_by_shrinking_it() -> None:
    for width in (1.0, 0.3, 0.03, 0.0, -0.05):
        loop = ring() * [1.0, width, 1.0]
        found = measure(loop, 0.005, Pieces(), NOTHING)
        # Lips that have wholly passed each other are a hole seen from behind.
        assert found.area == pytest.approx(abs(width) * np.pi * R**2, abs=2e-3 * np.pi * R**2)
        assert found.gap == pytest.approx(2 * abs(width) * R, abs=found.sampling)
        if width == 0.0:
            assert (found.covered, found.gap, found.open_area) == (1.0, 0.0, 0.0)


def test_where_lips_have_passed_each_other_nothing_is_open() -> None:
    flat = np.array([[0, -3], [4, 1], [4, -1], [0, 3]]) * R
    loop = np.column_stack([flat, np.zeros(4)])
    # A large lobe of the one sense, a small one of the other.
    assert np.linalg.norm(area_vector(loop)) == pytest.approx(8 * R**2)
    assert float(disc_of(loop).areas.sum()) == pytest.approx(9 * R**2, rel=5e-3)


def test_the_closest_places_are_those_of_another_library() -> None:
    rng = np.random.default_rng(3)
    triangles, places = rng.normal(size=(40, 3, 3)), rng.normal(size=(60, 3))
    triangles[3:] *= 0.1
    triangles[3:] += rng.normal(size=(37, 1, 3))
    distances, nearest = np.empty(60), np.empty(60, dtype=np.int64)
    weights = np.empty((60, 3))
    nearest_places(triangles, places, distances, nearest, weights)
    pairs = [
        np.linalg.norm(closest_point(triangles, np.repeat(place[None], 40, axis=0)) - place, axis=1)
        for place in places
    ]
    np.testing.assert_allclose(distances, np.min(pairs, axis=1), atol=1e-12)
    found = np.einsum("ij,ijk->ik", weights, triangles[nearest])
    np.testing.assert_allclose(np.linalg.norm(found - places, axis=1), distances, atol=1e-12)


EIGHT = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]]) * R
BENT = np.array([[0, -3, 0], [4, 1, 0], [4, -1, 0], [0, 3, 0]]) * R


@pytest.mark.parametrize(
    ("loop", "text"),
    [
        (np.full((4, 3), np.nan), "not finite"),
        (np.array([[0, 0, 0], [np.inf, 0, 0], [0, 1, 0]]), "not finite"),
        (1e200 * ring(), "allowed: up to 1000 m"),
        (np.empty((0, 3)), "0 different positions"),
        (ring()[:2], "2 different positions"),
        (np.repeat(ring()[:2], 2, axis=0), "2 different positions"),
        (np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]]) * R, "encloses no area"),
        (EIGHT, "encloses no area"),
        (BENT, "crosses itself"),
    ],
)
def test_a_loop_that_is_no_edge_of_a_hole_is_refused(loop: Reals, text: str) -> None:
    with pytest.raises(LoopError, match=text):
        checked_loop(loop)


def test_a_loop_may_end_where_it_begins_and_bend_inwards() -> None:
    flower = ring(R, 60) * (1.0 + 0.4 * np.cos(5 * np.linspace(0, 2 * np.pi, 60, False)))[:, None]
    closed = np.concatenate([flower, flower[:1]])
    assert len(checked_loop(closed)) == 60
    assert float(disc_of(flower).areas.sum()) == pytest.approx(
        float(np.linalg.norm(area_vector(flower))), rel=3e-3
    )
