"""A stand-in for the simulation: a block that is pulled, split open and let go, on the real topics.

Run as a program. Nothing elastic is computed: the displacement is a smooth function of time.
"""

from __future__ import annotations

import argparse
import json
import time
import zlib
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Bool
from tissue_interfaces.msg import (
    Command,
    Journal,
    Status,
    TissueState,
    Tool,
    ToolList,
    ToolSample,
    Topology,
)
from tissue_interfaces.msg import TopologyEdit as EditMsg

from support.split_block import split_plan
from tissue_sim import conversions, edit_messages, qos
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block

FRAME = "organ"


def queued() -> float:
    """Time this thread has waited for a processor so far [s]: others' doing, not a reader's."""
    return int(Path("/proc/thread-self/schedstat").read_text().split()[1]) / 1e9


class FakeTissue(Node):
    """Publishes one session, frame by frame."""

    def __init__(self, side: int, hz: float) -> None:
        super().__init__("tissue_sim")
        self.declare_parameter("seed", 7)
        self.mesh = Mesh(block(side, side, max(2, side // 2), 0.1, 0.1, 0.04))
        self.epoch = bytes(np.random.default_rng().integers(0, 256, 16, dtype=np.uint8))
        self.hz, self.frame = hz, 0
        self.cut_done = False
        make = self.create_publisher
        self.state = make(TissueState, "tissue/state", qos.STATE)
        self.topology = make(Topology, "tissue/topology", qos.LATCHED)
        self.edits = make(EditMsg, "tissue/edits", qos.EDITS)
        self.status = make(Status, "tissue/status", qos.LATCHED)
        self.tools = make(ToolList, "tissue/tools", qos.LATCHED)
        self.journal = make(Journal, "tissue/journal", qos.JOURNAL)
        self.servo = make(PoseStamped, "tools/hook/servo_cp", qos.POSE)
        self.use = make(Bool, "tools/hook/use", qos.USE)
        self.measured = make(PoseStamped, "tools/hook/measured_cp", qos.MEASURED)
        self.force = make(WrenchStamped, "tools/hook/measured_cf", qos.MEASURED)
        self.publish_latched()

    def heard_by(self, recorders: int, monitors: int) -> bool:
        by_all = min(p.get_subscription_count() for p in (self.journal, self.edits, self.state))
        by_state = self.state.get_subscription_count()
        return by_all >= recorders and by_state >= recorders + monitors

    def publish_latched(self) -> None:
        stamp = self.get_clock().now().to_msg()
        self.topology.publish(conversions.mesh_to_topology(self.mesh, self.epoch, FRAME, stamp))
        status = Status(organ="block", model="fake", state=Status.READY, version=1)
        status.epoch = conversions.epoch_field(self.epoch)
        self.status.publish(status)
        hook = Tool(id="hook", kind="grab", shape="sphere", size=[0.01], state="active")
        blade = Tool(id="blade", kind="cut", shape="rectangle", size=[0.02, 0.05], state="active")
        self.tools.publish(ToolList(tools=[hook, blade]))

    def step(self, total: int) -> float:
        """Publish the next frame; how long publishing worked or waited for readers [s]."""
        self.frame += 1
        share = self.frame / total
        pull = 0.03 * np.sin(np.pi * min(1.0, share)) if share < 0.98 else 0.0
        now = self.get_clock().now()
        stamp = now.to_msg()
        edges = {round(0.1 * total): 1, round(0.95 * total): -1}
        edge = edges.get(self.frame, 0)
        if edge:
            self.use.publish(Bool(data=edge > 0))
        edits = []
        if not self.cut_done and share >= 0.5:
            self.cut_done = True
            change = self.mesh.apply(split_plan(self.mesh))
            edits = [edit_messages.edit_to_msg(change.edit, self.epoch, FRAME, stamp)]
            self.edits.publish(edits[0])
        positions = self._positions(pull)
        tip = [0.075, 0.1 + pull, 0.02, 0.0, 0.0, 0.0, 1.0]
        pose = conversions.pose_stamped(tip, FRAME, stamp)
        began = time.perf_counter() - queued()
        self.servo.publish(pose)
        self.state.publish(self._state(positions, stamp))
        self.measured.publish(pose)
        wrench = np.array([0.0, -40.0 * pull, 0.0, 0.0, 0.0, 0.0])
        self.force.publish(conversions.wrench_stamped(wrench, FRAME, stamp))
        self.journal.publish(self._entry(positions, stamp, tip, edge, edits))
        return time.perf_counter() - queued() - began

    def _positions(self, pull: float) -> NDArray[np.float32]:
        rest = self.mesh.rest[: self.mesh.node_rows]
        reach = rest[:, 1] / rest[:, 1].max()
        moved = rest.copy()
        moved[:, 1] += pull * reach**2
        if self.cut_done:
            right = rest[:, 0] > 0.0501
            right[self.mesh.node_rows - self._copies() :] = True
            moved[:, 0] += np.where(right, 1, -1) * 0.3 * pull * np.maximum(0, reach - 0.5)
        return moved.astype(np.float32)

    def _copies(self) -> int:
        parents = self.mesh.node_parents[: self.mesh.node_rows]
        return int((parents != self.mesh.node_ids[: self.mesh.node_rows]).sum())

    def _state(self, positions: NDArray[np.float32], stamp: object) -> TissueState:
        message = TissueState(header=conversions.header(FRAME, stamp))
        message.sim_time = self.frame / self.hz
        message.epoch = conversions.epoch_field(self.epoch)
        message.version, message.frame = self.mesh.version, self.frame
        message.tool_ids, message.tool_stamps = ["hook"], [stamp]
        conversions.fill_state(message, positions)
        return message

    def _entry(
        self,
        positions: NDArray[np.float32],
        stamp: object,
        tip: list[float],
        edge: int,
        edits: list[EditMsg],
    ) -> Journal:
        entry = Journal(header=conversions.header(FRAME, stamp), frame=self.frame, steps=5)
        entry.epoch = conversions.epoch_field(self.epoch)
        entry.version, entry.sim_time = self.mesh.version, self.frame / self.hz
        hook = ToolSample(id="hook", stamp=stamp, use=edge > 0, edge=edge)
        hook.pose = np.array(tip)
        blade = ToolSample(id="blade", stamp=stamp)
        blade.pose = np.array([0.05, 0.1, 0.05, 0.0, 0.0, 0.0, 1.0])
        entry.tools, entry.edits = [hook, blade], edits
        if self.frame == 1:
            entry.commands = [Command(kind="start", arguments=json.dumps({"model": "fake"}))]
        entry.positions_crc32 = zlib.crc32(positions.tobytes())
        return entry


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--side", type=int, default=9)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--hz", type=float, default=60.0)
    parser.add_argument("--recorders", type=int, default=1, help="listeners to wait for")
    parser.add_argument("--monitors", type=int, default=0, help="further ones of the state alone")
    parser.add_argument("--report", type=Path)
    options = parser.parse_args()
    rclpy.init()
    node = FakeTissue(options.side, options.hz)
    deadline = time.monotonic() + 60
    # The middleware takes up to three seconds to find a listener, and each publisher's by itself.
    while not node.heard_by(options.recorders, options.monitors):
        rclpy.spin_once(node, timeout_sec=0.05)
        if time.monotonic() > deadline:
            raise SystemExit("nobody subscribed")
    costs, late = [], 0
    due = time.monotonic()
    for _ in range(options.frames):
        costs.append(node.step(options.frames))
        due += 1 / options.hz
        rclpy.spin_once(node, timeout_sec=0.0)
        late += time.monotonic() > due
        time.sleep(max(0.0, due - time.monotonic()))
    if options.report:
        report = {"frames": options.frames, "late": late, "worst_ms": 1e3 * max(costs)}
        report["median_ms"] = 1e3 * float(np.median(costs))
        options.report.write_text(json.dumps(report))
    # The last messages are still on their way.
    settled = time.monotonic() + 0.5
    while time.monotonic() < settled:
        rclpy.spin_once(node, timeout_sec=0.05)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
