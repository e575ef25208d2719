"""Fixtures shared by all tests, and the environment they run in."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tissue_sim import discovery

REPOSITORY = Path(__file__).resolve().parents[1]

# Before numba is imported: kernels are cached for the user, never beside the sources.
_CACHES = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
os.environ.setdefault("NUMBA_CACHE_DIR", str(_CACHES / "tissue_sim" / "numba" / "tests"))
# Before rclpy is imported: wrong types in message fields are errors.
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")

# Before tests are imported: the same examples in every run, so that a run that fails, fails again.
# `pytest -m hypothesis --hypothesis-profile=search` looks for new ones.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search", derandomize=False, print_blob=True)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root of the repository."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_meshes() -> Path:
    """Folder of real anatomical meshes that are no part of the repository; skips without it."""
    chosen = os.environ.get("TISSUE_TEST_MESHES")
    folder = Path(chosen) if chosen else REPOSITORY.parent / "shared" / "meshes"
    if not folder.is_dir():
        pytest.skip(f"no meshes at {folder} (TISSUE_TEST_MESHES names another folder)")
    return folder


def _domains() -> range:
    """ROS domains that tests may use; TISSUE_TEST_DOMAINS="11-19" restricts them.

    Domains up to 101 keep clear of the ports that Linux hands out by itself, and those below 30
    are left to people.
    """
    first, last = os.environ.get("TISSUE_TEST_DOMAINS", "30-99").split("-")
    return range(int(first), int(last) + 1)


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain that no other test on this machine uses, set in the environment.

    Concurrent test runs keep apart through one locked file per domain; a lock ends with its
    process, however that ends.
    """
    locks = Path(tempfile.gettempdir()) / f"tissue_sim_domains_{os.getuid()}"
    locks.mkdir(exist_ok=True)
    domains = _domains()
    for turn in range(len(domains)):
        domain = domains[(os.getpid() + turn) % len(domains)]
        with (locks / str(domain)).open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
            for variable in discovery.DISCOVERY_VARIABLES:
                monkeypatch.delenv(variable, raising=False)
            for variable, value in discovery.local({}).items():
                monkeypatch.setenv(variable, value)
            yield domain
            return
    pytest.fail(f"all ROS domains {domains.start} to {domains.stop - 1} are in use by other tests")
