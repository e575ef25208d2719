"""The simulation's node as others see it."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from tissue_interfaces.msg import Status, Tool
from tissue_interfaces.srv import (
    ApplyEdit,
    Grab,
    Load,
    Release,
    RemoveTool,
    Save,
    SetModel,
    SetTool,
    Undo,
)

from support.simulation_process import Client, SimulationProcess, client, eventually, simulation
from support.split_edit import split_at
from tissue_sim import conversions, edit_messages, journal_messages, qos
from tissue_sim.journal import replay

CORNER = (0.06, 0.06, 0.06)
GRASPER: dict[str, Any] = {
    "tools": ["grasper"],
    "tool__grasper__position": list(CORNER),
    "tool__grasper__size": [0.02],
}

pytestmark = pytest.mark.usefixtures("ros_domain")


def ready(peer: Client) -> Status:
    return peer.first("tissue/status", lambda status: status.state == Status.READY)


def hearing(peer: Client, *more: str) -> Client:
    peer.hear("tissue/state", "tissue/status", "tissue/topology", "/diagnostics", *more)
    return peer


def edit_message(peer: Client, x: float = 0.03, request_id: str = "") -> Any:
    """A split planned on the newest keyframe."""
    topology = peer.last("tissue/topology")
    mesh = conversions.topology_to_mesh(topology)
    # Versions of single nodes are not in a keyframe; the plan says what it was based on.
    plan = split_at(mesh, x, request_id=request_id)
    return edit_messages.edit_to_msg(plan, conversions.epoch_of(topology), "organ", peer.stamp())


def test_a_session_is_published_and_its_journal_repeats_it(tmp_path: Path) -> None:
    waiting = ["tissue/state:1", "tissue/journal:1", "tissue/topology:1"]
    with client() as peer:
        hearing(peer, "tissue/journal", "tools/grasper/measured_cp", "tools/grasper/measured_cf")
        with simulation(
            tmp_path, frames=150, wait_for=waiting, model="quasi_static", **GRASPER
        ) as process:
            ready(peer)
            peer.use("grasper", False)
            for number in range(60):
                pose = peer.pose("grasper", np.add(CORNER, [0, 0.0002 * number, 0]).tolist())
                if number in (10, 45):
                    peer.use("grasper", number == 10)
                if number == 30:
                    assert peer.call(
                        ApplyEdit, "tissue/apply_edit", edit=edit_message(peer)
                    ).success
                time.sleep(0.01)
            stamped = peer.first(
                "tissue/state", lambda state: pose.header.stamp in list(state.tool_stamps)
            )
            assert list(stamped.tool_ids) == ["grasper"]
            assert process.wait() == 0
        entries = [journal_messages.entry_from_msg(m) for m in peer.heard["tissue/journal"]]
        assert [entry.frame for entry in entries] == list(range(1, 151))
        mesh = conversions.topology_to_mesh(peer.heard["tissue/topology"][0])
        result = replay(entries, mesh)
        assert result.mismatches == ()
        last = peer.heard["tissue/state"][-1]
        assert last.frame == 150
        np.testing.assert_array_equal(result.positions, conversions.positions_from_state(last))
        assert result.simulation.mesh.version == 2
        pulls = [m.wrench.force.y for m in peer.heard["tools/grasper/measured_cf"]]
        assert min(pulls) < 0
        assert peer.heard["tools/grasper/measured_cp"][-1].header.frame_id == "organ"


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"rate_hzz": 50.0}, "unknown parameter rate_hzz (did you mean rate_hz?)"),
        ({"rate_hz": 5000.0}, "allowed: a number from 1 to 1000 1/s"),
        ({"model": "jelly"}, "spring_mass"),
        ({"shape.nodes_w": 4}, "block has no parameter 'nodes_w'"),
        ({"tools": ["a"], "tool.a.kind": "saw"}, "grab, cut"),
    ],
)
def test_wrong_parameters_stop_the_start(
    tmp_path: Path, parameters: dict[str, Any], said: str
) -> None:
    process = SimulationProcess(tmp_path, parameters)
    assert process.wait() == 2
    assert said in process.output
    assert "Traceback" not in process.output


def test_live_parameters_keep_their_limits(tmp_path: Path) -> None:
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters

    def asked(name: str, value: float) -> Any:
        number = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        return Parameter(name=name, value=number)

    with simulation(tmp_path, **GRASPER), client() as peer:
        hearing(peer)
        ready(peer)
        answers = peer.call(
            SetParameters,
            "tissue_sim/set_parameters",
            parameters=[
                asked("budget_ms", 2.0),
                asked("budget_ms", -1.0),
                asked("rate_hz", 30.0),
                asked("release_timeout", 0.05),
            ],
        )
        good, low, fixed, order = answers.results
        assert good.successful
        assert not low.successful
        assert "0.1" in low.reason
        assert "1000" in low.reason
        assert not fixed.successful
        assert not order.successful
        assert "freezes first" in order.reason
        peer.next("tissue/state")


def test_poses_that_cannot_be_used_are_refused_and_the_tool_stays(tmp_path: Path) -> None:
    nan = float("nan")
    with simulation(tmp_path, **GRASPER) as process, client() as peer:
        hearing(peer, "tools/grasper/measured_cp")
        ready(peer)
        origin = [0.0, 0.0, 0.0]
        peer.finding("tool grasper", "not finite", lambda: peer.pose("grasper", [nan, 0.0, 0.0]))
        zero = (0.0, 0.0, 0.0, 0.0)
        peer.finding("tool grasper", "length 0", lambda: peer.pose("grasper", origin, turn=zero))
        found = peer.finding(
            "tool grasper", "phantom", lambda: peer.pose("grasper", origin, frame="phantom")
        )
        assert "known frames: organ" in found.message
        assert "frames.phantom.parent: organ" in found.message
        assert peer.last("tools/grasper/measured_cp").pose.position.x == 0.06
        peer.pose("grasper", [0.01, 0.0, 0.0])
        peer.first("tools/grasper/measured_cp", lambda m: m.pose.position.x == 0.01)
        # A tool that is not there: nobody listens, but it does not go unnoticed.
        peer.node.create_publisher(PoseStamped, "tools/laser/servo_cp", qos.POSE)
        found = peer.finding("wiring", "laser")
        assert "known tools: grasper" in found.message
        # `use` needs every edge: a best-effort publisher is not heard, but named.
        peer.node.create_publisher(Bool, "tools/grasper/use", qos_profile_sensor_data)
        peer.finding("wiring", "tools/grasper/use: /client offers an incompatible")
        assert process.process.poll() is None


def test_poses_in_a_known_frame_are_turned_into_the_organs(tmp_path: Path) -> None:
    frames: dict[str, Any] = {
        "frames__table__parent": "organ",
        "frames__table__translation": [1.0, 0.0, 0.0],
    }
    with simulation(tmp_path, **GRASPER, **frames), client() as peer:
        hearing(peer, "tools/grasper/measured_cp")
        ready(peer)

        def arrived() -> bool:
            peer.pose("grasper", [0.25, 0.0, 0.0], frame="table")
            return peer.last("tools/grasper/measured_cp").pose.position.x == 1.25

        eventually(arrived)


def tool_state(peer: Client, state: str, reason: str) -> Tool:
    def wanted(tools: Any) -> bool:
        return any(t.state == state and reason in t.reason for t in tools.tools)

    return peer.first("tissue/tools", wanted)


def test_jumps_freeze_and_stale_tools_let_go(tmp_path: Path) -> None:
    with (
        simulation(tmp_path, pose_timeout=1.5, release_timeout=3.0, **GRASPER),
        client() as peer,
    ):
        hearing(peer, "tissue/tools", "tissue/journal", "tools/grasper/measured_cp")
        ready(peer)
        peer.use("grasper", False)
        peer.place("grasper", CORNER)
        peer.use("grasper", True)
        peer.first("tissue/journal", lambda m: any(t.edge == 1 for t in m.tools))
        peer.next("tissue/state")
        peer.pose("grasper", (0.5, 0.5, 0.5))
        tool_state(peer, "frozen", "jumped")
        assert peer.last("tools/grasper/measured_cp").pose.position.x == 0.06
        # Nothing comes any more: it lets go, and says so.
        peer.first("tissue/journal", lambda m: any(t.edge == -1 for t in m.tools))
        tool_state(peer, "frozen", "let go")
        release = peer.first(
            "tissue/journal", lambda m: any(c.kind == "release" for c in m.commands)
        )
        assert release.commands[0].kind == "release"


def test_two_sources_freeze_a_tool_and_are_named(tmp_path: Path) -> None:
    with (
        simulation(tmp_path, **GRASPER),
        client() as peer,
        client(name="robot") as robot,
    ):
        hearing(peer, "tissue/tools")
        ready(peer)
        peer.place("grasper", CORNER)
        robot.pose("grasper", CORNER)
        tool_state(peer, "frozen", "/client, /robot")


def test_no_pose_is_lost_while_ten_services_wait(tmp_path: Path) -> None:
    # One frame in 2 s: requests wait that long for the loop.
    with (
        simulation(tmp_path, rate_hz=1.0, wait_for=["tissue/status:1"], **GRASPER),
        client() as peer,
    ):
        hearing(peer)
        ready(peer)

        def received() -> int:
            for array in peer.heard["/diagnostics"][::-1]:
                for status in array.status:
                    for item in status.values:
                        if item.key == "poses_received":
                            return int(item.value)
            return 0

        def settled() -> int:
            first = received()
            peer.next("/diagnostics")
            return first if first == received() else 0

        peer.place("grasper", CORNER)
        # Whatever was sent before is counted in two reports in a row.
        before = eventually(settled)
        asked: list[Any] = []
        waiting: list[int] = []
        sent = before
        deadline = begun = time.perf_counter()
        while sent < before + 500:
            pending = [future for future in asked if not future.done()]
            waiting.append(len(pending))
            if len(pending) < 10:
                asked.append(peer.call_async(Grab, "tissue/grab", tool="grasper", radius=0.02))
            peer.pose("grasper", CORNER)
            sent += 1
            deadline += 0.008
            time.sleep(max(0.0, deadline - time.perf_counter()))
        assert np.mean(np.array(waiting) >= 9) > 0.5
        assert time.perf_counter() - begun > 3.9
        eventually(lambda: all(future.done() for future in asked))
        assert all(future.result().success for future in asked)

        eventually(lambda: received() >= sent, patience=10.0)
        assert received() == sent


def test_services_do_what_they_say(tmp_path: Path) -> None:
    with simulation(tmp_path, **GRASPER), client() as peer:
        hearing(peer, "tissue/tools", "tissue/edits")
        first = ready(peer)
        held = peer.call(Grab, "tissue/grab", tool="grasper", radius=0.0, request_id="one")
        assert held.success
        assert held.nodes > 0
        again = peer.call(Grab, "tissue/grab", tool="grasper", radius=0.0, request_id="one")
        assert (again.hold_id, again.nodes) == (held.hold_id, held.nodes)
        nobody = peer.call(Grab, "tissue/grab", tool="nobody")
        assert (nobody.success, nobody.error_code) == (False, Grab.Response.UNKNOWN_TOOL)
        assert "grasper" in nobody.message
        edit = edit_message(peer, request_id="split")
        applied = peer.call(ApplyEdit, "tissue/apply_edit", edit=edit)
        assert (applied.success, applied.version) == (True, 2)
        assert len(applied.applied.copied_nodes) == 25
        repeated = peer.call(ApplyEdit, "tissue/apply_edit", edit=edit)
        assert (repeated.success, repeated.version) == (True, 2)
        edit.request_id = "other"
        stale = peer.call(ApplyEdit, "tissue/apply_edit", edit=edit)
        assert (stale.success, stale.error_code) == (False, ApplyEdit.Response.STALE)
        edit.copied_nodes.append(1)
        edit.request_id = "broken"
        broken = peer.call(ApplyEdit, "tissue/apply_edit", edit=edit)
        assert broken.error_code == ApplyEdit.Response.INVALID
        assert peer.call(Release, "tissue/release", hold_id=held.hold_id).success
        forceps = Tool(id="forceps", kind="grab", shape="sphere")
        forceps.size.append(0.01)
        forceps.pose.orientation.w = 1.0
        forceps.hold, forceps.stiffness, forceps.force_limit = Tool.FORCE, 70.0, 3.0
        assert peer.call(SetTool, "tissue/set_tool", tool=forceps).success
        listed = peer.first(
            "tissue/tools", lambda tools: any(t.hold == "force" for t in tools.tools)
        )
        (shown,) = (tool for tool in listed.tools if tool.id == "forceps")
        assert (shown.stiffness, shown.damping, shown.force_limit) == (70.0, 5.0, 3.0)
        peer.place("forceps", CORNER)
        tool_state(peer, "active", "")
        assert peer.call(RemoveTool, "tissue/remove_tool", tool="forceps").success
        forceps.stiffness = -1.0
        wrong = peer.call(SetTool, "tissue/set_tool", tool=forceps)
        assert (wrong.error_code, "stiffness = -1 is out of range" in wrong.message) == (1, True)
        forceps.stiffness, forceps.kind = 70.0, "saw"
        wrong = peer.call(SetTool, "tissue/set_tool", tool=forceps)
        assert (wrong.error_code, "grab, cut" in wrong.message) == (1, True)
        other = peer.call(SetModel, "tissue/set_model", model="spring_mass")
        assert other.success, other.message
        peer.first("tissue/status", lambda status: status.model == "spring_mass")
        assert peer.call(SetModel, "tissue/set_model", model="jelly").error_code == 1
        assert peer.call(Save, "tissue/save", name="split").success
        assert peer.call(Save, "tissue/save", name="../up").error_code == Save.Response.BAD_NAME
        assert peer.call(SetBool, "tissue/pause", data=True).success
        peer.first("tissue/status", lambda status: status.state == Status.PAUSED)
        assert peer.call(SetBool, "tissue/pause", data=False).success
        assert peer.call(Load, "tissue/load", name="nothing").error_code == Load.Response.FAILED
        assert peer.call(Load, "tissue/load", name="split").success
        epoch = conversions.epoch_of(first)
        loaded = peer.first("tissue/topology", lambda m: conversions.epoch_of(m) != epoch)
        assert len(loaded.node_ids) == 150
        edit.request_id = "late"
        late = peer.call(ApplyEdit, "tissue/apply_edit", edit=edit)
        assert not late.success
        assert peer.call(Trigger, "tissue/reset").success
        assert (tmp_path / "data" / "split.npz").is_file()


def test_undo_and_redo_are_answered_and_the_journal_repeats_them(tmp_path: Path) -> None:
    with client() as peer:
        hearing(peer, "tissue/journal", "tissue/edits")
        waiting = ["tissue/state:1", "tissue/journal:1", "tissue/topology:1", "tissue/edits:1"]
        with simulation(tmp_path, wait_for=waiting, model="quasi_static", **GRASPER) as process:
            ready(peer)
            nothing = peer.call(Undo, "tissue/undo", author="bob")
            assert (nothing.success, nothing.error_code) == (False, Undo.Response.NOTHING_THERE)
            assert "no edit to undo" in nothing.message
            edit = edit_message(peer, request_id="split")
            edit.author = "alice"
            assert peer.call(ApplyEdit, "tissue/apply_edit", edit=edit).success
            undone = peer.call(Undo, "tissue/undo", author="bob", request_id="once")
            assert undone.success
            assert undone.version == 3
            assert (undone.reverted_kind, undone.reverted_author) == ("split", "alice")
            assert undone.reverted_request_id == "split"
            assert (undone.can_undo, undone.can_redo) == (0, 1)
            # A repeat is answered and not done again.
            assert peer.call(Undo, "tissue/undo", author="bob", request_id="once").success
            said = command_line("redo")
            assert "redo of the split by alice (split): version 4; 1 more to undo" in said.stdout
            said = command_line("redo")
            assert said.returncode == 1
            assert "no undone edit to redo" in said.stderr
            assert peer.call(Undo, "tissue/undo").version == 5
            peer.first("tissue/state", lambda state: state.version == 5)
            assert process.interrupt() == 0
        kinds = [(m.version, m.kind, m.author) for m in peer.heard["tissue/edits"]]
        assert kinds[:2] == [(2, "split", "alice"), (3, "undo", "bob")]
        assert [version for version, *_ in kinds] == [2, 3, 4, 5]
        mesh = conversions.topology_to_mesh(peer.heard["tissue/topology"][0])
        fresh = conversions.topology_to_mesh(peer.heard["tissue/topology"][0])
        for message in peer.heard["tissue/edits"]:
            mesh.apply(edit_messages.edit_from_msg(message))
        np.testing.assert_array_equal(
            mesh.tets[: mesh.element_rows], fresh.tets[: mesh.element_rows]
        )
        entries = [journal_messages.entry_from_msg(m) for m in peer.heard["tissue/journal"]]
        result = replay(entries, fresh)
        assert result.mismatches == ()
        assert result.simulation.mesh.version == 5


def command_line(*words: str) -> subprocess.CompletedProcess[str]:
    code = "import sys; sys.argv[0] = 'tissue'; from tissue_sim.cli import main; main()"
    arguments = [sys.executable, "-P", "-c", code, *words]
    return subprocess.run(arguments, capture_output=True, text=True, timeout=60, check=False)


def test_a_late_joiner_gets_the_topology_of_now(tmp_path: Path) -> None:
    with simulation(tmp_path, **GRASPER), client() as peer:
        hearing(peer)
        ready(peer)
        answer = peer.call(ApplyEdit, "tissue/apply_edit", edit=edit_message(peer))
        assert answer.success
        peer.first("tissue/topology", lambda m: m.version == 2)
        with client(name="late") as late:
            hearing(late, "tissue/edits")
            topology = late.first("tissue/topology")
            assert (topology.version, len(topology.node_ids)) == (2, 150)
            state = late.first("tissue/state")
            assert (state.version, len(state.positions)) == (2, 450)
            assert late.first("tissue/edits").version == 2


def test_a_killed_simulation_comes_back_in_a_new_epoch(tmp_path: Path) -> None:
    with client() as peer:
        hearing(peer)
        with simulation(tmp_path, **GRASPER):
            old = ready(peer)
            edit = edit_message(peer)
        peer.heard["tissue/status"].clear()
        with simulation(tmp_path, **GRASPER):
            new = ready(peer)
            assert conversions.epoch_of(new) != conversions.epoch_of(old)
            answer = peer.call(ApplyEdit, "tissue/apply_edit", edit=edit)
            assert (answer.success, answer.error_code) == (False, ApplyEdit.Response.STALE)
            assert conversions.epoch_of(old).hex() in answer.message


def test_two_organs_in_two_namespaces_do_not_meet(tmp_path: Path) -> None:
    with (
        simulation(tmp_path, "/left", **GRASPER),
        simulation(tmp_path, "/right", shape__nodes_x=4, **GRASPER),
        client("/left") as left,
        client("/right") as right,
    ):
        hearing(left)
        hearing(right)
        ready(left)
        ready(right)
        assert left.call(SetBool, "tissue/pause", data=True).success
        left.first("tissue/status", lambda status: status.state == Status.PAUSED)
        right.next("tissue/state")
        assert all(status.state != Status.PAUSED for status in right.heard["tissue/status"])
        assert {len(m.positions) for m in left.heard["tissue/state"]} == {3 * 125}
        assert {len(m.positions) for m in right.heard["tissue/state"]} == {3 * 100}


def test_a_second_simulator_is_refused(tmp_path: Path) -> None:
    with simulation(tmp_path), client() as peer:
        hearing(peer)
        ready(peer)
        second = SimulationProcess(tmp_path, {})
        assert second.wait() == 2
        assert "another simulator publishes /tissue/state" in second.output
        peer.next("tissue/state")


def test_ctrl_c_ends_the_process_cleanly(tmp_path: Path) -> None:
    with simulation(tmp_path, **GRASPER) as process, client() as peer:
        hearing(peer)
        ready(peer)
        peer.first("tissue/state")
        assert process.interrupt() == 0
        assert "Traceback" not in process.output


def test_a_cutting_tool_asks_for_a_cut(tmp_path: Path) -> None:
    knife: dict[str, Any] = {
        "tools": ["knife"],
        "tool__knife__kind": "cut",
        "tool__knife__size": [0.05, 0.02],
    }
    with simulation(tmp_path, **knife), client() as peer:
        hearing(peer, "tissue/cut_request")
        ready(peer)
        peer.use("knife", False)
        peer.place("knife", CORNER)
        peer.use("knife", True)
        request = peer.first("tissue/cut_request")
        assert request.tool == "knife"
        vertices = np.array(request.sweep.vertices).reshape(-1, 3)
        np.testing.assert_allclose(vertices.mean(axis=0), CORNER)
        assert request.sweep.header.stamp.sec > 0
        assert request.sweep.state_frame > 0
        assert request.version == 1
