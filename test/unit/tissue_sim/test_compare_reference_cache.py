"""A kept reference is what computing it again would give, and nothing else is."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tissue_sim.compare import reference_cache
from tissue_sim.compare.effort import Effort
from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.organs import load_organ
from tissue_sim.compare.reference_cache import cached, digest, user_folder
from tissue_sim.compare.sources.motions import motion
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Trajectory, simulate
from tissue_sim.elastic.model import Material

SUBJECT = Subject("quasi_static", {"step": 1.0}, Effort(steps=2))


@pytest.fixture(scope="module")
def organ() -> Organ:
    return load_organ("wall", parameters={"columns": 5, "rows": 7})


@pytest.fixture(scope="module")
def pull(organ: Organ) -> Interaction:
    return motion("oblique", organ, pull_seconds=0.2, hold_seconds=0.2)


class Computed:
    """Counts the frames that are computed."""

    def __init__(self, folder: Path, organ: Organ) -> None:
        self.folder, self.organ = folder, organ
        self.frames = 0
        self.said: list[str] = []

    def __call__(self, subject: Subject, interaction: Interaction, **more: int) -> Trajectory:
        return cached(
            subject, self.organ, interaction, self.folder, self._count, self.said.append, **more
        )

    def _count(self, _: int) -> None:
        self.frames += 1


@pytest.fixture
def computed(tmp_path: Path, organ: Organ) -> Computed:
    return Computed(tmp_path / "references", organ)


def test_the_second_time_nothing_is_computed(computed: Computed, pull: Interaction) -> None:
    first = computed(SUBJECT, pull)
    assert computed.frames == pull.frames
    again = computed(replace(SUBJECT, label="reference"), pull)
    assert computed.frames == pull.frames
    assert again.label == "reference"
    direct = simulate(SUBJECT, computed.organ, pull)
    for trajectory in (first, again):
        np.testing.assert_array_equal(trajectory.displacement, direct.displacement)
        np.testing.assert_array_equal(trajectory.steps, direct.steps)
    assert computed.said == []


def test_everything_that_decides_a_reference_is_in_its_name(
    organ: Organ, pull: Interaction, monkeypatch: pytest.MonkeyPatch
) -> None:
    shifted = replace(pull, displacement=pull.displacement * (1 + 1e-12))
    shorter = replace(pull, held=pull.held[:-1], displacement=pull.displacement[:-1])
    finer = load_organ("wall", parameters={"columns": 6, "rows": 7})
    names = [
        digest(SUBJECT, organ, pull),
        digest(SUBJECT.with_values({"step": 1.1}), organ, pull),
        digest(SUBJECT.with_values({"material.young_modulus": 1e4}), organ, pull),
        digest(SUBJECT.with_values({"springs.stiffness": 2.0}), organ, pull),
        digest(replace(SUBJECT, model="lr", values={}), organ, pull),
        digest(replace(SUBJECT, effort=Effort(steps=3)), organ, pull),
        digest(replace(SUBJECT, effort=Effort(to_rest=1e-9)), organ, pull),
        digest(SUBJECT, organ, shifted),
        digest(SUBJECT, organ, shorter),
        digest(SUBJECT, organ, replace(pull, rate_hz=25.0)),
        digest(SUBJECT, organ, replace(pull, held=~pull.held)),
        digest(SUBJECT, replace(organ, material=Material(poisson_ratio=0.3)), pull),
        digest(SUBJECT, finer, pull),
    ]
    monkeypatch.setattr(reference_cache, "code_digest", lambda: "other code")
    names.append(digest(SUBJECT, organ, pull))
    assert len(set(names)) == len(names)


def test_what_only_people_see_is_not_in_its_name(organ: Organ, pull: Interaction) -> None:
    name = digest(SUBJECT, organ, pull)
    assert digest(replace(SUBJECT, label="mine"), organ, replace(pull, name="other")) == name
    values = {"levels": 3.0, "step": 1.0}
    turned = dict(reversed(values.items()))
    assert digest(replace(SUBJECT, values=values), organ, pull) == digest(
        replace(SUBJECT, values=turned), organ, pull
    )


@pytest.mark.parametrize("damage", ["torn", "flipped", "other", "shape"])
def test_a_damaged_file_is_computed_anew_and_that_is_said(
    computed: Computed, pull: Interaction, damage: str
) -> None:
    first = computed(SUBJECT, pull)
    (path,) = computed.folder.iterdir()
    whole = bytearray(path.read_bytes())
    if damage == "torn":
        path.write_bytes(whole[: len(whole) // 2])
    elif damage == "flipped":
        for place in range(len(whole) // 4, len(whole) // 2):
            whole[place] ^= 0x5A
        path.write_bytes(whole)
    elif damage == "other":
        pull.save(path)
    else:
        replace(first, displacement=first.displacement[1:]).save(path)
    again = computed(SUBJECT, pull)
    assert computed.frames == 2 * pull.frames
    assert len(computed.said) == 1
    assert "cannot be used and is computed anew" in computed.said[0]
    assert path.name in computed.said[0]
    np.testing.assert_array_equal(again.displacement, first.displacement)
    computed(SUBJECT, pull)
    assert computed.frames == 2 * pull.frames


def test_a_time_a_frame_is_never_kept(computed: Computed, pull: Interaction) -> None:
    by_time = replace(SUBJECT, effort=Effort(seconds=1e-5))
    computed(by_time, pull)
    computed(by_time, pull)
    assert computed.frames == 2 * pull.frames
    assert not computed.folder.exists()


def test_what_was_used_longest_ago_goes_first(computed: Computed, pull: Interaction) -> None:
    subjects = [SUBJECT.with_values({"step": 0.5 + 0.1 * number}) for number in range(3)]
    paths = []
    for age, subject in zip((300, 200, 100), subjects, strict=True):
        computed(subject, pull)
        paths.append(computed.folder / f"{digest(subject, computed.organ, pull)}.npz")
        os.utime(paths[-1], (time.time() - age,) * 2)
    computed(subjects[0], pull)  # the oldest is used again
    size = max(path.stat().st_size for path in paths)
    computed(SUBJECT.with_values({"step": 1.3}), pull, largest=3 * size + size // 2)
    assert [path.exists() for path in paths] == [True, False, True]
    computed(SUBJECT.with_values({"step": 1.4}), pull, largest=1)
    assert len(list(computed.folder.iterdir())) == 1


def test_a_folder_that_cannot_be_written_is_said(
    tmp_path: Path, organ: Organ, pull: Interaction
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    computed = Computed(blocked / "references", organ)
    trajectory = computed(SUBJECT, pull)
    assert trajectory.frames == pull.frames
    assert any("could not be kept" in text for text in computed.said)


def test_references_are_kept_among_the_users_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/caches")
    assert user_folder() == Path("/caches/tissue_sim/references")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/somebody")
    assert user_folder() == Path("/home/somebody/.cache/tissue_sim/references")
