"""Messages read from bytes alone equal those that ROS reads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Empty
from tissue_interfaces.msg import Journal, Status, TissueState, Topology

from support.bags import EPOCH, type_of
from tissue_sim import conversions
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from viz_bridge.cdr import CdrError, Decoder
from viz_bridge.message_text import UnknownTypeError, message_text


def decoder_of(message: Any) -> Decoder:
    return Decoder(type_of(message), message_text(type_of(message)))


def same(ours: Any, ros: Any) -> bool:
    if hasattr(ros, "get_fields_and_field_types"):
        names = ros.get_fields_and_field_types()
        return set(vars(ours)) == set(names) and all(
            same(getattr(ours, name), getattr(ros, name)) for name in names
        )
    if isinstance(ros, (list, tuple)) and not isinstance(ours, np.ndarray):
        return len(ours) == len(ros) and all(map(same, ours, ros))
    if isinstance(ours, np.ndarray):
        return np.array_equal(ours, np.asarray(ros))
    if isinstance(ros, bytes):
        return ours == ros[0]
    return bool(ours == ros)


@settings(max_examples=30, deadline=None)
@given(
    text=st.text(max_size=12),
    values=st.lists(st.floats(width=32, allow_nan=False), max_size=9),
    frame=st.integers(0, 2**64 - 1),
    tools=st.lists(st.text(max_size=6), max_size=3),
)
def test_a_state_reads_as_ros_reads_it(
    text: str, values: list[float], frame: int, tools: list[str]
) -> None:
    state = TissueState(frame=frame, scalar_name=text.replace("\0", ""), sim_time=0.1)
    state.tool_ids = [tool.replace("\0", "") for tool in tools]
    state.tool_stamps = [conversions.stamp_of(7 * k) for k in range(len(tools))]
    conversions.fill_state(state, np.array(values, dtype=np.float32))
    data = serialize_message(state)
    assert same(decoder_of(state)(data), deserialize_message(data, TissueState))


def test_nested_lists_and_constants_read_as_ros_reads_them() -> None:
    mesh = Mesh(block(3, 3, 3))
    stamp = conversions.stamp_of(5)
    topology = conversions.mesh_to_topology(mesh, EPOCH, "organ", stamp)
    status = Status(organ="herz", message="ä", progress=0.5)
    for message in (topology, status, WrenchStamped(), Journal(), Empty()):
        data = serialize_message(message)
        assert same(decoder_of(message)(data), deserialize_message(data, type(message)))


def test_big_endian_is_read_too() -> None:
    little = Decoder("a/msg/B", "uint16 small\nfloat64 large\nint32[] list\n")
    data = b"\0\0\0\0" + b"\1\2" + bytes(6) + bytes.fromhex("3ff8000000000000")
    message = little(data + bytes.fromhex("00000002 00000001 fffffffe"))
    assert (message.small, message.large, message.list.tolist()) == (258, 1.5, [1, -2])


@pytest.mark.parametrize("keep", [0, 3, 5, 40, 200])
def test_a_cut_off_message_is_refused(keep: int) -> None:
    mesh = Mesh(block(3, 3, 3))
    topology = conversions.mesh_to_topology(mesh, EPOCH, "organ", conversions.stamp_of(5))
    decoder = decoder_of(topology)
    with pytest.raises(CdrError):
        decoder(serialize_message(topology)[:keep])


def test_bytes_of_another_type_are_refused() -> None:
    data = serialize_message(Topology(organ="x" * 100))
    with pytest.raises(CdrError):
        decoder_of(Status())(data)


def test_an_unknown_type_is_named() -> None:
    with pytest.raises(UnknownTypeError, match="nobody/msg/Knows"):
        message_text("nobody/msg/Knows")
