"""Markers on tissue are a measurement of the nodes next to them, and of what is held."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tissue_sim.compare.comparison import compare
from tissue_sim.compare.difference import known_rows
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.interaction import Interaction, InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.sources.choose import interaction_from, reference_from
from tissue_sim.compare.sources.motions import motion
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Trajectory, simulate

EXACT = Subject("finite_element", effort=Effort(steps=40))
STEP = 11
"""Every so many nodes has a marker."""


@pytest.fixture(scope="module")
def organ() -> Organ:
    return load_organ("wall", parameters={"columns": 9, "rows": 13})


@pytest.fixture(scope="module")
def pull(organ: Organ) -> Interaction:
    return motion("oblique", organ, pull_seconds=0.4, hold_seconds=0.4)


@pytest.fixture(scope="module")
def moved(organ: Organ, pull: Interaction) -> Trajectory:
    return simulate(EXACT, organ, pull)


def marker_rows(organ: Organ, pull: Interaction) -> np.ndarray:
    """Some nodes and all that are held, in no order."""
    some = np.union1d(np.arange(0, organ.mesh.node_rows, STEP), pull.nodes)
    return np.random.default_rng(3).permutation(some)


def write(path: Path, organ: Organ, moved: Trajectory, rows: np.ndarray, **more: object) -> Path:
    """What a camera a little off would see: the frame at rest, then those of a trajectory."""
    rest = organ.rest[rows] + 2e-4
    positions = np.concatenate([rest[None], rest + moved.displacement[:, rows]])
    content = {"positions": positions, "rate_hz": moved.rate_hz, **more}
    np.savez(path, **content)  # type: ignore[arg-type]
    return path


def test_markers_are_a_reference_where_they_are(
    organ: Organ, pull: Interaction, moved: Trajectory, tmp_path: Path
) -> None:
    """The model that the markers were taken from is no distance from them; others are."""
    rows = marker_rows(organ, pull)
    seen = reference_from(write(tmp_path / "seen.npz", organ, moved, rows), organ, pull)
    np.testing.assert_array_equal(known_rows(organ, seen), np.sort(rows))
    assert "markers of seen" in seen.label
    result = compare(organ, pull, seen, [EXACT, Subject("quasi_static", effort=Effort(steps=1))])
    exact, other = result.targets
    assert exact.difference.largest < 1e-8
    assert other.relative > 0.01
    whole = compare(organ, pull, moved, [other.subject]).targets[0].trajectory
    expected = np.linalg.norm((whole.displacement - moved.displacement)[:, np.sort(rows)], axis=2)
    assert other.difference.mean == pytest.approx(expected.mean(), rel=1e-5)


def test_markers_that_are_held_are_the_interaction(
    organ: Organ, pull: Interaction, moved: Trajectory, tmp_path: Path
) -> None:
    rows = marker_rows(organ, pull)
    held = np.tile(np.isin(rows, pull.nodes), (pull.frames + 1, 1))
    path = write(tmp_path / "seen.npz", organ, moved, rows, held=held)
    found = interaction_from(str(path), organ)
    np.testing.assert_array_equal(found.interaction.nodes, pull.nodes)
    np.testing.assert_allclose(found.interaction.displacement, pull.displacement, atol=1e-8)
    assert found.reference().frames == pull.frames
    assert compare(organ, found.interaction, found.reference(), [EXACT]).targets[0].relative < 1e-6


def test_a_faster_camera_gives_the_newest_frame_at_each_time(
    organ: Organ, pull: Interaction, tmp_path: Path
) -> None:
    """Markers that move at constant speed lag by less than a frame of the camera."""
    rows, speed, camera = np.arange(0, 200, 40), 0.01, 100.0
    along = speed * np.arange(0, 120)[:, None, None] / camera * np.array([0.0, 1.0, 0.0])
    path = tmp_path / "seen.npz"
    np.savez(path, positions=organ.rest[rows] + along, rate_hz=camera)
    seen = reference_from(path, organ, pull)
    expected = speed * np.arange(1, pull.frames + 1) / pull.rate_hz
    lag = expected - seen.displacement[:, rows[0], 1]
    assert (lag >= -1e-9).all()
    assert (lag < speed / camera).all()


def test_a_kept_trajectory_is_a_reference(
    organ: Organ, pull: Interaction, moved: Trajectory, tmp_path: Path
) -> None:
    moved.save(tmp_path / "exact.npz")
    found = reference_from(tmp_path / "exact.npz", organ, pull)
    np.testing.assert_array_equal(found.displacement, moved.displacement)


def test_markers_that_cannot_be_used_are_refused(
    organ: Organ, pull: Interaction, moved: Trajectory, tmp_path: Path
) -> None:
    rows, path = marker_rows(organ, pull), tmp_path / "seen.npz"

    def refused(said: str, **more: object) -> None:
        write(path, organ, moved, rows, **more)
        with pytest.raises(InteractionError, match=said):
            reference_from(path, organ, pull)

    good = np.load(write(path, organ, moved, rows))["positions"]
    refused(
        r"positions have shape \(2, 3\); allowed: \(frames, markers, 3\)", positions=good[0, :2]
    )
    refused("rate_hz = 0 is not allowed", rate_hz=0.0)
    refused("30 frames a second cannot be taken from 10; allowed: 1 to 10", rate_hz=10.0)
    refused(r"seen\.npz ends after .* s; interaction oblique takes 0\.8 s", positions=good[:9])
    gap = good.copy()
    gap[4, 2, 1] = np.nan
    refused("1 positions are not finite, the first is that of marker 2 in frame 4", positions=gap)
    refused("marker . is .* mm from the next node of wall", positions=1e3 * good)
    twice = good.copy()
    twice[:, 1] = twice[:, 0]
    refused("markers 0 and 1 are at the same node", positions=twice)
    np.savez(path, places=good)
    with pytest.raises(InteractionError, match="no positions, rate_hz; it holds places"):
        reference_from(path, organ, pull)
    write(path, organ, moved, rows)
    with pytest.raises(InteractionError, match=r"no held \(frames, markers\); give it as"):
        interaction_from(str(path), organ)
    write(path, organ, moved, rows, held=np.ones(3, dtype=bool))
    with pytest.raises(InteractionError, match=r"held has shape \(3,\); allowed: \(25, "):
        interaction_from(str(path), organ)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InteractionError, match=r"seen\.npz is no NumPy archive"):
        interaction_from(str(path), organ)
