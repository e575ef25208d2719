"""What `tissue run` plays on a mesh nobody has written a procedure for: grab, pull and cut."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tissue_sim.geometry.suggestions import Interaction

TOOL = "grasper"
SHORTEST_SECONDS = 0.5
SLACK = 0.5
"""Seconds of the run before the procedure begins and after it ends."""

PARTS = {"arrive": 0.10, "press": 0.13, "taut": 0.30, "cut": 0.34, "opened": 0.80, "release": 0.88}
"""When what has happened, as a share of the whole."""

TAUT = 0.3
"""Share of the pull before the cut."""


def tool_parameters(interaction: Interaction, others: Iterable[str] = ()) -> dict[str, Any]:
    """Parameters of the simulation that make the procedure's tool.

    Args:
        interaction: Where to work.
        others: Tools the scene has besides.
    """
    return {
        "tools": [*(tool for tool in others if tool != TOOL), TOOL],
        f"tool.{TOOL}.kind": "grab",
        f"tool.{TOOL}.shape": "sphere",
        f"tool.{TOOL}.size": [float(interaction.radius)],
        f"tool.{TOOL}.position": _metres(interaction.tool_start),
    }


def write_default_procedure(path: Path, interaction: Interaction, seconds: float) -> None:
    """Write a procedure that lasts as long as the run.

    Args:
        path: File to write.
        interaction: Where to work.
        seconds: Length of the run [s]; the procedure is shorter by `SLACK`, but not below
            `SHORTEST_SECONDS`.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    content = default_procedure(interaction, max(seconds - SLACK, SHORTEST_SECONDS))
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def default_procedure(interaction: Interaction, seconds: float) -> dict[str, Any]:
    """The procedure as a YAML file holds it, in metres and seconds."""
    at = {name: round(share * seconds, 3) for name, share in PARTS.items()}
    a, b, c, d = (_metres(corner) for corner in interaction.cut)
    taut = interaction.grab_point + TAUT * interaction.pull
    pulled = interaction.grab_point + interaction.pull
    return {
        "title": "grab, pull and cut",
        "units": "m",
        "frame_id": "organ",
        "tools": {TOOL: {"kind": "grab", "start": {"position": _metres(interaction.tool_start)}}},
        "timeline": [
            {
                "at": 0.0,
                "move": TOOL,
                "to": _metres(interaction.grab_point),
                "for": at["arrive"],
            },
            {"at": at["press"], "press": TOOL},
            {
                "at": at["press"],
                "move": TOOL,
                "to": _metres(taut),
                "for": round(at["taut"] - at["press"], 3),
            },
            {"at": at["cut"], "cut": {"strip": {"from": [a, d], "to": [b, c]}}},
            {
                "at": at["cut"],
                "move": TOOL,
                "to": _metres(pulled),
                "for": round(at["opened"] - at["cut"], 3),
            },
            {"at": at["release"], "release": TOOL},
        ],
        "end": round(0.95 * seconds, 3),
    }


def _metres(point: Sequence[float] | np.ndarray) -> list[float]:
    return [round(float(value), 7) for value in point]
