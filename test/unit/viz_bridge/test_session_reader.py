"""What a report reads out of bags, against sessions whose figures are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tissue_interfaces.msg import (
    Hole,
    Holes,
    Journal,
    Reading,
    Readings,
    RiskWarning,
    ToolSample,
)

from support.bags import EPOCH, PERIOD, ROOMY, START, put, session_bag
from support.recorded_pull import PRESS, PULL, RELEASE, pull_bag, record_pull, robot_bag
from tissue_sim import conversions
from tissue_sim.report.loads import load_of
from tissue_sim.report.motion import motion_of
from tissue_sim.report.session import Missing, Session
from viz_bridge.bag_reader import BagError
from viz_bridge.bag_writer import BagWriter
from viz_bridge.session_reader import read_session

FRAMES = 60


@pytest.fixture(scope="module")
def pulled(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A simulated session: a corner is pulled at a constant speed, and the block is cut."""
    bag, _ = pull_bag(tmp_path_factory.mktemp("bags") / "pull", cut_at=30, pause_at=40)
    return read_session(bag)


def test_way_and_speed_are_those_of_the_hand(pulled: Session) -> None:
    """Ten frames are paused: no time passes in them, and the tool arrives at its place later."""
    (track,) = pulled.tools.values()
    way = float(np.linalg.norm(PULL)) * (FRAMES - PRESS)
    motion = motion_of(track.positions, pulled.rate_hz, 0.002)
    assert motion.path == pytest.approx(way, rel=1e-6)
    assert motion.straightness == pytest.approx(1.0)
    assert pulled.rate_hz == pytest.approx(60.0)
    assert pulled.seconds == pytest.approx((FRAMES - 1 - 10) / 60, abs=0.02)
    assert pulled.paused_seconds == pytest.approx(10 / 60, abs=0.02)
    assert pulled.wall_seconds == pytest.approx((FRAMES - 1) / 60, abs=0.01)


def test_events_are_told_in_their_order(pulled: Session) -> None:
    told = [event.kind for event in pulled.events]
    assert told == ["press", "cut", "pause", "pause", "release"]
    assert pulled.events[0].time == pytest.approx(PRESS / 60, abs=0.01)
    assert [event.text for event in pulled.events if event.kind == "pause"] == ["paused", "goes on"]


def test_a_cut_is_measured(pulled: Session) -> None:
    """Through a cube of 60 mm; its corner is held, not its cut."""
    assert not isinstance(pulled.cuts, Missing)
    (cut,) = pulled.cuts
    assert cut.surface.area == pytest.approx(0.06**2)
    assert cut.surface.length == pytest.approx(0.06)
    assert cut.surface.depth == pytest.approx(0.06)
    assert not cut.undone


def test_stress_is_read_again_where_it_was_not_recorded(pulled: Session) -> None:
    """It rises while the corner is pulled; the report says where it comes from."""
    stress = pulled.stress
    assert not isinstance(stress, Missing)
    assert (stress.quantity, stress.unit) == ("von_mises_stress", "Pa")
    assert "read again by tissue_sim.readings from tissue/state" in stress.source
    before = stress.peak.times < (PRESS - 1) / 60
    assert stress.peak.values[before].max() < 1.0
    assert stress.peak.values.max() > 100.0
    released = float(stress.peak.times[stress.peak.values.argmax()])
    assert PRESS / 60 < released < RELEASE / 60


def test_what_is_not_recorded_is_said_and_not_taken_for_nothing(pulled: Session) -> None:
    (track,) = pulled.tools.values()
    assert str(track.force) == "not recorded: tools/grasper/measured_cf"
    assert str(pulled.holes) == "not recorded: tissue/holes"
    assert str(pulled.violations).startswith("not recorded: tissue/readings")


def test_without_a_start_the_material_is_not_known(tmp_path: Path) -> None:
    """A journal whose first frame has no start: no stress, but the rest."""
    session = read_session(session_bag(tmp_path / "bag"))
    assert isinstance(session.stress, Missing)
    assert "does not say what the tissue is made of" in str(session.stress)
    (track,) = session.tools.values()
    # Up 20 mm along half a sine and back, from the first frame on.
    start = 0.02 * np.sin(np.pi / 40)
    path = motion_of(track.positions, session.rate_hz).path
    assert path == pytest.approx(2 * 0.02 - start, rel=1e-3)
    assert track.kind == "grab"


def test_recorded_readings_warnings_and_holes_are_taken(tmp_path: Path) -> None:
    """Stress 1000 sin over half a period of 0.5 s: its integral is 1000 / pi."""
    writer = BagWriter(tmp_path / "bag", ROOMY)
    record_pull(writer, frames=40)
    for number in range(31):
        at = START + (number + 1) * PERIOD
        stamp = conversions.stamp_of(at)
        message = Readings(
            header=conversions.header("organ", stamp), frame=number + 1, sim_time=number / 60
        )
        message.epoch = conversions.epoch_field(EPOCH)
        peak = 1000.0 * float(np.sin(np.pi * number / 30))
        message.readings = [Reading(name="von_mises_stress", unit="Pa", peak=peak)]
        near = {10: (0.004, True), 11: (0.002, True), 12: (0.003, True), 20: (0.009, False)}
        if number in near:
            value, begins = near[number]
            warning = RiskWarning(
                region="node", what="near", tool="grasper", value=value, begins=begins
            )
            message.warnings = [warning]
        put(writer, "/tissue/readings", message, at)
    for frame, covered in ((10, 0.25), (30, 0.75)):
        hole = Hole(name="defect", covered=covered, open_area=1e-4 * (1 - covered), gap=0.004)
        holes = Holes(frame=frame, holes=[hole])
        holes.epoch = conversions.epoch_field(EPOCH)
        put(writer, "/tissue/holes", holes, START + frame * PERIOD)
    writer.close()
    session = read_session(tmp_path / "bag", name="anna 1")
    stress = session.stress
    assert not isinstance(stress, Missing)
    assert stress.source == "recorded in tissue/readings, 31 times"
    load = load_of(stress.peak.times, stress.peak.values)
    assert load is not None
    assert load.peak == pytest.approx(1000.0)
    assert load.integral == pytest.approx(1000.0 / np.pi, rel=2e-3)
    assert not isinstance(session.violations, Missing)
    (one,) = session.violations
    assert (one.begin, one.end, one.worst) == pytest.approx((10 / 60, 20 / 60, 0.002))
    assert not isinstance(session.holes, Missing)
    assert session.holes["defect"].covered.tolist() == [0.25, 0.75]
    assert session.holes["defect"].times == pytest.approx([10 / 60, 30 / 60], abs=1e-6)


def test_of_several_epochs_the_longest_is_reported(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", ROOMY)
    for number, frames in enumerate((20, 50, 15)):
        record_pull(writer, frames=frames, epoch=bytes([number]) * 16)
    writer.close()
    session = read_session(tmp_path / "bag")
    assert session.seconds == pytest.approx(49 / 60)
    assert "holds 3 epochs" in session.notes[0]
    assert "number 2" in session.notes[0]
    assert read_session(tmp_path / "bag", epoch=3).seconds == pytest.approx(14 / 60)
    with pytest.raises(BagError, match="has no epoch 4; it has 1 to 3"):
        read_session(tmp_path / "bag", epoch=4)


def test_what_is_no_session_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="nothing"):
        read_session(tmp_path / "nothing")
    text = tmp_path / "notes.txt"
    text.write_text("not a bag")
    with pytest.raises(ValueError, match=r"notes\.txt"):
        read_session(text)
    BagWriter(tmp_path / "empty", ROOMY).close()
    with pytest.raises(BagError, match="empty"):
        read_session(tmp_path / "empty")
    with pytest.raises(BagError, match="nothing of an organ"):
        read_session(robot_bag(tmp_path / "robot"))
    bag, _ = pull_bag(tmp_path / "states", frames=5, with_journal=False)
    with pytest.raises(BagError, match="holds no /tissue/journal"):
        read_session(bag)


def test_poses_at_another_rate_than_frames_are_no_stops(tmp_path: Path) -> None:
    """A device at 20 Hz under 60 frames a second: a straight run, not twenty steps a second."""
    writer = BagWriter(tmp_path / "bag", ROOMY)
    for frame in range(1, 121):
        at = START + frame * PERIOD
        entry = Journal(
            header=conversions.header("organ", conversions.stamp_of(at)), frame=frame,
            sim_time=frame / 60,
        )  # fmt: skip
        entry.epoch = conversions.epoch_field(EPOCH)
        heard = 3 * (frame // 3)
        sample = ToolSample(id="hook", stamp=conversions.stamp_of(START + heard * PERIOD))
        sample.pose = np.array([0.001 * heard, 0, 0, 0, 0, 0, 1.0])
        entry.tools = [sample]
        put(writer, "/tissue/journal", entry, at)
    writer.close()
    session = read_session(tmp_path / "bag")
    motion = motion_of(session.tools["hook"].positions, session.rate_hz)
    assert (motion.movements, motion.idle) == (1, 0.0)
    assert motion.mean_speed == pytest.approx(0.06, rel=0.03)
    assert str(session.cuts) == "not recorded: tissue/topology at the start"
