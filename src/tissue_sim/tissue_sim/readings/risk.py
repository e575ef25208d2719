"""What is near risk regions, or happens in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.mesh import Mesh
from tissue_sim.readings.holders import Holders
from tissue_sim.readings.reach import ToolReach
from tissue_sim.readings.regions import RiskRegion, RiskRegions
from tissue_sim.readings.risk_warnings import CUT, NEAR, STRESS, TOUCHED, Cause, Finding

Reals = NDArray[np.float64]

WIDER = 1.2
"""A warning that is on goes on within a margin so much wider, or a limit so much lower."""


class RiskWatch:
    """Looks at risk regions as tissue and tools move."""

    def __init__(self, regions: RiskRegions) -> None:
        """Begin.

        Args:
            regions: The regions, looked at as they are at the time.
        """
        self._regions = regions
        self._holders = Holders()
        self._version = 0

    def restart(self, mesh: Mesh) -> None:
        """Begin with another organ, or with one that was loaded again."""
        self._holders.clear()
        self._version = mesh.version

    def look(
        self,
        mesh: Mesh,
        places: NDArray[np.floating],
        tools: Sequence[ToolReach],
        held: NDArray[np.integer],
        stress: Reals | None,
    ) -> tuple[dict[Cause, Finding], Reals]:
        """What is found now.

        Args:
            mesh: The tissue.
            places: Where its nodes are [m], shape (node_rows, 3).
            tools: The tools.
            held: Ids of the nodes that tools hold.
            stress: Von Mises stress at the nodes [Pa], shape (node_rows,); None: not known.

        Returns:
            What is found, by cause; and the risk of each node, shape (node_rows,): 0 with nothing
            within the margin of its region and no stress, 1 where a tool touches it or its stress
            is at the limit, nan outside all regions.
        """
        found: dict[Cause, Finding] = {}
        risk = np.full(mesh.node_rows, np.nan)
        held_rows = mesh.node_rows_of(held)
        there = held_rows >= 0
        held_rows = held_rows[there]
        holders = self._holders.take(held[there], places[held_rows], tools)
        held_by = {tool: held_rows[which] for tool, which in holders.items()}
        is_cut = self._cut_since(mesh)
        for region in self._regions.by_name.values():
            rows = self._regions.rows(region.name)
            if not len(rows):
                continue
            own = np.zeros(len(rows))
            if count := int(is_cut[rows].sum()):
                found[Cause(region.name, CUT)] = Finding(count)
            touched = {tool: np.isin(rows, nodes) for tool, nodes in held_by.items()}
            _look_at_tools(region, places[rows].astype(np.float64), tools, touched, found, own)
            if stress is not None and region.stress_limit > 0.0:
                there, limit = np.nan_to_num(stress[rows]), region.stress_limit
                np.maximum(own, np.minimum(there / limit, 1.0), out=own)
                if (worst := float(there.max())) > limit / WIDER:
                    found[Cause(region.name, STRESS)] = Finding(worst, worst > limit)
            risk[rows] = np.fmax(risk[rows], own)
        return found, risk

    def _cut_since(self, mesh: Mesh) -> NDArray[np.bool_]:
        """Nodes of the elements that edits have changed since the last look."""
        cut = np.zeros(mesh.node_rows, dtype=np.bool_)
        for change in mesh.changes:
            if change.edit.version > self._version:
                for nodes in (change.old_elements, change.new_elements):
                    cut[nodes[nodes >= 0]] = True
        self._version = mesh.version
        return cut


def _look_at_tools(
    region: RiskRegion,
    places: Reals,
    tools: Sequence[ToolReach],
    touched: dict[str, NDArray[np.bool_]],
    found: dict[Cause, Finding],
    risk: Reals,
) -> None:
    """Enter which tools are near a region or touch it, and the risk of its nodes.

    `touched` says what each tool holds; what is inside it is added.
    """
    for tool in tools:
        distances = tool.distances(places)
        nearest = float(distances.min())
        if nearest <= WIDER * region.margin:
            finding = Finding(max(nearest, 0.0), nearest <= region.margin)
            found[Cause(region.name, NEAR, tool.tool)] = finding
        touched[tool.tool] = touched.get(tool.tool, np.False_) | (distances <= 0.0)
        if region.margin > 0.0:
            np.maximum(risk, np.clip(1.0 - distances / region.margin, 0.0, 1.0), out=risk)
    for name, nodes in touched.items():
        if nodes.any():
            found[Cause(region.name, TOUCHED, name)] = Finding(int(nodes.sum()))
            risk[nodes] = 1.0
