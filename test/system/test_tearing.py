"""Simulation and cutting node as processes: tissue is pulled until it tears, and burned."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from tissue_interfaces.msg import Tool
from tissue_interfaces.srv import SetTool, Undo

from support.processes import Processes, processes
from support.simulation_process import Client, client, eventually, simulation
from support.valid_mesh import check_valid
from tissue_sim import conversions, edit_messages
from tissue_sim.replica import Replica

WIDTH, HEIGHT = 0.03, 0.06
"""Of the strip [m]."""

STRIP = {
    "geometry": "block", "shape.nodes_x": 4, "shape.nodes_y": 3, "shape.nodes_z": 9,
    "shape.size_x": WIDTH, "shape.size_y": 0.01, "shape.size_z": HEIGHT,
    "model": "finite_element", "poisson_ratio": 0.3, "young_modulus": 5e4,
    "rate_hz": 30.0, "tools": ["grip"], "tool.grip.size": [0.055], "max_jump": 1.0,
    "pose_timeout": 3600.0, "release_timeout": 3600.0,
}  # fmt: skip
GRIP = np.array([WIDTH / 2, 0.005, HEIGHT + 0.05])


def followed(seen: Client) -> Replica:
    """The organ as the topics tell it."""
    replica = Replica()
    keyframe = seen.last("tissue/topology")
    epoch = conversions.epoch_of(keyframe)
    replica.take_keyframe(epoch, conversions.topology_to_mesh(keyframe))
    for message in list(seen.heard["tissue/edits"]):
        replica.take_edit(conversions.epoch_of(message), edit_messages.edit_from_msg(message))
    return replica


def parts(seen: Client) -> int:
    """Number of parts of the organ, which is valid."""
    mesh = followed(seen).mesh
    assert mesh is not None
    return check_valid(mesh).components


def kinds(seen: Client) -> list[str]:
    return [message.kind for message in list(seen.heard["tissue/edits"])]


def set_threshold(seen: Client, value: float) -> bool:
    number = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    answer = seen.call(
        SetParameters,
        "cut_service/set_parameters",
        parameters=[ParameterMsg(name="tear.threshold", value=number)],
    )
    return bool(answer.results[0].successful)


def press(seen: Client, tool: str, done: Callable[[], bool]) -> None:
    """Press a tool until it does something.

    The first messages may find nobody listening, and the first of all makes no edge.
    """

    def tried() -> bool:
        if not done():
            seen.use(tool, False)
            seen.use(tool, True)
            deadline = time.monotonic() + 2.0
            while not done() and time.monotonic() < deadline:
                time.sleep(0.02)
        return done()

    eventually(tried)


def pull_until(seen: Client, done: Callable[[], bool], most: float = 0.09) -> None:
    """Move the grip up, a millimetre at a time, until something has happened."""
    pull = 0.0
    deadline = time.monotonic() + 90.0
    while not done():
        assert time.monotonic() < deadline, f"nothing at a pull of {pull:g} m; {kinds(seen)}"
        pull = min(pull + 0.001, most)
        seen.pose("grip", [*GRIP[:2], GRIP[2] + pull])
        time.sleep(0.1)


def watch_says(seen: Client, key: str) -> str:
    """The newest value of the diagnostics of tearing and burning."""
    for array in reversed(list(seen.heard["/diagnostics"])):
        for status in array.status:
            assert isinstance(status, DiagnosticStatus)
            if status.name.endswith("tearing and burning"):
                return next((v.value for v in status.values if v.key == key), "")
    return ""


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[tuple[Processes, Client]]:
    with processes(tmp_path) as made, client() as seen:
        yield made, seen


def test_a_pull_tears_a_strip_in_two_and_a_hook_burns_it(
    world: tuple[Processes, Client], tmp_path: Path
) -> None:
    made, seen = world
    seen.hear("tissue/topology", "tissue/edits", "tissue/state", "tissue/tools", "/diagnostics")
    made.start(
        "cut", "cut_service.cut_node", "--ros-args", "-p", "tear.threshold:=20000.0",
        "-p", "burn.power:=1000.0",
    )  # fmt: skip
    parameters: dict[str, Any] = {key.replace(".", "__"): value for key, value in STRIP.items()}
    with simulation(tmp_path, **parameters) as running:
        seen.first("tissue/state")
        eventually(lambda: watch_says(seen, "held nodes") == "0")
        seen.place("grip", GRIP.tolist())
        press(seen, "grip", lambda: int(watch_says(seen, "held nodes") or 0) > 0)

        pull_until(seen, lambda: "tear" in kinds(seen))
        pull_until(seen, lambda: parts(seen) == 2)
        assert set(kinds(seen)) == {"tear"}
        torn = len(kinds(seen))
        assert watch_says(seen, "tears refused") == "0"

        # Without a threshold nothing tears, and what was torn can be undone to the first.
        assert not set_threshold(seen, -1.0)
        assert not set_threshold(seen, float("nan"))
        assert set_threshold(seen, 0.0)
        seen.use("grip", False)
        for _ in range(torn):
            assert seen.call(Undo, "tissue/undo", author="test", request_id="").success
        eventually(lambda: kinds(seen).count("undo") == torn)
        assert parts(seen) == 1

        # A tool burns only if it says so, and while it is pressed.
        hook = Tool(id="hook", kind="burn", shape="sphere", size=[0.0])
        tip = [WIDTH / 2, 0.005, HEIGHT / 2]
        hook.pose.position.x, hook.pose.position.y, hook.pose.position.z = tip
        hook.pose.orientation.w = 1.0
        refused = seen.call(SetTool, "tissue/set_tool", tool=hook)
        assert not refused.success
        assert "size" in refused.message
        hook.size = [0.006]
        assert seen.call(SetTool, "tissue/set_tool", tool=hook).success
        seen.place("hook", tip)
        assert "burn" not in kinds(seen)
        press(seen, "hook", lambda: "burn" in kinds(seen))
        seen.use("hook", False)
        assert parts(seen) >= 1
        assert int(watch_says(seen, "burns refused") or 0) == 0

        # The simulation restarts in the middle of a tear: nothing is left of the old organ.
        assert set_threshold(seen, 20000.0)
        running.kill()
    seen.heard["tissue/topology"].clear()
    seen.heard["tissue/edits"].clear()
    with simulation(tmp_path, **parameters):
        eventually(lambda: seen.heard["tissue/topology"])
        seen.heard["/diagnostics"].clear()
        eventually(lambda: watch_says(seen, "held nodes") == "0")
        seen.place("grip", GRIP.tolist())
        press(seen, "grip", lambda: int(watch_says(seen, "held nodes") or 0) > 0)
        pull_until(seen, lambda: "tear" in kinds(seen))
        assert made.runs("cut")
        assert made.end("cut", signal.SIGINT) == 0
