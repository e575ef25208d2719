"""Late and lost frames are counted as they were made."""

from __future__ import annotations

import numpy as np
import pytest

from viz_bridge.cadence import LatencyMeter, cadence

T = 16_666_667


def stream(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(5)
    frames = np.arange(1, count + 1)
    stamps = 10**18 + frames * T + random.integers(0, 300_000, count)
    return frames, stamps, stamps + 4_000_000


def test_a_steady_stream_is_on_time() -> None:
    seen = cadence(*stream(1000), 60.0)
    assert (seen.late, seen.lost, seen.skipped) == (0, 0, 0)
    assert seen.hz == pytest.approx(60.0, abs=0.01)


def test_frames_published_late_are_counted() -> None:
    frames, stamps, received = stream(1000)
    received[[10, 500, 777]] += 6_000_000
    assert cadence(frames, stamps, received, 60.0).late == 3


def test_frames_that_begin_late_are_counted() -> None:
    frames, stamps, received = stream(1000)
    stamps[[10, 500]] += 12_000_000
    received[[10, 500]] += 12_000_000
    assert cadence(frames, stamps, received, 60.0).late == 2


def test_skipped_deadlines_are_late() -> None:
    frames, stamps, received = stream(1000)
    stamps[400:] += 3 * T
    received[400:] += 3 * T
    seen = cadence(frames, stamps, received, 60.0)
    assert (seen.skipped, seen.late, seen.lost) == (3, 3, 0)


def test_lost_states_are_not_skipped_deadlines() -> None:
    frames, stamps, received = stream(1000)
    keep = np.ones(1000, dtype=bool)
    keep[[100, 101, 600]] = False
    seen = cadence(frames[keep], stamps[keep], received[keep], 60.0)
    assert (seen.lost, seen.skipped, seen.late) == (3, 0, 0)
    assert seen.hz == pytest.approx(60.0, abs=0.01)


def test_a_drifting_clock_makes_no_frame_late() -> None:
    frames, stamps, received = stream(7200)
    drift = (frames * 3_000).astype(np.int64)
    assert cadence(frames, stamps + drift, received + drift, 60.0).late == 0


def test_latency_is_that_of_the_first_state_with_a_pose() -> None:
    meter = LatencyMeter()
    meter.take("hook", 100, 50_000_000)
    for frame in range(1, 5):
        stamp = 10**9 + frame * 16_000_000
        meter.take("hook", stamp, stamp + 5_000_000)
        meter.take("hook", stamp, stamp + 21_000_000)
    assert meter.quantiles() == pytest.approx({"p50": 5.0, "p99": 5.0, "max": 5.0, "poses": 4.0})
