"""Quality of service of every topic, for both sides."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _profile(
    depth: int,
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE,
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE,
) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=reliability,
        durability=durability,
    )


STATE = _profile(1)
"""tissue/state: only the newest frame counts; reliable, since one lost fragment loses a frame."""

POSE = _profile(1)
"""What publishers of tools/<tool>/servo_cp offer."""

POSE_IN = _profile(1000, ReliabilityPolicy.BEST_EFFORT)
"""Subscriber to tools/<tool>/servo_cp: best effort matches both kinds of publisher. Only the newest
pose of a frame is used; the queue holds all that come in one, so that none is lost, uncounted or
unchecked."""

NEWEST_POSE_IN = _profile(1, ReliabilityPolicy.BEST_EFFORT)
"""An arm's measured_cp for who needs the newest only, and must not fall behind when it is late."""

MEASURED = _profile(1)
"""tools/<tool>/measured_cp, measured_cf and contact_model."""

READINGS = _profile(10)
"""tissue/readings: a warning that is over is told of once."""

USE = _profile(100)
"""tools/<tool>/use and tools/<tool>/clutch: every edge counts."""

LATCHED = _profile(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""tissue/topology, tissue/status, tissue/tools, tissue/material, tissue/held_nodes, tissue/holes:
late joiners get the newest."""

EDITS = _profile(1024, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""tissue/edits: late joiners get the keyframe, then the newer edits (see MAX_UNKEYED_EDITS)."""

MAX_UNKEYED_EDITS = 512
"""A keyframe is published before so many edits lie unkeyed: half of what `EDITS` keeps."""

JOURNAL = _profile(1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""tissue/journal: a gap would end the replay. Who finds the publisher seconds after it was found
by it still gets the first frames."""

JOURNAL_CLOCK = _profile(10)
"""tissue/journal for those that only want to know what time it is."""

CUT_REQUEST = _profile(200)
"""tissue/cut_request: strips of progressive cuts come in every frame, also while one is planned."""

DIAGNOSTICS = _profile(10)
"""/diagnostics."""
