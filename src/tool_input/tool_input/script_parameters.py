"""Parameters of the script node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tissue_sim.parameters import ParameterError, Spec

SPECS = (
    Spec("procedure", "string", "", "YAML file to play"),
    Spec("pose_hz", "double", 125.0, "poses per second and tool", "Hz", 1.0, 1000.0),
    Spec(
        "clock",
        "string",
        "wall",
        "what the procedure's seconds are: real ones, or the organ's own",
        choices=("wall", "simulation"),
    ),
    Spec(
        "listeners",
        "integer",
        1,
        "how many must listen to each tool before it moves: the simulation, a recorder",
        "",
        1,
        100,
    ),
    Spec("start_timeout", "double", 600.0, "longest wait for the simulation", "s", 0.1, 3600.0),
    Spec("service_timeout", "double", 60.0, "longest wait for an answer", "s", 0.1, 3600.0),
    Spec("report", "string", "", "JSON file for the services' answers; empty: none"),
)


@dataclass(frozen=True)
class ScriptParameters:
    """What the script node can be told; `SPECS` describes each."""

    procedure: str
    pose_hz: float
    clock: str
    listeners: int
    start_timeout: float
    service_timeout: float
    report: str

    @classmethod
    def of(cls, values: dict[str, Any]) -> ScriptParameters:
        """The parameters from their checked values.

        Raises:
            ParameterError: There is no procedure.
        """
        if not values["procedure"]:
            raise ParameterError("no procedure: give its file with -p procedure:=FILE")
        return cls(**values)
