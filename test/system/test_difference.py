"""Node `difference` beside a real session: another model, the same one, and one that joins late."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tissue_interfaces.msg import TissueState
from tissue_interfaces.srv import ApplyEdit

from support.bags import interrupt, start_module
from support.simulation_process import Client, client, eventually, simulation
from support.split_edit import split_at
from tissue_sim import conversions, edit_messages, qos

pytestmark = pytest.mark.usefixtures("ros_domain")

START_SECONDS = 200.0
"""Longest wait for a session to begin [s]: on a new machine kernels are compiled first."""

MODEL: dict[str, Any] = {
    "model": "quasi_static", "steps_per_frame": 2, "wait_timeout": START_SECONDS,
    "pose_timeout": 3000.0, "release_timeout": 3000.0,
    "tools": ["grasper"], "tool__grasper__size": [0.025],
    "tool__grasper__position": [0.06, 0.06, 0.06],
    "shape__nodes_x": 4, "shape__nodes_y": 4, "shape__nodes_z": 4,
}  # fmt: skip


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Any]:
    running: list[subprocess.Popen[bytes]] = []

    def begin(name: str, model: str) -> subprocess.Popen[bytes]:
        process = start_module(
            "viz_bridge.difference_node", "--ros-args", "-p", f"model:={model}",
            "-r", f"__node:={name}", "-r", f"tissue/difference:={name}/difference",
            log=tmp_path / f"{name}.log",
        )  # fmt: skip
        running.append(process)
        return process

    yield begin
    for process in running:
        if process.poll() is None:
            process.kill()
        process.wait(10)
    for log in tmp_path.glob("*.log"):
        print(f"--- {log.name}\n{log.read_text(errors='replace')}")


def hear_difference(me: Client, name: str) -> list[TissueState]:
    topic = f"{name}/difference"
    me.node.create_subscription(TissueState, topic, me.heard[topic].append, qos.STATE)
    return me.heard[topic]


def press(me: Client) -> None:
    """Press; the first level that the simulation hears makes no edge."""

    def pressed() -> bool:
        me.use("grasper", False)
        me.use("grasper", True)
        time.sleep(0.05)
        return any(s.edge == 1 and s.use for m in me.heard["tissue/journal"] for s in m.tools)

    eventually(pressed)


def largest(message: TissueState) -> float:
    return float(np.max(message.scalar))


def figures(me: Client, name: str) -> dict[str, str]:
    """What a node says of itself."""
    status = me.finding(f"{name}: second model", "")
    newest = [
        status
        for array in me.heard["/diagnostics"]
        for status in array.status
        if f"/{name}:" in status.name
    ][-1]
    assert status.hardware_id == "software"
    return {item.key: item.value for item in newest.values}


def test_the_same_model_is_no_different_another_is_and_edits_are_followed(
    tmp_path: Path, start: Any
) -> None:
    start("same", "quasi_static")
    other = start("other", "finite_element@rest")
    with (
        simulation(tmp_path, wait_for=["tissue/journal:3"], **MODEL) as session,
        client() as me,
    ):
        same, apart = (hear_difference(me, name) for name in ("same", "other"))
        me.hear("tissue/journal", "tissue/state", "tissue/topology", "/diagnostics")
        eventually(lambda: me.heard["tissue/journal"], START_SECONDS)
        me.place("grasper", (0.06, 0.06, 0.06))
        press(me)
        for step in range(1, 11):
            me.place("grasper", (0.06, 0.06 + 0.002 * step, 0.06))
        eventually(lambda: apart and largest(apart[-1]) > 5e-4)
        mesh = conversions.topology_to_mesh(me.first("tissue/topology"))
        plan = split_at(mesh, 0.02, top=0.05, request_id="cut")
        epoch = conversions.epoch_of(me.first("tissue/topology"))
        edit = edit_messages.edit_to_msg(plan, epoch, "organ", me.stamp())
        assert me.call(ApplyEdit, "tissue/apply_edit", edit=edit).success
        eventually(lambda: apart[-1].version == 2 and same[-1].version == 2)

        # The same model makes the same steps: bit for bit, before and after the cut.
        assert max(map(largest, same)) == 0.0
        assert len(same[-1].scalar) == len(same[-1].positions) // 3 > mesh.node_rows
        assert (same[-1].scalar_name, same[-1].scalar_unit) == (
            "difference from quasi_static", "m",
        )  # fmt: skip

        # A message is about one frame of the session.
        state = me.first("tissue/state", lambda s: s.frame == apart[-1].frame)
        ours, theirs = (conversions.positions_from_state(m) for m in (apart[-1], state))
        np.testing.assert_allclose(
            apart[-1].scalar, np.linalg.norm(ours - theirs, axis=1), atol=1e-7
        )
        assert apart[-1].header.stamp == state.header.stamp

        start("late", "finite_element@rest")
        late = hear_difference(me, "late")
        eventually(lambda: len(late) > 30)
        close = next(m for m in apart if m.frame >= late[-1].frame - 5)
        # Both are the equilibrium of the same holds, of the same cut tissue.
        np.testing.assert_allclose(late[-1].scalar, close.scalar, atol=2e-4)

        eventually(lambda: float(figures(me, "other")["mean [mm]"]) > 0.01)
        eventually(lambda: float(figures(me, "other")["lag [s]"]) < 30.0)
        said = figures(me, "other")
        assert 0.0 < float(said["of the worst"]) < 3.0
        eventually(lambda: figures(me, "same")["mean [mm]"] == "0")
        # A node speaks once a second, at first of having no session yet.
        eventually(lambda: int(figures(me, "late")["began at frame"]) > 0)
        assert int(figures(me, "other")["began at frame"]) == 0
        assert interrupt(other) == 0
        assert session.interrupt() == 0


def test_a_model_that_does_not_exist_is_refused(start: Any, tmp_path: Path) -> None:
    assert start("wrong", "jelly").wait(60) == 2
    assert "there is no model 'jelly'; allowed" in (tmp_path / "wrong.log").read_text()
