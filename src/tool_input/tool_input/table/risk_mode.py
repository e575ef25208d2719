"""Risk regions: painted on the tissue with a brush, and warned of when something comes near."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray
from tissue_interfaces.msg import RiskRegion
from tissue_interfaces.srv import SetRiskRegion

from tissue_sim.conversions import array_of
from tissue_sim.readings.regions import painted
from tool_input.table.marks import RISK, Marks
from tool_input.table.modes import END, START, Drag, Vec3
from tool_input.table.page_scene import PageScene
from tool_input.table.person import Person
from tool_input.table.sight import Sight
from tool_input.table.tissue_frame import TissueFrame
from tool_input.table.tool_size import MM, in_mm

PAINT, ERASE = "paint", "erase"
MOST_STEPS = 20
"""Of half a brush between two events; the pointer has jumped to other tissue if there are more."""


class RiskMode:
    """Paints and erases the nodes of a risk region."""

    name = "risk"
    key = "M"
    help = (
        "Drag over tissue that should be kept away from: it becomes a risk region, and everybody "
        "is warned when a tool or a cut comes near it."
    )

    def __init__(self, person: Person, scene: PageScene) -> None:
        """Begin without paint."""
        self._person = person
        self._marks = Marks(scene, "/risk")
        self._region = "risk"
        self._brush = PAINT
        self._radius = 0.04 * scene.organ_size
        self._margin = 0.04 * scene.organ_size
        self._limit = 0.0
        self._most = 0.2 * scene.organ_size
        self._stroke: NDArray[np.uint32] | None = None
        self._last: Vec3 | None = None

    def drag(self, drag: Drag) -> None:
        """Take the tissue under the brush; at the end, ask for the region it makes."""
        frame = self._person.desk.frame()
        if drag.phase == START:
            self._stroke, self._last = np.empty(0, dtype=np.uint32), None
        if self._stroke is None or frame is None:
            return
        ray = drag.point - drag.eye
        hit = Sight.of(frame).hit(drag.eye, ray / np.linalg.norm(ray))
        if hit is not None:
            way = self._way_to(hit.rest)
            self._stroke = np.union1d(self._stroke, painted(frame.mesh, way, self._radius))
            self._show(frame, self._stroke)
        if drag.phase == END:
            stroke = self._stroke
            self.leave()
            self._ask(stroke)

    def settings(self, gui: viser.GuiApi) -> None:
        """Which region, the brush, and when to warn."""
        most = self._most / MM
        region = gui.add_text("Region", self._region)
        brush = gui.add_dropdown("Brush", (PAINT, ERASE), initial_value=self._brush)
        radius = gui.add_slider("Brush [mm]", most / 100, most, most / 100, in_mm(self._radius))
        margin = gui.add_slider(
            "Margin [mm]", 0.0, most, most / 100, in_mm(self._margin),
            hint="Tools and cuts nearer than this are warned of",
        )  # fmt: skip
        limit = gui.add_number(
            "Stress limit [kPa]", self._limit / 1e3, min=0.0, step=1.0, hint="0: none"
        )
        remove = gui.add_button("Remove region")

        def take() -> None:
            self._region, self._brush = region.value.strip(), brush.value
            self._radius, self._margin = radius.value * MM, margin.value * MM
            self._limit = limit.value * 1e3

        for control in (region, brush, radius, margin, limit):
            control.on_update(self._person.in_turn(take))
        remove.on_click(self._person.in_turn(self._remove))

    def leave(self) -> None:
        """Forget the stroke."""
        self._stroke = None
        self._marks.clear()

    def _way_to(self, point: Vec3) -> NDArray[np.float64]:
        """Points of the tissue at rest from the last one that was painted [m], shape (n, 3)."""
        last = point if self._last is None else self._last
        self._last = point
        steps = int(np.ceil(float(np.linalg.norm(point - last)) / (0.5 * self._radius)))
        if steps > MOST_STEPS:
            return point[None]
        return np.linspace(point, last, steps, endpoint=False) if steps else point[None]

    def _show(self, frame: TissueFrame, nodes: NDArray[np.uint32]) -> None:
        rows = frame.mesh.node_rows_of(nodes)
        if len(rows):
            self._marks.dots("stroke", frame.positions[rows[rows >= 0]], RISK)

    def _before(self) -> NDArray[np.uint32]:
        """Ids of the region's nodes as it is."""
        heard = self._person.desk.risk_regions
        for region in heard.regions if heard is not None else ():
            if region.name == self._region:
                return np.asarray(array_of(region.nodes, np.uint32))
        return np.empty(0, dtype=np.uint32)

    def _ask(self, stroke: NDArray[np.uint32]) -> None:
        if not len(stroke):
            raise ValueError("no tissue was under the brush; make it larger or drag on the organ")
        if self._brush == PAINT:
            nodes = np.union1d(self._before(), stroke)
        else:
            nodes = np.setdiff1d(self._before(), stroke)
            if not len(nodes):
                self._remove()
                return
        region = RiskRegion(
            name=self._region, nodes=nodes.tolist(), margin=self._margin, stress_limit=self._limit
        )
        request = SetRiskRegion.Request(region=region, radius=self._radius)
        self._person.request("set_risk_region", request, self._done)

    def _remove(self) -> None:
        region = RiskRegion(name=self._region)
        request = SetRiskRegion.Request(region=region, remove=True)
        self._person.request("set_risk_region", request, self._done)

    def _done(self, answer: SetRiskRegion.Response) -> None:
        self._person.tell(answer.message)
