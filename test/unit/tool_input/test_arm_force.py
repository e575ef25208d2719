"""Forces at an arm: scaling keeps the sign of power, and the arm's limits hold at the arm."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tissue_sim.interaction import rigid
from tissue_sim.interaction.reaction import ForceLimits
from tissue_sim.parameters import ParameterError
from tool_input.arm_mapping import ArmBase, ArmMapping
from tool_input.arm_parameters import named
from tool_input.haptics.arm_force import ArmForce
from tool_input.haptics.haptic_parameters import SPECS, arm_force_of, limits_of
from tool_input.motion import Pose
from tool_input.workspace import Workspace

NUMBERS = st.floats(-1.0, 1.0)
VALUES = {spec.name: spec.default for spec in SPECS} | {"arm": "arm", "tool": "finger"}


def array(pose: Pose) -> np.ndarray:
    return np.concatenate([pose.position, pose.quaternion])


@given(st.tuples(*[NUMBERS] * 18), st.floats(0.05, 20.0), st.floats(0.05, 20.0))
def test_work_at_the_arm_is_a_share_of_the_work_at_the_tool(
    numbers: tuple[float, ...], scale: float, force_scale: float
) -> None:
    """In all six coordinates at once: what is passive at the tool is passive at the arm."""
    base = ArmBase(np.array(numbers[:3]), Rotation.from_rotvec(numbers[3:6]), scale)
    force = ArmForce(base, force_scale)
    wrench, way = np.array(numbers[6:12]), 1e-3 * np.array(numbers[12:18])
    mapping = ArmMapping(base)
    start = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    end = Pose(way[:3], Rotation.from_rotvec(way[3:]).as_quat())
    moved = rigid.motion(array(mapping.hand_pose(start)), array(mapping.hand_pose(end)))
    at_tool = float(wrench @ moved)
    at_arm = float(force.at_arm(wrench) @ way)
    assert at_arm == pytest.approx(force_scale / scale * at_tool, abs=1e-12)


def test_limits_of_the_arm_are_those_of_the_force_it_displays() -> None:
    base = ArmBase(scale=4.0)
    force = ArmForce(base, 0.5)
    limits = force.on_tool(ForceLimits(3.0, 0.1, 300.0, 10.0))
    most = np.array([limits.max_force, 0.0, 0.0, limits.max_torque, 0.0, 0.0])
    np.testing.assert_allclose(force.at_arm(most), [3.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    # A stiffness of k at the tool is felt as force_scale scale k: each metre of the arm is four.
    assert force.per_length(2000.0) == pytest.approx(1000.0)
    loop = limits_of(VALUES | {"scale": 4.0, "force_scale": 0.5}, force)
    assert loop.force.max_force == pytest.approx(6.0)
    assert arm_force_of(VALUES).torque_scale == 1.0


def test_the_hand_moves_on_where_the_tool_cannot() -> None:
    mapping = ArmMapping(ArmBase(), Workspace.between([-1.0] * 3, [0.1, 1.0, 1.0]))
    still = np.array([0.0, 0.0, 0.0, 1.0])
    inside, outside = Pose(np.zeros(3), still), Pose(np.array([0.3, 0.0, 0.0]), still)
    mapping.tool_pose(inside)
    assert mapping.tool_pose(outside).position[0] == pytest.approx(0.1)
    assert mapping.hand_pose(outside).position[0] == pytest.approx(0.3)
    mapping.clutch(True)
    assert mapping.clutched
    assert mapping.tool_pose(inside).position[0] == pytest.approx(0.1)
    assert mapping.hand_pose(inside).position[0] == pytest.approx(0.0)


def test_an_arm_that_is_not_named_is_refused() -> None:
    with pytest.raises(ParameterError, match="no arm: give it with -p arm:=NAME"):
        named(VALUES | {"arm": ""})
