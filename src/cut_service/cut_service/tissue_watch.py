"""What the cutting node does without being asked: it tears what is pulled too hard, and burns."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from tissue_interfaces import msg as messages

from cut_service.burn_strokes import BurnStrokes
from cut_service.burning import Burns, plan_burn
from cut_service.errors import CutError
from cut_service.proposals import Proposals
from cut_service.sheet_tearing import plan_sheet_tear
from cut_service.tearing import Tear, plan_tear
from cut_service.unswept import work_without_sweep
from cut_service.watch_parameters import WATCH_SPECS, WatchSettings
from cut_service.work import Settings
from tissue_sim import conversions, qos
from tissue_sim.condition_topics import material_from_msg
from tissue_sim.elastic.material_field import MaterialError
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.stress import ElementMaterial, material_without_fibres
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.tools import BURN
from tissue_sim.replica import Replica, Shape

SHARE = 0.2
"""Most of the node's time that looking for tears takes: cuts that are asked for come first."""


class TissueWatch:
    """Tears and burns the organ that the cutting node follows."""

    def __init__(
        self, node: Node, replica: Replica, cutting: Settings, patience: float,
        frame_id: Callable[[], str],
    ) -> None:  # fmt: skip
        """Listen and start the timers.

        Args:
            node: The cutting node, with `WATCH_SPECS` declared.
            replica: The organ it follows.
            cutting: How it cuts.
            patience: Longest wait for an answer of the simulation [s].
            frame_id: The organ's frame.
        """
        self._node, self._replica, self._cutting = node, replica, cutting
        self._frame_id = frame_id
        self._tears, self._burnt = Proposals(node, patience), Proposals(node, patience)
        self._burns, self._strokes = Burns(), BurnStrokes()
        self._material: tuple[bytes, Material] | None = None
        self._field: tuple[Mesh, int, ElementMaterial] | None = None
        self._held: tuple[bytes, NDArray[np.uint32]] = (b"", np.empty(0, dtype=np.uint32))
        self._epoch, self._version, self._changed_at = b"", 0, -np.inf
        self._state_version = -1
        self._look_again = -np.inf
        self._last, self._seconds, self._problem = Tear(0, 0.0), 0.0, ""
        self._tools: dict[str, Any] = {}
        hear = node.create_subscription
        hear(messages.Material, "tissue/material", self._on_material, qos.LATCHED)
        hear(messages.HeldNodes, "tissue/held_nodes", self._on_held, qos.LATCHED)
        hear(messages.ToolList, "tissue/tools", self._on_tools, qos.LATCHED)
        node.create_timer(1.0 / node.get_parameter("tear.rate_hz").value, self._look_for_tears)
        node.create_timer(1.0 / node.get_parameter("burn.rate_hz").value, self._burn)

    # What is heard

    def on_state(self, message: messages.TissueState) -> None:
        """A state has come: tools that are pressed have burned since the one before."""
        self._state_version = message.version
        self._strokes.advance(conversions.epoch_of(message), message.sim_time)

    def on_edit(self, change: EditChange) -> None:
        """The replica has followed an edit."""
        if self._replica.mesh is not None and self._replica.mesh.sheet_rows is None:
            self._burns.follow(self._replica.mesh, change)

    def _on_material(self, message: messages.Material) -> None:
        self._field = None
        try:
            self._material = (conversions.epoch_of(message), material_from_msg(message))
        except ValueError as error:
            self._material, self._problem = None, str(error)

    def _on_held(self, message: messages.HeldNodes) -> None:
        nodes = np.array(message.nodes, dtype=np.uint32)
        self._held = (conversions.epoch_of(message), nodes)

    def _on_tools(self, message: messages.ToolList) -> None:
        burning = {tool.id: tool for tool in message.tools if tool.kind == BURN}
        self._strokes.set_tools(
            {name: float(tool.size[0]) for name, tool in burning.items()},
            {name for name, t in burning.items() if t.pressed and t.state != messages.Tool.FROZEN},
        )
        for gone in [name for name in self._tools if name not in burning]:
            self._node.destroy_subscription(self._tools.pop(gone))
        for name in burning:
            if name not in self._tools:
                self._tools[name] = self._follow(name)

    def _follow(self, tool: str) -> Any:
        def on_pose(message: PoseStamped) -> None:
            place = message.pose.position
            self._strokes.move(tool, np.array([place.x, place.y, place.z]))

        topic = f"tools/{tool}/measured_cp"
        return self._node.create_subscription(PoseStamped, topic, on_pose, qos.MEASURED)

    # What is done

    def _settings(self) -> WatchSettings:
        names = [spec.name for spec in WATCH_SPECS]
        values = {name: self._node.get_parameter(name).value for name in names}
        return WatchSettings.of({**values, "smallest_piece": self._cutting.smallest_piece})

    def _follow_epoch(self) -> None:
        replica, now = self._replica, time.monotonic()
        if replica.epoch != self._epoch:
            self._epoch = replica.epoch
            self._burns.forget()
            self._tears.forget()
            self._burnt.forget()
            self._field = None
            self._last = Tear(0, 0.0)
        if replica.version != self._version:
            self._version, self._changed_at = replica.version, now

    def held_nodes(self) -> NDArray[np.uint32]:
        """Ids of the nodes that tools hold."""
        epoch, nodes = self._held
        return nodes if epoch == self._replica.epoch else nodes[:0]

    def _look_for_tears(self) -> None:
        self._follow_epoch()
        replica, mesh = self._replica, self._replica.mesh
        settings = self._settings()
        wanted = settings.tear.threshold > 0.0
        if mesh is not None and mesh.sheet_rows is not None:
            wanted = settings.sheet.elongation > 0.0
        busy = self._tears.busy()
        now = time.monotonic()
        settled = now - self._changed_at >= settings.settle and now >= self._look_again
        if not wanted or mesh is None or not replica.ready or busy or not settled:
            return
        if self._state_version != mesh.version or mesh.version < self._tears.version:
            return  # The stress is looked at in a shape that came after the last edit.
        shape = replica.shape_at(0)
        if shape is None:
            return
        begun = time.perf_counter()
        try:
            tear = self._tear(mesh, shape, settings)
        except (CutError, MaterialError) as error:
            self._problem = str(error)
            return
        self._seconds = time.perf_counter() - begun
        self._look_again = time.monotonic() + (1.0 / SHARE - 1.0) * self._seconds
        if tear is None:
            return
        self._last, self._problem = tear, tear.why
        if tear.edit is not None:
            self._tears.send(tear.edit, tear.faces, shape, replica.epoch, self._frame_id())
            self._node.get_logger().info(
                f"tears: {tear.faces} faces, {len(tear.edit.copied_nodes)} nodes; "
                f"{tear.over} elements were above the threshold",
                throttle_duration_sec=1.0,
            )

    def _tear(self, mesh: Mesh, shape: Shape, settings: WatchSettings) -> Tear | None:
        """What tears; None while it is not known what the tissue is made of."""
        if mesh.sheet_rows is not None:
            return plan_sheet_tear(
                mesh, shape.positions, settings.sheet, self._cutting, self.held_nodes()
            )
        material = self._element_material(mesh)
        if material is None:
            self._problem = "nothing has been heard on tissue/material"
            return None
        work = work_without_sweep(mesh, shape.positions, self.held_nodes(), self._cutting)
        return plan_tear(work, material, settings.tear)

    def _element_material(self, mesh: Mesh) -> ElementMaterial | None:
        if self._material is None or self._material[0] != self._replica.epoch:
            return None
        known = self._field
        if known is None or known[0] is not mesh or known[1] != mesh.version:
            # How fibres run is not in a keyframe: their stress is left out.
            known = (mesh, mesh.version, material_without_fibres(mesh, self._material[1]))
            self._field = known
        return known[2]

    def _burn(self) -> None:
        self._follow_epoch()
        replica, mesh = self._replica, self._replica.mesh
        touches = self._strokes.taken(replica.epoch)
        if not touches and not self._burns.waiting:
            return
        shape = replica.shape_at(0)
        if mesh is None or shape is None:
            return
        if mesh.sheet_rows is not None:
            self._problem = f"{mesh.name} is made of triangles, which do not burn"
            return
        places = shape.positions.astype(np.float64)
        gone = self._burns.heat(mesh, places, touches, self._settings().burn)
        if not len(gone) or self._burnt.busy() or mesh.version < self._burnt.version:
            return
        try:
            work = work_without_sweep(mesh, places, settings=self._cutting)
            edit = plan_burn(work, gone)
        except CutError as error:
            self._problem = f"burning: {error}"
            return
        removed = len(edit.removed_elements)
        self._burnt.send(edit, removed, shape, replica.epoch, self._frame_id())

    # Reporting

    def status(self, name: str) -> DiagnosticStatus:
        """What is torn and burned, for the diagnostics of a node."""
        tear = self._last
        values: dict[str, object] = {
            "elements above the threshold": tear.over,
            "largest stress (elongation of a surface) [Pa]": f"{tear.largest:.6g}",
            "last look [ms]": f"{1e3 * self._seconds:.3f}",
            "faces torn": self._tears.done,
            "elements burned": self._burnt.done,
            "held nodes": len(self.held_nodes()),
            **{f"tears {what}": number for what, number in self._tears.counts.items()},
            **{f"burns {what}": number for what, number in self._burnt.counts.items()},
        }
        said = self._tears.said or self._burnt.said
        if said:
            values["last refusal"] = said
        return DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=f"{name}: tearing and burning",
            message=self._problem or "watching",
            hardware_id="",
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
