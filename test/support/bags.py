"""Bags for tests, without ROS running: a session of a block, written message by message."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from tissue_interfaces.msg import Holes, Journal, Status, TissueState, Tool, ToolList, ToolSample

from support.split_block import split_plan
from tissue_sim import conversions, edit_messages
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from viz_bridge.bag_writer import BagOptions, BagWriter
from viz_bridge.cdr import Decoder, _Cursor
from viz_bridge.message_text import message_text

EPOCH = bytes(range(16))
PERIOD = 16_666_667
START = 1_700_000_000_000_000_000
ROOMY = BagOptions(min_free_gb=0.0)


def type_of(message: Any) -> str:
    module = type(message).__module__.split(".")
    return f"{module[0]}/{module[1]}/{type(message).__name__}"


def put(writer: BagWriter, topic: str, message: Any, stamp: int) -> bool:
    return writer.write(topic, type_of(message), on_the_wire(message), stamp)


def on_the_wire(message: Any) -> bytes:
    """A message as a subscriber gets it: `serialize_message` may append bytes of rubbish."""
    decoder = Decoder(type_of(message), message_text(type_of(message)))
    data = bytes(serialize_message(message))
    cursor = _Cursor(data)
    decoder._read(cursor)
    return data[: cursor.at]


def session_bag(
    folder: Path,
    frames: int = 40,
    cut_at: int = 20,
    namespace: str = "",
    options: BagOptions = ROOMY,
    holes: Sequence[Holes] = (),
) -> Path:
    """A block whose free side is pulled by a hook and which is split half way; at the end holes."""
    writer = BagWriter(folder, options)
    mesh = Mesh(block(7, 7, 3, 0.06, 0.06, 0.02))
    stamp = conversions.stamp_of(START)
    hook = Tool(id="hook", kind="grab", shape="sphere", size=[0.012], state="active")
    for topic, message in (
        ("tissue/status", Status(organ="block", model="fake", state=Status.READY)),
        ("tissue/tools", ToolList(tools=[hook])),
        ("tissue/topology", conversions.mesh_to_topology(mesh, EPOCH, "organ", stamp)),
    ):
        put(writer, f"{namespace}/{topic}", message, START)
    for frame in range(1, frames + 1):
        _put_frame(writer, namespace, mesh, frame, frames, frame == cut_at)
    for message in holes:
        put(writer, f"{namespace}/tissue/holes", message, START + (frames + 1) * PERIOD)
    writer.close()
    return folder


def _put_frame(
    writer: BagWriter, namespace: str, mesh: Mesh, frame: int, frames: int, cut: bool
) -> None:
    at = START + frame * PERIOD
    stamp = conversions.stamp_of(at)
    edits = []
    if cut:
        change = mesh.apply(split_plan(mesh))
        edits = [edit_messages.edit_to_msg(change.edit, EPOCH, "organ", stamp)]
        put(writer, f"{namespace}/tissue/edits", edits[0], at)
    pull = 0.02 * np.sin(np.pi * frame / frames)
    rest = mesh.rest[: mesh.node_rows]
    positions = rest.copy()
    positions[:, 1] += pull * rest[:, 1] / 0.06
    copies = mesh.node_parents[: mesh.node_rows] != mesh.node_ids[: mesh.node_rows]
    positions[copies, 0] += 0.2 * pull
    state = TissueState(header=conversions.header("organ", stamp), sim_time=frame / 60)
    state.epoch = conversions.epoch_field(EPOCH)
    state.version, state.frame = mesh.version, frame
    state.tool_ids, state.tool_stamps = ["hook"], [stamp]
    conversions.fill_state(state, positions.astype(np.float32))
    put(writer, f"{namespace}/tissue/state", state, at)
    entry = Journal(header=conversions.header("organ", stamp), frame=frame, steps=5)
    entry.epoch, entry.version = conversions.epoch_field(EPOCH), mesh.version
    entry.sim_time, entry.edits = frame / 60, edits
    sample = ToolSample(id="hook", stamp=stamp, use=frame >= 2)
    sample.edge = 1 if frame == 2 else -1 if frame == frames else 0
    sample.pose = np.array([0.03, 0.06 + pull, 0.01, 0, 0, 0, 1.0])
    entry.tools = [sample]
    put(writer, f"{namespace}/tissue/journal", entry, at)


def start_module(module: str, *arguments: str, log: Path | None = None) -> subprocess.Popen[bytes]:
    """Start `python -m module`; its output goes to the log."""
    output = log.open("wb") if log is not None else subprocess.DEVNULL
    return subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        stdout=output,
        stderr=subprocess.STDOUT,
        env=dict(os.environ),
    )


def start_fake(*arguments: str) -> subprocess.Popen[bytes]:
    """Start the stand-in for the simulation."""
    script = Path(__file__).with_name("fake_tissue.py")
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(
        [str(script.parents[1]), environment.get("PYTHONPATH", "")]
    )
    return subprocess.Popen([sys.executable, str(script), *arguments], env=environment)


def interrupt(process: subprocess.Popen[bytes], timeout: float = 20.0) -> int:
    """Ctrl-C, and the exit code."""
    process.send_signal(signal.SIGINT)
    return process.wait(timeout)


def wait_for(condition: Callable[[], object], seconds: float, what: str) -> None:
    """Poll until something holds."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"{what} did not happen within {seconds:g} s")
        time.sleep(0.02)
