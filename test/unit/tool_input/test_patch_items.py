"""The `patch` step of a procedure: where the patch lies, what it is made of, what is a mistake."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tool_input.located_yaml import ProcedureError
from tool_input.patch_items import PatchItem
from tool_input.procedure import parse_procedure

TEXT = """\
units: mm
tools:
  forceps: {kind: grab, shape: sphere, size: [5], start: {position: [0, 0, 10]}}
timeline:
  - at: 1
    patch: {%s}
"""
SQUARE = "outline: [[0, 0], [20, 0], [20, 20], [0, 20]]"


def patch_of(keys: str) -> PatchItem:
    (event,) = parse_procedure(TEXT % keys).events
    assert event.action == "patch"
    assert event.patch is not None
    assert event.target == event.patch.name
    return event.patch


def test_lengths_are_in_the_files_units_and_moduli_in_pascals() -> None:
    patch = patch_of(
        f"{SQUARE}, at: [10, 0, 50], thickness: 1.5, young_modulus: 3.0e+5, density: 1100, edge: 2,"
        "carried_by: forceps, name: pericardium"
    )
    np.testing.assert_allclose(patch.corners, np.array([[0, 0], [2, 0], [2, 2], [0, 2]]) * 0.01)
    np.testing.assert_allclose(patch.pose.position, [0.01, 0, 0.05])
    assert (patch.name, patch.tool) == ("pericardium", "forceps")
    assert (patch.thickness, patch.edge) == pytest.approx((0.0015, 0.002))
    assert (patch.young_modulus, patch.density) == (3e5, 1100)


def test_what_is_left_out_is_the_services_default() -> None:
    patch = patch_of("outline: [[0, 0, 1], [20, 0, 1], [20, 20, 1]]")
    assert patch.corners.shape == (3, 3)
    assert (patch.thickness, patch.young_modulus, patch.density, patch.edge) == (0, 0, 0, 0)
    assert (patch.name, patch.tool) == ("", "")


def test_an_ellipse_has_its_half_axes() -> None:
    patch = patch_of("ellipse: [12, 8], at: [0, 0, 0]")
    np.testing.assert_allclose(np.abs(patch.corners).max(axis=0), [0.012, 0.008])
    np.testing.assert_allclose(np.hypot(*(patch.corners / [0.012, 0.008]).T), 1.0)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3))
def test_the_planes_z_goes_along_the_normal(normal: tuple[float, float, float]) -> None:
    length = float(np.linalg.norm(normal))
    if length < 1e-3:
        return
    numbers = ", ".join(f"{value:.17f}" for value in normal)
    patch = patch_of(f"{SQUARE}, at: [0, 0, 0], normal: [{numbers}]")
    up = Rotation.from_quat(patch.pose.quaternion).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(up, np.array(normal) / length, atol=1e-9)


def test_a_pose_turns_the_plane() -> None:
    patch = patch_of(
        f"{SQUARE}, pose: {{position: [1, 2, 3], orientation: {{axis: [1, 0, 0], angle_deg: 90}}}}"
    )
    up = Rotation.from_quat(patch.pose.quaternion).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(up, [0, -1, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("at: [0, 0, 0]", "either outline or ellipse"),
        (f"{SQUARE}, ellipse: [1, 2], at: [0, 0, 0]", "either outline or ellipse"),
        (SQUARE, "need pose, or at"),
        (f"{SQUARE}, normal: [0, 0, 1]", "need pose, or at"),
        (f"{SQUARE}, at: [0, 0, 0], normal: [0, 0, 0]", "must not be zero"),
        (f"{SQUARE}, at: [0, 0, 0], pose: {{position: [0, 0, 0]}}", "either pose"),
        ("outline: [[0, 0, 0], [1, 0, 0], [1, 1, 0]], at: [0, 0, 0]", "in space"),
        ("outline: [[0, 0], [1, 0]], at: [0, 0, 0]", "at least 3"),
        ("outline: [[0, 0], [1, 0, 0], [1, 1]], at: [0, 0, 0]", "2 numbers"),
        ("outline: [[0, .nan], [1, 0], [1, 1]], at: [0, 0, 0]", "finite"),
        ("ellipse: [1, 0], at: [0, 0, 0]", "greater than 0"),
        (f"{SQUARE}, at: [0, 0, 0], thickness: -1", "greater than 0"),
        (f"{SQUARE}, at: [0, 0, 0], carried_by: tweezers", "unknown tool 'tweezers'"),
        (f"{SQUARE}, at: [0, 0, 0], colour: red", "colour"),
    ],
)
def test_mistakes_are_told_with_their_line(keys: str, said: str) -> None:
    with pytest.raises(ProcedureError, match=said) as caught:
        parse_procedure(TEXT % keys)
    assert "procedure:" in str(caught.value)


def test_a_name_is_given_once() -> None:
    text = TEXT % f"{SQUARE}, at: [0, 0, 0], name: one"
    twice = text + text[text.index("  - at: 1") :].replace("at: 1", "at: 2")
    with pytest.raises(ProcedureError, match="taken"):
        parse_procedure(twice)
