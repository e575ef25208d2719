"""From viser's events to drags on the tissue: geometry, depth, and what belongs to one drag."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tool_input.table.drag_input import DragInput
from tool_input.table.modes import END, MOVE, START, Drag
from tool_input.table.page_scene import PageScene, Placement
from tool_input.table.pointer import MODIFIER_PAUSE, NEAREST, DragPath, Eye
from tool_input.table.tissue_frame import Surface, TissueFrame

DOWN = Eye(np.array([0.03, 0.03, 0.5]), np.array([0.0, 0, -1]), np.array([0.0, 1, 0]))


def eyes() -> list[Eye]:
    """Cameras all around."""
    found = []
    for turn in Rotation.random(8, random_state=3):
        right, down, forward = turn.as_matrix().T
        del right
        found.append(Eye(-0.4 * forward, forward, -down))
    return found


@pytest.mark.parametrize("eye", eyes())
def test_the_point_stays_under_the_pointer_until_shift_is_used(eye: Eye) -> None:
    start = np.array([0.01, -0.02, 0.015])
    path = DragPath(start, eye)
    across = np.cross(eye.forward, eye.up)
    for step in (0.3 * across, 0.1 * eye.up, -0.2 * across + 0.05 * eye.up):
        path.follow(start + step, in_depth=False)
        np.testing.assert_allclose(path.point, start + step, atol=1e-12)


@pytest.mark.parametrize("eye", eyes())
def test_shift_moves_along_the_line_of_sight(eye: Eye) -> None:
    start = np.array([0.01, -0.02, 0.015])
    path = DragPath(start, eye)
    sight = (start - eye.position) / np.linalg.norm(start - eye.position)
    path.follow(start + 0.02 * eye.up, in_depth=True)
    way = path.point - start
    np.testing.assert_allclose(np.cross(way, sight), 0.0, atol=1e-12)
    assert way @ eye.forward == pytest.approx(0.02)
    # Sideways does nothing, and what is undone is undone.
    path.follow(start + 0.02 * eye.up + 0.3 * np.cross(eye.forward, eye.up), in_depth=True)
    np.testing.assert_allclose(path.point, start + way, atol=1e-12)
    path.follow(start, in_depth=True)
    np.testing.assert_allclose(path.point, start, atol=1e-12)


@pytest.mark.parametrize("eye", eyes())
def test_after_shift_nothing_jumps_and_nearer_points_move_less(eye: Eye) -> None:
    start = 0.1 * eye.forward  # 0.5 m before the eye, in the middle of the window
    path, across = DragPath(start, eye), np.cross(eye.forward, eye.up)
    path.follow(start - 0.25 * eye.up, in_depth=True)
    np.testing.assert_allclose(path.point, start - 0.25 * eye.forward, atol=1e-12)
    path.follow(start - 0.25 * eye.up + 0.1 * across, in_depth=False)
    # Half as far from the eye the same way on the screen is half as long.
    np.testing.assert_allclose(path.point, start - 0.25 * eye.forward + 0.05 * across, atol=1e-12)


def test_a_drag_never_comes_behind_the_eye() -> None:
    path = DragPath(np.array([0.03, 0.03, 0.0]), DOWN)
    path.follow(np.array([0.03, -9.0, 0.0]), in_depth=True)
    assert DOWN.position[2] - path.point[2] == pytest.approx(NEAREST * DOWN.position[2])


class Hand:
    """A hand at a window that looks down on a block, and what its drags were told as."""

    def __init__(self) -> None:
        self.now = 10.0
        self.drags: list[Drag] = []
        self.mesh = Mesh(block(5, 5, 5))
        points = self.mesh.rest[: self.mesh.node_rows]
        self.scene = PageScene(None, Placement.around(points))
        self.input = DragInput(self.scene, self.drags.append, lambda: self.now)
        self.input.see(self.frame(points))

    def frame(self, positions: NDArray[np.floating]) -> TissueFrame:
        return TissueFrame(
            b"", 1, self.mesh, positions.astype(np.float32), Surface.of(self.mesh), {}
        )

    def sends(self, phase: str, x: float, y: float, start: Any, modifier: str | None) -> None:
        """An event with points on the block's upper side [m]."""
        event = SimpleNamespace(
            phase=phase,
            modifier=modifier,
            start_position=tuple(self.scene.to_page([*start, 0.06])),
            end_position=tuple(self.scene.to_page([x, y, 0.06])),
        )
        self.input.take(event, DOWN)

    def drag(self, *ways: tuple[float, float], modifier: str | None = None) -> None:
        """A drag through some places: the first is where it starts."""
        start = ways[0]
        self.sends("start", *start, start, modifier)
        for way in ways[1:]:
            self.sends("update", *way, start, modifier)
        self.sends("end", *ways[-1], start, modifier)

    @property
    def phases(self) -> list[str]:
        return [drag.phase for drag in self.drags]


def test_a_drag_is_told_in_metres_with_what_is_under_the_pointer() -> None:
    hand = Hand()
    hand.drag((0.02, 0.03), (0.04, 0.03), (0.2, 0.03))
    hand.now += 1.0
    hand.input.expire()
    assert [phase for phase in hand.phases if phase != MOVE] == [START, END]
    first, last = hand.drags[0], hand.drags[-1]
    np.testing.assert_allclose(first.start, [0.02, 0.03, 0.06], atol=1e-7)
    np.testing.assert_array_equal(first.point, first.start)
    np.testing.assert_allclose(first.normal, [0, 0, 1], atol=1e-9)
    assert first.hit is not None
    np.testing.assert_allclose(first.hit, first.start, atol=1e-6)
    np.testing.assert_array_equal(first.forward, DOWN.forward)
    second = hand.drags[2].hit
    assert second is not None
    np.testing.assert_allclose(second, [0.04, 0.03, 0.06], atol=1e-6)
    np.testing.assert_allclose(last.point, [0.2, 0.03, 0.06], atol=1e-6)
    assert last.hit is None


def test_the_pointer_meets_the_tissue_where_it_is_now() -> None:
    hand = Hand()
    hand.sends("start", 0.02, 0.03, (0.02, 0.03), None)
    raised = hand.mesh.rest[: hand.mesh.node_rows] + np.array([0, 0, 0.1])
    hand.input.see(hand.frame(raised))
    hand.sends("update", 0.02, 0.03, (0.02, 0.03), None)
    assert hand.drags[-1].hit is not None
    assert hand.drags[-1].hit[2] == pytest.approx(0.16)


def test_shift_pressed_or_let_go_on_the_way_does_not_end_a_drag() -> None:
    hand, start = Hand(), (0.02, 0.02)
    hand.drag(start, (0.03, 0.02))
    hand.now += 0.12  # viser waits a tenth of a second before it begins again
    hand.input.expire()
    hand.sends("start", 0.03, 0.02, start, "shift")
    hand.sends("end", 0.03, 0.03, start, "shift")
    hand.now += 0.12
    hand.input.expire()
    hand.sends("start", 0.03, 0.03, start, None)
    hand.sends("end", 0.04, 0.03, start, None)
    hand.now += MODIFIER_PAUSE + 0.01
    hand.input.expire()
    assert [phase for phase in hand.phases if phase != MOVE] == [START, END]
    end = hand.drags[-1].point
    assert end[2] == pytest.approx(0.05, abs=1e-6)  # 1 cm deeper, not 1 cm higher in the window
    ratio = (0.5 - 0.05) / (0.5 - 0.06)
    np.testing.assert_allclose(end[:2] - 0.03, np.array([0.01, -0.01]) * ratio, atol=1e-6)


def test_a_new_drag_ends_the_one_before_at_once() -> None:
    hand = Hand()
    hand.drag((0.02, 0.02), (0.03, 0.02))
    hand.drag((0.05, 0.05), modifier="shift")  # elsewhere: not the same drag
    hand.drag((0.05, 0.05), modifier="shift")  # the same modifier: not the same drag
    hand.now += 1.0
    hand.input.expire()
    assert [phase for phase in hand.phases if phase != MOVE] == [START, END] * 3


def test_a_drag_that_is_forgotten_has_no_end() -> None:
    hand = Hand()
    hand.sends("start", 0.02, 0.02, (0.02, 0.02), None)
    assert hand.input.dragging
    hand.input.forget()
    hand.sends("update", 0.03, 0.02, (0.02, 0.02), None)
    hand.now += 1.0
    hand.input.expire()
    assert END not in hand.phases
    assert not hand.input.dragging
