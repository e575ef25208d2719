"""What is drawn is the organ as it was, at every version."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr

from support import bags
from support.bags import session_bag
from support.sewn_blocks import sew_edit, two_blocks
from support.split_block import split_plan
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from viz_bridge import pictures
from viz_bridge.bag_reader import read_organ
from viz_bridge.drawing_thread import MOST_WAITING, DrawingThread
from viz_bridge.moments import MomentFinder, find_moments
from viz_bridge.organ_surface import surface_of
from viz_bridge.picture_scene import camera_of
from viz_bridge.recording import Recording, file_stream
from viz_bridge.summary import SessionFigures, step_times, summarise
from viz_bridge.to_rrd import to_rrd
from viz_bridge.viewer_process import viewer_binary


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return session_bag(tmp_path_factory.mktemp("drawing") / "bag")


def rrd(*arguments: str) -> str:
    command = [str(viewer_binary()), "rrd", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def area(part: Any, positions: np.ndarray) -> float:
    corners = part.vertices(positions)[part.triangles].astype(np.float64)
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(sides, axis=1).sum() / 2)


def test_an_uncut_organ_is_all_outside() -> None:
    mesh = Mesh(block(5, 5, 3, 0.04, 0.04, 0.02))
    surface = surface_of(mesh)
    positions = mesh.rest[: mesh.node_rows].astype(np.float32)
    assert len(surface.inside.triangles) == 0
    assert area(surface.outside, positions) == pytest.approx(2 * 0.0016 + 4 * 0.0008, rel=1e-5)


def test_both_lips_of_a_cut_are_inside_and_the_outside_stays() -> None:
    mesh = Mesh(block(5, 5, 3, 0.04, 0.04, 0.02))
    before = len(surface_of(mesh).outside.triangles)
    mesh.apply(split_plan(mesh))
    surface = surface_of(mesh)
    positions = mesh.rest[: mesh.node_rows].astype(np.float32)
    assert len(surface.outside.triangles) == before
    assert area(surface.inside, positions) == pytest.approx(2 * 0.02 * 0.02, rel=1e-5)


def test_what_a_removed_element_has_uncovered_is_inside() -> None:
    mesh = Mesh(block(5, 5, 3))
    before = len(surface_of(mesh).outside.triangles)
    middle = mesh.rest[mesh.tets[: mesh.element_rows]].mean(axis=1)
    removed = int(np.linalg.norm(middle - middle.mean(axis=0), axis=1).argmin())
    mesh.element_alive[removed] = False
    surface = surface_of(mesh)
    assert len(surface.inside.triangles) == 4
    assert len(surface.outside.triangles) == before


def test_normals_point_outward() -> None:
    mesh = Mesh(block(5, 5, 5))
    part = surface_of(mesh).outside
    vertices = part.vertices(mesh.rest[: mesh.node_rows].astype(np.float32))
    outward = vertices - vertices.mean(axis=0)
    assert (np.einsum("ij,ij->i", part.normals(vertices), outward) > 0).all()


def test_the_recording_has_every_state_and_both_versions(bag: Path, tmp_path: Path) -> None:
    target = tmp_path / "session.rrd"
    assert to_rrd(bag, target) == 40
    assert "verified without error" in rrd("verify", str(target))
    printed = rrd("print", "-vvv", str(target))
    assert "organ/outside" in printed
    assert "organ/inside" in printed
    assert "split" in printed


def test_states_drawn_a_second_can_be_limited(bag: Path, tmp_path: Path) -> None:
    drawn = to_rrd(bag, tmp_path / "few.rrd", max_hz=10.0)
    assert 6 <= drawn <= 9


def test_a_state_that_outruns_its_edit_is_drawn_after_it(tmp_path: Path) -> None:
    session = session_bag(tmp_path / "bag", frames=20, cut_at=10)
    items = list(read_organ(session))
    late = [entry for entry in items if entry[0] == "tissue/edits"]
    items.remove(late[0])
    first_cut = next(
        place
        for place, (topic, item) in enumerate(items)
        if topic == "tissue/state" and item.message.version == 2
    )
    items.insert(first_cut + 1, late[0])
    recording = Recording(file_stream(str(tmp_path / "late.rrd")))
    for topic, item in items:
        if recording.takes(topic):
            recording.take(topic, item.message, item.log_time)
    recording.close()
    assert recording.states == 20


def test_a_state_is_never_drawn_on_another_version(tmp_path: Path) -> None:
    session = session_bag(tmp_path / "bag", frames=20, cut_at=10)
    recording = Recording(file_stream(str(tmp_path / "gap.rrd")))
    for topic, item in read_organ(session):
        if topic != "tissue/edits" and recording.takes(topic):
            recording.take(topic, item.message, item.log_time)
    recording.close()
    assert recording.states == 9


class Stuck:
    """A recording that takes nothing until it is let go."""

    def __init__(self) -> None:
        self.go, self.entered = threading.Event(), threading.Event()
        self.taken: list[tuple[str, Any]] = []
        self.states = 0

    def take(self, topic: str, message: Any, _received: int) -> None:
        self.entered.set()
        self.go.wait(30)
        self.taken.append((topic, message))

    def close(self) -> None:
        pass


@pytest.fixture
def stuck() -> Iterator[Stuck]:
    recording = Stuck()
    yield recording
    recording.go.set()


def test_the_latest_state_wins_and_edits_are_kept(stuck: Stuck) -> None:
    thread = DrawingThread("a viewer that has stopped", lambda: stuck)  # type: ignore[arg-type,return-value]
    as_it_is: Any = bytes
    for number in range(200):
        thread.put("tissue/state", as_it_is, bytes([number]), 0)
        if number % 50 == 0:
            thread.put("tissue/edits", as_it_is, bytes([number]), 0)
    assert thread.passed_over >= 197
    stuck.go.set()
    assert thread.close(20)
    assert stuck.taken[-1] == ("tissue/state", bytes([199]))
    edits = [data[0] for topic, data in stuck.taken if topic == "tissue/edits"]
    assert edits == [0, 50, 100, 150]


def test_what_waits_is_bounded_and_counted(stuck: Stuck) -> None:
    thread = DrawingThread("stopped", lambda: stuck)  # type: ignore[arg-type,return-value]
    decode: Any = bytes
    thread.put("tissue/journal", decode, b"", 0)
    assert stuck.entered.wait(20)
    for _ in range(MOST_WAITING + 500):
        thread.put("tissue/journal", decode, b"", 0)
    assert thread.dropped == 500
    stuck.go.set()
    assert thread.close(20)


def test_moments_are_before_pulled_cut_open_and_released(bag: Path) -> None:
    moments = find_moments(bag)
    assert [m.name for m in moments] == ["before", "pulled", "cut_open", "released"]
    frames = {m.name: m.frame for m in moments}
    assert frames == {"before": 1, "pulled": 19, "cut_open": 20, "released": 40}
    opened = next(m for m in moments if m.name == "cut_open")
    assert len(opened.surface.inside.triangles)
    camera = camera_of(moments)
    everything = opened.positions - camera.position
    toward = camera.target - camera.position
    toward /= np.linalg.norm(toward)
    along = everything @ toward
    beside = np.linalg.norm(everything - along[:, None] * toward, axis=1)
    assert (np.degrees(np.arctan2(beside, along)) < 20.0).all()


def test_pictures_show_the_organ(bag: Path, tmp_path: Path) -> None:
    drawn = pictures.render(bag, tmp_path)
    if not drawn.files:
        pytest.skip(drawn.message)
    assert [p.name for p in drawn.files] == [
        "before.png",
        "pulled.png",
        "cut_open.png",
        "released.png",
    ]
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOImage import vtkPNGReader

    reds = []
    for picture in drawn.files:
        reader = vtkPNGReader()
        reader.SetFileName(str(picture))
        reader.Update()
        pixels = vtk_to_numpy(reader.GetOutput().GetPointData().GetScalars()).astype(int)
        reds.append(float((pixels[:, 0] > 1.6 * pixels[:, 2]).mean()))
    assert min(reds) > 0.1


def test_without_a_graphics_driver_there_is_a_message_and_no_failure(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    aborting = tmp_path / "python"
    aborting.write_text("#!/bin/sh\necho 'failed to get a display' >&2\nkill -ABRT $$\n")
    aborting.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(aborting))
    drawn = pictures.render(bag, tmp_path / "pictures")
    assert drawn.files == ()
    assert "no graphics driver" in drawn.message
    assert pictures.draw_session(bag, tmp_path / "pictures") == [drawn.message]


def test_a_bag_that_cannot_be_read_gives_a_line(tmp_path: Path) -> None:
    (line,) = pictures.draw_session(tmp_path / "nothing", tmp_path)
    assert "no pictures" in line


def test_the_summary_tells_grabs_and_cuts(bag: Path) -> None:
    told = summarise(bag)
    assert told["geometry"] == {"name": "block", "nodes": 147, "tetrahedra": 432}
    assert (told["model"], told["frames"], told["model_steps"]) == ("fake", 40, 200)
    (cut,) = told["cuts"]
    assert cut["faces_split"] == 12
    assert cut["nodes_added"] == 9
    assert cut["opening_mm"] == pytest.approx(0.2 * 20.0, abs=0.05)
    (grab,) = told["grabs"]
    assert grab["nodes"] > 0
    assert grab["moved_mm"] == pytest.approx(20.0, rel=0.2)


def test_a_second_epoch_is_told_apart(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bags, "EPOCH", bytes(reversed(range(16))))
    second = session_bag(tmp_path / "second", frames=30, cut_at=25)
    figures, finder = SessionFigures(), MomentFinder()
    recording = Recording(file_stream(str(tmp_path / "both.rrd")))
    for session in (bag, second):
        for topic, item in read_organ(session):
            figures.take(topic, item.message)
            finder.take(topic, item.message)
            recording.take(topic, item.message, item.log_time)
    recording.close()
    assert recording.states == 70
    assert [cut.nodes_added for cut in figures.cuts] == [9, 9]
    assert [len(grab.nodes) > 0 for grab in figures.grabs] == [True, True]
    assert figures.cuts[0].opening == pytest.approx(0.004, abs=5e-5)
    assert [m.name for m in finder.moments()] == ["before", "pulled", "cut_open", "released"]


def test_step_times_are_found_in_diagnostics() -> None:
    values = {"step_ms_p50": "1.5", "step_ms_p99": "2.5", "step_ms_max": "4", "steps": "7"}
    assert step_times({"tissue_sim: model": values}) == {"p50": 1.5, "p99": 2.5, "max": 4.0}


def test_the_recording_is_no_static_topology(bag: Path, tmp_path: Path) -> None:
    target = tmp_path / "session.rrd"
    to_rrd(bag, target)
    printed = rrd("stats", str(target))
    static = [line for line in printed.splitlines() if line.startswith("num_static")]
    # The blueprint's and the recording's own properties alone are static.
    assert static
    assert rr.version()


def test_sutures_are_drawn_as_long_as_they_are_there(tmp_path: Path) -> None:
    mesh, left, right = two_blocks()
    path = tmp_path / "sewn.rrd"
    recording = Recording(file_stream(str(path)))
    positions = mesh.rest[: mesh.node_rows].astype(np.float32)
    recording._log_sutures(mesh.sutures, positions)
    mesh.apply(sew_edit(mesh, left, right))
    recording.stream.set_time("frame", sequence=1)
    recording._log_sutures(mesh.sutures, positions)
    removed = TopologyEdit(mesh.version, kind="unsuture", removed_sutures=mesh.sutures.ids)
    mesh.apply(removed)
    recording.stream.set_time("frame", sequence=2)
    recording._log_sutures(mesh.sutures, positions)
    recording.close()
    said = rrd("print", "-v", str(path))
    assert said.count("/organ/sutures/knots") >= 1
    assert "LineStrips3D" in said
    assert "Clear" in said
