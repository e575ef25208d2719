"""The force on the tool."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from support.small_block import CORNER, block_simulation, pose_of
from tissue_sim.frame import Budget, Command, Frame, FrameInputs, ToolSample
from tissue_sim.interaction.reaction import ForceLimiter, ForceLimits, wrench_on_tool

GRAB = FrameInputs((Command("grab", {"tool": "grasper", "radius": 0.02}),))
LIMITS = ForceLimits(max_force=5.0, max_torque=0.5, max_force_rate=60.0, max_torque_rate=6.0)


def pulled(way: list[float], model: str = "quasi_static") -> Frame:
    simulation = block_simulation(model=model)
    simulation.advance(GRAB, Budget(steps=1))
    tool = ToolSample("grasper", pose_of(np.add(CORNER, way)))
    return simulation.advance(FrameInputs(tools=(tool,)), Budget(steps=20))


def test_tissue_pulls_the_tool_back() -> None:
    for axis in range(3):
        way = [0.0, 0.0, 0.0]
        way[axis] = 0.005
        assert pulled(way).wrenches["grasper"][axis] < 0


def test_undeformed_tissue_pulls_with_nothing() -> None:
    np.testing.assert_allclose(pulled([0.0, 0.0, 0.0]).wrenches["grasper"], 0.0, atol=1e-6)


def test_a_model_without_stiffness_gives_no_force() -> None:
    assert pulled([0.0, 0.005, 0.0], model="relaxation").wrenches == {}


def test_the_torque_is_about_the_tip() -> None:
    forces = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 1.0]])
    points = np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]) + 5.0
    tip = np.array([5.0, 5.0, 5.0])
    np.testing.assert_allclose(wrench_on_tool(forces, points, tip), [0, 0, 3, 0.1, -0.2, 0])


wrenches = st.lists(
    st.one_of(st.none(), st.tuples(*[st.floats(-1e3, 1e3)] * 6).map(np.array)), max_size=20
)


@given(wrenches)
def test_the_published_force_is_bounded_and_changes_slowly(
    wanted: list[np.ndarray | None],
) -> None:
    limiter = ForceLimiter(LIMITS)
    period = 1 / 60
    before = np.zeros(6)
    for wrench in wanted:
        now = limiter.next(wrench, period)
        assert np.linalg.norm(now[:3]) <= LIMITS.max_force * (1 + 1e-9)
        assert np.linalg.norm(now[3:]) <= LIMITS.max_torque * (1 + 1e-9)
        if wrench is None:
            assert not now.any()
        else:
            assert np.linalg.norm(now[:3] - before[:3]) <= LIMITS.max_force_rate * period + 1e-9
        before = now


def test_a_steady_force_is_reached() -> None:
    limiter = ForceLimiter(LIMITS)
    for _ in range(10):
        wrench = limiter.next(np.array([3.0, 0, 0, 0, 0.1, 0]), 1 / 60)
    np.testing.assert_allclose(wrench, [3.0, 0, 0, 0, 0.1, 0])


def test_a_force_that_is_not_finite_is_none() -> None:
    limiter = ForceLimiter(LIMITS)
    assert not limiter.next(np.full(6, np.nan), 1 / 60).any()
