"""Recorded states lie evenly, and the first of each version is among them."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from tissue_interfaces.msg import TissueState

from support.bags import EPOCH, PERIOD
from tissue_sim import conversions
from viz_bridge.state_thinning import StateThinning, state_head


def state(frame: int, version: int = 1, jitter: int = 0, name: str = "organ") -> bytes:
    stamp = conversions.stamp_of(10**18 + frame * PERIOD + jitter)
    message = TissueState(header=conversions.header(name, stamp), version=version, frame=frame)
    message.epoch = conversions.epoch_field(EPOCH)
    return bytes(serialize_message(message))


@pytest.mark.parametrize("name", ["", "a", "organ", "left/heart"])
def test_the_head_is_read_whatever_the_frame_is_called(name: str) -> None:
    head = state_head(state(7, version=3, name=name))
    assert (head.frame, head.version, head.epoch) == (7, 3, EPOCH)
    assert head.stamp == 10**18 + 7 * PERIOD


@pytest.mark.parametrize(("hz", "share"), [(10, 1 / 6), (20, 1 / 3), (30, 0.5), (60, 1), (0, 1)])
def test_the_rate_is_kept_in_spite_of_jitter(hz: float, share: float) -> None:
    random = np.random.default_rng(3)
    thinning = StateThinning(hz)
    kept = [
        frame
        for frame in range(1, 601)
        if thinning.keeps(state(frame, jitter=int(random.integers(0, 5_000_000))))
    ]
    assert len(kept) == pytest.approx(600 * share, abs=2)
    assert max(np.diff(kept)) <= 1 / share + 1


def test_the_first_state_of_each_version_is_kept() -> None:
    thinning = StateThinning(1)
    kept = [f for f in range(1, 60) if thinning.keeps(state(f, version=1 + f // 10))]
    assert set(range(10, 60, 10)) <= set(kept)


def test_rubbish_is_refused() -> None:
    with pytest.raises(ValueError, match="TissueState"):
        state_head(b"\0\1\0\0abc")
