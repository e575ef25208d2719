"""Parameters of an arm that drives a tool."""

from __future__ import annotations

from typing import Any

import numpy as np

from tissue_sim.parameters import ParameterError, Spec
from tool_input.arm_mapping import ArmBase, ArmMapping, JawSwitch
from tool_input.device_parameters import INPUT_TIMEOUT, WORKSPACE, unit_quaternion
from tool_input.workspace import Workspace

BOOL, JOY = "bool", "joy"
ARM = (
    Spec("arm", "string", "", "namespace of the arm's topics, such as PSM1"),
    Spec("tool", "string", "", "the tool it drives"),
    Spec("frame_id", "string", "organ", "frame the base below is given in"),
    Spec(
        "base_position", "doubles", [0.0, 0.0, 0.0], "the arm's base", "m", -100.0, 100.0, length=3
    ),
    Spec(
        "base_orientation",
        "doubles",
        [0.0, 0.0, 0.0, 1.0],
        "orientation of the arm's base, quaternion x y z w",
        length=4,
    ),
    Spec(
        "arm_origin",
        "doubles",
        [0.0, 0.0, 0.0],
        "place of the arm that is mapped to base_position, in the frame of its base",
        "m",
        -100.0,
        100.0,
        length=3,
    ),
    Spec("scale", "double", 1.0, "metres of the tool per metre of the arm", "", 0.01, 100.0),
    *WORKSPACE,
    Spec(
        "close_below", "double", 0.1, "jaw opening below which the tool is used", "rad", -3.2, 3.2
    ),
    Spec("open_above", "double", 0.25, "jaw opening above which it is not", "rad", -3.2, 3.2),
    Spec("clutch_topic", "string", "", "what takes the arm off the tool; empty: nothing"),
    Spec(
        "clutch_type",
        "string",
        BOOL,
        "type of clutch_topic: std_msgs/Bool, or sensor_msgs/Joy whose first button is the clutch",
        choices=(BOOL, JOY),
    ),
    INPUT_TIMEOUT,
)


def named(values: dict[str, Any]) -> dict[str, Any]:
    """The values, if they name the arm and the tool.

    Raises:
        ParameterError: They do not.
    """
    for name in ("arm", "tool"):
        if not values[name]:
            raise ParameterError(f"no {name}: give it with -p {name}:=NAME")
    return values


def base_of(values: dict[str, Any]) -> ArmBase:
    """How the arm's frame lies in the organ's.

    Raises:
        ParameterError: The orientation is none.
    """
    return ArmBase(
        np.array(values["base_position"]),
        unit_quaternion("base_orientation", values["base_orientation"]),
        values["scale"],
        np.array(values["arm_origin"]),
    )


def mapping_of(values: dict[str, Any]) -> ArmMapping:
    """From the arm's poses to the tool's.

    Raises:
        ValueError: A parameter is not allowed.
    """
    workspace = Workspace.between(values["workspace_min"], values["workspace_max"])
    return ArmMapping(base_of(values), workspace)


def jaw_of(values: dict[str, Any]) -> JawSwitch:
    """From the jaw's opening to the tool's use.

    Raises:
        ValueError: The thresholds leave no gap.
    """
    return JawSwitch(values["close_below"], values["open_above"])
