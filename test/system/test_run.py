"""`tissue run` and `tissue demo` as a person runs them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from support.fake_simulation import wait_for
from tissue_sim.geometry.shapes import block
from viz_bridge.bag_reader import topic_counts

PATIENCE = 200.0
MARK = "TISSUE_TEST_MARK"
COMMAND = "from tissue_sim.cli import main; main()"

PROCEDURE = """
title: lift and cut
units: m
tools:
  grasper: {kind: grab, start: {position: [0.032, 0.09, 0.03]}}
timeline:
  - {at: 0.0, move: grasper, to: [0.032, 0.09, 0.004], for: 0.5}
  - {at: 0.6, press: grasper}
  - {at: 0.7, move: grasper, by: [0, 0, 0.012], for: 0.6}
  - at: 1.4
    cut: {rectangle: {center: [0.032, 0.075, 0.005], along: [0.03, 0, 0], depth: [0, 0, 0.05]}}
  - {at: 1.6, move: grasper, by: [0, 0, 0.01], for: 0.5}
  - {at: 2.4, release: grasper}
end: 2.6
"""


class Tissue:
    """Runs the command with a mark in the environment of everything it starts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mark = uuid.uuid4().hex
        self._running: list[subprocess.Popen[str]] = []

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-u", "-c", COMMAND, *arguments],
            cwd=self.folder,
            env={**os.environ, MARK: self.mark, "COLUMNS": "200"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._running.append(process)
        return process

    def run(self, *arguments: str) -> tuple[int, str]:
        process = self.start(*arguments)
        output, _ = process.communicate(timeout=PATIENCE)
        return process.returncode, output

    def alive(self) -> list[str]:
        """Command lines of all living processes with the mark."""
        found = []
        for entry in Path("/proc").iterdir():
            try:
                marked = f"{MARK}={self.mark}".encode() in (entry / "environ").read_bytes()
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
            except OSError:
                continue
            if marked and state not in "ZX":
                found.append(command)
        return found

    def close(self) -> None:
        for process in self._running:
            if process.poll() is None:
                process.kill()
                process.wait()


@pytest.fixture
def tissue(ros_domain: int, tmp_path: Path) -> Iterator[Tissue]:
    made = Tissue(tmp_path)
    try:
        yield made
    finally:
        made.close()


def write_block(path: Path) -> None:
    import meshio

    raw = block(11, 11, 11)
    meshio.Mesh(raw.points * 1e3, [("tetra", raw.tetrahedra)]).write(path)


def test_any_mesh_is_grabbed_pulled_and_cut_and_its_journal_replays(
    tissue: Tissue, tmp_path: Path
) -> None:
    write_block(tmp_path / "block.vtu")
    code, output = tissue.run(
        "run", "block.vtu", "--units", "mm", "--headless", "--frames", "200", "--out", "out"
    )
    assert code == 0, output
    assert "200" in output
    assert "faces split" in output
    assert "nodes, moved" in output
    assert tissue.alive() == []
    counts = topic_counts(tmp_path / "out" / "session")
    assert counts["/tissue/journal"] == 200
    assert counts["/tissue/edits"] == 1
    code, output = tissue.run("replay", "out/session")
    assert code == 0, output
    assert "bit-identical" in output
    with np.load(tmp_path / "out" / "replayed.npz") as replayed:
        assert replayed["frames"] == 200
        assert np.isfinite(replayed["positions"]).all()
        same = replayed["positions"]
    code, output = tissue.run("replay", "out/session", "--model", "relaxation")
    assert code == 0, output
    with np.load(tmp_path / "out" / "replayed_relaxation.npz") as other:
        assert other["positions"].shape == same.shape
        assert not np.array_equal(other["positions"], same)


def test_the_heart_of_a_patient_is_grabbed_pulled_and_cut(
    tissue: Tissue, shared_meshes: Path
) -> None:
    mesh = shared_meshes / "toronto_chd" / "derived_2018002_tof_ftetwild_33k.vtu"
    code, output = tissue.run(
        "run", str(mesh), "--units", "mm", "--headless", "--frames", "300", "--out", "out"
    )
    assert code == 0, output
    said = dict(re.findall(r"│ ([a-z][a-z ]+?) +│ +([^│]+?) +│", output))
    assert said["finite"] == said["replays bit for bit"] == "yes"
    assert float(said["opening"].split()[0]) > 3.0
    assert "moved" in said["grab by grasper"]
    assert tissue.alive() == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_no_process_is_left_behind(tissue: Tissue, number: signal.Signals) -> None:
    """Also when the command itself has no chance to end them."""
    process = tissue.start("run", "wall", "--out", "out", "--rrd")
    assert process.stdout is not None
    lines: list[str] = []
    while not any("http://127.0.0.1" in line for line in lines):
        line = process.stdout.readline()
        assert line, lines
        lines.append(line)
    nodes = ("simulation_node", "cut_node", "bag_node", "rerun_node", "table_node")
    assert all(any(node in command for command in tissue.alive()) for node in nodes)
    process.send_signal(number)
    process.wait(timeout=60)
    wait_for(lambda: tissue.alive() == [], 30.0, "the end of every process")
    assert process.returncode == (0 if number == signal.SIGINT else -signal.SIGKILL)
    if number == signal.SIGINT:
        topic_counts(tissue.folder / "out" / "session")  # raises where a bag was not ended


def test_end_of_a_node_ends_the_session_with_its_last_words(tissue: Tissue, tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(
        "/**/tissue_sim: {ros__parameters: {geometry: wall, rate_hz: 60.0, modle: lr}}\n"
    )
    code, output = tissue.run("run", "scene.yaml", "--headless", "--frames", "50", "--out", "out")
    assert code == 1
    assert "did you mean model?" in output
    assert tissue.alive() == []


def test_procedure_that_fails_is_reported(tissue: Tissue, tmp_path: Path) -> None:
    (tmp_path / "miss.yaml").write_text(PROCEDURE.replace("[0.032, 0.075, 0.005]", "[1, 1, 1]"))
    code, output = tissue.run(
        "run", "wall", "--headless", "--procedure", "miss.yaml", "--frames", "200", "--out", "out"
    )
    assert code == 1
    assert "cut at 1.4 s failed" in output


def test_demo_leaves_a_bag_a_recording_pictures_and_a_summary(
    tissue: Tissue, tmp_path: Path
) -> None:
    (tmp_path / "procedure.yaml").write_text(PROCEDURE)
    load_before = os.getloadavg()[0]
    began = time.monotonic()
    code, output = tissue.run(
        "demo", "--scene", "wall", "--procedure", "procedure.yaml", "--out", "out"
    )
    assert code == 0, output
    out = tmp_path / "out"
    # Everybody waits for everybody, and nobody for ever.
    assert "started without" not in (out / "logs" / "tissue_sim.log").read_text()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["geometry"] == {"name": "wall", "nodes": 884, "tetrahedra": 2400}
    assert summary["model"] == "lr"
    assert summary["frames"] > 150
    assert 20 < summary["published_hz"] < 61
    assert 0 <= summary["late_frames"] <= summary["frames"]
    assert set(summary["step_ms"]) >= {"p50", "p99", "max"}
    assert summary["model_steps_per_second"] > 0
    assert set(summary["pose_to_state_ms"]) >= {"p50", "p99"}
    (cut,) = summary["cuts"]
    assert cut["faces_split"] > 0
    assert cut["nodes_added"] > 0
    assert cut["plan_ms"] > 0
    assert cut["apply_ms"] > 0
    assert cut["opening_mm"] > 1.0
    (grab,) = summary["grabs"]
    assert grab["nodes"] > 3
    assert grab["moved_mm"] > 10
    assert summary["lost_states"] >= 0
    assert set(summary["cpu_share"]) >= {"tissue_sim", "cut_service", "bag", "rerun", "script"}
    assert summary["load_average_before"] == pytest.approx(load_before, abs=3.0)
    assert 3 < summary["wall_seconds"] < time.monotonic() - began
    assert summary["replayed_bit_for_bit"]
    assert (out / "session.rrd").stat().st_size > 1000
    assert topic_counts(out / "session")["/tissue/journal"] == summary["frames"]
    pictures = sorted(path.name for path in out.glob("*.png"))
    if "no pictures" not in output:
        assert len(pictures) >= 3, output
        assert {"before.png", "cut_open.png"} <= set(pictures)
    assert tissue.alive() == []
