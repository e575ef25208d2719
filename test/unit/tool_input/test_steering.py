"""One device moves its tools, one at a time, without a jump."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tool_input.joy_mapping import CLUTCH, HOME, NEXT_TOOL, SLOW, USE
from tool_input.joy_parameters import SPECS, mapping_of, steering_of
from tool_input.motion import Pose
from tool_input.steering import Speeds, SteeredTool, Steering
from tool_input.velocity_integration import Response
from tool_input.workspace import Workspace

STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0])
ALONG_X = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def steering(*names: str, **more: object) -> Steering:
    made = Steering(
        [SteeredTool(name) for name in names or ("grasper",)],
        Speeds(linear=0.1, angular=1.0, slow=0.25),
        Response(deadband=0.1),
        Workspace.between([-1, -1, -1], [1, 1, 1]),
        **more,  # type: ignore[arg-type]
    )
    for tool in made.tools:
        made.place(tool, Pose(np.zeros(3), STRAIGHT))
    return made


def press(hand: Steering, *buttons: str, resumed: bool = False) -> None:
    hand.press(frozenset(buttons), resumed)


def place(hand: Steering, index: int = 0) -> np.ndarray:
    pose = hand.tools[index].pose
    assert pose is not None
    return pose.position


def test_full_deflection_moves_at_the_scale() -> None:
    hand = steering()
    hand.deflect(ALONG_X)
    hand.advance(2.0)
    np.testing.assert_allclose(place(hand), [0.2, 0.0, 0.0])
    press(hand, SLOW)
    hand.advance(2.0)
    np.testing.assert_allclose(place(hand), [0.25, 0.0, 0.0])


def test_in_the_deadband_nothing_moves_at_all() -> None:
    hand = steering()
    hand.deflect(np.full(6, 0.1))
    before = hand.tool.pose
    hand.advance(10.0)
    assert hand.tool.pose is before


def test_in_the_tools_axes_it_moves_where_it_points() -> None:
    hand = steering(axes=None)
    hand.place(hand.tool, Pose(np.zeros(3), Rotation.from_rotvec([0, 0, np.pi / 2]).as_quat()))
    hand.deflect(ALONG_X)
    hand.advance(1.0)
    np.testing.assert_allclose(place(hand), [0.0, 0.1, 0.0], atol=1e-15)


def test_clutch_takes_the_device_off_the_tool_and_back_without_a_jump() -> None:
    hand = steering()
    hand.deflect(ALONG_X)
    hand.advance(1.0)
    before = place(hand).copy()
    press(hand, CLUTCH)
    hand.advance(5.0)
    np.testing.assert_array_equal(place(hand), before)
    press(hand)
    np.testing.assert_array_equal(place(hand), before)
    hand.advance(0.008)
    np.testing.assert_allclose(place(hand) - before, [0.0008, 0.0, 0.0], atol=1e-15)


def test_held_button_uses_the_tool_while_it_is_down() -> None:
    hand = steering()
    levels = []
    for buttons in ([], [USE], [USE], [], [USE]):
        press(hand, *buttons)
        levels.append(hand.tool.used)
    assert levels == [False, True, True, False, True]


def test_toggled_button_changes_the_level_at_each_press() -> None:
    hand = steering(toggles=True)
    levels = []
    for buttons in ([], [USE], [USE], [], [USE], []):
        press(hand, *buttons)
        levels.append(hand.tool.used)
    assert levels == [False, True, True, True, False, False]


def test_tool_that_is_left_goes_on_holding_where_it_is() -> None:
    hand = steering("left", "right")
    press(hand, USE)
    press(hand, USE, NEXT_TOOL)
    press(hand)
    hand.deflect(ALONG_X)
    hand.advance(1.0)
    assert [tool.used for tool in hand.tools] == [True, False]
    np.testing.assert_array_equal(place(hand, 0), 0.0)
    np.testing.assert_allclose(place(hand, 1), [0.1, 0.0, 0.0])
    press(hand, NEXT_TOOL)
    press(hand, USE)
    press(hand)
    assert hand.active == 0
    assert [tool.used for tool in hand.tools] == [False, False]


def test_home_is_reached_smoothly_and_never_faster_than_full_deflection() -> None:
    hand = steering()
    hand.place(hand.tool, Pose(np.array([0.1, 0.05, 0.0]), STRAIGHT))
    press(hand, HOME)
    places = [place(hand)]
    for _ in range(1000):
        hand.advance(0.005)
        places.append(place(hand))
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps.max() <= 0.1 * 0.005 * (1 + 1e-9)
    assert steps.max() == pytest.approx(0.1 * 0.005, rel=1e-3)
    np.testing.assert_allclose(places[-1], 0.0, atol=1e-15)


def test_pushing_the_device_ends_the_way_home() -> None:
    hand = steering()
    hand.place(hand.tool, Pose(np.array([0.1, 0.0, 0.0]), STRAIGHT))
    press(hand, HOME)
    hand.advance(0.5)
    hand.deflect(ALONG_X)
    hand.deflect(np.zeros(6))
    before = place(hand).copy()
    hand.advance(1.0)
    np.testing.assert_array_equal(place(hand), before)


def test_after_silence_releases_count_and_presses_do_not() -> None:
    hand = steering()
    press(hand, USE)
    press(hand, resumed=True)
    assert not hand.tool.used
    press(hand, USE, resumed=True)
    assert not hand.tool.used
    press(hand)
    press(hand, USE)
    assert hand.tool.used


def test_stopped_device_moves_nothing_and_keeps_what_is_pressed() -> None:
    hand = steering()
    press(hand, USE)
    hand.deflect(ALONG_X)
    hand.stop()
    hand.advance(1.0)
    np.testing.assert_array_equal(place(hand), 0.0)
    assert hand.tool.used


def test_workspace_stops_the_tool_along_each_axis() -> None:
    hand = steering()
    hand.workspace = Workspace.between([-0.1, -0.1, -0.1], [0.1, 0.1, 0.1])
    hand.deflect(np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.0]))
    hand.advance(1.5)
    np.testing.assert_allclose(place(hand), [0.1, 0.15 * 4 / 9, 0.0])


def test_tool_outside_the_workspace_comes_in_without_a_jump() -> None:
    box = Workspace.between([0, 0, 0], [1, 1, 1])
    before = np.array([2.0, 0.5, -0.5])
    for after, limited in (
        ([2.1, 0.5, -0.5], [2.0, 0.5, -0.5]),
        ([1.9, 1.5, -0.4], [1.9, 1.0, -0.4]),
        ([0.9, 0.5, 0.5], [0.9, 0.5, 0.5]),
    ):
        np.testing.assert_array_equal(box.limited(before, np.array(after)), limited)


DEFAULTS = {spec.name: spec.default for spec in SPECS}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({}, "no tools"),
        ({"tools": ["a", "a"]}, "each once"),
        ({"tools": ["a"], "camera_orientation": [0.0, 0.0, 0.0, 2.0]}, "of length 1"),
        ({"tools": ["a"], "workspace_max": [1.0, -2.0, 1.0]}, "must be less than"),
        ({"tools": ["a"], "axes": ["+0", "y", "", "", "", ""]}, "number of an axis"),
        ({"tools": ["a"], "home_button": 0}, "one meaning"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(changed: dict[str, object], says: str) -> None:
    values = {**DEFAULTS, **changed}
    with pytest.raises(ValueError, match=says):
        _ = mapping_of(values), steering_of(values)


@pytest.mark.parametrize("scale", [0.0, -0.05, 50.0, float("nan"), float("inf")])
def test_absurd_scales_are_refused_with_what_is_allowed(scale: float) -> None:
    spec = next(spec for spec in SPECS if spec.name == "linear_scale")
    with pytest.raises(ValueError, match=r"allowed: a number from 0\.0001 to 0\.5 m/s"):
        spec.checked(scale)
