"""Surfaces and connected surfaces of the wall and the heart, pulled as their tetrahedra are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tissue_sim import model_study
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import SheetStiffness
from tissue_sim.geometry.sheet_geometry import CONNECTED, SURFACE, SheetSettings
from tissue_sim.model_study import Pull, Row, Shape, Variant

EVERYWHERE = Variant("quasi_static, all levels", "quasi_static", (("levels", float(WHOLE_ORGAN)),))
GEOMETRIES: tuple[tuple[str, SheetSettings | None], ...] = (
    ("tetrahedra", None),
    ("connected surfaces", SheetSettings(CONNECTED)),
    ("surface, torsion springs", SheetSettings(SURFACE, stiffness=SheetStiffness(torsion=1.0))),
)
"""What the same organ is made of."""


def study(geometry: str) -> Iterator[Shape]:
    """Pull an organ made of each; rows tell how far its surface is from finite elements'."""
    volume = model_study.pull_of(geometry)
    springs = SpringNetwork(volume.mesh, Material())
    reference, _, _ = model_study.pulled(model_study.REFERENCE, volume, springs)
    seen = np.isin(np.arange(volume.mesh.node_rows), _rows(volume.mesh, _surface(geometry)))
    for label, settings in GEOMETRIES:
        mesh = volume.mesh
        if settings is not None:
            mesh = scene_geometry.load(geometry, sheet=settings).mesh
        rows = _rows(volume.mesh, mesh)
        held = np.flatnonzero(np.isin(rows, volume.held)).astype(np.int32)
        pull = Pull(geometry, mesh, held, volume.vector)
        network = SpringNetwork(mesh, Material())
        displacement, steps, at_rest = model_study.pulled(EVERYWHERE, pull, network)
        free = seen[rows] & ~mesh.fixed[: mesh.node_rows]
        free[held] = False
        difference = 1e3 * np.linalg.norm(displacement - reference[rows], axis=1)[free]
        length = 1e3 * float(np.linalg.norm(pull.vector))
        largest = 1e3 * float(np.linalg.norm(displacement, axis=1).max())
        row = Row(
            geometry, label, EVERYWHERE.model, dict(EVERYWHERE.parameters), round(length, 3),
            steps, at_rest, round(largest, 3), round(float(difference.mean()), 4),
            round(float(difference.max()), 4), round(float(difference.mean()) / length, 5),
            round(float(difference.max()) / length, 5), 0, mesh.element_rows,
        )  # fmt: skip
        yield Shape(pull, row, displacement)


def _surface(geometry: str) -> Mesh:
    return scene_geometry.load(geometry, sheet=SheetSettings(SURFACE)).mesh


def _rows(volume: Mesh, mesh: Mesh) -> np.ndarray:
    """Row in the volume mesh of each node of another mesh of the same geometry."""
    row_of = np.full(int(volume.node_file_ids.max()) + 1, -1)
    row_of[volume.node_file_ids[: volume.node_rows]] = np.arange(volume.node_rows)
    return row_of[mesh.node_file_ids[: mesh.node_rows]]
