"""Processes find each other on this machine only, and the dead leave nothing behind."""

from __future__ import annotations

import os
import signal
from functools import partial
from pathlib import Path

import pytest

from support.fake_simulation import FakeSimulation, spinning, wait_for
from support.processes import Processes, processes
from tissue_sim.discovery import DISCOVERY_VARIABLES
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block

PATIENCE = 120.0
"""Longest wait [s]; only a failing test waits so long."""

DEATHS = 3
"""With shared memory the first or second could leave the publisher unable to send a topology."""


def udp_addresses() -> set[str]:
    """Local addresses on which this process receives, as the kernel writes them."""
    own = {link.readlink().name for link in Path("/proc/self/fd").iterdir() if link.is_symlink()}
    rows = [row.split() for row in Path("/proc/self/net/udp").read_text().splitlines()[1:]]
    return {row[1].split(":")[0] for row in rows if f"socket:[{row[9]}]" in own}


def has_attached(world: Processes, times: int) -> bool:
    """Whether so many cut services have got the topology."""
    return world.log("cut").count("attached to") == times


@pytest.mark.parametrize("range_of_ros", ["LOCALHOST", "SUBNET"])
def test_a_program_with_a_range_of_ros_hears_the_tissue(
    ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, range_of_ros: str
) -> None:
    organ = Mesh(block(17, 17, 17, 0.1, 0.1, 0.1))
    with (
        spinning(ros_domain, lambda context: FakeSimulation(organ, context)),
        processes(tmp_path) as world,
    ):
        for variable in DISCOVERY_VARIABLES:
            monkeypatch.delenv(variable, raising=False)
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", range_of_ros)
        here = str(Path(__file__).resolve().parents[1])
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join([here, os.environ.get("PYTHONPATH", "")]))
        world.start("listener", "support.state_listener")
        wait_for(lambda: world.log("listener").count("\n") > 20, PATIENCE, "frames")


def test_who_comes_after_several_deaths_still_gets_the_topology(
    ros_domain: int, tmp_path: Path
) -> None:
    organ = Mesh(block(17, 17, 17, 0.1, 0.1, 0.1))
    with (
        spinning(ros_domain, lambda context: FakeSimulation(organ, context)),
        processes(tmp_path) as world,
    ):
        for turn in range(DEATHS):
            world.start("cut", "cut_service.cut_node")
            wait_for(partial(has_attached, world, turn + 1), PATIENCE, "the topology")
            assert world.end("cut", signal.SIGKILL) == -signal.SIGKILL
        assert "/dev/shm/fastrtps" not in Path("/proc/self/maps").read_text()
        assert udp_addresses() == {"0100007F"}
