"""Deadlines that do not drift, and what is counted about them."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from tissue_sim.realtime import FixedRate, Window


class Clock:
    """Time that passes only when told to, or while waiting."""

    def __init__(self) -> None:
        self.now = 50.0

    def __call__(self) -> float:
        return self.now


class Stop(threading.Event):
    """Waiting lets the clock go on."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        self.clock.now += timeout or 0.0
        return False


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def rate(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> FixedRate:
    def sleep(seconds: float) -> None:
        clock.now += seconds

    monkeypatch.setattr("tissue_sim.realtime.time.sleep", sleep)
    rate = FixedRate(100.0, clock)
    rate.start()
    return rate


def test_deadlines_lie_on_a_grid_however_long_frames_take(rate: FixedRate, clock: Clock) -> None:
    stop = Stop(clock)
    deadlines = []
    for busy in [0.001, 0.009, 0.003, 0.0] * 5:
        assert rate.wait(stop)
        deadlines.append(rate.deadline)
        clock.now += busy
    np.testing.assert_allclose(deadlines, 50.0 + 0.01 * np.arange(20), atol=1e-9)
    assert rate.skipped == 0


def test_a_frame_is_late_after_half_a_period(rate: FixedRate, clock: Clock) -> None:
    rate.wait(Stop(clock))
    clock.now += 0.0049
    assert not rate.published()
    clock.now += 0.0002
    assert rate.published()
    assert rate.late == 1


def test_missed_deadlines_are_skipped_and_counted_as_late(rate: FixedRate, clock: Clock) -> None:
    stop = Stop(clock)
    rate.wait(stop)
    clock.now += 0.0351
    rate.wait(stop)
    # Deadlines at 10, 20 and 30 ms are over; the last of them is still worth a frame.
    assert rate.skipped == 2
    assert rate.late == 2
    assert rate.deadline == pytest.approx(50.03)
    rate.wait(stop)
    assert rate.deadline == pytest.approx(50.04)


def test_waiting_ends_when_told_to_stop(rate: FixedRate, clock: Clock) -> None:
    stop = threading.Event()
    stop.set()
    assert not rate.wait(stop)


def test_a_window_forgets_the_oldest() -> None:
    window = Window(4)
    window.add(100.0)
    window.extend(np.array([1.0, 2.0]))
    window.extend(np.array([3.0, 4.0]))
    assert sorted(window.values()) == [1, 2, 3, 4]
    window.extend(np.arange(10.0))
    assert sorted(window.values()) == [6, 7, 8, 9]
    assert window.count == 15
    assert window.quantiles(0.0, 0.5, 1.0) == [6, 7.5, 9]


def test_an_empty_window_has_no_quantiles() -> None:
    assert Window(4).quantiles(0.5, 0.99) == [0.0, 0.0]
