"""An interaction out of a bag is what was held in it; its measurement is how the tissue moved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from std_msgs.msg import String

from support.bags import ROOMY, put
from support.recorded_pull import (
    CORNER,
    PRESS,
    PULL,
    RELEASE,
    STEPS,
    Pulled,
    pull_bag,
    record_pull,
    robot_bag,
)
from support.small_block import block_mesh
from tissue_sim.compare.comparison import compare
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.interaction import InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ, organ_of
from tissue_sim.compare.sources.choose import interaction_from
from tissue_sim.compare.sources.held_frames import frames_at
from tissue_sim.compare.sources.recording import read_recording
from tissue_sim.compare.subject import Subject
from viz_bridge.bag_writer import BagWriter

OTHER = bytes(range(16, 32))
SAME = Subject("quasi_static", effort=Effort(steps=STEPS))
"""The model of the session."""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Pulled]:
    return pull_bag(tmp_path_factory.mktemp("bags") / "session")


@pytest.fixture(scope="module")
def block() -> Organ:
    return organ_of("block", block_mesh())


# Sessions


def test_what_was_held_is_held_where_the_tool_took_it(session: tuple[Path, Pulled]) -> None:
    """Of 60 frames a second every other one counts, from the grab on."""
    bag, seen = session
    found = read_recording(bag)
    made = found.interaction
    assert found.notes == ()
    assert made.rate_hz == 30.0
    frames = np.arange(PRESS, 61, 2)
    assert made.frames == len(frames)
    for row, frame in enumerate(frames):
        np.testing.assert_array_equal(made.held_rows(row), seen.held[frame - 1])
        if frame < RELEASE:
            expected = np.tile(PULL * (frame - PRESS), (len(made.nodes), 1))
            np.testing.assert_allclose(made.displacement[row], expected, atol=1e-8)
    assert not made.held[frames >= RELEASE].any()


def test_the_sessions_own_model_moves_exactly_as_it_was_measured(
    session: tuple[Path, Pulled],
) -> None:
    """With all frames, the same steps in each and the same held nodes nothing is left over."""
    bag, seen = session
    found = interaction_from(str(bag), rate_hz=60.0)
    measured = found.reference()
    for row in (0, 20, -1):
        shape = found.organ.rest + measured.displacement[row]
        np.testing.assert_allclose(shape, seen.positions[PRESS - 1 :][row], atol=1e-8)
    other = Subject("relaxation", effort=Effort(steps=1))
    result = compare(found.organ, found.interaction, measured, [SAME, other])
    assert result.targets[0].difference.largest < 1e-7
    assert result.targets[1].relative > 0.01
    assert result.reference_subject is None


def test_a_pause_is_left_out(tmp_path: Path, session: tuple[Path, Pulled]) -> None:
    """What the tool does meanwhile moves nothing; the tissue follows at once when it goes on."""
    bag, seen = pull_bag(tmp_path / "paused", pause_at=20)
    found = read_recording(bag, rate_hz=60.0)
    assert found.interaction.frames == 60 - PRESS + 1 - 10
    running = [frame for frame in range(PRESS, 61) if not 20 <= frame < 30]
    for row, frame in enumerate(running):
        np.testing.assert_array_equal(found.interaction.held_rows(row), seen.held[frame - 1])
        shape = found.organ.rest + found.reference().displacement[row]
        np.testing.assert_allclose(shape, seen.positions[frame - 1], atol=1e-8)


def test_waiting_after_the_last_release_is_left_out(tmp_path: Path) -> None:
    """A second of it counts: tissue comes back."""
    bag, _ = pull_bag(tmp_path / "long", frames=150)
    found = read_recording(bag, rate_hz=60.0)
    assert found.interaction.frames == RELEASE - PRESS + 60
    assert found.reference().frames == found.interaction.frames


def test_an_interaction_ends_before_the_mesh_changes(tmp_path: Path) -> None:
    bag, _ = pull_bag(tmp_path / "cut", cut_at=31)
    found = read_recording(bag, rate_hz=60.0)
    assert found.interaction.frames == 31 - PRESS
    assert found.notes == ("only frames 1 to 30 of 60 are taken: the next one changes the mesh",)
    assert found.reference().frames == found.interaction.frames


def test_nodes_of_a_hold_by_force_are_where_the_session_had_them(tmp_path: Path) -> None:
    bag, seen = pull_bag(tmp_path / "force", hold="force")
    found = read_recording(bag, rate_hz=60.0)
    assert "grasper holds by force: its nodes are held where the recorded model" in found.notes[0]
    rows = found.interaction.held_rows(30)
    expected = seen.positions[PRESS - 1 + 30][rows] - found.organ.rest[rows]
    np.testing.assert_allclose(found.interaction.displacement[30], expected, atol=1e-7)


@pytest.mark.parametrize(
    ("every", "rate", "enough"),
    [(2, 30.0, True), (2, 60.0, False), (6, 30.0, False), (6, 10.0, True)],
)
def test_positions_must_be_recorded_as_often_as_they_are_wanted(
    tmp_path: Path, every: int, rate: float, enough: bool
) -> None:
    """The interaction does not need them."""
    bag, _ = pull_bag(tmp_path / "thin", state_every=every)
    found = read_recording(bag, rate_hz=rate)
    assert found.interaction.frames > 5
    if enough:
        assert found.reference().frames == found.interaction.frames
        return
    with pytest.raises(InteractionError, match=r"--record-state-hz 60.*fewer frames a second"):
        found.reference()


def test_the_organ_is_that_of_the_bag_or_must_be_like_it(
    session: tuple[Path, Pulled], block: Organ
) -> None:
    bag, _ = session
    assert read_recording(bag).organ.digest == block.digest
    assert read_recording(bag, organ=block).organ.name == "block"
    wall = load_organ("wall")
    with pytest.raises(
        InteractionError, match=r"another topology \(block, 125 nodes, 384 ele.* than wall \(884"
    ):
        read_recording(bag, organ=wall)


def test_one_of_several_epochs_or_organs_must_be_chosen(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", ROOMY)
    record_pull(writer, frames=20, namespace="/left")
    record_pull(writer, frames=30, namespace="/left", epoch=OTHER)
    record_pull(writer, frames=15, namespace="/right")
    writer.close()
    bag = tmp_path / "bag"
    with pytest.raises(
        ValueError, match=r"several organs; choose a namespace among \['/left', '/right'\]"
    ):
        read_recording(bag)
    with pytest.raises(ValueError, match=r"no organ in namespace 'middle'; it has \['/left'"):
        read_recording(bag, namespace="middle")
    with pytest.raises(
        InteractionError, match=r"several epochs; choose one: 1 \(block, 20 frames\), 2"
    ):
        read_recording(bag, namespace="left")
    with pytest.raises(InteractionError, match=r"has no epoch 3: 1 \(block, 20 frames\), 2"):
        read_recording(bag, namespace="left", epoch=3)
    frames = [
        read_recording(bag, "left", 60.0, 1).interaction.frames,
        read_recording(bag, "left", 60.0, 2).interaction.frames,
        read_recording(bag, "right", 60.0).interaction.frames,
    ]
    assert frames == [20 - PRESS + 1, 30 - PRESS + 1, 15 - PRESS + 1]


def test_bags_without_what_is_needed_are_refused(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "empty", ROOMY)
    writer.close()
    with pytest.raises(InteractionError, match="empty is empty: it holds no message"):
        read_recording(tmp_path / "empty")
    writer = BagWriter(tmp_path / "words", ROOMY)
    put(writer, "/words", String(data="hello"), 1)
    writer.close()
    with pytest.raises(
        InteractionError, match=r"no tissue/journal and no tools/.*; its topics: /words"
    ):
        read_recording(tmp_path / "words")
    bag, _ = pull_bag(tmp_path / "mute", with_journal=False)
    with pytest.raises(
        InteractionError, match=r"no tissue/journal .* topics: /tissue/state, /tissue/topology"
    ):
        read_recording(bag)
    bag, _ = pull_bag(tmp_path / "bare", with_topology=False)
    with pytest.raises(ValueError, match="no tissue/topology of epoch"):
        read_recording(bag)
    bag, _ = pull_bag(tmp_path / "idle", frames=PRESS - 2)
    with pytest.raises(InteractionError, match="idle: no tool holds tissue in any frame"):
        read_recording(bag)
    with pytest.raises(ValueError, match="nowhere"):
        read_recording(tmp_path / "nowhere")
    torn = tmp_path / "idle" / "idle_0.mcap"
    torn.write_bytes(torn.read_bytes()[:-200])
    with pytest.raises(ValueError, match="tissue bag recover"):
        read_recording(tmp_path / "idle")


def test_tissue_that_is_deformed_at_the_start_is_refused(tmp_path: Path) -> None:
    bag, _ = pull_bag(tmp_path / "deformed", displaced=1e-3)
    with pytest.raises(InteractionError, match="begins with tissue that is deformed already"):
        read_recording(bag)


@pytest.mark.parametrize(
    ("rate", "recorded"), [(30.0, 60.0), (25.0, 60.0), (60.0, 60.0), (7.0, 50.0)]
)
def test_the_newest_frame_at_each_time_is_taken(rate: float, recorded: float) -> None:
    chosen = frames_at(rate, recorded, 100)
    times = np.arange(len(chosen)) / rate
    age = times - chosen / recorded
    assert (age > -1e-9).all()
    assert (age < 1 / recorded - 1e-9).all()
    assert chosen[-1] <= 99 < chosen[-1] + recorded / rate
    with pytest.raises(InteractionError, match=f"allowed: 1 to {recorded:g}"):
        frames_at(1.01 * recorded, recorded, 100)


# Tools alone


def test_a_robots_tool_is_played_to_an_organ(tmp_path: Path, block: Organ) -> None:
    found = interaction_from(str(robot_bag(tmp_path / "robot")), block)
    made = found.interaction
    near = np.linalg.norm(block.rest - CORNER, axis=1)
    np.testing.assert_array_equal(np.sort(near)[: len(made.nodes)], np.sort(near[made.nodes]))
    assert made.seconds == pytest.approx(0.8, abs=2 / 30)
    expected = 0.02 * np.arange(made.frames) / 30
    # A pose of the robot is up to 5 ms old.
    off = expected - made.displacement[:, 0, 1]
    assert np.abs(off).max() < 0.02 * (1 / 60 + 0.005)
    np.testing.assert_allclose(made.displacement[:, :, [0, 2]], 0.0, atol=1e-8)
    with pytest.raises(InteractionError, match="it holds an interaction only"):
        found.reference()


def test_what_is_guessed_of_a_robot_is_said(tmp_path: Path, block: Organ) -> None:
    bag = robot_bag(tmp_path / "robot", tool="jaws", frame_id="robot_base")
    notes = read_recording(bag, organ=block).notes
    assert "poses in frame robot_base are taken as if in frame organ" in notes
    assert any("jaws is taken for a grasper with a radius of" in note for note in notes)


def test_tools_that_hold_nothing_or_have_no_organ_are_refused(tmp_path: Path, block: Organ) -> None:
    bag = robot_bag(tmp_path / "robot")
    with pytest.raises(InteractionError, match="tools only, no tissue/journal: name the organ"):
        read_recording(bag)
    idle = robot_bag(tmp_path / "idle", press_at=0.0)
    with pytest.raises(InteractionError, match="no tool is used in it"):
        read_recording(idle, organ=block)
    far = organ_of("block", load_organ("wall").mesh)
    with pytest.raises(InteractionError, match="robot: no tool holds tissue in any frame"):
        read_recording(bag, organ=far)
