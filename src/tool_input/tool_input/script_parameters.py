"""Parameters of the script node."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.node import Node

from tool_input.declared import (
    declare_number,
    declare_text,
    refuse_unknown,
)

CLOCKS = ("wall", "simulation")


@dataclass(frozen=True)
class ScriptParameters:
    """What the script node can be told.

    Attributes:
        procedure: File to play.
        pose_hz: Poses per second and tool [Hz].
        clock: "wall", or "simulation": the organ's own time.
        start_timeout: Longest wait for the simulation [s].
        service_timeout: Longest wait for an answer [s].
        report: JSON file for what the services answered; empty: none.
    """

    procedure: str
    pose_hz: float
    clock: str
    start_timeout: float
    service_timeout: float
    report: str


def declared(node: Node) -> ScriptParameters:
    """Declare the parameters and take their values.

    Raises:
        ValueError: One of them is not allowed.
    """
    procedure = declare_text(node, "procedure", "", "YAML file to play")
    clock = declare_text(node, "clock", "wall", "wall, or simulation: the organ's own time")
    if not procedure:
        raise ValueError("no procedure: give its file with -p procedure:=FILE")
    if clock not in CLOCKS:
        raise ValueError(f"clock = {clock!r} is not allowed; allowed: {', '.join(CLOCKS)}")
    parameters = ScriptParameters(
        procedure=procedure,
        pose_hz=declare_number(
            node, "pose_hz", 125.0, 1.0, 1000.0, "poses per second and tool [Hz]"
        ),
        clock=clock,
        start_timeout=declare_number(
            node, "start_timeout", 120.0, 0.1, 3600.0, "longest wait for the simulation [s]"
        ),
        service_timeout=declare_number(
            node, "service_timeout", 60.0, 0.1, 3600.0, "longest wait for an answer [s]"
        ),
        report=declare_text(node, "report", "", "JSON file for the services' answers; empty: none"),
    )
    refuse_unknown(node)
    return parameters
