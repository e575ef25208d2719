"""The haptic node beside a running simulation and an arm that moves by itself: what is measured."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.context import Context

from tissue_sim import qos
from tissue_sim.polled_subscriptions import PolledSubscriptions
from tissue_sim.scene_file import SceneFile
from tool_input.haptics.model_cost import DEEP, RADIUS, mesh_of, outermost

CLEAR = 0.004
"""How far from the tissue the probe begins [m]."""
PATIENCE = 300.0
"""Longest wait for the simulation: kernels may have to be compiled [s]."""
END_SECONDS = 20.0
ARM, TOOL = "arm", "finger"


def measure(
    scene: SceneFile,
    towards: NDArray[np.float64],
    rate_hz: float,
    arm_hz: float,
    priority: int,
    seconds: float,
) -> dict[str, Any]:
    """Press a scene's organ with a probe that a virtual arm moves, and measure the forces.

    Args:
        scene: What is simulated; its other tools stay.
        towards: Direction the probe presses in, along an axis, shape (3,).
        rate_hz: Of the haptic node.
        arm_hz: Poses per second of the arm.
        priority: Real-time priority of the haptic node; 0: none.
        seconds: How long.

    Raises:
        TimeoutError: The simulation or the force did not come.
    """
    start = outermost(mesh_of(scene), towards) - (RADIUS + CLEAR) * towards
    tools = [*scene.simulation["tools"], TOOL]
    finger = {
        f"tool.{TOOL}.kind": "probe", f"tool.{TOOL}.size": [RADIUS],
        f"tool.{TOOL}.position": start.tolist(), "tools": tools,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        scene.with_simulation(finger).write(out / "scene.yaml")
        with _diagnostics() as (heard, wait), _started(out) as run:
            run("tissue_sim.simulation_node", "--params-file", out / "scene.yaml")
            wait(lambda: "/tissue_sim: loop" in heard, "the simulation")
            stroke = ((CLEAR + DEEP) * towards).tolist()
            haptic = run(
                "tool_input.haptic_node", "-p", f"arm:={ARM}", "-p", f"tool:={TOOL}",
                "-p", f"rate_hz:={rate_hz}", "-p", f"realtime_priority:={priority}",
            )  # fmt: skip
            arm = run(
                "tool_input.virtual_arm_node", "-p", f"arm:={ARM}", "-p", f"rate_hz:={arm_hz}",
                "-p", f"position:={start.tolist()}", "-p", f"stroke:={stroke}",
                "-p", "closes_after:=0.0", "-p", f"report:={out / 'arm.json'}",
            )  # fmt: skip
            wait(lambda: "force is given" in _message(heard, "/haptic: force"), "a force")
            end = time.monotonic() + seconds
            wait(lambda: time.monotonic() > end, "the end")
            findings = {
                name.rpartition("/")[2]: {value.key: value.value for value in status.values}
                for name, status in heard.items()
                if name in ("/tissue_sim: loop", "/haptic: loop", "/haptic: force")
            }
            for process in (arm, haptic):
                process.send_signal(signal.SIGTERM)
                process.wait(timeout=END_SECONDS)
            measured: dict[str, Any] = json.loads((out / "arm.json").read_text())
    asked = {"rate_hz": rate_hz, "arm_hz": arm_hz, "realtime_priority": priority}
    return {**asked, **measured, "load_average": os.getloadavg()[0], **findings}


def _message(heard: dict[str, Any], name: str) -> str:
    return str(heard[name].message) if name in heard else ""


@contextmanager
def _started(folder: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Starts nodes, and ends what is left of them."""
    processes: list[subprocess.Popen[bytes]] = []

    def run(module: str, *arguments: object) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", module, "--ros-args", *map(str, arguments)]
        with (folder / f"{module}.log").open("wb") as log:
            made = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        processes.append(made)
        return made

    try:
        yield run
    finally:
        for process in reversed(processes):
            process.terminate()
        for process in processes:
            try:
                process.wait(timeout=END_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()


@contextmanager
def _diagnostics() -> Iterator[tuple[dict[str, Any], Callable[[Callable[[], bool], str], None]]]:
    """The newest finding of /diagnostics by its name, and how to wait for one."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("haptic_study", context=context)
    polled, heard = PolledSubscriptions(node), dict[str, Any]()

    def on_diagnostics(message: DiagnosticArray, _info: object) -> None:
        heard.update({status.name: status for status in message.status})

    polled.add(DiagnosticArray, "/diagnostics", on_diagnostics, qos.DIAGNOSTICS)

    def wait(there: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not there():
            if time.monotonic() > deadline:
                raise TimeoutError(f"waited {PATIENCE:g} s for {what}")
            time.sleep(0.1)
            polled.take()

    try:
        yield heard, wait
    finally:
        node.destroy_node()
        context.try_shutdown()
