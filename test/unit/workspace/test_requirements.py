"""The locks are complete, hashed, and hold the ROS distribution that the code is written for."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from support.workspace import REPOSITORY

LOCKS = sorted((REPOSITORY / "requirements").glob("py3*.lock"))
EXTRAS = sorted((REPOSITORY / "requirements").glob("bench-py3*.lock"))


def entries(lock: Path) -> dict[str, str]:
    """From each package of a lock to its whole entry, continuation lines included."""
    text = lock.read_text()
    starts = list(re.finditer(r"^([a-z0-9][a-z0-9._-]*)(?:\[[^]]*\])?==", text, re.MULTILINE))
    ends = [start.start() for start in starts[1:]] + [len(text)]
    return {start[1]: text[start.start() : end] for start, end in zip(starts, ends, strict=True)}


def version(entry: str) -> str:
    match = re.search(r"==([^\s;]+)", entry)
    assert match
    return match[1]


def test_there_is_a_lock_for_each_supported_python() -> None:
    assert [lock.stem for lock in LOCKS] == ["py311", "py312", "py313"]
    assert [lock.stem for lock in EXTRAS] == ["bench-py311", "bench-py312", "bench-py313"]


@pytest.mark.parametrize("lock", LOCKS + EXTRAS, ids=lambda lock: lock.stem)
def test_every_locked_package_has_hashes(lock: Path) -> None:
    assert [name for name, entry in entries(lock).items() if "--hash=sha256:" not in entry] == []


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_every_requirement_is_locked(lock: Path) -> None:
    locked = entries(lock)
    for source in ("requirements.in", "requirements-dev.in"):
        text = (REPOSITORY / source).read_text().lower()
        for name in re.findall(r"^[a-z0-9][a-z0-9_-]*", text, re.MULTILINE):
            assert name in locked


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_ros_is_jazzy(lock: Path) -> None:
    """The wheels `ros-rclpy` and the like carry the names of every distribution."""
    locked = entries(lock)
    assert version(locked["ros-rclpy"]).startswith("7.1.")
    assert version(locked["ros-std-msgs"]).startswith("5.3.")
    assert int(version(locked["setuptools"]).partition(".")[0]) < 80


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_first_step_of_the_setup_installs_what_the_lock_holds(lock: Path) -> None:
    locked = entries(lock)
    for name, entry in entries(REPOSITORY / "requirements" / "bootstrap.lock").items():
        assert version(locked[name]) == version(entry)


@pytest.mark.parametrize("extra", EXTRAS, ids=lambda lock: lock.stem)
def test_the_optional_extra_changes_no_version(extra: Path) -> None:
    locked = entries(extra.with_name(extra.name.removeprefix("bench-")))
    optional = entries(extra)
    text = (REPOSITORY / "requirements-bench.in").read_text().lower()
    wanted = set(re.findall(r"^[a-z0-9][a-z0-9_-]*", text, re.MULTILINE))
    assert wanted <= set(optional)
    assert not wanted & set(locked)
    for name in set(optional) & set(locked):
        assert version(optional[name]) == version(locked[name])
