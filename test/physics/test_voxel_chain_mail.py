"""3D ChainMail on voxels keeps every limit, moves nothing that need not move, and relaxes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tissue_sim.elastic.voxel_chain_mail import LinkLimits, VoxelChainMail

SPACING = (0.002, 0.003, 0.004)
LIMITS = LinkLimits((0.0015, 0.002, 0.003), (0.003, 0.0035, 0.0045), (0.0005, 0.001, 0.0002))


def grid(size: tuple[int, int, int] = (5, 4, 6), fixed: bool = False) -> VoxelChainMail:
    mask = np.zeros(size, dtype=np.bool_)
    mask[:, :, 0] = fixed
    return VoxelChainMail(size, SPACING, LIMITS, mask, np.float64)


def most_beyond(voxels: VoxelChainMail, free: np.ndarray | None = None) -> float:
    """How far the worst link is beyond its limits [m]; of links between voxels of a mask."""
    x, worst = voxels.positions, -np.inf
    keep = voxels.filled if free is None else voxels.filled & free
    for axis in range(3):
        first = np.moveaxis(x, axis, 0)
        both = np.moveaxis(keep, axis, 0)
        link = (first[1:] - first[:-1])[both[1:] & both[:-1]]
        if not len(link):
            continue
        for c in range(3):
            if c == axis:
                low, high = LIMITS.nearest[axis], LIMITS.farthest[axis]
            else:
                low, high = -LIMITS.shear[axis], LIMITS.shear[axis]
            worst = max(worst, (low - link[:, c]).max(), (link[:, c] - high).max())
    return worst


def test_a_pulled_row_gives_its_slack_link_by_link() -> None:
    voxels = VoxelChainMail((12, 1, 1), SPACING, LIMITS, dtype=np.float64)
    slack, pull = LIMITS.farthest[0] - SPACING[0], 0.0065
    voxels.move([11, 0, 0], [pull, 0, 0])
    links = np.arange(12)[::-1]
    expected = np.maximum(pull - links * slack, 0)
    np.testing.assert_allclose(voxels.displacement[:, 0], expected, atol=1e-15)
    assert voxels.moved == 6
    voxels.relax(2000, 1.9)
    voxels.move([11, 0, 0], [0, 0.004, 0])
    np.testing.assert_allclose(
        voxels.displacement[:, 1], np.maximum(0.004 - links * LIMITS.shear[0], 0), atol=1e-12
    )


def test_every_voxel_that_one_moves_is_visited_once() -> None:
    voxels = grid((9, 9, 9))
    voxels.move([2, 3, 4], [0.003, -0.002, 0.0015])
    assert 50 < voxels.moved < 9**3
    assert voxels.visits == voxels.moved + 1
    assert (voxels.displacement != 0).any(axis=1).sum() == voxels.moved + 1


places = st.tuples(st.integers(0, 4), st.integers(0, 3), st.integers(1, 5))
way = st.floats(-0.01, 0.01)
moves = st.lists(st.tuples(places, st.tuples(way, way, way)), min_size=1, max_size=8)


@settings(max_examples=60, deadline=None)
@given(moves, st.lists(places, max_size=12), st.booleans())
def test_limits_hold_after_any_moves_around_any_holes(
    moves: list[tuple[tuple[int, int, int], tuple[float, float, float]]],
    holes: list[tuple[int, int, int]],
    fixed: bool,
) -> None:
    voxels = grid(fixed=fixed)
    if holes:
        voxels.remove(holes)
    for place, way in moves:
        voxels.move(place, way)
        still = voxels._grid.prescribed.reshape(voxels.size)
        assert most_beyond(voxels, ~still) < 1e-12
        voxels.relax(3, 1.5)
        assert most_beyond(voxels, ~still) < 1e-12
        voxels.release()
        assert most_beyond(voxels) < 1e-12
    assert np.isfinite(voxels.displacement).all()


def test_several_voxels_moved_to_where_the_limits_let_them_keep_all_limits() -> None:
    voxels = grid((9, 8, 7))
    voxels.move([[0, 0, 0], [8, 7, 6]], [[-0.004, 0, 0], [0.003, 0.001, 0]])
    assert most_beyond(voxels) < 1e-12
    assert not voxels.displacement[voxels.rows([4, 4, 4])].any()


def test_nothing_passes_a_removed_layer() -> None:
    voxels = grid((7, 3, 3))
    voxels.remove([[3, y, z] for y in range(3) for z in range(3)])
    voxels.move([6, 1, 1], [0.02, 0.02, 0.02])
    left = voxels.displacement.reshape(7, 3, 3, 3)[:4]
    assert not left.any()


def test_it_returns_to_rest_after_a_release() -> None:
    voxels = grid((9, 9, 9), fixed=True)
    voxels.move([4, 4, 8], [0.002, 0.001, 0.003])
    voxels.release()
    peak = np.abs(voxels.displacement).max()
    voxels.relax(40, 1.7)
    assert np.abs(voxels.displacement).max() < 0.05 * peak


def test_the_rest_and_a_moved_grid_stay_bit_for_bit() -> None:
    voxels = VoxelChainMail((4, 4, 4), SPACING, LIMITS)
    voxels.move([1, 1, 1], [0, 0, 0])
    voxels.relax(5)
    assert not voxels.displacement.any()
    voxels.displacement[:] = [0.01, -0.02, 0.005]
    before = voxels.displacement.copy()
    voxels.relax(5, 1.9)
    voxels.release()
    np.testing.assert_array_equal(voxels.displacement, before)


@pytest.mark.parametrize(
    ("size", "limits", "message"),
    [
        ((0, 4, 4), LIMITS, "size = .* allowed: three numbers"),
        ((4, 4, 4), LinkLimits((0.003,) * 3, (0.004,) * 3, (0,) * 3), "along axis 0 .* nearest <="),
        ((4, 4, 4), LinkLimits((0,) * 3, (0.01,) * 3, (-1, 0, 0)), "shear = -1 m is out of range"),
    ],
)
def test_bad_grids_are_refused(
    size: tuple[int, int, int], limits: LinkLimits, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        VoxelChainMail(size, SPACING, limits)


def test_bad_requests_are_refused() -> None:
    voxels = grid()
    with pytest.raises(ValueError, match="outside of the grid"):
        voxels.move([5, 0, 0], [0, 0, 0])
    with pytest.raises(ValueError, match="not finite"):
        voxels.move([0, 0, 0], [np.nan, 0, 0])
    with pytest.raises(ValueError, match="rate = 2 is out of range"):
        voxels.relax(1, 2.0)
