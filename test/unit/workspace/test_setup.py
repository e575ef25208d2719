"""`make setup`: names what is missing, does nothing twice, leaves everything importable."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from support.workspace import PYTHON_PACKAGES, REPOSITORY, modules

# What setup.sh itself calls up to the end of its checks.
BASICS = (
    "awk",
    "bash",
    "cat",
    "dirname",
    "flock",
    "getconf",
    "head",
    "sort",
    "tail",
    "uname",
    "make",
    "rm",
)


@pytest.fixture
def bare_machine(tmp_path: Path) -> Path:
    """A copy of the set-up with a PATH that holds neither compiler nor Python."""
    shutil.copytree(REPOSITORY / "scripts", tmp_path / "scripts")
    tools = tmp_path / "bin"
    tools.mkdir()
    for name in BASICS:
        found = shutil.which(name)
        assert found, name
        (tools / name).symlink_to(found)
    return tmp_path


def pretend(machine: Path, name: str, output: str) -> None:
    """Puts a program on the machine that prints a text whatever it is asked."""
    program = machine / "bin" / name
    program.unlink(missing_ok=True)
    program.write_text(f"#!/bin/sh\necho '{output}'\n".replace("/bin/sh", "/usr/bin/env bash"))
    program.chmod(0o755)


def run_setup(machine: Path, python: str) -> subprocess.CompletedProcess[str]:
    """Runs the copied set-up with nothing but the machine's programs."""
    return subprocess.run(
        [machine / "bin" / "bash", machine / "scripts" / "setup.sh"],
        env={"PATH": f"{machine / 'bin'}:/nonexistent", "HOME": str(machine), "PYTHON": python},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
    )


@pytest.fixture(autouse=True)
def _env_program(request: pytest.FixtureRequest) -> None:
    """The pretended programs are bash scripts found through env."""
    if "bare_machine" in request.fixturenames:
        machine: Path = request.getfixturevalue("bare_machine")
        (machine / "bin" / "env").symlink_to(shutil.which("env") or "/usr/bin/env")


def test_missing_compiler_and_headers_are_named_with_the_line_that_installs_them(
    bare_machine: Path,
) -> None:
    pretend(bare_machine, "python3.12", "3.12;dev venv")
    result = run_setup(bare_machine, "python3.12")
    assert result.returncode != 0
    assert "Not found: c++" in result.stdout
    assert "sudo apt-get install build-essential python3.12-dev python3.12-venv" in result.stdout, (
        result.stdout
    )


def test_unsupported_python_is_named_with_the_versions_that_are(bare_machine: Path) -> None:
    pretend(bare_machine, "python3.9", "3.9;")
    result = run_setup(bare_machine, "python3.9")
    assert result.returncode != 0
    assert "No Python 3.11, 3.12 or 3.13 found at PYTHON=python3.9" in result.stdout


@pytest.mark.parametrize(
    ("system", "libc"),
    [
        ("Darwin arm64", "glibc 2.36"),
        ("Linux aarch64", "glibc 2.36"),
        ("Linux x86_64", "glibc 2.17"),
    ],
)
def test_platform_without_wheels_is_sent_to_apt(bare_machine: Path, system: str, libc: str) -> None:
    pretend(bare_machine, "uname", system)
    pretend(bare_machine, "getconf", libc)
    result = run_setup(bare_machine, "python3.12")
    assert result.returncode != 0
    assert "Linux on x86_64 with glibc 2.28 or newer" in result.stdout
    assert "colcon build" in result.stdout
    assert not (bare_machine / ".venv").exists()


@pytest.fixture(scope="module")
def workspace() -> Path:
    """The repository, set up."""
    if (
        not (REPOSITORY / ".venv" / ".tissue_stamp").is_file()
        or not (REPOSITORY / "tissue").is_file()
    ):
        pytest.skip("this checkout was not set up: make setup")
    return REPOSITORY


def test_second_setup_does_nothing_and_is_quick(workspace: Path) -> None:
    def run() -> str:
        script = workspace / "scripts" / "setup.sh"
        return subprocess.run(
            ["bash", script], capture_output=True, text=True, check=True, timeout=250
        ).stdout

    run()
    stamps = {path: path.stat().st_mtime_ns for path in (workspace / "build/stamps").iterdir()}
    started = time.monotonic()
    assert run() == ""
    assert time.monotonic() - started < 10.0
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps


IMPORT_ALL = """
import importlib, sys
for name in sys.argv[1:]:
    print(importlib.import_module(name).__file__)
"""


def test_every_module_is_importable_from_the_installation_alone(
    workspace: Path, tmp_path: Path
) -> None:
    names = sorted(modules())
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(
        [
            "bash",
            "-c",
            '. "$0/scripts/env.sh" && exec python -P -c "$@"',
            workspace,
            IMPORT_ALL,
            *names,
        ],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=250,
    )
    assert result.returncode == 0, result.stderr
    for name, file in zip(names, result.stdout.split(), strict=True):
        package = name.partition(".")[0]
        assert package in PYTHON_PACKAGES
        assert file.startswith(str(workspace / "install" / package)), name
