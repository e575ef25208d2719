"""Node `rerun` records and shows the organ, and nobody waits for it."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from support.bags import interrupt, start_fake, start_module, wait_for
from viz_bridge.viewer_process import viewer_binary

pytestmark = pytest.mark.usefixtures("ros_domain")


@pytest.fixture
def running() -> Iterator[list[subprocess.Popen[bytes]]]:
    processes: list[subprocess.Popen[bytes]] = []
    yield processes
    for process in processes:
        if process.poll() is None:
            for child in psutil.Process(process.pid).children():
                child.kill()
            process.kill()
        process.wait(10)


def rerun_node(folder: Path, sink: str) -> subprocess.Popen[bytes]:
    path, log = folder / "session.rrd", folder / "rerun.log"
    arguments = ("-p", f"sink:={sink}", "-p", f"path:={path}", "-p", "close_timeout:=3.0")
    process = start_module("viz_bridge.rerun_node", "--ros-args", *arguments, log=log)
    said = "showing on" if sink == "web" else "recording to"
    wait_for(lambda: said in log.read_text(errors="replace"), 40, f"{said} ...")
    return process


def rrd(*arguments: str) -> str:
    command = [str(viewer_binary()), "rrd", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def test_a_recording_is_valid_and_has_the_cut(
    tmp_path: Path, running: list[subprocess.Popen[bytes]]
) -> None:
    node = rerun_node(tmp_path, "file")
    running.append(node)
    assert start_fake("--frames", "200").wait(60) == 0
    assert interrupt(node) == 0
    target = str(tmp_path / "session.rrd")
    assert "verified without error" in rrd("verify", target)
    printed = rrd("print", "-vvv", target)
    for word in ("organ/outside", "organ/inside", "tools/hook", "forces/hook", "split"):
        assert word in printed, word


def test_a_stopped_viewer_delays_nobody(
    tmp_path: Path, running: list[subprocess.Popen[bytes]]
) -> None:
    node = rerun_node(tmp_path, "web")
    running.append(node)
    viewer = next(child for child in psutil.Process(node.pid).children() if "rerun" in child.name())
    listening = {
        connection.laddr.ip
        for connection in viewer.net_connections("tcp")
        if connection.status == psutil.CONN_LISTEN
    }
    assert listening == {"127.0.0.1"}
    viewer.send_signal(signal.SIGSTOP)
    report = tmp_path / "fake.json"
    fake = start_fake("--frames", "300", "--side", "13", "--report", str(report))
    running.append(fake)
    assert fake.wait(60) == 0
    figures = json.loads(report.read_text())
    # A reliable publisher that waited for a reader would wait for tenths of seconds.
    assert figures["worst_ms"] < 100
    assert figures["median_ms"] < 16
    assert psutil.Process(node.pid).memory_info().rss < 2e9
    assert interrupt(node) == 0
    assert not viewer.is_running()


def test_an_unwritable_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "blocked").write_text("a file, not a folder")
    log = tmp_path / "log"
    path = tmp_path / "blocked" / "session.rrd"
    process = start_module(
        "viz_bridge.rerun_node", "--ros-args", "-p", "sink:=file", "-p", f"path:={path}", log=log
    )
    assert process.wait(30) == 2
    assert "cannot be written" in log.read_text()
