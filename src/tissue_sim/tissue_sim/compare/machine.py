"""Machines whose speed fixes how many steps a model makes in a frame.

The thesis ran every model for as long as a frame of 1/30 s lasts on a desktop of 2003 (THESIS.md,
section 7). Its frame rates, as steps per 1/30 s with fractions carried over, are that machine.
"""

from __future__ import annotations

from dataclasses import replace

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.elastic import registry
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.geometry.sheet import CONNECTING

FRAME_HZ = 30.0
"""Frames of the thesis' comparisons per second [1/s]."""

THESIS_FPS = {
    "quasi_static": 57.0, "quasi_static on connected surfaces": 90.0,
    "quasi_static with relaxation": 61.0, "spring_mass": 86.0, "relaxation": 106.0,
    "finite_element": 12.0, "lr": 20.0,
}  # fmt: skip
"""The thesis' frames a second on the wall; of lr on its heart, its only figure of that model."""

MACHINES = ("thesis",)
"""Names of the machines."""


def thesis_steps(subject: Subject, organ: Organ) -> float:
    """Steps in each 1/30 s that the thesis' machine made of a model, rounded as its rates are.

    `lr` with all levels is the quasi-static model with relaxation, with fewer of them the thesis'
    LR model; its 20 frames a second are those of the heart, and our reading is that a frame was a
    step there too.

    Raises:
        ValueError: The thesis has no rate of this model.
    """
    kind = subject.model
    if kind == "lr" and _levels(subject) >= WHOLE_ORGAN:
        kind = "quasi_static with relaxation"
    elif kind == "quasi_static" and _is_connected(organ):
        kind = "quasi_static on connected surfaces"
    if kind not in THESIS_FPS:
        raise ValueError(
            f"the thesis has no frame rate of {subject.model}: give it an effort of its own, for "
            f"example {subject.model}@2; it has one of " + ", ".join(sorted(THESIS_FPS))
        )
    digits = 2 if kind == "lr" else 1
    return round(THESIS_FPS[kind] / FRAME_HZ, digits)


def on_machine(machine: str, subject: Subject, organ: Organ, rate_hz: float) -> Subject:
    """A subject with as many steps a frame as a machine makes.

    Args:
        machine: One of `MACHINES`.
        subject: The subject; its effort is replaced.
        organ: What it runs on.
        rate_hz: Frames per second of the interaction [1/s].

    Raises:
        ValueError: There is no such machine, or it never ran this model.
    """
    if machine not in MACHINES:
        raise ValueError(f"there is no machine {machine!r}; allowed: {', '.join(MACHINES)}")
    steps = thesis_steps(subject, organ) * FRAME_HZ / rate_hz
    return replace(subject, effort=Effort(steps=steps))


def _levels(subject: Subject) -> float:
    default = {entry.name: entry.default for entry in registry.parameters_of(subject.model)}
    return subject.values.get("levels", default["levels"])


def _is_connected(organ: Organ) -> bool:
    sheet = organ.mesh.sheet
    return sheet is not None and sheet.count(CONNECTING) > 0
