"""Options of commands that put models on an organ: what the organ is, and which models."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import typer

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.machine import MACHINES, on_machine
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.subject import Subject, parse_subject
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material

OrganName = Annotated[
    str | None,
    typer.Argument(
        help="A shape (wall, block, sphere_shell, heart), a mesh file or a scene file; "
        "left out: the organ of the recording."
    ),
]
Units = Annotated[str, typer.Option(help="Unit of a mesh file's coordinates: mm or m.")]
Fixed = Annotated[
    str, typer.Option(help="Nodes that never move: auto, none, set:NAME, box:..., low:z:0.1, ...")
]
Kind = Annotated[
    str, typer.Option(help="What it is made of: volume, surface or connected_surfaces.")
]
Young = Annotated[float | None, typer.Option(help="Young's modulus of the organ [Pa].")]
Poisson = Annotated[float | None, typer.Option(help="Poisson's ratio of the organ.")]
Targets = Annotated[
    list[str] | None,
    typer.Option(
        "--target", "-t", help="A model: [NAME=]MODEL[:VALUE=NUMBER,...][@EFFORT]; several times."
    ),
]
DefaultEffort = Annotated[
    str, typer.Option(help="Of models without @: steps a frame (2.9), time (4ms), rest or time.")
]
Machine = Annotated[
    str, typer.Option(help=f"Steps of models without @ as on a machine: {', '.join(MACHINES)}.")
]


def organ_of(
    name: str | None, units: str, fixed: str, kind: str, young: float | None, poisson: float | None
) -> Organ | None:
    """The organ that the options mean; None: nobody named one.

    Raises:
        ValueError: It cannot be made, or something is said of an organ that nobody named.
    """
    if name is None:
        if units or fixed or kind or young is not None or poisson is not None:
            raise ValueError(
                "units, fixed, kind, young and poisson are of an organ that is named: name it, or "
                "leave them out to take the recording's"
            )
        return None
    organ = load_organ(
        name, units or None, geometry_kind=kind or "volume", fixed=fixed or "auto"
    )  # fmt: skip
    return replace(organ, material=material_of(organ.material, young, poisson))


def material_of(material: Material, young: float | None, poisson: float | None) -> Material:
    """A material with other constants.

    Raises:
        MaterialError: They are out of range.
    """
    changed = replace(
        material,
        young_modulus=material.young_modulus if young is None else young,
        poisson_ratio=material.poisson_ratio if poisson is None else poisson,
    )
    registry.check_material(changed)
    return changed


def subjects_of(texts: Sequence[str] | None) -> list[Subject]:
    """The targets that the options mean, each with a name of its own.

    Several of a model without names are called by what was written.

    Raises:
        ValueError: There is none, one cannot be read, or two are the same.
    """
    if not texts:
        raise ValueError(
            "there is no target: name one or more with --target MODEL, for example --target "
            f"quasi_static@2; models: {', '.join(registry.names())}"
        )
    subjects = [parse_subject(text) for text in texts]
    counts = Counter(subject.name for subject in subjects)
    named = [
        replace(subject, label=text.strip()) if counts[subject.name] > 1 else subject
        for subject, text in zip(subjects, texts, strict=True)
    ]
    names = Counter(subject.name for subject in named)
    for name, count in names.items():
        if count > 1:
            raise ValueError(f"target {name} is there {count} times; give names: NAME={name}")
    return named


def with_efforts(
    subjects: Sequence[Subject],
    texts: Sequence[str],
    effort: str,
    machine: str,
    organ: Organ,
    rate_hz: float,
) -> list[Subject]:
    """The targets with the effort that they have where their own text says none.

    Args:
        subjects: Of `subjects_of`.
        texts: What they were read from.
        effort: The effort of all of them; "": that of the machine, or their own default.
        machine: Name of a machine; "": none.
        organ: What they run on.
        rate_hz: Frames per second of the interaction [1/s].

    Raises:
        ValueError: There is no such effort or machine, both are given, or the machine never ran a
            model.
    """
    if effort and machine:
        raise ValueError("effort and machine both say how many steps a model makes: give one")
    default = Effort.parse(effort) if effort else None
    return [
        subject
        if "@" in text
        else on_machine(machine, subject, organ, rate_hz)
        if machine
        else replace(subject, effort=default or subject.effort)
        for subject, text in zip(subjects, texts, strict=True)
    ]
