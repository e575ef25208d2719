"""All that is told of tissue in one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material
from tissue_sim.elastic.stress import ElementMaterial, material_without_fibres
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.readings import fields
from tissue_sim.readings.history import Histories, Reading
from tissue_sim.readings.reach import ToolReach
from tissue_sim.readings.regions import RiskRegions
from tissue_sim.readings.risk import RiskWatch
from tissue_sim.readings.risk_warnings import RiskWarning, Warnings

WITHOUT_READING = (fields.SMALLEST_STRESS, fields.RISK)
"""Quantities whose largest value at a node says nothing of a frame."""


@dataclass(frozen=True)
class Told:
    """What is told in one frame.

    Attributes:
        values: At the nodes by name of the quantity, shape (node_rows,) each.
        readings: One for each quantity.
        warnings: That are on, and those just over.
        regions_changed: Whether copies have joined a region, or nodes have left one.
    """

    values: dict[str, NDArray[np.float64]]
    readings: list[Reading] = field(default_factory=list)
    warnings: list[RiskWarning] = field(default_factory=list)
    regions_changed: bool = False


class TissueReadings:
    """Reads tissue that moves and is cut.

    Attributes:
        regions: Its risk regions.
        histories: What quantities have been.
    """

    def __init__(self, lasting: float) -> None:
        """Begin.

        Args:
            lasting: Time that a warning lasts after what it is about [s].
        """
        self.regions, self.histories = RiskRegions(), Histories()
        self._warnings, self._watch = Warnings(lasting), RiskWatch(self.regions)
        self._made_of: tuple[Mesh, int, Material, ElementMaterial] | None = None

    def restart(self, mesh: Mesh) -> list[str]:
        """Begin anew with another epoch's organ; names of the risk regions that are not in it."""
        self.histories.clear()
        self._warnings.clear()
        self._watch.restart(mesh)
        return self.regions.carry(mesh)

    def read(
        self,
        mesh: Mesh,
        places: NDArray[np.floating],
        time: float,
        material: Material | None,
        tools: Sequence[ToolReach],
        held: NDArray[np.integer],
        wanted: str,
    ) -> Told:
        """Read the tissue in one frame.

        Args:
            mesh: The tissue.
            places: Where its nodes are [m], shape (node_rows, 3).
            time: Of the frame [s].
            material: What it is made of; None: not known, and no stress is told.
            tools: The tools.
            held: Ids of the nodes that they hold.
            wanted: A quantity that is told besides those that are cheap.

        Raises:
            MaterialError: The mesh cannot have this material.
        """
        values = {fields.DISPLACEMENT: fields.displacement(mesh, places)}
        if mesh.sheet_rows is None:
            made_of = None if material is None else self._element_material(mesh, material)
            values |= fields.stresses(mesh, places, made_of)
        if mesh.sheet_rows is not None or wanted == fields.SPRING_STRAIN:
            values[fields.SPRING_STRAIN] = fields.spring_strain(mesh, places)
        changed = self.regions.follow(mesh)
        found, risk = self._watch.look(mesh, places, tools, held, values.get(fields.VON_MISES))
        values[fields.RISK] = risk
        readings = [
            self.histories.take(name, at_nodes, time)
            for name, at_nodes in values.items()
            if name not in WITHOUT_READING
        ]
        return Told(
            values,
            [reading for reading in readings if reading is not None],
            self._warnings.take(found, time),
            changed,
        )

    def _element_material(self, mesh: Mesh, material: Material) -> ElementMaterial:
        known = self._made_of
        if (
            known is None or known[0] is not mesh or known[1] != mesh.version
            or known[2] is not material
        ):  # fmt: skip
            known = (mesh, mesh.version, material, material_without_fibres(mesh, material))
            self._made_of = known
        return known[3]
