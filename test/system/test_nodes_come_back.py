"""Nodes are killed, stopped and restarted while the others go on; two organs share a domain."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from rclpy.context import Context
from tissue_interfaces.srv import ApplyEdit

from cut_service.sweep import Sweep
from support.fake_simulation import spinning, wait_for
from support.observer import FRAME, PATIENCE, Observer
from support.processes import Processes, processes
from tissue_sim import edit_messages
from tissue_sim.geometry.components import connected_components
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from viz_bridge.bag_reader import read_bag

SIZE = 0.06
SIDE = 5
RATE = 30
TOP = [SIZE / 2, SIZE / 2, SIZE]
"""The middle of the block's top."""

HEAD = f"""
title: a block
units: m
frame_id: {FRAME}
tools:
  grasper:
    kind: grab
    start: {{position: {TOP}}}
end: 600.0
timeline:
"""
PULLING = f"""{HEAD}
  - {{at: 0.3, press: grasper}}
  - {{at: 0.5, move: grasper, by: [0.0, 0.0, 0.006], for: 0.5}}
"""
PRESSING = HEAD + "".join(
    f"  - {{at: {0.3 + turn:.1f}, {word}: grasper}}\n"
    for turn in range(100)
    for word in [("press", "release")[turn % 2]]
)


def start_simulation(world: Processes, repository: Path, name: str, *more: str) -> None:
    world.start(
        name, "tissue_sim.simulation_node", "--ros-args",
        "--params-file", str(repository / "config" / "block.yaml"),
        *(word for axis in "xyz" for word in ("-p", f"shape.nodes_{axis}:={SIDE}")),
        "-p", f"rate_hz:={RATE}.0", "-p", "steps_per_frame:=2",
        "-p", "wait_for:=['tissue/journal:1']", "-p", "tool.grasper.size:=[0.016]", *more,
    )  # fmt: skip


def start_rerun(world: Processes, file: str) -> None:
    world.start("rerun", "viz_bridge.rerun_node", "--ros-args", "-p", "sink:=file",
                "-p", f"path:={file}")  # fmt: skip


@contextmanager
def observing(domain: int, namespace: str = "") -> Iterator[Observer]:
    def factory(context: Context) -> Observer:
        return Observer(context, namespace)

    with spinning(domain, factory) as observer:
        yield observer


@pytest.fixture
def world(ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Processes]:
    # Programs of the tests run as modules too.
    here = str(Path(__file__).resolve().parents[1])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([here, os.environ.get("PYTHONPATH", "")]))
    with processes(tmp_path) as made:
        yield made


def slab(share: float) -> Sweep:
    """A plane x = const through the block and beyond it."""
    x, far, near = share * SIZE, 2.0 * SIZE, -SIZE
    return Sweep.between(
        np.array([[x, near, far], [x, far, far]]), np.array([[x, near, near], [x, far, near]])
    )


def parts(mesh: Mesh) -> int:
    rows = mesh.element_rows
    return connected_components(mesh.tets[:rows], mesh.element_alive[:rows], mesh.node_rows)[0]


def assert_same(one: Mesh, other: Mesh) -> None:
    assert (one.node_rows, one.element_rows) == (other.node_rows, other.element_rows)
    nodes, elements = one.node_rows, one.element_rows
    assert np.array_equal(one.rest[:nodes], other.rest[:nodes])
    assert np.array_equal(one.node_ids[:nodes], other.node_ids[:nodes])
    assert np.array_equal(one.tets[:elements], other.tets[:elements])
    assert np.array_equal(one.element_alive[:elements], other.element_alive[:elements])


def presses(seen: Observer) -> int:
    return sum(sample.edge == 1 for sample in seen.samples("grasper"))


def assert_no_gap(frames: list[int]) -> None:
    assert frames == list(range(1, len(frames) + 1))


def test_whoever_is_killed_comes_back_and_the_simulation_misses_no_frame(
    world: Processes, ros_domain: int, repository: Path, tmp_path: Path
) -> None:
    (tmp_path / "procedure.yaml").write_text(PRESSING)
    script = ("script", "tool_input.script_node", "--ros-args", "-p", "procedure:=procedure.yaml")
    cut = ("cut", "cut_service.cut_node")
    with observing(ros_domain) as seen:
        start_simulation(world, repository, "simulation", "-p", "release_timeout:=0.8")
        world.start(*cut)
        world.start("bag", "viz_bridge.bag_node", "--ros-args", "-p", "bag:=first")
        start_rerun(world, "first.rrd")
        world.start(*script)
        epoch = seen.wait_ready()
        first = seen.cut(slab(0.25), "first")
        assert first.success, first.message
        wait_for(lambda: presses(seen) > 0, what="the press")
        wait_for(lambda: seen.finding("/bag: recording") == "recording", PATIENCE, "the bag")
        wait_for(lambda: (tmp_path / "first.rrd").exists(), PATIENCE, "the recording")
        steps_before = {entry.steps for entry in seen.entries}

        for name in ("script", "cut", "bag", "rerun"):
            assert world.end(name, signal.SIGKILL) == -signal.SIGKILL
        wait_for(lambda: "let go" in seen.tools["grasper"].reason, what="the report of it")
        assert seen.tools["grasper"].state == "frozen"
        wait_for(
            lambda: "no pose" in seen.finding("/tissue_sim: tool grasper"), what="the diagnostic"
        )
        seen.wait_frames(RATE)
        assert seen.ready

        world.start(*cut)
        world.start("bag", "viz_bridge.bag_node", "--ros-args", "-p", "bag:=second")
        start_rerun(world, "second.rrd")
        wait_for(lambda: "recording to second" in world.log("bag"), PATIENCE)
        wait_for((tmp_path / "second.rrd").exists, PATIENCE, "the recording")
        world.start(*script)
        wait_for(lambda: seen.tools["grasper"].state == "active", PATIENCE, "the script again")
        pressed = presses(seen)
        wait_for(lambda: presses(seen) > pressed, PATIENCE, "the press of the restarted script")
        second = seen.cut(slab(0.75), "second")
        assert second.success, second.message
        assert second.version == 3
        wait_for(lambda: seen.replica.version == 3, what="the edit")
        assert parts(seen.mesh) == 3
        seen.wait_frames(RATE)

        assert seen.epoch == epoch
        assert_no_gap(seen.frames(epoch))
        assert steps_before == {entry.steps for entry in seen.entries} == {2}
        assert world.end("bag", signal.SIGINT) == 0
        assert world.end("rerun", signal.SIGINT) == 0
        assert (tmp_path / "second.rrd").stat().st_size > 10_000
    frames = [int(m.message.frame) for m in read_bag(tmp_path / "second", ["/tissue/journal"])]
    assert len(frames) > RATE
    assert frames == list(range(frames[0], frames[0] + len(frames)))


def test_a_restarted_simulation_begins_a_new_epoch_and_everybody_follows(
    world: Processes, ros_domain: int, repository: Path
) -> None:
    with observing(ros_domain) as seen:
        start_simulation(world, repository, "simulation")
        world.start("cut", "cut_service.cut_node")
        old_epoch = seen.wait_ready()
        assert seen.cut(slab(0.25), "old").success
        wait_for(lambda: seen.replica.version == 2, what="the edit")
        # Nothing is wrong with this edit but its epoch.
        mesh = seen.mesh
        corners = mesh.tets[0]
        edit = TopologyEdit(
            base_version=1,
            moved_nodes=mesh.node_ids[corners[:1]],
            moved_rest=mesh.rest[corners[:1]],
            moved_anchors=mesh.node_ids[corners][None],
            moved_weights=np.array([[1.0, 0.0, 0.0, 0.0]]),
            request_id="left over",
        )
        stamp = seen.get_clock().now().to_msg()
        left_over = edit_messages.edit_to_msg(edit, old_epoch, FRAME, stamp)

        assert world.end("simulation", signal.SIGKILL) == -signal.SIGKILL
        wait_for(
            lambda: "silent" in seen.finding("/cut_service: cutting"), what="the report of silence"
        )
        start_simulation(world, repository, "simulation")
        wait_for(lambda: seen.epoch not in (old_epoch, bytes(16)), PATIENCE, "a new epoch")
        new_epoch = seen.wait_ready()
        stale = seen.apply(left_over)
        assert (stale.success, stale.error_code) == (False, ApplyEdit.Response.STALE)
        assert old_epoch.hex() in stale.message
        assert new_epoch.hex() in stale.message

        following = f"epoch {new_epoch.hex()[:8]}"
        wait_for(lambda: following in world.log("cut"), what="the cut service in the new epoch")
        for number, share in enumerate((0.25, 0.75)):
            answer = seen.cut(slab(share), f"new {number}")
            assert answer.success, answer.message
            assert answer.version == number + 2
        wait_for(lambda: seen.replica.version == 3, what="the edits")

        with observing(ros_domain, "") as late:
            assert late.wait_ready() == new_epoch
            wait_for(lambda: late.replica.version == seen.replica.version, what="the topology")
            assert_same(late.mesh, seen.mesh)
            assert late.positions.shape == (late.mesh.node_rows, 3)
        assert parts(seen.mesh) == 3
        assert_no_gap(seen.frames(old_epoch))
        assert_no_gap(seen.frames(new_epoch))


def test_two_organs_in_one_domain_do_not_meet(
    world: Processes, ros_domain: int, repository: Path, tmp_path: Path
) -> None:
    (tmp_path / "procedure.yaml").write_text(PULLING)
    with ExitStack() as stack:
        seen = {}
        for side in ("left", "right"):
            namespace = ("-r", f"__ns:=/{side}")
            seen[side] = stack.enter_context(observing(ros_domain, f"/{side}"))
            start_simulation(world, repository, f"{side}/simulation", *namespace)
            world.start(f"{side}/cut", "cut_service.cut_node", "--ros-args", *namespace)
        world.start("script", "tool_input.script_node", "--ros-args", "-r", "__ns:=/left",
                    "-p", "procedure:=procedure.yaml")  # fmt: skip
        left, right = seen["left"], seen["right"]
        assert left.wait_ready() != right.wait_ready()
        assert right.cuts.wait_for_service(PATIENCE)
        answer = left.cut(slab(0.25), "same id")
        assert answer.success, answer.message
        wait_for(lambda: presses(left) == 1, what="the press")
        wait_for(lambda: lift(left) > 0.004, what="the pull")
        right.wait_frames(RATE)

        assert (left.replica.version, parts(left.mesh)) == (2, 2)
        assert (right.replica.version, parts(right.mesh)) == (1, 1)
        assert lift(right) < 1e-6
        assert left.tools["grasper"].state == "active"
        assert right.tools["grasper"].state == "free"
        assert {sample.stamp for sample in right.samples("grasper")} == {0}
        assert not [entry for entry in right.entries if entry.inputs.edits]

        # A request's id means something in its own organ only.
        answer = right.cut(slab(0.75), "same id")
        assert answer.success, answer.message
        wait_for(lambda: right.replica.version == 2, what="the edit")
        assert left.replica.version == 2
        for organ in (left, right):
            assert_no_gap(organ.frames(organ.epoch))


def test_a_listener_that_stands_still_delays_nobody(
    world: Processes, ros_domain: int, repository: Path
) -> None:
    with observing(ros_domain) as seen:
        start_simulation(world, repository, "simulation")
        world.start("listener", "support.state_listener")
        epoch = seen.wait_ready()
        wait_for(lambda: len(world.log("listener").split()) > RATE, PATIENCE, "the listener")
        before = seconds_for(seen, 2 * RATE)
        world.send("listener", signal.SIGSTOP)
        during = seconds_for(seen, 4 * RATE) / 2
        heard = len(world.log("listener").split())
        world.send("listener", signal.SIGCONT)
        newest = seen.frames(epoch)[-1]
        wait_for(
            lambda: int(world.log("listener").split()[-1]) >= newest, what="the listener again"
        )
        frames = [int(word) for word in world.log("listener").split()]
        # What was missed is passed over: the newest state counts.
        assert max(np.diff(frames)) > RATE
        assert len(frames) - heard < 2 * RATE
        # Frames of before this test listened may come all at once: then the nominal time counts.
        assert during < 1.5 * max(before, 2.0) + 1.0
        assert_no_gap(seen.frames(epoch))


def lift(seen: Observer) -> float:
    """How far the organ rises above its rest shape [m]."""
    return float(seen.positions[:, 2].max()) - float(seen.mesh.rest[:, 2].max())


def seconds_for(seen: Observer, frames: int) -> float:
    began = time.monotonic()
    seen.wait_frames(frames)
    return time.monotonic() - began
