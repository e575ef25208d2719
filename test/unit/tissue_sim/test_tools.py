"""Tools: what is allowed, and the sweep of a blade."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from support.small_block import pose_of
from tissue_sim.interaction.tools import ToolError, ToolSpec, blade


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"id": "../x"}, "a letter, then letters, digits"),
        ({"kind": "laser"}, "allowed: grab, cut"),
        ({"shape": "rectangle"}, "sphere, box, capsule for kind grab"),
        ({"size": (0.0,)}, "lengths from"),
        ({"size": (float("nan"),)}, "lengths from"),
        ({"size": (0.01, 0.02)}, r"\[radius\]"),
        ({"scale": 0.0}, "0.001 to 1000"),
        ({"offset": (float("inf"), 0.0, 0.0)}, "three finite numbers"),
        ({"pose": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)}, "length 0"),
        ({"pose": (float("nan"), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)}, "not finite"),
    ],
)
def test_a_wrong_tool_is_refused_and_says_what_is_allowed(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ToolError, match=said):
        ToolSpec(**{"id": "grasper", **wrong}).checked()


def test_arguments_carry_a_tool_exactly() -> None:
    tool = ToolSpec("knife", "cut", "triangle", (0.1, 0.02), owner="me", scale=0.3).checked()
    assert ToolSpec.from_arguments(tool.as_arguments()) == tool


def test_unknown_arguments_of_a_tool_are_refused() -> None:
    with pytest.raises(ToolError, match="colour"):
        ToolSpec.from_arguments({"id": "grasper", "colour": "red"})


def test_a_rectangle_has_the_tip_in_its_centre() -> None:
    tool = ToolSpec("knife", "cut", "rectangle", (0.04, 0.02)).checked()
    corners, triangles = blade(tool, pose_of([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(corners.mean(axis=0), [1, 2, 3])
    np.testing.assert_allclose(np.ptp(corners, axis=0), [0.04, 0, 0.02])
    edges = corners[triangles]
    areas = np.linalg.norm(np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]), axis=1)
    assert areas.sum() / 2 == pytest.approx(0.04 * 0.02)


def test_a_triangle_stands_on_the_tip_and_turns_with_the_tool() -> None:
    tool = ToolSpec("knife", "cut", "triangle", (0.04, 0.02)).checked()
    quarter_about_x = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    corners, triangles = blade(tool, pose_of([0.0, 0.0, 0.0], quarter_about_x))
    assert triangles.tolist() == [[0, 1, 2]]
    # z of the tool points along -y now.
    np.testing.assert_allclose(
        corners, np.array([[0, 0, 0], [0.02, -0.02, 0], [-0.02, -0.02, 0]]), atol=1e-12
    )
