"""Every source of tool motion drives a tool of a running simulation."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.context import Context
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from support.fake_simulation import spinning, wait_for
from support.observer import FRAME, PATIENCE, Observer
from support.processes import Processes, processes
from tissue_sim import qos
from tool_input.bag_tracks import BagTracks

START = [0.032, 0.08, 0.03]
HOLD = [0.032, 0.09, 0.004]
"""At the middle of the wall's free side."""


@pytest.fixture
def world(ros_domain: int, tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path) as made:
        yield made


@contextmanager
def simulation(world: Processes, repository: Path, domain: int, *more: str) -> Iterator[Observer]:
    """The wall at 60 Hz, watched."""

    def factory(context: Context) -> Observer:
        return Observer(context)

    with spinning(domain, factory) as seen:
        world.start(
            "simulation", "tissue_sim.simulation_node", "--ros-args",
            "--params-file", str(repository / "config" / "wall.yaml"),
            "-p", "steps_per_frame:=2", "-p", "wait_for:=['tissue/journal:1']", *more,
        )  # fmt: skip
        seen.wait_ready()
        yield seen


def start_script(world: Processes, folder: Path, text: str, *more: str) -> None:
    (folder / "procedure.yaml").write_text(text)
    world.start(
        "script", "tool_input.script_node", "--ros-args", "-p", "procedure:=procedure.yaml",
        "-p", "report:=report.json", *more,
    )  # fmt: skip


def code_of(world: Processes, name: str) -> int:
    """Exit code of a process that ends by itself."""
    wait_for(lambda: not world.runs(name), PATIENCE, f"the end of {name}")
    return world.end(name, signal.SIGINT)


def place_of(seen: Observer, tool: str = "grasper") -> np.ndarray:
    samples = seen.samples(tool)
    return samples[-1].pose[:3] if samples else np.full(3, np.nan)


def edges(seen: Observer, tool: str = "grasper") -> list[int]:
    return [sample.edge for sample in seen.samples(tool) if sample.edge]


PROCEDURE = f"""
title: lift, cut, change
units: m
frame_id: {FRAME}
tools:
  grasper: {{kind: grab, start: {{position: {START}}}}}
  hook: {{kind: grab, shape: sphere, size: [0.004], start: {{position: [0.0, 0.0, 0.03]}}}}
timeline:
  - {{at: 0.0, move: grasper, to: {HOLD}, for: 0.4}}
  - {{at: 0.8, press: grasper}}
  - {{at: 1.6, move: grasper, by: [0.0, 0.0, 0.008], for: 0.5}}
  - at: 2.2
    cut: {{rectangle: {{center: [0.032, 0.07, 0.005], along: [0.03, 0, 0], depth: [0, 0, 0.05]}}}}
  - {{at: 2.3, model: quasi_static, parameters: {{levels: 12}}}}
  - {{at: 2.4, grab: hook, radius: 0.03}}
  - {{at: 2.6, let_go: hook}}
  - {{at: 2.8, release: grasper}}
end: 3.0
"""
"""Between a press and the next move a frame must begin, on a machine however busy."""


@pytest.mark.parametrize("clock", ["wall", "simulation"])
def test_script_plays_a_whole_procedure(
    world: Processes, ros_domain: int, repository: Path, tmp_path: Path, clock: str
) -> None:
    with simulation(world, repository, ros_domain) as seen:
        world.start("cut", "cut_service.cut_node")
        start_script(world, tmp_path, PROCEDURE, "-p", f"clock:={clock}")
        report = tmp_path / "report.json"
        wait_for(report.exists, PATIENCE, "the end of the procedure")
        requests = json.loads(report.read_text())["requests"]
        assert {entry["action"] for entry in requests} == {"cut", "model", "let_go", "grab"}
        assert all(entry["success"] for entry in requests), requests
        cut = next(entry for entry in requests if entry["action"] == "cut")
        assert cut["faces_split"] > 0
        assert next(entry["nodes"] for entry in requests if entry["action"] == "grab") > 0
        wait_for(lambda: edges(seen) == [1, -1], 20.0, "the press and release")
        np.testing.assert_allclose(place_of(seen), np.add(HOLD, [0, 0, 0.008]), atol=1e-6)
        pressed = [sample for sample in seen.samples("grasper") if sample.use]
        np.testing.assert_allclose(pressed[0].pose[:3], HOLD, atol=1e-6)
        wait_for(lambda: seen.status is not None and seen.status.model == "quasi_static")
        assert "hook" in seen.tools
        assert code_of(world, "script") == 0


def test_script_says_what_is_wrong_and_ends(
    world: Processes, ros_domain: int, repository: Path, tmp_path: Path
) -> None:
    short = PROCEDURE.split("  - at: 2.2")[0] + PROCEDURE.split("levels: 12}}\n")[1]
    saw = "tools:\n  saw: {kind: cut, start: {position: [0, 0, 0]}}"
    with simulation(world, repository, ros_domain):
        for old, new, code, says in (
            ("press: grasper", "press: grapser", 2, "procedure.yaml:10: procedure.timeline[1]"),
            ("tools:", saw, 1, "no tool saw"),
            ("grasper: {kind: grab", "grasper: {kind: cut", 1, "is a grab tool there"),
            ("radius: 0.03", "radius: 0.000001", 1, "grab hook failed"),
        ):
            text = short.replace(old, new, 1)
            assert text != short
            start_script(world, tmp_path, text)
            assert code_of(world, "script") == code
            assert says in world.log("script")


STREAMED = 330


def stream(domain: int, publish: Callable[[Any, int], None], make: Callable[[Any], Any]) -> None:
    """Publish 125 times a second for a while from a context of its own."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("source", context=context)
    try:
        topics = make(node)
        deadline = time.monotonic() + PATIENCE
        while not all(topic.get_subscription_count() for topic in topics):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        for step in range(STREAMED):
            publish(topics, step)
            time.sleep(1 / 125)
    finally:
        node.destroy_node()
        context.try_shutdown()


def test_crtk_arm_moves_a_tool_and_its_jaw_grabs(
    world: Processes, ros_domain: int, repository: Path
) -> None:
    def make(node: Any) -> Any:
        return (
            node.create_publisher(PoseStamped, "PSM1/measured_cp", 1),
            node.create_publisher(JointState, "PSM1/jaw/measured_js", 1),
        )

    def publish(topics: Any, step: int) -> None:
        pose = PoseStamped()
        pose.header.frame_id = "PSM1_base"
        pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        # Up, a rest around the press in which some frame begins however busy the machine, and up.
        pose.pose.position.z = 0.008 * min(step, 50) / 50 + 0.012 * np.clip((step - 150) / 50, 0, 1)
        pose.pose.orientation.w = 1.0
        topics[0].publish(pose)
        opening = 0.5 if step < 80 else 0.0 if step < 280 else 0.5
        topics[1].publish(JointState(name=["jaw"], position=[opening + 0.04 * (-1) ** step]))

    with simulation(world, repository, ros_domain) as seen:
        world.start(
            "crtk", "tool_input.crtk_node", "--ros-args", "-p", "arm:=PSM1", "-p", "tool:=grasper",
            "-p", f"base_position:={HOLD}", "-p", "scale:=0.5",
        )  # fmt: skip
        wait_for(lambda: "somebody listens" in world.log("crtk"), PATIENCE, "the simulation")
        stream(ros_domain, publish, make)
        wait_for(lambda: edges(seen) == [1, -1], 20.0, "the jaw's press and release")
        np.testing.assert_allclose(place_of(seen), np.add(HOLD, [0, 0, 0.01]), atol=1e-6)
        held = [sample.pose[2] for sample in seen.samples("grasper") if sample.use]
        assert held[0] == pytest.approx(HOLD[2] + 0.004, abs=1e-6)
        assert max(abs(float(seen.positions[:, 2].max()) - held[-1]), 0.0) < 0.01


def test_replay_moves_the_tools_of_a_bag_again(
    world: Processes, ros_domain: int, repository: Path, tmp_path: Path
) -> None:
    lift = PROCEDURE.split("  - at: 2.2")[0] + "  - {at: 2.3, release: grasper}\nend: 2.5\n"
    with simulation(world, repository, ros_domain) as seen:
        world.start("bag", "viz_bridge.bag_node", "--ros-args", "-p", "bag:=session")
        wait_for(lambda: seen.finding("/bag: recording") == "recording", PATIENCE, "the bag")
        start_script(world, tmp_path, lift, "-p", "listeners:=2")
        wait_for((tmp_path / "report.json").exists, PATIENCE, "the end of the procedure")
        wait_for(lambda: edges(seen) == [1, -1], 20.0, "the press and release")
        first = seen.samples("grasper")
        assert code_of(world, "script") == 0
        assert world.end("bag", signal.SIGINT) == 0
        seen.entries.clear()
        world.start("replay", "tool_input.replay_node", "--ros-args", "-p", "bag:=session")
        assert code_of(world, "replay") == 0, world.log("replay")
        wait_for(lambda: edges(seen) == [1, -1], 20.0, "the replayed press and release")
        second = seen.samples("grasper")
    ways = [max(sample.pose[2] for sample in samples if sample.use) for samples in (first, second)]
    assert ways[0] == pytest.approx(HOLD[2] + 0.008, abs=1e-4)
    assert ways[1] == pytest.approx(ways[0], abs=1e-4)
    # What is held while the button is down is what was held then: the press comes at its place.
    for samples in (first, second):
        assert next(s.pose[2] for s in samples if s.use) == pytest.approx(HOLD[2], abs=1e-6)
    recorded = list(BagTracks(tmp_path / "session").messages())
    played = re.search(r"(\d+) messages in ([\d.]+) s", world.log("replay"))
    assert played is not None
    assert int(played[1]) == len(recorded)
    # Never early; how late a message may be is the machine's affair.
    assert recorded[-1].time - 0.01 < float(played[2]) < recorded[-1].time + 1.0


@pytest.mark.parametrize(
    ("module", "parameters", "says"),
    [
        ("replay_node", ["-p", "bag:=none"], "no such bag"),
        ("replay_node", [], "no bag"),
        ("replay_node", ["-p", "bag:=.", "-p", "rate:=0.0"], "rate"),
        ("crtk_node", ["-p", "tool:=grasper"], "no arm"),
        ("crtk_node", ["-p", "arm:=A", "-p", "tool:=t", "-p", "scal:=2.0"], "did you mean scale"),
        ("crtk_node", ["-p", "arm:=A", "-p", "tool:=t", "-p", "close_below:=0.5"], "less than"),
        ("script_node", [], "no procedure"),
        ("script_node", ["-p", "procedure:=none.yaml"], "cannot be read"),
        ("script_node", ["-p", "clock:=sun"], "wall, simulation"),
    ],
)
def test_node_that_is_told_nonsense_refuses_with_one_line(
    ros_domain: int, tmp_path: Path, module: str, parameters: list[str], says: str
) -> None:
    command = [sys.executable, "-m", f"tool_input.{module}", "--ros-args", *parameters]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert result.returncode == 2
    assert says in result.stderr
    assert "Traceback" not in result.stderr


RECORDER = """#!{python}
import json, shlex, sys
print(json.dumps(sys.argv[1:]), file=open({file!r}, "a"))
"""


@pytest.mark.parametrize("example", ["move_tool.py", "move_tool_dds.py"])
def test_example_moves_a_tool(
    world: Processes, ros_domain: int, repository: Path, example: str
) -> None:
    """cyclonedds is an implementation of DDS that has nothing to do with the one we use."""
    if "dds" in example:
        pytest.importorskip("cyclonedds")
    with simulation(world, repository, ros_domain) as seen:
        start = place_of(seen)
        result = subprocess.run(
            [sys.executable, str(repository / "examples" / example)],
            capture_output=True,
            text=True,
            timeout=60,
            env=dict(os.environ),
        )
        assert result.returncode == 0, result.stderr
        wait_for(lambda: place_of(seen)[0] == pytest.approx(0.035), 10.0, "the tool")
        places = np.array([sample.pose[:3] for sample in seen.samples("grasper")])
        way = places[places[:, 0] == 0.035][:, 1]
        assert np.ptp(way) > 0.008
        assert way.max() == pytest.approx(0.022, abs=2e-4)
        assert not np.allclose(start, places[-1])
        if "dds" in example:
            assert int(result.stdout.split()[-4]) > 60, result.stdout


def test_shell_example_names_topics_and_messages_that_exist(
    ros_domain: int, repository: Path, tmp_path: Path
) -> None:
    """The wheels have no ros2 command: one of the test's takes its place and reads the message."""
    calls = shell_calls(repository / "examples" / "move_tool.sh", tmp_path, "ros2")
    assert [call[:2] for call in calls] == [["topic", "pub"]] * len(calls)
    types = {"geometry_msgs/msg/PoseStamped": PoseStamped, "std_msgs/msg/Bool": Bool}
    for call in calls:
        topic, kind, text = call[-3:]
        assert topic.startswith("/tools/grasper/")
        message = types[kind]()
        fill(message, text)
    assert {call[-3].rsplit("/", 1)[1] for call in calls} == {"servo_cp", "use"}


def shell_calls(script: Path, folder: Path, program: str) -> list[list[str]]:
    """What a shell script calls a program with."""
    log = folder / "calls"
    stand_in = folder / program
    stand_in.write_text(RECORDER.format(python=sys.executable, file=str(log)))
    stand_in.chmod(0o755)
    path = f"{folder}:{os.environ['PATH']}"
    subprocess.run(
        ["bash", "-c", f". {script}; wait"], check=True, env={**os.environ, "PATH": path}
    )
    return [json.loads(line) for line in log.read_text().splitlines()]


def fill(message: Any, text: str) -> None:
    """Set the fields of a message as `ros2 topic pub` does; an unknown field raises."""
    import yaml

    def put(target: Any, values: dict[str, Any]) -> None:
        for name, value in values.items():
            assert name in target.get_fields_and_field_types()
            if isinstance(value, dict):
                put(getattr(target, name), value)
            elif not (name == "stamp" and value == "now"):
                setattr(target, name, value)

    put(message, yaml.safe_load(text))


def test_dvrk_example_grabs_with_the_arms_jaw(
    world: Processes, ros_domain: int, repository: Path, tmp_path: Path
) -> None:
    """Its two commands are run with stand-ins for a page and an arm."""
    text = (repository / "examples" / "dvrk.sh").read_text()
    node = text.split("tool_input.crtk_node")[1].replace("\\\n", " ")
    arguments = subprocess.run(
        ["bash", "-c", f"printf '%s\\n' {node}"], capture_output=True, text=True, check=True
    ).stdout.splitlines()

    def make(node: Any) -> Any:
        return (
            node.create_publisher(PoseStamped, "PSM1/measured_cp", qos.POSE),
            node.create_publisher(JointState, "PSM1/jaw/measured_js", qos.POSE),
        )

    def publish(topics: Any, step: int) -> None:
        pose = PoseStamped()
        pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        pose.pose.orientation.w = 1.0
        topics[0].publish(pose)
        topics[1].publish(JointState(name=["jaw"], position=[0.5 if step < 100 else 0.0]))

    assert "./tissue run heart" in text
    with simulation(world, repository, ros_domain) as seen:
        world.start("crtk", "tool_input.crtk_node", *arguments)
        wait_for(lambda: "somebody listens" in world.log("crtk"), PATIENCE, "the simulation")
        stream(ros_domain, publish, make)
        wait_for(lambda: edges(seen) == [1], 20.0, "the press")
