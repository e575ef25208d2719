"""Parameters of the haptic node."""

from __future__ import annotations

from typing import Any

from tissue_sim.interaction.reaction import ForceLimits
from tissue_sim.parameters import Spec
from tool_input.arm_parameters import ARM, base_of
from tool_input.haptics.arm_force import ArmForce
from tool_input.haptics.contact_loop import LoopLimits

SPECS = (
    *ARM,
    Spec("rate_hz", "double", 1000.0, "forces per second", "Hz", 100.0, 4000.0),
    Spec(
        "pose_hz", "double", 250.0,
        "poses per second that the tool is told; 0: another node drives it", "Hz", 0.0, 4000.0,
    ),
    Spec("force_scale", "double", 1.0, "newtons at the arm per newton on the tool", "", 1e-3, 1e3),
    Spec("max_force", "double", 3.0, "largest force at the arm", "N", 1e-3, 100.0),
    Spec("max_torque", "double", 0.1, "largest torque at the arm", "N m", 1e-4, 10.0),
    Spec("max_force_rate", "double", 300.0, "fastest change of the force", "N/s", 0.1, 1e5),
    Spec("max_torque_rate", "double", 10.0, "fastest change of the torque", "N m/s", 1e-3, 1e4),
    Spec("max_stiffness", "double", 2000.0, "largest stiffness at the arm", "N/m", 1.0, 1e5),
    Spec("max_damping", "double", 20.0, "largest damping at the arm", "N s/m", 0.0, 1e3),
    Spec("fade", "double", 0.03, "time in which a force goes that must go", "s", 0.001, 1.0),
    Spec(
        "force_timeout", "double", 0.05, "silence of the arm after which its force goes", "s",
        0.005, 1.0,
    ),
    Spec(
        "enable_topic", "string", "",
        "std_msgs/Bool, the dead man's switch: no force unless its newest message is true; empty: "
        "there is none",
    ),
    Spec("realtime_priority", "integer", 0, "SCHED_FIFO priority of the loop; 0: none", "", 0, 99),
)  # fmt: skip


def arm_force_of(values: dict[str, Any]) -> ArmForce:
    """How the arm displays the wrench on the tool."""
    return ArmForce(base_of(values), values["force_scale"])


def limits_of(values: dict[str, Any], force: ArmForce) -> LoopLimits:
    """What the arm bears, in forces on the tool."""
    at_arm = ForceLimits(
        values["max_force"], values["max_torque"],
        values["max_force_rate"], values["max_torque_rate"],
    )  # fmt: skip
    return LoopLimits(
        force.on_tool(at_arm),
        force.per_length(values["max_stiffness"]),
        force.per_length(values["max_damping"]),
        values["fade"],
    )
