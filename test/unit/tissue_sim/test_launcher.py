"""Processes start together, end together and leave nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tissue_sim.free_domain import choose_domain, is_free, unicast_port
from tissue_sim.launcher import Launcher, LaunchError, ProcessSpec, describe_exit
from tissue_sim.session import PUBLICATION_MODE, TRANSPORT_VARIABLES, transport

SLEEPER = [sys.executable, "-c", "import time; time.sleep(600)"]
STUBBORN = ["sh", "-c", "trap '' INT TERM; sleep 600 & while true; do sleep 600; done"]

RUN = """
import sys, time
from pathlib import Path
from tissue_sim.launcher import Launcher, ProcessSpec
with Launcher(Path(sys.argv[1])) as launcher:
    for name in ("a", "b"):
        launcher.start(ProcessSpec(name, ["sh", "-c", {command!r}], patience=1.0))
    print(*[p.popen.pid for p in launcher.processes.values()], flush=True)
    time.sleep(600)
"""


def wait_for(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def group_is_empty(group: int) -> bool:
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                state, _, of = (entry / "stat").read_text().rpartition(")")[2].split()[:3]
            except OSError:
                continue
            if int(of) == group and state not in "ZX":
                return False
    return True


def test_leaving_ends_every_process_even_a_stubborn_one_with_children(tmp_path: Path) -> None:
    with Launcher(tmp_path) as launcher:
        launcher.start(ProcessSpec("polite", SLEEPER))
        launcher.start(ProcessSpec("stubborn", STUBBORN, patience=0.3))
        groups = [process.popen.pid for process in launcher.processes.values()]
        launcher.check()
        assert not any(group_is_empty(group) for group in groups)
    assert all(group_is_empty(group) for group in groups)
    assert launcher.processes["stubborn"].exit_code == -signal.SIGKILL
    assert launcher.processes["polite"].exit_code not in (0, None, -signal.SIGKILL)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_launcher_that_is_ended_leaves_no_process_behind(
    tmp_path: Path, number: signal.Signals
) -> None:
    script = RUN.format(command="trap '' INT TERM; sleep 600 & while true; do sleep 600; done")
    launcher = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell's background jobs ignore Ctrl-C, and so would what a test among them starts.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert launcher.stdout is not None
    groups = [int(word) for word in launcher.stdout.readline().split()]
    assert len(groups) == 2
    os.kill(launcher.pid, number)
    launcher.wait(timeout=30)
    launcher.stdout.close()
    wait_for(lambda: all(group_is_empty(group) for group in groups))


def test_end_of_a_needed_process_is_reported_with_its_last_words(tmp_path: Path) -> None:
    with Launcher(tmp_path) as launcher:
        launcher.start(ProcessSpec("failing", ["sh", "-c", "echo no fuel; exit 3"]))
        with pytest.raises(LaunchError, match=r"(?s)failing ended with exit code 3.*no fuel"):
            launcher.wait(lambda: False, 20.0, "anything")


def test_end_that_is_waited_for_is_no_error(tmp_path: Path) -> None:
    with Launcher(tmp_path) as launcher:
        launcher.start(ProcessSpec("short", ["sh", "-c", "exit 5"]))
        assert launcher.wait_for_end("short", 20.0) == 5


def test_wait_ends_when_time_is_over(tmp_path: Path) -> None:
    with (
        Launcher(tmp_path) as launcher,
        pytest.raises(LaunchError, match="a wonder did not"),
    ):
        launcher.wait(lambda: False, 0.2, "a wonder")


def test_program_that_is_not_there_is_reported(tmp_path: Path) -> None:
    with Launcher(tmp_path) as launcher, pytest.raises(LaunchError, match="cannot be run"):
        launcher.start(ProcessSpec("none", ["/no/such/program"]))


def test_niceness_and_environment_reach_the_process(tmp_path: Path) -> None:
    with Launcher(tmp_path) as launcher:
        command = ["sh", "-c", "echo $(nice) $FRUIT"]
        spec = ProcessSpec("child", command, niceness=3, environment={"FRUIT": "pear"})
        process = launcher.start(spec)
        assert launcher.wait_for_end("child", 20.0) == 0
        nice, fruit = process.last_words().split()
    assert int(nice) == min(19, os.nice(0) + 3)
    assert fruit == "pear"


def test_busy_process_is_not_idle_and_a_sleeping_one_is(tmp_path: Path) -> None:
    with Launcher(tmp_path) as launcher:
        launcher.start(ProcessSpec("busy", ["sh", "-c", "while true; do true; done"], niceness=10))
        launcher.start(ProcessSpec("asleep", ["sleep", "600"]))
        assert launcher.wait_until_idle(20.0, "asleep")
        assert not launcher.wait_until_idle(1.0, "busy", "asleep")


def test_exit_codes_in_words() -> None:
    assert describe_exit(2) == "exit code 2"
    assert describe_exit(-9) == "signal SIGKILL"


def test_domain_in_use_is_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    import socket

    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", unicast_port(57)))
        assert not is_free(57)
    assert is_free(57)
    assert is_free(choose_domain())


def test_domain_of_the_user_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert choose_domain() == 42


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        ({}, {"FASTDDS_BUILTIN_TRANSPORTS", "RMW_FASTRTPS_PUBLICATION_MODE"}),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "SHM"}, {"RMW_FASTRTPS_PUBLICATION_MODE"}),
        ({"FASTDDS_DEFAULT_PROFILES_FILE": "mine.xml"}, {"RMW_FASTRTPS_PUBLICATION_MODE"}),
        ({"RMW_FASTRTPS_PUBLICATION_MODE": "SYNCHRONOUS"}, {"FASTDDS_BUILTIN_TRANSPORTS"}),
    ],
)
def test_a_session_leaves_what_the_user_chose_of_the_transport(
    monkeypatch: pytest.MonkeyPatch, chosen: dict[str, str], expected: set[str]
) -> None:
    for name in (*TRANSPORT_VARIABLES, PUBLICATION_MODE):
        monkeypatch.delenv(name, raising=False)
    for name, value in chosen.items():
        monkeypatch.setenv(name, value)
    assert set(transport()) == expected
