"""Saving an organ and loading it again."""

from __future__ import annotations

import errno
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.small_block import block_simulation
from support.split_edit import split_at
from support.valid_mesh import check_valid
from tissue_sim import snapshot
from tissue_sim.frame import Budget, FrameInputs
from tissue_sim.simulation import Simulation


@pytest.fixture
def simulation() -> Simulation:
    """Split, one element removed, and deformed."""
    simulation = block_simulation()
    mesh = simulation.mesh
    simulation.advance(FrameInputs(edits=(split_at(mesh, 0.03),)), Budget(steps=1))
    removal = type(split_at(mesh, -1.0))(
        base_version=mesh.version, removed_elements=mesh.element_ids[:1].astype(np.uint32)
    )
    simulation.advance(FrameInputs(edits=(removal,)), Budget(steps=1))
    assert mesh.version == 3
    generator = np.random.default_rng(1)
    simulation.state.displacement[:] = generator.normal(
        scale=1e-3, size=simulation.state.displacement.shape
    )
    return simulation


def take(simulation: Simulation) -> snapshot.Snapshot:
    return snapshot.take(simulation.mesh, simulation.state.displacement)


def test_a_saved_organ_comes_back_as_it_was(simulation: Simulation, tmp_path: Path) -> None:
    snapshot.save(take(simulation), tmp_path, "opened-1.2")
    loaded = snapshot.load(tmp_path, "opened-1.2")
    old, new = simulation.mesh, loaded.mesh()
    alive = np.flatnonzero(old.node_alive[: old.node_rows])
    np.testing.assert_array_equal(new.rest[: new.node_rows], old.rest[alive])
    np.testing.assert_array_equal(new.fixed[: new.node_rows], old.fixed[alive])
    np.testing.assert_array_equal(new.node_file_ids[: new.node_rows], old.node_file_ids[alive])
    np.testing.assert_array_equal(
        loaded.displacement, simulation.state.displacement[: old.node_rows][alive]
    )
    elements = np.flatnonzero(old.element_alive[: old.element_rows])
    np.testing.assert_array_equal(
        new.rest[new.tets[: new.element_rows]], old.rest[old.tets[elements]]
    )
    assert new.element_alive[: new.element_rows].all()
    assert new.version == 1
    check_valid(new)


def test_a_snapshot_is_a_copy(simulation: Simulation) -> None:
    taken = take(simulation)
    points = taken.raw.points.copy()
    simulation.mesh.rest[:] = 7.0
    simulation.state.displacement[:] = 7.0
    np.testing.assert_array_equal(taken.raw.points, points)
    assert not (taken.displacement == 7.0).any()


@pytest.mark.parametrize("name", ["", ".hidden", "../up", "a/b", "/tmp/x", "a b", "ü", "x" * 101])
def test_a_name_is_never_a_path(simulation: Simulation, tmp_path: Path, name: str) -> None:
    with pytest.raises(snapshot.SnapshotNameError, match="letters, digits"):
        snapshot.save(take(simulation), tmp_path / "data", name)
    with pytest.raises(snapshot.SnapshotNameError):
        snapshot.load(tmp_path / "data", name)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_save_leaves_the_old_file(
    simulation: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = snapshot.save(take(simulation), tmp_path, "organ")
    before = path.read_bytes()

    def full(_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(snapshot.SnapshotError, match="No space left"):
        snapshot.save(take(simulation), tmp_path, "organ")
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["organ.npz"]


def test_a_missing_file_names_those_that_are_there(simulation: Simulation, tmp_path: Path) -> None:
    snapshot.save(take(simulation), tmp_path, "one")
    with pytest.raises(snapshot.SnapshotError, match="saved: one"):
        snapshot.load(tmp_path, "two")


def damage(path: Path, **changes: Any) -> None:
    with np.load(path) as file:
        values = {key: file[key] for key in file.files}
    np.savez(path, **{**values, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"tetrahedra": np.array([[0, 1, 2, 10**6]])},
        {"points": np.zeros((3, 2))},
        {"points": np.zeros(5)},
        {"fixed": np.zeros(3, dtype=bool)},
        {"displacement": np.array(["x"])},
        {"format": np.array(99)},
    ],
)
def test_a_damaged_file_is_refused(
    simulation: Simulation, tmp_path: Path, changes: dict[str, Any]
) -> None:
    path = snapshot.save(take(simulation), tmp_path, "organ")
    damage(path, **changes)
    with pytest.raises(snapshot.SnapshotError):
        snapshot.load(tmp_path, "organ")


def test_numbers_that_are_not_finite_and_inverted_elements_are_refused(
    simulation: Simulation, tmp_path: Path
) -> None:
    path = snapshot.save(take(simulation), tmp_path, "organ")
    points = take(simulation).raw.points
    for wrong in (np.where(points > 0.05, np.nan, points), -points):
        damage(path, points=wrong)
        with pytest.raises(snapshot.SnapshotError, match="damaged"):
            snapshot.load(tmp_path, "organ")


def test_truncated_files_and_pickles_are_refused(simulation: Simulation, tmp_path: Path) -> None:
    path = snapshot.save(take(simulation), tmp_path, "organ")
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(snapshot.SnapshotError):
        snapshot.load(tmp_path, "organ")
    path.write_bytes(pickle.dumps({"points": [1, 2, 3]}))
    with pytest.raises(snapshot.SnapshotError):
        snapshot.load(tmp_path, "organ")
    np.savez(path, points=np.array([{}], dtype=object))
    with pytest.raises(snapshot.SnapshotError):
        snapshot.load(tmp_path, "organ")
