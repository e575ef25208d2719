from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tissue_interfaces.srv import Cut
from trimesh.triangles import closest_point

from cut_service.errors import CutCode, SweepError
from cut_service.sweep import MAX_TRIANGLES, Sweep
from cut_service.sweep_kernels import EDGES, crossed_edges

SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
HALVES = [[0, 1, 2], [0, 2, 3]]


def test_codes_are_those_of_the_service() -> None:
    assert {code.name: code.value for code in CutCode} == {
        code.name: getattr(Cut.Response, code.name) for code in CutCode
    }


@pytest.mark.parametrize(
    ("vertices", "triangles", "words"),
    [
        ([[0, 0, np.nan], *SQUARE[1:]], HALVES, "not finite"),
        ([[0, 0, np.inf], *SQUARE[1:]], HALVES, "not finite"),
        ([[0, 0, 1e200], *SQUARE[1:]], HALVES, "1e.200 m away; allowed: up to 1e.06 m"),
        (SQUARE, [], "0 triangles"),
        ([], [], "0 triangles"),
        (SQUARE, [[0, 1, 4]], "outside 0 to 3"),
        (SQUARE, [[0, 1, -1]], "outside 0 to 3"),
        ([0.0, 1.0], [0, 1, 2], "three numbers"),
        (SQUARE, [0, 1], "three numbers"),
        ([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]], "degenerate"),
        ([[0, 0, 0]], [[0, 0, 0]], "degenerate"),
        (SQUARE, [[0, 1, 2]] * (MAX_TRIANGLES + 1), "allowed: 1 to"),
    ],
)
def test_refuses_what_is_no_surface(vertices: list, triangles: list, words: str) -> None:
    with pytest.raises(SweepError, match=words) as caught:
        Sweep.from_arrays(vertices, triangles)
    assert caught.value.code == CutCode.INVALID_SWEEP


def test_leaves_out_triangles_without_area() -> None:
    sweep = Sweep.from_arrays(SQUARE, [[0, 1, 1], [0, 1, 2]])
    assert sweep.triangles.tolist() == [[0, 1, 2]]


def test_refuses_a_sweep_enormous_beside_the_organ() -> None:
    sweep = Sweep.from_arrays(SQUARE, HALVES)
    sweep.check_size(np.zeros(3), np.full(3, 0.1))
    with pytest.raises(SweepError, match="units metres"):
        sweep.check_size(np.zeros(3), np.full(3, 0.001))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_closest_points_equal_trimesh(seed: int) -> None:
    random = np.random.default_rng(seed)
    sweep = Sweep.from_arrays(random.normal(size=(5, 3)), [[0, 1, 2], [1, 2, 3], [2, 3, 4]])
    points = random.normal(size=(7, 3)) * 2
    nearest, distances, _ = sweep.closest(points)
    expected = np.stack(
        [closest_point(np.repeat(c[None], len(points), axis=0), points) for c in sweep.corners]
    )
    best = np.linalg.norm(expected - points, axis=2).min(axis=0)
    np.testing.assert_allclose(distances, best, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(nearest - points, axis=1), best, atol=1e-12)
    np.testing.assert_allclose(np.abs(sweep.signed_distance(points)), best, atol=1e-12)


def crossed(points: np.ndarray, sweep: Sweep) -> set[tuple[int, int]]:
    masks = np.zeros(1, dtype=np.uint8)
    tets = np.array([[0, 1, 2, 3]], dtype=np.int32)
    rows = np.array([0], dtype=np.int32)
    crossed_edges(points, tets, rows, sweep.vertices, sweep.triangles, masks)
    return {(int(i), int(j)) for k, (i, j) in enumerate(EDGES) if masks[0] >> k & 1}


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_crossings_equal_a_linear_solve(seed: int) -> None:
    random = np.random.default_rng(seed)
    points = random.normal(size=(4, 3))
    sweep = Sweep.from_arrays(random.normal(size=(3, 3)) * 2, [[0, 1, 2]])
    a, b, c = sweep.corners[0]
    expected = set()
    for i, j in EDGES.tolist():
        # p + t (q - p) = a + u (b - a) + v (c - a)
        p, q = points[i], points[j]
        t, u, v = np.linalg.solve(np.stack([p - q, b - a, c - a], axis=1), p - a)
        if 0 < t < 1 and u > 0 and v > 0 and u + v < 1:
            expected.add((i, j))
    assert crossed(points, sweep) == expected


@pytest.mark.parametrize("where", [0.25, 0.5, 0.1])
def test_no_edge_slips_through_where_triangles_meet(where: float) -> None:
    # All edges from the apex pass exactly through the diagonal that the two triangles share.
    points = np.array([[where, where, 1.0], [where, where, -1.0], [where, where, -2.0],
                       [where, where, -0.5]])  # fmt: skip
    assert crossed(points, Sweep.from_arrays(SQUARE, HALVES)) == {(0, 1), (0, 2), (0, 3)}
    turned = Sweep.from_arrays(SQUARE, [[0, 1, 2], [3, 2, 0]])
    assert crossed(points, turned) == {(0, 1), (0, 2), (0, 3)}
    flipped = Sweep.from_arrays(SQUARE, [[0, 1, 2], [0, 3, 2]])
    assert crossed(points, flipped) == {(0, 1), (0, 2), (0, 3)}


def test_a_strip_between_two_poses_has_the_swept_area() -> None:
    blade = np.linspace([0, 0, 0], [0, 0, 0.03], 4)
    sweep = Sweep.between(blade, blade + np.array([0.02, 0, 0]))
    corners = sweep.corners
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert 0.5 * np.linalg.norm(cross, axis=1).sum() == pytest.approx(0.0006)
