"""What the tissue told in a session: as it was recorded, or read again from its states."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.readings.fields import SPRING_STRAIN, UNITS, VON_MISES
from tissue_sim.readings.reach import ToolReach
from tissue_sim.readings.region_files import read_regions
from tissue_sim.readings.risk_warnings import NEAR
from tissue_sim.readings.tissue import TissueReadings
from tissue_sim.report.session import Missing, RiskViolation, Series, StressHistory, not_recorded
from viz_bridge.cdr import Message
from viz_bridge.tool_shapes import DrawnTool

TOPIC, STATE = "tissue/readings", "tissue/state"
LASTING = 0.5
"""How long a warning stays after what it is about [s], as in the readings node."""
MARGIN = 0.005
"""Of risk regions that name none [m], as in the readings node."""
NOBODY = np.empty(0, dtype=np.uint32)

Cause = tuple[str, str, str]


class StressFollower:
    """Peaks of stress and warnings of one epoch.

    Attributes:
        regions_lost: Names of risk regions that are not in the organ.
    """

    def __init__(self, recorded: bool, risk: Path | None = None) -> None:
        """Begin.

        Args:
            recorded: Whether the bag has `tissue/readings`; otherwise states are read.
            risk: File with risk regions; with it states are read in any case.
        """
        self._recorded, self._risk = recorded and risk is None, risk
        self._tissue = TissueReadings(LASTING)
        self._times: list[float] = []
        self._peaks: list[float] = []
        self._quantity = ""
        self._on: dict[Cause, RiskViolation] = {}
        self._over: list[RiskViolation] = []
        self._states = 0

    def begin(self, mesh: Mesh) -> None:
        """Stand before the first state of an organ.

        Raises:
            RiskRegionError: A risk region of the file is not in it.
        """
        self._tissue.restart(mesh)
        if self._risk is not None:
            for region in read_regions(self._risk, mesh, MARGIN, 0.0):
                self._tissue.regions.put(mesh, region)

    def take_readings(self, message: Message) -> None:
        """Take a message of `tissue/readings`."""
        if not self._recorded:
            return
        time = float(message.sim_time)
        self._take_peaks(time, {str(r.name): float(r.peak) for r in message.readings})
        for warning in message.warnings:
            cause = (str(warning.region), str(warning.what), str(warning.tool))
            self._warn(cause, time, float(warning.value), bool(warning.begins))

    def take_state(
        self,
        mesh: Mesh,
        places: NDArray[np.float32],
        time: float,
        material: Material | None,
        tools: Iterable[DrawnTool],
    ) -> None:
        """Take a state: read it as the node would have, unless that was recorded."""
        self._states += 1
        if self._recorded:
            return
        reaches = [
            ToolReach.of(tool.id, tool.shape, list(tool.size), tool.pose)
            for tool in tools
            if tool.state != "free"
        ]
        told = self._tissue.read(mesh, places, time, material, reaches, NOBODY, "")
        self._take_peaks(time, {reading.name: reading.peak for reading in told.readings})
        for warning in told.warnings:
            cause = warning.cause
            key = (cause.region, cause.what, cause.tool)
            self._warn(key, time, float(warning.value), warning.begins)

    def history(self) -> StressHistory | Missing:
        """Largest stress over time."""
        if not self._times:
            if not self._recorded and self._states:
                return Missing("not known: the journal does not say what the tissue is made of")
            return not_recorded(TOPIC if self._recorded else f"{TOPIC}, nor {STATE} to read")
        source = (
            f"recorded in {TOPIC}"
            if self._recorded
            else f"read again by tissue_sim.readings from {STATE}"
        )
        peak = Series(np.array(self._times), np.array(self._peaks))
        source += f", {len(self._times)} times"
        return StressHistory(self._quantity, UNITS[self._quantity], peak, source)

    def violations(self, end: float) -> tuple[RiskViolation, ...] | Missing:
        """Warnings from begin to end; those still on end with the session [s]."""
        if not self._recorded and self._risk is None:
            return not_recorded(f"{TOPIC} (risk regions can be given with --risk)")
        still = [_ended(one, end) for one in self._on.values()]
        return tuple(sorted([*self._over, *still], key=lambda one: one.begin))

    def _take_peaks(self, time: float, peaks: dict[str, float]) -> None:
        quantity = VON_MISES if VON_MISES in peaks else SPRING_STRAIN
        if quantity not in peaks or (self._quantity and quantity != self._quantity):
            return
        self._quantity = quantity
        if not self._times or time > self._times[-1]:
            self._times.append(time)
            self._peaks.append(peaks[quantity])

    def _warn(self, cause: Cause, time: float, value: float, begins: bool) -> None:
        known = self._on.pop(cause, None)
        if known is None:
            known = RiskViolation(*cause, time, time, value)
        worst = min(known.worst, value) if cause[1] == NEAR else max(known.worst, value)
        now = RiskViolation(*cause, known.begin, time, worst)
        if begins:
            self._on[cause] = now
        else:
            self._over.append(now)


def _ended(violation: RiskViolation, end: float) -> RiskViolation:
    return RiskViolation(
        violation.region, violation.what, violation.tool, violation.begin,
        max(violation.end, end), violation.worst,
    )  # fmt: skip
