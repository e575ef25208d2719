"""Messages of a device are read as mapped, or refused with what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from tissue_sim.diagnostics import OK, WARN
from tool_input.input_watch import InputWatch
from tool_input.joy_mapping import InputError, JoyMapping, checked_deflection

MAPPING = JoyMapping.parsed(
    ["-0", "+1", "4", "", "", "-3"],
    {"use": 0, "next_tool": 2, "clutch": -1, "slow": -1, "home": -1},
)


def test_axes_and_buttons_are_read_with_their_sign_and_meaning() -> None:
    reading = MAPPING.read([0.5, 0.25, 9.0, 0.125, -1.0], [1, 1, 0])
    np.testing.assert_array_equal(reading.deflection, [-0.5, 0.25, -1.0, 0.0, 0.0, -0.125])
    assert reading.pressed == {"use"}


@pytest.mark.parametrize(
    ("axes", "buttons", "says"),
    [
        ([0.0] * 4, [0] * 3, "4 axes where at least 5 are mapped"),
        ([0.0] * 5, [0] * 2, "2 buttons where at least 3 are mapped"),
        ([0.0, float("nan"), 0.0, 0.0, float("inf")], [0] * 3, "y, z not finite"),
    ],
)
def test_message_that_cannot_be_used_says_why(
    axes: list[float], buttons: list[int], says: str
) -> None:
    with pytest.raises(InputError, match=says):
        MAPPING.read(axes, buttons)


def test_axes_that_nothing_is_mapped_to_may_be_anything() -> None:
    reading = MAPPING.read([0.0, 0.0, float("nan"), 0.0, 0.0], [0, 1, 0])
    assert not reading.deflection.any()
    assert not reading.pressed


def test_twist_that_is_not_finite_is_refused() -> None:
    with pytest.raises(InputError, match="turn about x not finite"):
        checked_deflection(np.array([0.0, 0.0, 0.0, np.nan, 0.0, 0.0]))


def test_silence_is_noticed_once_and_ended_by_a_good_message_only() -> None:
    watch = InputWatch("joy", timeout=0.5)
    assert watch.finding().message == "no input on joy yet"
    assert not watch.lost(100.0)
    assert watch.accept(100.0)
    assert not watch.accept(100.1)
    assert watch.finding().level == OK
    assert [watch.lost(time) for time in (100.6, 100.61, 100.62)] == [False, True, False]
    watch.refuse("x not finite")
    assert not watch.fresh
    finding = watch.finding()
    assert finding.level == WARN
    assert "no input on joy for more than 0.5 s" in finding.message
    assert "1 messages refused, the last one because x not finite" in finding.message
    assert watch.accept(101.0)
    assert watch.losses == 1
