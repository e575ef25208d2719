"""Parameters: what is allowed, and what a wrong one says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tissue_sim.frames import Frames, StaticFrame, UnknownFrameError
from tissue_sim.interaction import rigid
from tissue_sim.parameters import ParameterError, Spec, refuse_unknown
from tissue_sim.simulation_parameters import SPECS, Settings, specs

RATE = Spec("rate_hz", "double", 60.0, "Rate.", unit="1/s", minimum=1.0, maximum=1000.0)


def values_of(given: dict[str, Any]) -> dict[str, Any]:
    table = specs(given)
    refuse_unknown(given, [spec.name for spec in table])
    return {spec.name: spec.checked(given.get(spec.name, spec.default)) for spec in table}


@pytest.mark.parametrize("value", [0.5, 1001, float("nan"), float("inf"), "60", True, [60.0], None])
def test_a_value_that_is_not_allowed_names_the_limits(value: Any) -> None:
    with pytest.raises(ParameterError, match=r"rate_hz = .* from 1 to 1000 1/s"):
        RATE.checked(value)


def test_a_whole_number_is_a_number() -> None:
    assert RATE.checked(30) == 30.0
    assert isinstance(RATE.checked(30), float)


def test_lists_are_checked_item_by_item() -> None:
    spec = Spec("offset", "doubles", [0.0] * 3, "Offset.", unit="m", length=3, maximum=1.0)
    assert spec.checked([0, 1, 0.5]) == [0.0, 1.0, 0.5]
    for wrong in ([0, 1], [0, 0, 2], "abc", [0, 0, "x"]):
        with pytest.raises(ParameterError, match="3 items"):
            spec.checked(wrong)


def test_a_misspelt_name_is_refused_with_the_name_that_is_meant() -> None:
    with pytest.raises(ParameterError, match=r"budget_m \(did you mean budget_ms\?\)"):
        values_of({"budget_m": 3.0})


def test_every_default_is_allowed() -> None:
    values = values_of({"tools": ["a"], "frames.base.parent": "organ"})
    assert Settings.of(values).scene.tools[0].id == "a"


def test_names_are_unique_and_described() -> None:
    names = [spec.name for spec in specs({"tools": ["a", "b"]})]
    assert len(set(names)) == len(names)
    assert all(spec.description for spec in SPECS)


def test_settings_say_what_the_parameters_mean() -> None:
    given = {
        "tools": ["knife"],
        "tool.knife.kind": "cut",
        "tool.knife.size": [0.1, 0.05],
        "lr.levels": 6,
        "young_modulus": 1000,
        "wait_for": ["tissue/state:2"],
        "budget_ms": 4,
    }
    settings = Settings.of(values_of(given))
    assert settings.scene.tools[0].shape == "rectangle"
    assert settings.scene.parameters["lr"]["levels"] == 6
    assert settings.scene.material.young_modulus == 1000.0
    assert settings.wait_for == {"tissue/state": 2}
    assert settings.budget == pytest.approx(0.004)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"tools": ["a", "a"]}, "twice"),
        ({"tools": ["a"], "tool.a.kind": "saw"}, "grab, cut"),
        ({"tools": ["a"], "tool.b.kind": "cut"}, "tool.b.kind"),
        ({"tools": ["a"], "tool.a.size": [1e9]}, "from 1e-06 to 10 m"),
        ({"tools": ["a b"]}, "letters, digits"),
        ({"lr.levels": 2.5}, "whole number"),
        ({"lr.level": 2}, r"did you mean lr\.levels"),
        ({"model": "jelly"}, "spring_mass"),
        ({"wait_for": ["state"]}, "topic:count"),
        ({"release_timeout": 0.1}, "freezes first"),
        ({"frames.base.translation": [0.0, 0.0, 1.0]}, "parent is missing"),
        ({"frames.base.parent": "organ", "frames.base.rotation": [0.0] * 4}, "length 0"),
    ],
)
def test_wrong_parameters_are_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Settings.of(values_of(given))


def frame(name: str, parent: str, *pose: float) -> StaticFrame:
    return StaticFrame(name, parent, np.array(pose))


QUARTER = np.sqrt(0.5)


def test_poses_go_through_a_chain_of_frames() -> None:
    frames = Frames(
        "organ",
        [
            frame("table", "organ", 1, 0, 0, 0, 0, QUARTER, QUARTER),
            frame("robot", "table", 2, 0, 0, 0, 0, 0, 1),
        ],
    )
    pose = frames.pose_in_organ("robot", np.array([0.5, 0, 0, 0, 0, 0, 1.0]))
    np.testing.assert_allclose(pose, [1, 2.5, 0, 0, 0, QUARTER, QUARTER], atol=1e-12)
    points = frames.points_in_organ("robot", np.array([[0.5, 0, 0], [0.0, 1, 0]]))
    np.testing.assert_allclose(points, np.array([[1, 2.5, 0], [0, 2, 0]]), atol=1e-12)


def test_the_organ_may_be_a_child_itself() -> None:
    frames = Frames("organ", [frame("organ", "world", 0, 0, 1, 0, 0, 0, 1)])
    pose = frames.pose_in_organ("world", rigid.IDENTITY)
    np.testing.assert_allclose(pose[:3], [0, 0, -1])


def test_an_unknown_frame_says_which_are_known_and_what_to_add() -> None:
    frames = Frames("organ", [frame("table", "organ", *rigid.IDENTITY)])
    with pytest.raises(UnknownFrameError) as caught:
        frames.pose_in_organ("phantom", rigid.IDENTITY)
    message = str(caught.value)
    assert "known frames: organ, table" in message
    assert "frames.phantom.parent: organ" in message
    with pytest.raises(UnknownFrameError, match="empty"):
        frames.pose_in_organ("", rigid.IDENTITY)


def test_a_frame_apart_from_the_organ_is_unknown() -> None:
    frames = Frames("organ", [frame("table", "room", *rigid.IDENTITY)])
    with pytest.raises(UnknownFrameError):
        frames.pose_in_organ("table", rigid.IDENTITY)


def test_frames_in_a_circle_are_refused() -> None:
    with pytest.raises(ValueError, match="circle"):
        Frames("organ", [frame("a", "b", *rigid.IDENTITY), frame("b", "a", *rigid.IDENTITY)])


def test_a_matrix_and_its_quaternion_are_the_same_rotation() -> None:
    generator = np.random.default_rng(0)
    for quaternion in generator.normal(size=(50, 4)):
        unit = quaternion / np.linalg.norm(quaternion)
        again = rigid.from_matrix(rigid.matrix(unit))
        assert abs(np.dot(unit, again)) == pytest.approx(1.0)
