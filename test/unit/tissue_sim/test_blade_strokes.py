"""What a blade has passed: strips that join, cover what it swept and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tissue_sim.interaction import rigid
from tissue_sim.interaction.strokes import HARDLY, SIDEWAYS, Stroke
from tissue_sim.interaction.tools import ToolSpec, outline

LENGTH, DEPTH, STEP = 0.02, 0.01, 0.001
SPEC = ToolSpec("knife", "cut", "rectangle", (LENGTH, DEPTH), cutting="progressive").checked()


def stroke_at(pose: NDArray[np.float64], spec: ToolSpec = SPEC) -> Stroke:
    return Stroke("stroke", outline(spec), STEP, pose)


def pose_of(place: NDArray[np.float64], turn: float = 0.0) -> NDArray[np.float64]:
    return np.array([*place, 0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)])


def strips_along(
    poses: list[NDArray[np.float64]], spec: ToolSpec = SPEC
) -> list[tuple[NDArray[np.float64], NDArray[np.uint32]]]:
    stroke = stroke_at(poses[0], spec)
    found = [stroke.follow(pose) for pose in poses[1:]]
    found.append(stroke.follow(poses[-1], last=True))
    return [strip for strip in found if strip is not None]


def area(strips: list[tuple[NDArray[np.float64], NDArray[np.uint32]]]) -> float:
    corners = np.concatenate([vertices[triangles] for vertices, triangles in strips])
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(0.5 * np.linalg.norm(sides, axis=1).sum())


pieces = st.lists(st.floats(1e-5, 4e-3), min_size=1, max_size=30)


@settings(deadline=None, max_examples=60)
@given(pieces, st.floats(-np.pi, np.pi))
def test_strips_cover_what_a_straight_stroke_passes_whatever_its_frames(
    steps: list[float], way: float
) -> None:
    """A convex blade that goes straight on in its plane passes width across its way x distance."""
    direction = np.array([np.cos(way), 0.0, np.sin(way)])
    gone = np.concatenate([[0.0], np.cumsum(steps)])
    strips = strips_along([pose_of(distance * direction) for distance in gone])
    across = LENGTH * abs(direction[2]) + DEPTH * abs(direction[0])
    # Sides that hardly advance while they slide along themselves are left out.
    slack = (HARDLY / SIDEWAYS * gone[-1] + HARDLY * STEP) * (LENGTH + DEPTH)
    passed = area(strips) if strips else 0.0
    assert passed <= across * gone[-1] * (1 + 1e-9)
    assert passed >= across * gone[-1] - slack


@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(st.floats(0, 3e-3), st.floats(-0.05, 0.05)), min_size=2, max_size=30))
def test_a_strip_begins_where_the_one_before_it_ended(moves: list[tuple[float, float]]) -> None:
    place, turn = np.zeros(3), 0.0
    poses = [pose_of(place)]
    for step, bend in moves:
        turn += bend
        place = place + step * np.array([np.cos(turn), np.sin(turn), 0.0])
        poses.append(pose_of(place, turn))
    front = rigid.to_world(poses[0], outline(SPEC)[[1, 2]])
    gone = sum(step for step, _ in moves)
    for vertices, _ in strips_along(poses):
        # Only the side ahead advances.
        ((before, after),) = vertices.reshape(-1, 2, 2, 3)
        if gone > SIDEWAYS * STEP:
            np.testing.assert_array_equal(before, front)
        front = after


def test_a_blade_moved_across_its_plane_cuts_nothing() -> None:
    assert strips_along([pose_of(np.array([0.0, y, 0.0])) for y in np.linspace(0, 0.03, 20)]) == []


def test_a_blade_that_rests_or_trembles_cuts_nothing() -> None:
    still = np.zeros(3)
    assert strips_along([pose_of(still)] * 10) == []
    random = np.random.default_rng(1)
    trembling = [pose_of(still)] + [pose_of(random.normal(scale=1e-6, size=3)) for _ in range(200)]
    assert strips_along(trembling) == []


def test_only_the_side_that_leads_cuts() -> None:
    forth = strips_along([pose_of(np.array([x, 0.0, 0.0])) for x in np.linspace(0, 0.01, 11)])
    for vertices, _ in forth:
        np.testing.assert_allclose(vertices[:, 0].min(), LENGTH / 2, atol=0.011)
        assert vertices[:, 0].min() >= LENGTH / 2 - 1e-12
    deeper = strips_along([pose_of(np.array([0.0, 0.0, -z])) for z in np.linspace(0, 0.01, 11)])
    for vertices, _ in deeper:
        assert vertices[:, 2].max() <= -DEPTH / 2 + 1e-12


def test_a_triangle_cuts_by_its_tip_as_well() -> None:
    spec = ToolSpec("knife", "cut", "triangle", (LENGTH, DEPTH), cutting="progressive").checked()
    strips = strips_along([pose_of(np.array([0, 0, -z])) for z in np.linspace(0, 0.01, 11)], spec)
    assert area(strips) == pytest.approx(LENGTH * 0.01, rel=1e-9)


def test_a_jump_is_noticed_and_cuts_nothing_in_between() -> None:
    stroke = stroke_at(pose_of(np.zeros(3)))
    far = pose_of(np.array([0.06, 0.0, 0.0]))
    assert stroke.jumped(far) == pytest.approx(0.06)
    assert stroke.jumped(pose_of(np.array([0.04, 0.0, 0.0]))) == 0.0
    stroke.restart(far)
    assert stroke.follow(far, last=True) is None
