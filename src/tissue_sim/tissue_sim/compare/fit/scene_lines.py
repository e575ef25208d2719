"""What a fitted subject is in a scene's file."""

from __future__ import annotations

from typing import Any

import yaml

from tissue_sim.compare.effort import shortest
from tissue_sim.compare.subject import MATERIAL, SPRINGS, Subject
from tissue_sim.elastic import registry


def scene_lines(subject: Subject, rate_hz: float) -> list[str]:
    """Lines for a scene's `ros__parameters`; what a scene cannot have is a comment.

    Args:
        subject: The subject.
        rate_hz: Frames per second that its effort is meant for [1/s].
    """
    whole = {entry.name for entry in registry.parameters_of(subject.model) if entry.integer}
    given: dict[str, Any] = {"model": subject.model}
    comments = []
    for name, value in subject.values.items():
        if name.startswith(SPRINGS):
            comments.append(f"# {name} {shortest(value)}: springs of a scene have the material's")
        elif name.startswith(MATERIAL):
            given[name.removeprefix(MATERIAL)] = float(value)
        else:
            given[f"{subject.model}.{name}"] = int(value) if name in whole else float(value)
    steps = subject.effort.steps
    if steps is not None and steps == int(steps):
        given |= {"rate_hz": float(rate_hz), "steps_per_frame": int(steps)}
    elif steps is not None:
        comments.append(
            f"# {shortest(steps)} steps in a frame of 1/{rate_hz:g} s: steps_per_frame is whole"
        )
    return [*yaml.safe_dump(given, sort_keys=False).splitlines(), *comments]
