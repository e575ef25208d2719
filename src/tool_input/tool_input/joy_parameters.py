"""Parameters of the joy node."""

from __future__ import annotations

from typing import Any

from scipy.spatial.transform import Rotation

from tissue_sim.parameters import ParameterError, Spec
from tool_input.device_parameters import INPUT_TIMEOUT, WORKSPACE, unit_quaternion
from tool_input.joy_mapping import BUTTONS, JoyMapping
from tool_input.steering import Speeds, SteeredTool, Steering
from tool_input.velocity_integration import Response
from tool_input.workspace import Workspace

JOY, TWIST, TWIST_STAMPED = "joy", "twist", "twist_stamped"
TOOL, ORGAN, CAMERA = "tool", "organ", "camera"
HOLD, TOGGLE = "hold", "toggle"

_DEFAULT_BUTTONS = {"use": 0, "next_tool": 1, "clutch": 4, "slow": 5, "home": 7}
_BUTTON_WORDS = {
    "use": "button that uses the tool",
    "next_tool": "button that goes on to the next tool",
    "clutch": "button that takes the device off the tool while it is down",
    "slow": "button that moves slowly while it is down",
    "home": "button that takes the tool back to where it was first",
}

SPECS = (
    Spec("tools", "strings", [], "the tools it drives, in the order of the button next_tool"),
    Spec(
        "motion",
        "string",
        JOY,
        "what moves the tool: the axes of joy_topic, or twist_topic as Twist or TwistStamped",
        choices=(JOY, TWIST, TWIST_STAMPED),
    ),
    Spec("joy_topic", "string", "joy", "sensor_msgs/Joy: buttons, and axes with motion joy"),
    Spec("twist_topic", "string", "spacenav/twist", "with motion twist or twist_stamped"),
    Spec(
        "axes",
        "strings",
        ["-0", "+1", "+4", "+7", "-6", "+3"],
        'axis of joy_topic with its sign ("+0", "-3", "" for none) for x, y, z and the turns '
        "about them",
        length=6,
    ),
    *(
        Spec(f"{name}_button", "integer", _DEFAULT_BUTTONS[name],
             f"{_BUTTON_WORDS[name]}; -1: none", "", -1, 999)
        for name in BUTTONS
    ),
    Spec("use_mode", "string", HOLD, "used while the button is down, or changed by each press",
         choices=(HOLD, TOGGLE)),
    Spec("motion_in", "string", ORGAN, "whose axes the motion is in",
         choices=(TOOL, ORGAN, CAMERA)),
    Spec("camera_orientation", "doubles", [0.0, 0.0, 0.0, 1.0],
         "orientation of the camera in the frame of the organ, quaternion x y z w", length=4),
    Spec("linear_scale", "double", 0.05, "speed at full deflection", "m/s", 1e-4, 0.5),
    Spec("angular_scale", "double", 1.0, "angular speed at full deflection", "rad/s", 1e-3, 10.0),
    Spec("slow_factor", "double", 0.2, "factor on both while slow", "", 0.01, 1.0),
    Spec("deadband", "double", 0.05, "deflection up to which nothing moves", "", 0.0, 0.9),
    Spec("exponent", "double", 0.0, "how much finer it is near the middle; 0: in proportion", "",
         0.0, 10.0),
    *WORKSPACE,
    INPUT_TIMEOUT,
    Spec("pose_hz", "double", 125.0, "poses per second and tool", "Hz", 10.0, 1000.0),
)  # fmt: skip


def mapping_of(values: dict[str, Any]) -> JoyMapping:
    """Which axis and button means what.

    Raises:
        ValueError: An axis or a button is not allowed.
    """
    # Without the axes, a device that has none but buttons is as good as any.
    axes = values["axes"] if values["motion"] == JOY else [""] * 6
    return JoyMapping.parsed(axes, {name: values[f"{name}_button"] for name in BUTTONS})


def steering_of(values: dict[str, Any]) -> Steering:
    """How the tools are steered.

    Raises:
        ValueError: There is no tool, one is named twice, or a value is not allowed.
    """
    tools = values["tools"]
    if not tools or not all(tools):
        raise ParameterError("no tools: give them with -p tools:=\"['grasper']\"")
    if len(set(tools)) < len(tools):
        raise ParameterError(f"tools = {tools} names a tool twice; allowed: each once")
    orientation = unit_quaternion("camera_orientation", values["camera_orientation"])
    axes = {TOOL: None, ORGAN: Rotation.identity(), CAMERA: orientation}[values["motion_in"]]
    return Steering(
        [SteeredTool(name) for name in tools],
        Speeds(values["linear_scale"], values["angular_scale"], values["slow_factor"]),
        Response(values["deadband"], values["exponent"]),
        Workspace.between(values["workspace_min"], values["workspace_max"]),
        axes,
        values["use_mode"] == TOGGLE,
    )
