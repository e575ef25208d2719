"""The wall of the thesis twice, how it is pulled, and what exact finite elements do then."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tissue_sim.compare.effort import Effort
from tissue_sim.compare.fit.problem import Case, case_of
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.machine import FRAME_HZ
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.sources.motions import motion
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.thesis.conditions import Conditions
from tissue_sim.compare.trajectory import Trajectory, simulate
from tissue_sim.geometry.sheet_geometry import CONNECTED

SAME_PLACE = 1e-9
"""Nodes of two walls this near each other are one [m]."""


@dataclass(frozen=True)
class Walls:
    """The wall as tetrahedra and as connected surfaces: the same nodes in another order.

    Attributes:
        tetrahedra: For finite elements, and springs along the edges of tetrahedra.
        connected: Two surfaces of 17 x 26 nodes, closed at their sides, and springs between them.
        rows: Row in `tetrahedra` of each node of `connected`, shape (node_rows,).
    """

    tetrahedra: Organ
    connected: Organ
    rows: NDArray[np.intp]

    @classmethod
    def build(cls, conditions: Conditions) -> Walls:
        """The walls, held as the conditions say.

        Raises:
            ValueError: Their nodes are not the same.
        """
        tetrahedra, connected = load_organ("wall"), load_organ("wall", geometry_kind=CONNECTED)
        found = cKDTree(tetrahedra.rest).query(connected.rest)
        away, rows = np.asarray(found[0]), np.asarray(found[1], dtype=np.intp)
        if len(np.unique(rows)) < tetrahedra.mesh.node_rows or away.max() > SAME_PLACE:
            raise ValueError("the two walls do not have the same nodes")
        hold = _held(tetrahedra, conditions.hold)
        of_connected = np.flatnonzero(np.isin(rows, hold)).astype(np.int32)
        return cls(replace(tetrahedra, hold=hold), replace(connected, hold=of_connected), rows)

    def case(self, pull: str, amplitude: float, conditions: Conditions) -> Case:
        """A pull of tetrahedra [m], and what exact finite elements do under it."""
        organ = self.tetrahedra
        interaction = motion(pull, organ, amplitude, FRAME_HZ)
        if conditions.tremor:
            interaction = _trembling(interaction, conditions.tremor)
        exact = Subject(
            "finite_element", {"material.poisson_ratio": conditions.poisson_ratio,
                               "corotated": conditions.corotated},
            Effort(to_rest=1e-8),
        )  # fmt: skip
        return case_of(organ, interaction, simulate(exact, organ, interaction))

    def carried(self, case: Case) -> Case:
        """The same case for connected surfaces."""
        interaction, reference = case.interaction, case.reference
        at = np.flatnonzero(np.isin(self.rows, interaction.nodes))
        place = np.searchsorted(interaction.nodes, self.rows[at])
        held = Interaction(
            interaction.name, interaction.rate_hz, at.astype(np.int32), interaction.held[:, place],
            interaction.displacement[:, place], self.connected.digest,
        )  # fmt: skip
        moved: Trajectory = replace(
            reference, displacement=reference.displacement[:, self.rows],
            organ=self.connected.digest,
        )  # fmt: skip
        return case_of(self.connected, held, moved)


def _held(organ: Organ, hold: float) -> NDArray[np.int32]:
    """Free nodes of the free side within a share of the wall's width of its middle."""
    rest = organ.rest
    free_side = rest[:, 1] >= rest[:, 1].max() - SAME_PLACE
    width = np.ptp(rest[:, 0])
    off = np.abs(rest[:, 0] - rest[:, 0].mean())
    near = off <= 0.5 * hold * width + SAME_PLACE
    free = ~organ.mesh.fixed[: organ.mesh.node_rows]
    return np.flatnonzero(free_side & near & free).astype(np.int32)


def _trembling(interaction: Interaction, share: float) -> Interaction:
    """A pull by hand: it goes in jerks, back and forth by a share of the way in a frame."""
    rng = np.random.default_rng(1)
    displacement = interaction.displacement.copy()
    step = float(np.linalg.norm(np.diff(displacement[:, 0], axis=0), axis=1).max())
    moving = np.linalg.norm(np.diff(displacement[:, 0], axis=0, prepend=0), axis=1) > 0
    jerks = share * step * rng.standard_normal((int(moving.sum()), 1, 3))
    displacement[moving] += jerks
    return replace(interaction, displacement=displacement)
