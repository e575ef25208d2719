"""Everything a comparison found as plain JSON values; docs/compare_report.md is the schema."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.comparison import Comparison, Target
from tissue_sim.compare.difference import Difference
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Trajectory
from tissue_sim.elastic import registry
from tissue_sim.whole_files import write_json

FORMAT = 1
"""Version of the schema."""

DIGITS = 7
"""Significant digits of the numbers in arrays: displacements are single precision."""

LIBRARIES = ("numpy", "scipy", "numba", "plotly")


def result_of(comparisons: Sequence[Comparison], command: str = "") -> dict[str, Any]:
    """What comparisons found, in SI units, with None for what is not a number.

    Args:
        comparisons: One for each interaction.
        command: The command that made them, as a person would type it again.
    """
    return {
        "format": FORMAT,
        "made": made(command),
        "comparisons": [comparison_document(comparison) for comparison in comparisons],
    }


def write_result(path: Path, comparisons: Sequence[Comparison], command: str = "") -> None:
    """Write `result_of` as JSON, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, result_of(comparisons, command))


def made(command: str = "") -> dict[str, Any]:
    """Where figures come from: date, command, versions and machine."""
    from tissue_sim.bench import machine
    from viz_bridge.provenance import provenance

    origin = provenance()
    measured_on = machine()
    return {
        "at": origin["recorded_at"],
        "command": command,
        "git_revision": origin["git_revision"],
        "processor": measured_on["processor"],
        "cores": measured_on["cores"],
        "system": origin["system"],
        "versions": {"python": origin["python"]} | {name: _version(name) for name in LIBRARIES},
    }


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """One comparison; see `result_of`."""
    subject = comparison.reference_subject
    reference = _trajectory_document(comparison.reference)
    rows = comparison.reference.rows
    return {
        "organ": organ_document(comparison.organ),
        "interaction": interaction_document(comparison.interaction),
        "reference": {
            "subject": None if subject is None else subject_document(subject),
            "measured_nodes": None if rows is None else len(rows),
            **reference,
        },
        "worst_mean_m": number(comparison.worst.mean),
        "ranking": [target.subject.name for target in comparison.ranking],
        "targets": [_target_document(target) for target in comparison.targets],
    }


def organ_document(organ: Organ) -> dict[str, Any]:
    """What an organ is."""
    mesh = organ.mesh
    material = organ.material
    alive = mesh.node_alive[: mesh.node_rows]
    return {
        "name": organ.name,
        "digest": organ.digest,
        "nodes": int(alive.sum()),
        "fixed_nodes": int((mesh.fixed[: mesh.node_rows] & alive).sum()),
        "elements": int(mesh.element_alive[: mesh.element_rows].sum()),
        "kind": "tetrahedra" if mesh.sheet is None else "triangles",
        "size_m": number(organ.size),
        "material": {
            "young_modulus": material.young_modulus,
            "poisson_ratio": material.poisson_ratio,
            "density": material.density,
            "fibre_stiffness": material.fibre_stiffness,
            "regions": [region.region for region in material.regions],
        },
    }


def interaction_document(interaction: Interaction) -> dict[str, Any]:
    """What was done to the organ."""
    return {
        "name": interaction.name,
        "rate_hz": interaction.rate_hz,
        "frames": interaction.frames,
        "seconds": interaction.seconds,
        "held_nodes": len(interaction.nodes),
        "held_frames": int(interaction.held.any(axis=1).sum()),
        "amplitude_m": number(interaction.amplitude),
    }


def subject_document(subject: Subject) -> dict[str, Any]:
    """A model, what was set on it, and what all of its parameters were then."""
    return {
        "label": subject.name,
        "text": subject.text,
        "model": subject.model,
        "values": dict(subject.values),
        "parameters": registry.checked_parameters(subject.model, subject.parameters),
        "effort": str(subject.effort),
        "reproducible": subject.effort.reproducible,
    }


def number(value: float) -> float | None:
    """A number as JSON has it: None for what is not finite."""
    return float(value) if math.isfinite(value) else None


def numbers(values: NDArray[Any]) -> list[float | None]:
    """Numbers as JSON has them, to `DIGITS` significant digits."""
    return [number(float(f"{value:.{DIGITS}g}")) for value in np.asarray(values).tolist()]


def _target_document(target: Target) -> dict[str, Any]:
    return {
        **subject_document(target.subject),
        "relative": number(target.relative),
        **_difference_document(target.difference),
        "trajectory": _trajectory_document(target.trajectory),
    }


def _difference_document(apart: Difference) -> dict[str, Any]:
    return {
        "mean_m": number(apart.mean),
        "p95_m": number(apart.p95),
        "largest_m": number(apart.largest),
        "largest_volume_error": number(apart.largest_volume_error),
        "frames": {
            "mean_m": numbers(apart.frame_mean),
            "p95_m": numbers(apart.frame_p95),
            "largest_m": numbers(apart.frame_largest),
            "volume_error": numbers(apart.volume_error),
        },
        "nodes": {
            "mean_m": numbers(apart.node_mean),
            "largest_m": numbers(apart.node_largest),
        },
    }


def _trajectory_document(trajectory: Trajectory) -> dict[str, Any]:
    return {
        "label": trajectory.label,
        "frames": trajectory.frames,
        "stable_frames": trajectory.stable,
        "steps_per_frame": number(trajectory.steps_per_frame),
        "ms_per_frame": number(trajectory.ms_per_frame),
        "steps": trajectory.steps.tolist(),
        "seconds": numbers(trajectory.seconds),
    }


def _version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return ""
