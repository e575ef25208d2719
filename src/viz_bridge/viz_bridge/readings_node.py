"""Node `readings`: what the tissue tells, read off the simulation's clock (docs/readings.md)."""

from __future__ import annotations

import sys
import time
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from std_srvs.srv import Trigger
from tissue_interfaces import msg as messages
from tissue_interfaces.srv import SetRiskRegion

from tissue_sim import conversions, edit_messages, qos
from tissue_sim.condition_topics import material_from_msg
from tissue_sim.elastic.model import Material
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.node_main import declare, run
from tissue_sim.parameters import Spec
from tissue_sim.polled_subscriptions import PolledSubscriptions
from tissue_sim.readings.fields import UNITS
from tissue_sim.readings.region_files import read_regions
from tissue_sim.readings.regions import RiskRegion, RiskRegionError, nodes_of_region, painted
from tissue_sim.readings.tissue import TissueReadings
from tissue_sim.replica import Replica
from viz_bridge.readings_messages import Moment, readings_message, regions_message, scalar_message
from viz_bridge.tools_heard import ToolsHeard

NO_SCALAR = "none"
ANSWERS_KEPT = 64
SPECS = (
    Spec("scalar", "string", NO_SCALAR, "quantity published at every node on tissue/scalar",
         choices=(NO_SCALAR, *UNITS), live=True),
    Spec("rate_hz", "double", 10.0, "how often the tissue is read, in system time", unit="Hz",
         minimum=0.1, maximum=120.0),
    Spec("risk_file", "string", "", "file with risk regions (YAML or NPZ); empty: none"),
    Spec("risk_mesh_regions", "strings", [],
         "regions of the mesh, by name or label, that are risk regions"),
    Spec("risk_margin", "double", 0.005, "margin of risk regions that name none", unit="m",
         minimum=0.0, maximum=1.0),
    Spec("risk_stress_limit", "double", 0.0,
         "von Mises stress allowed in risk regions that name none; 0: any", unit="Pa",
         minimum=0.0, maximum=1e12),
    Spec("warning_lasting", "double", 0.5, "how long a warning stays after what it is about",
         unit="s", minimum=0.0, maximum=60.0),
)  # fmt: skip


class ReadingsNode(Node):
    """Follows the organ, and says how much is asked of it and where care is needed."""

    def __init__(self) -> None:
        super().__init__("readings")
        self._values = declare(self, SPECS)
        self._replica = Replica(shapes_kept=2)
        self._tissue = TissueReadings(self._values["warning_lasting"])
        self._material: tuple[bytes, Material | None] = (b"", None)
        self._frame_id, self._moment = "organ", Moment("organ", conversions.stamp_of(0), b"", 0, 0)
        self._frame_read, self._first = 0, True
        self._milliseconds, self._warnings, self._problem = 0.0, 0, ""
        self._answers: OrderedDict[str, SetRiskRegion.Response] = OrderedDict()
        self._heard = heard = PolledSubscriptions(self)
        heard.add(messages.Topology, "tissue/topology", self._on_topology, qos.LATCHED)
        heard.add(messages.TopologyEdit, "tissue/edits", self._on_edit, qos.EDITS)
        heard.add(messages.Material, "tissue/material", self._on_material, qos.LATCHED)
        heard.add(messages.TissueState, "tissue/state", self._on_state, qos.STATE)
        self._tools = ToolsHeard(heard)
        tell = self.create_publisher
        self._scalar = tell(messages.NodeScalar, "tissue/scalar", qos.STATE)
        self._readings = tell(messages.Readings, "tissue/readings", qos.READINGS)
        self._regions = tell(messages.RiskRegions, "tissue/risk_regions", qos.LATCHED)
        self._diagnostics = tell(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self.create_service(SetRiskRegion, "tissue/set_risk_region", self._on_set_region)
        self.create_service(Trigger, "tissue/reset_readings", self._on_reset)
        self.create_timer(1.0 / self._values["rate_hz"], self._read)
        self.create_timer(1.0, self._publish_diagnostics)

    # What is heard

    def _on_topology(self, message: messages.Topology, _: Any) -> None:
        epoch = conversions.epoch_of(message)
        if not self._replica.wants_keyframe(epoch, message.version):
            return
        is_new = epoch != self._replica.epoch
        mesh = conversions.topology_to_mesh(message)
        self._replica.take_keyframe(epoch, mesh)
        self._frame_id = message.header.frame_id
        if not is_new:
            return
        self._frame_read = 0
        lost = self._tissue.restart(mesh)
        if lost:
            self.get_logger().warning(f"risk regions that {mesh.name} lacks: {', '.join(lost)}")
        if self._first:
            self._first = False
            self._put_given_regions(mesh)
        self._publish_regions()

    def _put_given_regions(self, mesh: Mesh) -> None:
        """Put the risk regions of the parameters; the node ends where one is not there."""
        margin, limit = self._values["risk_margin"], self._values["risk_stress_limit"]
        if self._values["risk_file"]:
            for region in read_regions(Path(self._values["risk_file"]), mesh, margin, limit):
                self._tissue.regions.put(mesh, region)
        for name in self._values["risk_mesh_regions"]:
            nodes = nodes_of_region(mesh, name)
            self._tissue.regions.put(mesh, RiskRegion(name, nodes, margin, limit))

    def _on_edit(self, message: messages.TopologyEdit, _: Any) -> None:
        edit = edit_messages.edit_from_msg(message)
        self._replica.take_edit(conversions.epoch_of(message), edit)

    def _on_material(self, message: messages.Material, _: Any) -> None:
        try:
            self._material = (conversions.epoch_of(message), material_from_msg(message))
        except ValueError as error:
            self._material, self._problem = (b"", None), str(error)

    def _on_state(self, message: messages.TissueState, _: Any) -> None:
        epoch, frame = conversions.epoch_of(message), int(message.frame)
        places = conversions.positions_from_state(message)
        self._replica.take_state(epoch, message.version, frame, places)
        self._moment = Moment(
            self._frame_id, message.header.stamp, epoch, frame, float(message.sim_time)
        )

    # What is told

    def _read(self) -> None:
        self._heard.take()
        replica, moment = self._replica, self._moment
        mesh, shape = replica.mesh, replica.shape_at(0)
        if mesh is None or shape is None or moment.epoch != replica.epoch:
            return
        # A shape carried over an edit is of an older frame than the edit: the next one is read.
        if shape.frame != moment.frame or shape.frame <= self._frame_read:
            return
        self._frame_read = shape.frame
        wanted = self.get_parameter("scalar").value
        material = self._material[1] if self._material[0] == replica.epoch else None
        began = time.thread_time()
        try:
            told = self._tissue.read(
                mesh, shape.positions, moment.sim_time, material, self._tools.reaches(),
                self._tools.held(replica.epoch), wanted,
            )  # fmt: skip
        except ValueError as error:
            self._problem = str(error)
            return
        self._milliseconds = 1e3 * (time.thread_time() - began)
        self._warnings = sum(warning.begins for warning in told.warnings)
        self._problem = ""
        if wanted in told.values:
            self._scalar.publish(scalar_message(moment, mesh, wanted, told.values[wanted]))
        elif wanted != NO_SCALAR:
            self._problem = f"{mesh.name} has no {wanted}: {_why_not(mesh)}"
        self._readings.publish(readings_message(moment, mesh, told))
        if told.regions_changed:
            self._publish_regions()

    def _publish_regions(self) -> None:
        self._regions.publish(
            regions_message(
                self._frame_id, self.get_clock().now().to_msg(), self._replica.epoch,
                self._tissue.regions.by_name.values(),
            )
        )  # fmt: skip

    # What is asked

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._tissue.histories.clear()
        response.success, response.message = True, "highest values and integrals begin anew"
        return response

    def _on_set_region(
        self, request: SetRiskRegion.Request, response: SetRiskRegion.Response
    ) -> SetRiskRegion.Response:
        self._heard.take()
        if request.request_id in self._answers:
            return self._answers[request.request_id]
        try:
            self._set_region(request, response)
        except RiskRegionError as error:
            response.error_code, response.message = response.INVALID, str(error)
        response.success = response.error_code == response.NONE
        if response.success:
            self._publish_regions()
        if request.request_id:
            self._answers[request.request_id] = response
            while len(self._answers) > ANSWERS_KEPT:
                self._answers.popitem(last=False)
        return response

    def _set_region(self, request: SetRiskRegion.Request, response: SetRiskRegion.Response) -> None:
        mesh, regions, given = self._replica.mesh, self._tissue.regions, request.region
        if mesh is None:
            response.error_code = response.NO_TISSUE
            response.message = "no topology of the tissue has been received yet"
        elif request.remove:
            if regions.remove(given.name):
                response.message = f"{given.name} is no risk region any more"
                return
            response.error_code = response.UNKNOWN_REGION
            there = ", ".join(regions.by_name) or "none"
            response.message = f"there is no risk region {given.name!r}; there are: {there}"
        else:
            nodes = np.array(given.nodes, dtype=np.uint32)
            if not len(nodes):
                if len(request.positions) % 3:
                    raise RiskRegionError("positions are x y z of each point")
                points = np.array(request.positions).reshape(-1, 3)
                nodes = painted(mesh, points, request.radius)
            if not len(nodes):
                response.error_code = response.NOTHING_THERE
                response.message = f"no node within {request.radius:g} m of the points"
                return
            regions.put(mesh, RiskRegion(given.name, nodes, given.margin, given.stress_limit))
            response.nodes = len(regions.rows(given.name))
            response.message = f"risk region {given.name}: {response.nodes} nodes"

    def _publish_diagnostics(self) -> None:
        level, text = DiagnosticStatus.OK, "reading"
        if self._replica.mesh is None:
            level, text = DiagnosticStatus.WARN, "waiting for the tissue's topology"
        elif self._problem or self._warnings:
            level = DiagnosticStatus.WARN
            text = self._problem or f"{self._warnings} warnings of risk regions"
        values = {
            "frame read": self._frame_read,
            "last reading [ms]": f"{self._milliseconds:.3f}",
            "risk regions": ", ".join(self._tissue.regions.by_name) or "none",
            "warnings": self._warnings,
        }
        status = DiagnosticStatus(
            level=level, name=self.get_fully_qualified_name(), message=text,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )  # fmt: skip
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def _why_not(mesh: Mesh) -> str:
    """Why a quantity is not told."""
    if mesh.sheet_rows is not None:
        return "it is made of triangles and springs"
    return "nothing has been heard on tissue/material"


def main(args: list[str] | None = None) -> None:
    """Read the tissue until interrupted."""
    sys.exit(run(ReadingsNode, args))


if __name__ == "__main__":
    main()
