"""Which topics a bag holds, and how they are subscribed to."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tissue_sim import qos
from viz_bridge.message_text import split_type


@dataclass(frozen=True)
class RecordedTopic:
    """One topic to record.

    Attributes:
        name: Relative to the node's namespace, or absolute.
        type_name: Its message type.
        profile: How to subscribe.
        latched: Also recorded while paused, so that what follows can be understood.
    """

    name: str
    type_name: str
    profile: QoSProfile
    latched: bool = False


def _ours(name: str) -> str:
    return f"tissue_interfaces/msg/{name}"


STATE = "tissue/state"
# No message of these may be lost between two turns of the executor, whatever publishers offer.
_INPUT = QoSProfile(
    depth=200, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
)
_MEASURED = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
_STATE = QoSProfile(depth=8, reliability=ReliabilityPolicy.RELIABLE)
_TEXTS = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

FIXED = (
    RecordedTopic("tissue/journal", _ours("Journal"), qos.JOURNAL),
    RecordedTopic(STATE, _ours("TissueState"), _STATE),
    RecordedTopic("tissue/topology", _ours("Topology"), qos.LATCHED, latched=True),
    RecordedTopic("tissue/edits", _ours("TopologyEdit"), qos.EDITS, latched=True),
    RecordedTopic("tissue/status", _ours("Status"), qos.LATCHED, latched=True),
    RecordedTopic("tissue/tools", _ours("ToolList"), qos.LATCHED, latched=True),
    RecordedTopic("tissue/holes", _ours("Holes"), qos.LATCHED, latched=True),
    RecordedTopic("tissue/readings", _ours("Readings"), qos.READINGS),
    RecordedTopic("tissue/scalar", _ours("NodeScalar"), qos.STATE),
    RecordedTopic("tissue/risk_regions", _ours("RiskRegions"), qos.LATCHED, latched=True),
    RecordedTopic("tissue/playback", _ours("Playback"), qos.LATCHED, latched=True),
    RecordedTopic("tissue/cut_request", _ours("CutRequest"), qos.CUT_REQUEST),
    RecordedTopic("script/event", "std_msgs/msg/String", _TEXTS, latched=True),
    RecordedTopic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", qos.DIAGNOSTICS),
)

DIFFERENCE = RecordedTopic("tissue/difference", _ours("TissueState"), _STATE)
"""Drawn, not recorded: it follows from the journal."""

DRAWN = (*FIXED, DIFFERENCE)

_PER_TOOL = {
    "servo_cp": ("geometry_msgs/msg/PoseStamped", _INPUT),
    "use": ("std_msgs/msg/Bool", qos.USE),
    "clutch": ("std_msgs/msg/Bool", qos.USE),
    "measured_cp": ("geometry_msgs/msg/PoseStamped", _MEASURED),
    "measured_cf": ("geometry_msgs/msg/WrenchStamped", _MEASURED),
}
_TOOL_TOPIC = re.compile(r"^tools/[A-Za-z_]\w*/(" + "|".join(_PER_TOOL) + ")$")


def of_tool(tool: str) -> list[RecordedTopic]:
    """The topics of one tool."""
    return [
        RecordedTopic(f"tools/{tool}/{leaf}", type_name, profile)
        for leaf, (type_name, profile) in _PER_TOOL.items()
    ]


def tool_of(topic: str, namespace: str) -> str | None:
    """The tool that a full topic name belongs to; None for topics of no tool in the namespace."""
    prefix = namespace.rstrip("/") + "/"
    relative = topic.removeprefix(prefix) if topic.startswith(prefix) else ""
    return relative.split("/")[1] if _TOOL_TOPIC.match(relative) else None


def message_class(type_name: str) -> Any:
    """The Python class of a message type.

    Raises:
        ValueError: It is not installed.
    """
    package, name = split_type(type_name)
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise ValueError(f"message type {type_name} is not installed") from None


def offered(endpoints: list[TopicEndpointInfo]) -> list[dict[str, Any]]:
    """What the publishers of a topic offer, each profile once, as rosbag2 writes it."""
    profiles: list[dict[str, Any]] = []
    for endpoint in endpoints:
        given = endpoint.qos_profile
        profile = {
            "history": given.history.name.lower(),
            "depth": given.depth,
            "reliability": given.reliability.name.lower(),
            "durability": given.durability.name.lower(),
            "deadline": _duration(given.deadline.nanoseconds),
            "lifespan": _duration(given.lifespan.nanoseconds),
            "liveliness": given.liveliness.name.lower(),
            "liveliness_lease_duration": _duration(given.liveliness_lease_duration.nanoseconds),
            "avoid_ros_namespace_conventions": bool(given.avoid_ros_namespace_conventions),
        }
        if profile not in profiles:
            profiles.append(profile)
    return profiles


def _duration(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}
