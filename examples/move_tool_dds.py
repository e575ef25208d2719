"""Moves the grasper from a program without ROS: Eclipse Cyclone DDS (pip install cyclonedds).

ROS topics are DDS topics with `rt/` before the name; a message is a struct of the same fields.
Prints the tissue's frames that come back.
"""

import os
import time
from dataclasses import dataclass

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

# Only this machine, as the simulation does by default.
LOCAL = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces></General>
<Discovery><Peers><Peer address="127.0.0.1"/></Peers>
<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>
</Discovery></Domain></CycloneDDS>"""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):  # type: ignore[call-arg]
    """Time of builtin_interfaces."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):  # type: ignore[call-arg]
    """Header of std_msgs."""

    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):  # type: ignore[call-arg]
    """Point of geometry_msgs."""

    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):  # type: ignore[call-arg]
    """Quaternion of geometry_msgs."""

    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):  # type: ignore[call-arg]
    """Pose of geometry_msgs."""

    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):  # type: ignore[call-arg]
    """PoseStamped of geometry_msgs."""

    header: Header
    pose: Pose


@dataclass
class TissueState(IdlStruct, typename="tissue_interfaces::msg::dds_::TissueState_"):  # type: ignore[call-arg]
    """TissueState of tissue_interfaces."""

    header: Header
    sim_time: float64
    epoch: array[uint8, 16]
    version: uint32
    frame: uint64
    tool_ids: sequence[str]
    tool_stamps: sequence[Time]
    positions: sequence[float32]
    scalar_name: str
    scalar_unit: str
    scalar: sequence[float32]


def main() -> None:
    """Move for 4 s, and look at what comes back."""
    number = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    domain = Domain(number, LOCAL)
    participant = DomainParticipant(number)
    reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(1))
    pose_topic = Topic(participant, "rt/tools/grasper/servo_cp", PoseStamped, qos=reliable)
    state_topic = Topic(participant, "rt/tissue/state", TissueState, qos=reliable)
    writer = DataWriter(participant, pose_topic, qos=reliable)
    reader = DataReader(participant, state_topic, qos=reliable)
    frames = 0
    while not writer.get_matched_subscriptions():
        time.sleep(0.05)
    for step in range(500):
        now = time.time_ns()
        header = Header(Time(now // 10**9, now % 10**9), "organ")
        place = Point(0.035, 0.012 + 0.01 * step / 500, -0.007)
        writer.write(PoseStamped(header, Pose(place, Quaternion(0.0, 0.0, 0.0, 1.0))))
        for state in reader.take(10):
            frames += 1
            if frames % 60 == 1:
                nodes = len(state.positions) // 3
                print(f"frame {state.frame}: {nodes} nodes, tools {state.tool_ids}", flush=True)
        time.sleep(1 / 125)
    print(f"{frames} frames came back", flush=True)
    del domain


if __name__ == "__main__":
    main()
