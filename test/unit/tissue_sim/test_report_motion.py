"""How tools moved, against sessions whose figures are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial.legendre import leggauss

from tissue_sim.report.coordination import coordination_of
from tissue_sim.report.loads import load_of
from tissue_sim.report.motion import motion_of, movements_of, path_length, speeds_of, working_space
from tissue_sim.report.smoothness import (
    HIGHEST_HZ,
    LEAST_SHARE,
    log_dimensionless_jerk,
    spectral_arc_length,
)

RATE = 60.0
RADIUS = 0.02


def circle(turns: float = 1.0, seconds: float = 4.0) -> np.ndarray:
    """A circle in a tilted plane, at constant speed."""
    angle = np.linspace(0.0, 2 * np.pi * turns, round(seconds * RATE) + 1)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
    return RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ tilt + [0.1, 0.2, 0.3]


def minimum_jerk(way: float, seconds: float, rate: float = RATE) -> np.ndarray:
    """Positions along a straight line, at rest at both ends (Flash and Hogan 1985)."""
    share = np.linspace(0.0, 1.0, round(seconds * rate) + 1)
    along = share**3 * (10 - 15 * share + 6 * share**2)
    return np.outer(along, way * np.array([0.6, 0.0, 0.8]))


def minimum_jerk_speed(rate: float, seconds: float = 1.0) -> np.ndarray:
    share = np.linspace(0.0, 1.0, round(seconds * rate) + 1)
    return 30.0 * share**2 * (1 - share) ** 2 / seconds


def test_a_circle_is_as_long_as_its_circumference_and_spans_its_disc() -> None:
    found = motion_of(circle(), RATE)
    assert found.path == pytest.approx(2 * np.pi * RADIUS, rel=1e-4)
    assert found.space is not None
    assert found.space.hull_volume == 0.0
    assert found.space.hull_area == pytest.approx(np.pi * RADIUS**2, rel=1e-3)
    assert found.space.box == pytest.approx([2 * RADIUS, 1.2 * RADIUS, 1.6 * RADIUS], rel=1e-3)
    assert found.mean_speed == pytest.approx(2 * np.pi * RADIUS / 4.0, rel=1e-2)
    assert (found.movements, found.idle) == (1, 0.0)
    assert found.straightness == pytest.approx(0.0, abs=1e-9)


def test_the_hull_of_a_cube_is_the_cube() -> None:
    corners = np.stack(np.meshgrid(*[[0.0, 0.01]] * 3), axis=-1).reshape(-1, 3)
    space = working_space(np.concatenate([corners, corners.mean(axis=0)[None]]))
    assert space.hull_volume == pytest.approx(1e-6)
    assert space.hull_area == pytest.approx(6e-4)
    assert working_space(corners[:1]).hull_area == 0.0
    assert working_space(corners[[0, 7, 0]]).hull_area == 0.0


def test_a_straight_reach_is_straight_and_stays_where_it_ends() -> None:
    reach = minimum_jerk(0.05, 1.0)
    still = np.repeat(reach[-1:], 60, axis=0)
    back = reach[::-1]
    found = motion_of(np.concatenate([reach, still, back]), RATE)
    assert found.path == pytest.approx(0.10)
    assert found.straightness == pytest.approx(1.0)
    assert found.movements == 2
    # Slower than 5 mm/s is idle: the second at rest, and the ends of both reaches.
    share = np.linspace(0.0, 1.0, 100_001)
    slow = float((30 * 0.05 * share**2 * (1 - share) ** 2 < 0.005).mean())
    assert found.moving == pytest.approx(2.0 * (1.0 - slow), abs=0.05)
    assert found.idle == pytest.approx(1.0 + slow, abs=0.05)
    assert found.space is not None
    assert found.space.hull_area == 0.0


def arc_length_by_quadrature(apart: float = 0.0) -> float:
    """SPARC of a minimum jerk movement of 1 s, from its Fourier integral, without any FFT.

    Made twice, the second one some time after the first began [s]: a shift by t multiplies the
    spectrum by exp(-2 pi i f t).
    """
    nodes, weights = leggauss(60)
    time = 0.5 * (nodes + 1.0)
    speed = 30.0 * time**2 * (1 - time) ** 2 * 0.5 * weights
    frequency = np.linspace(0.0, HIGHEST_HZ, 40_001)
    spectrum = np.abs(np.exp(-2j * np.pi * np.outer(frequency, time)) @ speed)
    spectrum *= np.abs(1 + np.exp(-2j * np.pi * frequency * apart)) / 2
    last = int(np.flatnonzero(spectrum >= LEAST_SHARE)[-1])
    across = np.diff(frequency[: last + 1]) / frequency[last]
    return -float(np.hypot(across, np.diff(spectrum[: last + 1])).sum())


@pytest.mark.parametrize("rate", [60.0, 250.0])
def test_arc_length_of_a_minimum_jerk_movement_is_its_fourier_integrals(rate: float) -> None:
    expected = arc_length_by_quadrature()
    assert expected == pytest.approx(-1.408, abs=1e-3)
    assert spectral_arc_length(minimum_jerk_speed(rate), rate) == pytest.approx(expected, abs=0.01)


def test_arc_length_goes_on_where_the_spectrum_comes_back_above_its_share() -> None:
    """Of two movements it is 0 at 0.33 Hz and odd multiples; the last frequency above 5 % counts.

    The cusps there are cut off by the spacing of the spectrum, which is that of the paper's code.
    """
    one = minimum_jerk_speed(RATE)[:-1]
    two = np.concatenate([one, np.zeros(round(0.5 * RATE)), one])
    expected = arc_length_by_quadrature(1.5)
    assert expected < arc_length_by_quadrature() - 1.5
    assert spectral_arc_length(two, RATE) == pytest.approx(expected, rel=0.02)


def test_log_dimensionless_jerk_of_a_minimum_jerk_movement_is_its_integral() -> None:
    """The integral of v''^2 is 720, the peak 15/8: -ln(720 / (15/8)^2) = -ln(204.8)."""
    assert log_dimensionless_jerk(minimum_jerk_speed(2000.0), 2000.0) == pytest.approx(
        -np.log(204.8), abs=5e-3
    )


@settings(max_examples=20, deadline=None)
@given(st.floats(0.01, 100.0), st.floats(0.7, 3.0))
def test_smoothness_does_not_depend_on_size_or_duration(size: float, seconds: float) -> None:
    """The same number of samples of the same movement, larger and slower."""
    speed = minimum_jerk_speed(100.0)
    for smoothness in (spectral_arc_length, log_dimensionless_jerk):
        # Only the cut-off at 10 Hz knows seconds; it is far above this movement's spectrum.
        assert smoothness(size * speed, 100.0 / seconds) == pytest.approx(smoothness(speed, 100.0))


def test_each_pause_makes_a_movement_less_smooth() -> None:
    """As in figure 3 of Balasubramanian et al. (2015): more and farther submovements."""
    one = minimum_jerk_speed(RATE)
    still = np.zeros(30)
    lengths = [
        spectral_arc_length(np.concatenate([one, *[still, one] * pauses]), RATE)
        for pauses in range(4)
    ]
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[0] - lengths[3] > 1.0


@pytest.mark.parametrize("speed", [np.zeros(100), np.ones(3), np.empty(0)])
def test_what_does_not_move_has_no_smoothness(speed: np.ndarray) -> None:
    assert np.isnan(spectral_arc_length(speed, RATE))
    assert np.isnan(log_dimensionless_jerk(speed, RATE))


def test_a_tool_that_rests_has_no_figures_but_its_way() -> None:
    found = motion_of(np.full((100, 3), 0.1), RATE)
    assert (found.path, found.movements, found.moving, found.space) == (0.0, 0, 0.0, None)
    assert np.isnan([found.sparc, found.straightness, found.economy_of_volume]).all()
    assert motion_of(np.zeros((1, 3)), RATE).path == 0.0


def test_a_twitch_is_no_movement() -> None:
    speed = np.zeros(120)
    speed[10:15] = 0.1
    speed[60:90] = 0.1
    assert movements_of(speed, RATE) == [slice(60, 90)]


def test_speed_is_that_of_the_motion_and_the_way_its_integral() -> None:
    way = circle(turns=2.0)
    speed = speeds_of(way, RATE)
    assert speed[9:-9] == pytest.approx(2 * 2 * np.pi * RADIUS / 4.0, rel=1e-3)
    assert path_length(way) == pytest.approx(speed[:-1].sum() / RATE, rel=1e-2)


def test_hands_that_move_alike_and_in_turn() -> None:
    """In turn: never together; alike: always, with correlation 1 and the ways' ratio."""
    one = np.tile(np.concatenate([minimum_jerk_speed(RATE)[:-1], np.zeros(60)]), 3)
    alike = coordination_of(0.1 * one, 0.05 * one, 1e-6)
    assert alike.correlation == pytest.approx(1.0)
    assert (alike.together, alike.balance) == pytest.approx((1.0, 0.5))
    turn = coordination_of(0.1 * one, 0.1 * np.roll(one, 60), 1e-6)
    assert turn.together == 0.0
    assert turn.balance == pytest.approx(1.0)
    assert turn.correlation < -0.4
    assert np.isnan(coordination_of(one, np.zeros_like(one)).correlation)
    assert np.isnan(coordination_of(np.zeros(9), np.zeros(9)).together)


def test_correlation_of_quarter_turns() -> None:
    """Speeds 1 + sin and 1 + cos over whole periods do not correlate; both always move."""
    phase = 2 * np.pi * np.arange(600) / 200
    found = coordination_of(1 + np.sin(phase), 1 + np.cos(phase), 0.0)
    assert found.correlation == pytest.approx(0.0, abs=1e-9)
    assert (found.together, found.balance) == pytest.approx((1.0, 1.0))


def test_a_load_is_integrated_over_time_but_not_over_gaps() -> None:
    """A triangle of 4 N over 2 s: 4 N s; then nobody publishes for a second; then 1 N for 1 s."""
    rise = np.concatenate([np.linspace(0, 4, 61), np.linspace(4, 0, 61)[1:]])
    times = np.concatenate([np.arange(121) / 60, 3.0 + np.arange(61) / 60])
    found = load_of(times, np.concatenate([rise, np.ones(61)]))
    assert found is not None
    assert (found.peak, found.peak_at) == (4.0, 1.0)
    assert found.integral == pytest.approx(4.0 + 1.0)
    assert found.loaded == pytest.approx(3.0)
    assert found.mean == pytest.approx(5.0 / 3.0)
    assert load_of(np.empty(0), np.empty(0)) is None
    nothing = load_of(np.arange(3.0) / 10, np.zeros(3))
    assert nothing is not None
    assert np.isnan(nothing.mean)
