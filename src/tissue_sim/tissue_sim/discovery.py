"""Who finds whom: processes on this machine only, unless the user chose otherwise."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

THIS_MACHINE = Path(__file__).parent / "data" / "this_machine.xml"
"""Profile of Fast DDS that keeps to this machine, over UDP."""

DISCOVERY_VARIABLES = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_DISCOVERY_SERVER",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "CYCLONEDDS_URI",
)
"""One of them set says that the user chose."""


def local(environment: Mapping[str, str]) -> dict[str, str]:
    """Variables that keep discovery on this machine; none where the user chose.

    `SYSTEM_DEFAULT` leaves everything to Fast DDS's profile. Other middlewares know nothing of it
    and get the range of ROS (https://docs.ros.org/en/jazzy, "Improved Dynamic Discovery").
    """
    if any(environment.get(name) for name in DISCOVERY_VARIABLES):
        return {}
    if "fastrtps" not in environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp"):
        return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(THIS_MACHINE),
    }


def stay_local() -> None:
    """Keep discovery on this machine, unless the user chose otherwise, and say how to open up."""
    chosen = local(os.environ)
    if not chosen:
        return
    os.environ.update(chosen)
    print(
        "Visible on this machine only; to open up: export ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET",
        file=sys.stderr,
        flush=True,
    )
