"""Tools and what they hold, heard by a node that reads the tissue."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from tissue_interfaces.msg import HeldNodes, Tool, ToolList

from tissue_sim import qos
from tissue_sim.conversions import epoch_of, pose_array
from tissue_sim.polled_subscriptions import PolledSubscriptions
from tissue_sim.readings.reach import ToolReach


class ToolsHeard:
    """Where tools are and which nodes they hold."""

    def __init__(self, heard: PolledSubscriptions) -> None:
        """Listen.

        Args:
            heard: Subscriptions of the node.
        """
        self._heard = heard
        self._tools: dict[str, Tool] = {}
        self._poses: dict[str, NDArray[np.float64]] = {}
        self._held: tuple[bytes, NDArray[np.uint32]] = (b"", np.empty(0, dtype=np.uint32))
        heard.add(ToolList, "tissue/tools", self._on_tools, qos.LATCHED)
        heard.add(HeldNodes, "tissue/held_nodes", self._on_held, qos.LATCHED)

    def reaches(self) -> list[ToolReach]:
        """How far each tool reaches; those that nobody has moved yet are left out."""
        return [
            ToolReach.of(name, tool.shape, list(tool.size), self._poses[name], tool.kind)
            for name, tool in self._tools.items()
            if tool.state != Tool.FREE
        ]

    def held(self, epoch: bytes) -> NDArray[np.uint32]:
        """Ids of the nodes that tools hold in an epoch."""
        return self._held[1] if self._held[0] == epoch else self._held[1][:0]

    def _on_held(self, message: HeldNodes, _: Any) -> None:
        self._held = (epoch_of(message), np.array(message.nodes, dtype=np.uint32))

    def _on_tools(self, message: ToolList, _: Any) -> None:
        now = {tool.id: tool for tool in message.tools}
        for gone in set(self._tools) - set(now):
            self._heard.remove(_topic(gone))
            del self._poses[gone]
        for name, tool in now.items():
            self._poses.setdefault(name, pose_array(tool.pose))
            self._heard.add(PoseStamped, _topic(name), self._pose_of(name), qos.MEASURED)
        self._tools = now

    def _pose_of(self, tool: str) -> Callable[[PoseStamped, Any], None]:
        def take(message: PoseStamped, _: Any) -> None:
            if tool in self._poses:
                self._poses[tool] = pose_array(message.pose)

        return take


def _topic(tool: str) -> str:
    return f"tools/{tool}/measured_cp"
