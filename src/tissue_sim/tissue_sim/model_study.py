"""Every model on the wall and the heart, held and pulled the same way, next to finite elements."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.bench import hold_for
from tissue_sim.elastic import registry
from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import Material, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import signed_volumes

PULL_STEPS, HOLD_STEPS = 240, 2000
"""Steps during which the hold moves, and most steps that follow; models without time."""
PULL_SECONDS, HOLD_SECONDS = 0.5, 0.5
"""The same of models in time [s]."""
CHECK_EVERY, AT_REST = 50, 1e-6
"""Tissue that moved by less than this [m] in so many steps is at rest."""
DYNAMIC_STEP = 1.0 / 4800.0
"""Time step of the dynamic model [s]: the heart's lightest nodes would want a tenth of it."""


@dataclass(frozen=True)
class Variant:
    """A model with some of its parameters.

    Attributes:
        label: Name for people.
        model: Name of the model.
        parameters: Values that differ from the defaults.
    """

    label: str
    model: str
    parameters: tuple[tuple[str, float], ...] = ()


VARIANTS = (
    Variant("finite_element", "finite_element"),
    Variant("finite_element, corotated", "finite_element", (("corotated", 1.0),)),
    Variant(
        "vertex_block_descent, all levels",
        "vertex_block_descent",
        (("levels", float(WHOLE_ORGAN)),),
    ),
    Variant("vertex_block_descent", "vertex_block_descent"),
    Variant("quasi_static, all levels", "quasi_static", (("levels", float(WHOLE_ORGAN)),)),
    Variant("spring_mass", "spring_mass", (("time_step", DYNAMIC_STEP), ("mass_scaling", 1.0))),
    Variant("lr", "lr"),
    Variant("relaxation", "relaxation"),
    Variant("chain_mail", "chain_mail"),
    Variant("voxel_chain_mail", "voxel_chain_mail"),
)
REFERENCE = VARIANTS[0]


@dataclass(frozen=True)
class Pull:
    """What is held on a geometry and where it goes.

    Attributes:
        geometry: Name of the geometry.
        mesh: Its mesh.
        held: Rows of the nodes held, sorted.
        vector: Where they go from rest [m], shape (3,).
    """

    geometry: str
    mesh: Mesh
    held: NDArray[np.int32]
    vector: NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """How a model came out on a geometry.

    Attributes:
        geometry: Name of the geometry.
        label: Name of the variant.
        model: Name of the model.
        parameters: Values that differ from the defaults.
        pull_mm: Length of the pull [mm].
        steps: Steps done.
        at_rest: Whether the tissue had come to rest.
        largest_mm: Largest displacement [mm].
        mean_difference_mm: From finite elements, mean over free nodes [mm].
        largest_difference_mm: From finite elements, largest of a free node [mm].
        mean_share: Mean difference over the pull.
        largest_share: Largest difference over the pull.
        inverted: Elements inside out.
        elements: Elements.
    """

    geometry: str
    label: str
    model: str
    parameters: dict[str, float]
    pull_mm: float
    steps: int
    at_rest: bool
    largest_mm: float
    mean_difference_mm: float
    largest_difference_mm: float
    mean_share: float
    largest_share: float
    inverted: int
    elements: int


@dataclass(frozen=True)
class Shape:
    """A pulled organ.

    Attributes:
        pull: What was pulled.
        row: How it came out.
        displacement: Of the nodes [m], shape (node_rows, 3).
    """

    pull: Pull
    row: Row
    displacement: NDArray[np.float64]


def pull_of(geometry: str) -> Pull:
    """What is held and where it goes: the wall 12 mm out of its plane, the heart 10 mm outward.

    The wall is held at the middle third of its free side, the heart at the nodes around the one
    farthest from what is fixed, and pulled away from what is fixed.
    """
    scene = scene_geometry.load(geometry)
    mesh = scene.mesh
    if "hold" in scene.raw.node_sets:
        held = np.sort(scene.raw.node_sets["hold"]).astype(np.int32)
        return Pull(geometry, mesh, held, np.array([0.0, 0.0, 0.012]))
    held = hold_for(mesh)
    rows = mesh.node_rows
    away = mesh.rest[held].mean(axis=0) - mesh.rest[:rows][mesh.fixed[:rows]].mean(axis=0)
    return Pull(geometry, mesh, held, 0.010 * away / np.linalg.norm(away))


def study(
    geometries: tuple[str, ...] = ("wall", "heart"), variants: tuple[Variant, ...] = VARIANTS
) -> Iterator[Shape]:
    """Pull every variant on every geometry; the first of them is what the others differ from."""
    for geometry in geometries:
        pull = pull_of(geometry)
        springs = SpringNetwork(pull.mesh, Material())
        reference = None
        for variant in variants:
            displacement, steps, at_rest = pulled(variant, pull, springs)
            if reference is None:
                reference = displacement
            row = _judge(variant, pull, displacement, reference, steps, at_rest)
            yield Shape(pull, row, displacement)


def pulled(
    variant: Variant, pull: Pull, springs: SpringNetwork
) -> tuple[NDArray[np.float64], int, bool]:
    """Displacement after a pull [m], shape (node_rows, 3), steps done, and whether it rests."""
    mesh, held = pull.mesh, pull.held
    model = registry.MODELS[variant.model](
        mesh,
        springs.material,
        registry.checked_parameters(variant.model, dict(variant.parameters)),
        springs,
    )
    state = State(mesh)
    model.prescribed_changed(state, held[:0])
    state.prescribed[held] = True
    model.prescribed_changed(state, held)
    moving, still = PULL_STEPS, HOLD_STEPS
    if model.time_step is not None:
        moving = round(PULL_SECONDS / model.time_step)
        still = round(HOLD_SECONDS / model.time_step)
    for step in range(moving):
        state.displacement[held] = pull.vector * (step + 1) / moving
        model.step(state)
    further, at_rest = _settle(model, state, still)
    return state.displacement[: mesh.node_rows].astype(np.float64), moving + further, at_rest


def _settle(model: MeshModel, state: State, most: int) -> tuple[int, bool]:
    """Steps done and whether the tissue came to rest within `most`."""
    for steps in range(CHECK_EVERY, most + 1, CHECK_EVERY):
        before = state.displacement.copy()
        for _ in range(CHECK_EVERY):
            model.step(state)
        if model.idle or float(np.abs(state.displacement - before).max()) < AT_REST:
            return steps, True
    return most - most % CHECK_EVERY, False


def _judge(
    variant: Variant,
    pull: Pull,
    displacement: NDArray[np.float64],
    reference: NDArray[np.float64],
    steps: int,
    at_rest: bool,
) -> Row:
    mesh, rows = pull.mesh, pull.mesh.node_rows
    free = mesh.node_alive[:rows] & ~mesh.fixed[:rows]
    free[pull.held] = False
    difference = 1e3 * np.linalg.norm(displacement - reference, axis=1)[free]
    length = 1e3 * float(np.linalg.norm(pull.vector))
    tets = mesh.tets[: mesh.element_rows][mesh.element_alive[: mesh.element_rows]]
    volumes = signed_volumes(mesh.rest[:rows] + displacement, tets)
    return Row(
        pull.geometry,
        variant.label,
        variant.model,
        dict(variant.parameters),
        round(length, 3),
        steps,
        at_rest,
        round(1e3 * float(np.linalg.norm(displacement, axis=1).max()), 3),
        round(float(difference.mean()), 4),
        round(float(difference.max()), 4),
        round(float(difference.mean()) / length, 5),
        round(float(difference.max()) / length, 5),
        int((volumes <= 0.0).sum()),
        len(tets),
    )


def as_markdown(rows: list[Row], geometry: str) -> str:
    """How the models came out on a geometry, as a table."""
    lines = [
        "| model | mean difference [mm] | largest [mm] | inverted elements | steps | at rest |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row.geometry != geometry:
            continue
        values = (
            f"{row.mean_difference_mm:.2f} ({row.mean_share:.1%}) "
            f"| {row.largest_difference_mm:.1f} ({row.largest_share:.0%})"
        )
        if row.label == REFERENCE.label:
            values = "the reference |"
        rest = "yes" if row.at_rest else "no"
        lines.append(f"| `{row.label}` | {values} | {row.inverted} | {row.steps:,} | {rest} |")
    return "\n".join(lines)


def write(file: Path, rows: list[Row]) -> None:
    """Write the rows as JSON."""
    protocol = {
        "pull_steps": PULL_STEPS,
        "hold_steps": HOLD_STEPS,
        "pull_seconds": PULL_SECONDS,
        "hold_seconds": HOLD_SECONDS,
        "young_modulus": Material().young_modulus,
        "poisson_ratio": Material().poisson_ratio,
    }
    result: dict[str, Any] = {"protocol": protocol, "rows": [asdict(row) for row in rows]}
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
