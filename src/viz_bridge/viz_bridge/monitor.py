"""Node `monitor`: an independent subscriber that counts frames, gaps and latencies."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from tissue_interfaces.msg import TissueState

from tissue_sim import qos
from tissue_sim.node_main import declare, run
from tissue_sim.parameters import Spec
from tissue_sim.whole_files import write_json
from viz_bridge.cadence import LatencyMeter, cadence
from viz_bridge.cdr import Decoder
from viz_bridge.cpu_shares import CpuShares
from viz_bridge.message_text import message_text
from viz_bridge.session_events import nanoseconds

SPECS = (
    Spec("path", "string", "monitor.json", "file for what was counted"),
    Spec("rate_hz", "double", 60.0, "frames a second that are due", unit="Hz", minimum=1.0,
         maximum=2000.0),
    Spec("write_period", "double", 5.0, "the file is also written this often", unit="s",
         minimum=0.5, maximum=3600.0),
)  # fmt: skip
_STATE_TYPE = "tissue_interfaces/msg/TissueState"


class MonitorNode(Node):
    """Counts what arrives; judges it when asked to write."""

    def __init__(self) -> None:
        super().__init__("monitor")
        self._load_average = os.getloadavg()
        self._values = declare(self, SPECS)
        self._path = Path(self._values["path"])
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._decoder = Decoder(_STATE_TYPE, message_text(_STATE_TYPE))
        self._epochs: dict[bytes, list[tuple[int, int, int]]] = {}
        self._latency = LatencyMeter()
        self._diagnostics: dict[str, dict[str, str]] = {}
        self._warnings: dict[str, str] = {}
        self._cpu = CpuShares()
        self._began = time.monotonic()
        # Deep enough that this process itself loses nothing while it is busy.
        deep = QoSProfile(depth=120, reliability=ReliabilityPolicy.RELIABLE)
        self.create_subscription(TissueState, "tissue/state", self._on_state, deep, raw=True)
        self.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.DIAGNOSTICS
        )
        self.create_timer(1.0, self._cpu.sample)
        self.create_timer(self._values["write_period"], self.write)

    def close(self) -> None:
        """Write the last figures."""
        self._cpu.sample()
        self.write()

    def _on_state(self, data: bytes, info: dict[str, int]) -> None:
        received = time.time_ns()
        state = self._decoder(data)
        stamp = nanoseconds(state.header.stamp)
        frames = self._epochs.setdefault(state.epoch.tobytes(), [])
        # The middleware stamps a message when it is published: that, not how soon this process was
        # given the processor, decides what is late.
        frames.append((int(state.frame), stamp, int(info["source_timestamp"])))
        for tool, posed in zip(state.tool_ids, state.tool_stamps, strict=False):
            self._latency.take(tool, nanoseconds(posed), received)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self._diagnostics[status.name] = {item.key: item.value for item in status.values}
            if status.level != b"\0":
                self._warnings[f"{status.name}: {status.message}"] = status.name

    def write(self) -> None:
        """Write the file, whole or not at all."""
        write_json(self._path, self.figures())

    def figures(self) -> dict[str, Any]:
        """What was counted so far."""
        judged = []
        for frames in self._epochs.values():
            rows = np.array(frames, dtype=np.int64)
            judged.append(cadence(rows[:, 0], rows[:, 1], rows[:, 2], self._values["rate_hz"]))
        seconds = sum(c.seconds for c in judged)
        published = sum(c.hz * c.seconds for c in judged)
        return {
            "frames": sum(c.frames for c in judged),
            "published_hz": published / seconds if seconds else 0.0,
            "rate_hz": self._values["rate_hz"],
            "late_frames": sum(c.late for c in judged),
            "skipped_frames": sum(c.skipped for c in judged),
            "lost_states": sum(c.lost for c in judged),
            "seconds": seconds,
            "epochs": len(judged),
            "pose_to_state_ms": self._latency.quantiles(),
            "cpu_share": self._cpu.shares(),
            "load_average_before": list(self._load_average),
            "watched_seconds": time.monotonic() - self._began,
            "diagnostics": self._diagnostics,
            "warnings": sorted(self._warnings),
        }


def main(args: list[str] | None = None) -> None:
    """Count until interrupted."""
    sys.exit(run(MonitorNode, args))


if __name__ == "__main__":
    main()
