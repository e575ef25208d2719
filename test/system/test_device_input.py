"""Joysticks, 3D mice, arms and unplugged devices beside a running simulation."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped, Vector3
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState, Joy

from support.bags import type_of
from support.device import device
from support.fake_simulation import spinning, wait_for
from support.observer import PATIENCE, Observer
from support.processes import Processes, processes

HOLD = [0.032, 0.09, 0.004]
"""At the middle of the wall's free side."""
USE, NEXT_TOOL = 0, 1


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path) as made:
        yield made


@contextmanager
def simulation(
    world: Processes, repository: Path, domain: int, meanwhile: Callable[[], None] = lambda: None
) -> Iterator[Observer]:
    """The wall with its grasper at the free side, watched; something is done while it starts."""
    with spinning(domain, Observer) as seen:
        world.start(
            "simulation", "tissue_sim.simulation_node", "--ros-args",
            "--params-file", str(repository / "config" / "wall.yaml"),
            "-p", f"tool.grasper.position:={HOLD}", "-p", "steps_per_frame:=2",
            "-p", "release_timeout:=1.0", "-p", "wait_for:=['tissue/journal:1']",
        )  # fmt: skip
        meanwhile()
        seen.wait_ready()
        yield seen


def start_joy(world: Processes, example: Path) -> None:
    """Start the node as an example to copy does."""
    words = example.read_text().split("tool_input.joy_node")[1].replace("\\\n", " ")
    printed = subprocess.run(
        ["bash", "-c", f"printf '%s\\n' {words}"], capture_output=True, text=True, check=True
    )
    world.start("joy", "tool_input.joy_node", *printed.stdout.splitlines())


def joy(up: float = 0.0, *pressed: int) -> Joy:
    """A gamepad whose stick for z is pushed so far, with these buttons down."""
    axes = [0.0] * 8
    axes[4] = up
    return Joy(axes=axes, buttons=[int(index in pressed) for index in range(8)])


def height(seen: Observer, tool: str = "grasper") -> float:
    samples = seen.samples(tool)
    return samples[-1].pose[2] if samples else np.nan


def edges(seen: Observer, tool: str = "grasper") -> list[int]:
    return [sample.edge for sample in seen.samples(tool) if sample.edge]


def told(seen: Observer, what: str) -> bool:
    """Whether the diagnostics of the node's input say something."""
    return what in seen.finding("/joy: input")


def state(seen: Observer, tool: str = "grasper") -> str:
    return f"{seen.tools[tool].state} {seen.tools[tool].reason}" if tool in seen.tools else ""


BAD_MESSAGES = (
    (joy(float("nan")), "z not finite"),
    (Joy(axes=[1.0], buttons=[1] * 8), "1 axes where at least"),
    (Joy(axes=[1.0] * 8, buttons=[]), "0 buttons where at least"),
)


def test_joystick_grabs_and_lifts_tissue_until_it_is_unplugged(
    world: Processes, ros_domain: int, repository: Path
) -> None:
    with simulation(world, repository, ros_domain) as seen, device(ros_domain, {"joy": Joy}) as pad:
        start_joy(world, repository / "examples" / "joy.sh")
        wait_for(lambda: "no input on joy yet" in seen.finding("/joy: input"), PATIENCE, "the node")
        pad.says["joy"] = joy()
        wait_for(lambda: state(seen).startswith("active"), PATIENCE, "poses")
        assert height(seen) == pytest.approx(HOLD[2], abs=1e-9)
        assert state(seen, "scalpel").startswith("free")
        for message, says in BAD_MESSAGES:
            pad.says["joy"] = message
            wait_for(partial(told, seen, says), 20.0, says)
        assert "left out because z not finite" in world.log("joy")
        assert height(seen) == pytest.approx(HOLD[2], abs=1e-9)
        assert edges(seen) == []
        pad.says["joy"] = joy()
        wait_for(lambda: state(seen).startswith("active"), 20.0, "poses after the bad messages")
        pad.says["joy"] = joy(0.0, USE)
        wait_for(lambda: edges(seen) == [1], 20.0, "the press")
        rest = float(seen.positions[:, 2].max())
        pad.says["joy"] = joy(1.0, USE)
        wait_for(lambda: height(seen) > HOLD[2] + 0.006, 20.0, "the lift")
        wait_for(lambda: float(seen.positions[:, 2].max()) > rest + 0.004, 20.0, "the tissue")

        pad.plugged = False
        wait_for(lambda: state(seen).startswith("frozen"), 20.0, "the freeze")
        wait_for(lambda: edges(seen) == [1, -1], 20.0, "the release")
        wait_for(lambda: "let go" in state(seen), 20.0, "the reason")
        frozen = height(seen)
        assert "no input on joy for more than 0.5 s" in world.log("joy")
        wait_for(lambda: "for more than 0.5 s" in seen.finding("/joy: input"), 20.0, "diagnostics")
        wait_for(lambda: "let go" in seen.finding("/tissue_sim: tool grasper"), 20.0, "diagnostics")

        # What is down when the device comes back grabs nothing; the next press does.
        pad.says["joy"] = joy(0.0, USE)
        pad.plugged = True
        wait_for(lambda: state(seen).startswith("active"), 20.0, "poses again")
        assert height(seen) == pytest.approx(frozen, abs=1e-6)
        assert edges(seen) == [1, -1]
        pad.says["joy"] = joy()
        wait_for(lambda: not seen.tools["grasper"].pressed, 20.0, "the release")
        seen.wait_frames(10)
        pad.says["joy"] = joy(0.0, USE)
        wait_for(lambda: edges(seen) == [1, -1, 1], 20.0, "the second press")
        assert world.end("joy", signal.SIGINT) == 0
        wait_for(lambda: edges(seen) == [1, -1, 1, -1], 20.0, "the release at the node's end")


def test_twists_of_a_spacenav_move_what_its_buttons_grab_and_stamped_ones_do_too(
    world: Processes, ros_domain: int, repository: Path
) -> None:
    topics = {"spacenav/twist": Twist, "spacenav/joy": Joy, "hand/twist": TwistStamped}
    with simulation(world, repository, ros_domain) as seen, device(ros_domain, topics) as puck:
        start_joy(world, repository / "examples" / "spacenav.sh")
        puck.says["spacenav/twist"] = Twist()
        puck.says["spacenav/joy"] = Joy(axes=[0.0] * 6, buttons=[0, 0])
        wait_for(lambda: state(seen).startswith("active"), PATIENCE, "poses")
        seen.wait_frames(10)
        puck.says["spacenav/joy"] = Joy(axes=[0.0] * 6, buttons=[1, 0])
        wait_for(lambda: edges(seen) == [1], 20.0, "the press")
        puck.says["spacenav/joy"] = Joy(axes=[0.0] * 6, buttons=[0, 0])
        puck.says["spacenav/twist"] = Twist(linear=Vector3(z=1.0))
        wait_for(lambda: height(seen) > HOLD[2] + 0.003, 20.0, "the lift")
        puck.says["spacenav/twist"] = Twist()
        puck.says["spacenav/joy"] = Joy(axes=[0.0] * 6, buttons=[0, 1])
        wait_for(lambda: state(seen, "scalpel").startswith("active"), 20.0, "the other tool")
        left, before = height(seen), height(seen, "scalpel")
        puck.says["spacenav/twist"] = Twist(linear=Vector3(z=-1.0))
        wait_for(lambda: height(seen, "scalpel") < before - 0.002, 20.0, "the other tool's motion")
        assert height(seen) == pytest.approx(left, abs=1e-9)
        assert seen.tools["grasper"].pressed
        assert state(seen).startswith("active")
        assert {tool.owner for tool in seen.tools.values()} == {"/joy"}

        # A device that stamps its twists takes the same tool over where it was left.
        assert world.end("joy", signal.SIGINT) == 0
        wait_for(lambda: not seen.tools["grasper"].pressed, 20.0, "the release at the node's end")
        world.start(
            "joy", "tool_input.joy_node", "--ros-args", "-p", "tools:=['grasper']",
            "-p", "motion:=twist_stamped", "-p", "twist_topic:=hand/twist",
        )  # fmt: skip
        puck.says["hand/twist"] = TwistStamped(twist=Twist(linear=Vector3(z=np.nan)))
        wait_for(lambda: told(seen, "z not finite"), PATIENCE, "what is wrong with the twist")
        assert height(seen) == pytest.approx(left, abs=1e-9)
        puck.says["hand/twist"] = TwistStamped(twist=Twist(linear=Vector3(z=1.0)))
        wait_for(lambda: height(seen) > left + 0.003, 20.0, "the lift")


ARM: dict[str, type] = {
    "/PSM1/measured_cp": PoseStamped,
    "/PSM1/jaw/measured_js": JointState,
    "/footpedals/clutch": Joy,
}
STEPS = 400
LOST = range(100, 110)
"""Steps at which the arm's encoders read nothing."""
QUARTER = np.sqrt(0.5)


def arm_pose(step: int) -> PoseStamped:
    """Along y and rest, twice; with the clutch pressed back again and turned."""
    way = 0.008 * min(step, 50) / 50 + 0.012 * np.clip((step - 150) / 50, 0, 1)
    back = float(np.clip((step - 260) / 50, 0, 1))
    message = PoseStamped()
    message.pose.position.x = np.nan if step in LOST else 0.1
    message.pose.position.y = float(way) - 0.02 * back
    message.pose.orientation.x, message.pose.orientation.w = np.sin(back / 2), np.cos(back / 2)
    return message


def jaw(step: int) -> JointState:
    """Open, then closed, trembling."""
    opening = np.nan if step in LOST else 0.5 if step < 80 else 0.0
    return JointState(name=["jaw"], position=[opening + 0.04 * (-1) ** step])


def pedal(step: int) -> Joy:
    return Joy(buttons=[int(230 <= step < 340)])


def record_arm(world: Processes, domain: int) -> None:
    """Record an arm that moves, with jaw and pedal, at 125 Hz."""
    topics = (f"{name}:{type_of(kind())}" for name, kind in ARM.items())
    words = [word for topic in topics for word in ("--topics", topic)]
    world.start("record", "viz_bridge.bag_cli", "record", "-o", "arm", *words)
    with spinning(domain, lambda context: Node("arm", context=context)) as arm:
        outputs = [arm.create_publisher(kind, name, STEPS) for name, kind in ARM.items()]
        wait_for(
            lambda: all(output.get_subscription_count() for output in outputs), PATIENCE, "recorder"
        )
        for step in range(STEPS):
            for output, make in zip(outputs, (arm_pose, jaw, pedal), strict=True):
                output.publish(make(step))
            time.sleep(0.008)
        for output in outputs:
            assert output.wait_for_all_acked(Duration(seconds=20))
    assert world.end("record", signal.SIGINT) == 0


def test_recorded_arm_grabs_and_its_pedal_takes_it_off_the_tool(
    world: Processes, ros_domain: int, repository: Path
) -> None:
    recorded = partial(record_arm, world, ros_domain)
    with simulation(world, repository, ros_domain, recorded) as seen:
        world.start(
            "crtk", "tool_input.crtk_node", "--ros-args", "-p", "arm:=PSM1", "-p", "tool:=grasper",
            "-p", f"base_position:={HOLD}", "-p", "arm_origin:=[0.1, 0.0, 0.0]",
            "-p", f"base_orientation:=[{QUARTER}, 0.0, 0.0, {QUARTER}]", "-p", "scale:=0.5",
            "-p", "clutch_type:=joy", "-p", "clutch_topic:=footpedals/clutch",
        )  # fmt: skip
        wait_for(lambda: "somebody listens" in world.log("crtk"), PATIENCE, "the simulation")
        played = [word for topic in ARM for word in ("--topics", topic)]
        world.start("play", "viz_bridge.bag_cli", "play", "arm", *played)
        wait_for(lambda: edges(seen) == [1, -1], 60.0, "the press, and the release after the end")
        pressed = [sample.pose for sample in seen.samples("grasper") if sample.use]
        # A quarter turn about x takes the arm's way along y up; what the clutch kept does nothing.
        assert pressed[0][2] == pytest.approx(HOLD[2] + 0.5 * 0.008, abs=1e-6)
        end = [*HOLD[:2], HOLD[2] + 0.5 * (0.008 + 0.012), QUARTER, 0, 0, QUARTER]
        np.testing.assert_allclose(pressed[-1], end, atol=1e-6)
        wait_for(lambda: "let go" in state(seen), 20.0, "the reason")
        silence = "no input on PSM1/measured_cp for more than 0.5 s"
        wait_for(lambda: silence in seen.finding("/crtk: input"), 20.0, "diagnostics")
        assert f"{2 * len(LOST)} messages refused" in seen.finding("/crtk: input")


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ("joy tools:=['grasper'] linear_scale:=50.0", "from 0.0001 to 0.5 m/s"),
        ("joy tools:=['grasper'] home_button:=0", "one meaning"),
        ("crtk arm:=PSM1 tool:=grasper scale:=1000.0", "from 0.01 to 100"),
    ],
)
def test_node_that_is_told_nonsense_refuses_with_one_line(
    ros_domain: int, tmp_path: Path, parameters: str, says: str
) -> None:
    node, *values = parameters.split()
    command = [sys.executable, "-m", f"tool_input.{node}_node", "--ros-args"]
    command += [word for value in values for word in ("-p", value)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert result.returncode == 2
    assert says in result.stderr
    assert "Traceback" not in result.stderr
