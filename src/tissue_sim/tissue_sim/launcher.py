"""Starts processes, watches them and ends them together.

Every process is the leader of a group of its own, so that its children end with it, and Ctrl-C at
the terminal reaches the launcher only, which then ends the others in order. Should the launcher
itself be killed, the kernel signals the processes it started (PR_SET_PDEATHSIG) and a guardian
process ends whole groups.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

import psutil

from tissue_sim import guardian

PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None, use_errno=True)
POLL_SECONDS = 0.05
IDLE_LOOKS = 50


class LaunchError(RuntimeError):
    """A process could not be started, or ended when it should not have."""


@dataclass(frozen=True)
class ProcessSpec:
    """A process to start.

    Attributes:
        name: What people call it; also the name of its log.
        command: Program and arguments.
        niceness: 0 to 19: how far it stands back for others.
        environment: Variables it gets besides the launcher's.
        needed: Whether the end of this process is an error while the others run.
        patience: Seconds it may take to end by itself after SIGINT, and again after SIGTERM.
    """

    name: str
    command: Sequence[str]
    niceness: int = 0
    environment: Mapping[str, str] = field(default_factory=dict)
    needed: bool = True
    patience: float = 6.0


def module_command(module: str, *arguments: str) -> list[str]:
    """The command that runs a Python module with this interpreter."""
    return [sys.executable, "-m", module, *arguments]


@dataclass
class RunningProcess:
    """A process that was started.

    Attributes:
        spec: What was asked for.
        popen: The process; it leads a group of its own.
        log: File with its output.
        cpu_seconds: Processor time it had used when last looked at [s].
        ended: Monotonic time its end was noticed [s]; None while it runs.
        started: Monotonic time it was started [s].
    """

    spec: ProcessSpec
    popen: subprocess.Popen[bytes]
    log: Path
    started: float
    cpu_seconds: float = 0.0
    ended: float | None = None

    @property
    def exit_code(self) -> int | None:
        """Its exit code; None while it runs, negative if a signal ended it."""
        return self.popen.poll()

    @property
    def cpu_share(self) -> float:
        """Processor time per second it ran: 1 is one core."""
        return self.cpu_seconds / max((self.ended or time.monotonic()) - self.started, 1e-9)

    def last_words(self, lines: int = 8) -> str:
        """The end of its log."""
        try:
            text = self.log.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""
        return "\n".join(text.strip().splitlines()[-lines:])


class Launcher:
    """Processes that live and end together. Use it as a context manager.

    Attributes:
        processes: By name, in the order they were started.
        logs: Folder of their output.
    """

    def __init__(self, logs: Path) -> None:
        """Prepare.

        Args:
            logs: Folder for one log per process; made when missing.
        """
        self.logs = logs
        self.processes: dict[str, RunningProcess] = {}
        self._guardian: subprocess.Popen[bytes] | None = None
        self._previous: dict[int, object] = {}

    def __enter__(self) -> Launcher:
        self.logs.mkdir(parents=True, exist_ok=True)
        self._guardian = subprocess.Popen(
            [sys.executable, "-S", "-E", guardian.__file__],
            stdin=subprocess.PIPE,
            start_new_session=True,
        )
        for number in (signal.SIGTERM, signal.SIGHUP):
            self._previous[number] = signal.signal(number, _interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        try:
            with _uninterrupted():
                self.stop()
        finally:
            for number, handler in self._previous.items():
                signal.signal(number, handler)  # type: ignore[arg-type]
            if self._guardian is not None and self._guardian.stdin is not None:
                with contextlib.suppress(BrokenPipeError):
                    self._guardian.stdin.close()
                self._guardian.wait()

    def start(self, spec: ProcessSpec) -> RunningProcess:
        """Start a process.

        Raises:
            LaunchError: The program cannot be run.
        """
        log = self.logs / f"{spec.name}.log"
        try:
            with log.open("ab") as output:
                popen = subprocess.Popen(
                    list(spec.command),
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    env={**os.environ, "PYTHONUNBUFFERED": "1", **spec.environment},
                    preexec_fn=_child_set_up(os.getpid(), spec.niceness),
                    start_new_session=True,
                )
        except (OSError, subprocess.SubprocessError) as error:
            raise LaunchError(f"{spec.name}: {spec.command[0]} cannot be run: {error}") from None
        self._tell_guardian("started", popen.pid)
        process = RunningProcess(spec, popen, log, time.monotonic())
        self.processes[spec.name] = process
        return process

    def check(self) -> None:
        """Look at every process.

        Raises:
            LaunchError: One that is needed has ended; the message holds its last words.
        """
        for name, process in self.processes.items():
            self._measure(process)
            code = process.exit_code
            if code is not None and process.spec.needed:
                raise LaunchError(
                    f"{name} ended with {describe_exit(code)}; its log is {process.log}\n"
                    f"{process.last_words()}"
                )

    def wait(self, until: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait for a condition while all processes are needed.

        Raises:
            LaunchError: A needed process ended, or the time was over.
        """
        deadline = time.monotonic() + seconds
        while not until():
            self.check()
            if time.monotonic() > deadline:
                raise LaunchError(f"{what} did not happen within {seconds:g} s")
            time.sleep(POLL_SECONDS)

    def wait_for_end(self, name: str, seconds: float | None = None) -> int:
        """Wait until one process has ended by itself, and return its exit code.

        Raises:
            LaunchError: Another needed process ended before, or the time was over.
        """
        process = self.processes[name]
        process.spec = _not_needed(process.spec)
        limit = float("inf") if seconds is None else seconds
        self.wait(lambda: process.exit_code is not None, limit, f"the end of {name}")
        code = process.exit_code
        return 1 if code is None else code

    def wait_until_idle(self, seconds: float, *names: str) -> bool:
        """Wait until processes have nothing to do; whether they have not before the time was over.

        A process is idle when, for half a second, it was asleep nearly always: one that is starved
        by others uses no processor time either, but is not asleep.
        """
        deadline = time.monotonic() + seconds
        looks, awake = 0, 0
        while looks < IDLE_LOOKS:
            if time.monotonic() > deadline:
                return False
            looks += 1
            awake += any(_is_awake(self.processes[name].popen) for name in names)
            if awake > IDLE_LOOKS // 8:
                looks, awake = 0, 0
            time.sleep(POLL_SECONDS / 5)
        return True

    def stop(self, *names: str) -> None:
        """End processes, all if none is named: SIGINT, then SIGTERM, then SIGKILL."""
        chosen = [self.processes[name] for name in names] or list(self.processes.values())
        chosen.reverse()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            running = [process for process in chosen if self._group_alive(process)]
            for process in running:
                self._measure(process)
                guardian.signal_group(process.popen.pid, number)
            asked = time.monotonic()
            while any(
                time.monotonic() < asked + process.spec.patience and self._group_alive(process)
                for process in running
            ):
                time.sleep(POLL_SECONDS / 5)
        for process in chosen:
            self._tell_guardian("ended", process.popen.pid)

    def _group_alive(self, process: RunningProcess) -> bool:
        self._measure(process)
        process.popen.poll()
        return guardian.alive(process.popen.pid)

    def _measure(self, process: RunningProcess) -> None:
        if process.popen.poll() is not None:
            process.ended = process.ended or time.monotonic()
            return
        with contextlib.suppress(psutil.Error):
            times = psutil.Process(process.popen.pid).cpu_times()
            process.cpu_seconds = times.user + times.system

    def _tell_guardian(self, word: str, group: int) -> None:
        if self._guardian is not None and self._guardian.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._guardian.stdin.write(f"{word} {group}\n".encode())
                self._guardian.stdin.flush()


def _is_awake(popen: subprocess.Popen[bytes]) -> bool:
    """Whether a thread of a process runs or waits for a processor."""
    for thread in Path(f"/proc/{popen.pid}/task").glob("*/stat"):
        with contextlib.suppress(OSError):
            if thread.read_text().rpartition(")")[2].split()[0] in "RD":
                return True
    return False


def describe_exit(code: int) -> str:
    """An exit code in words."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"


def _child_set_up(launcher: int, niceness: int) -> Callable[[], None]:
    def set_up() -> None:
        _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGINT, 0, 0, 0)
        if os.getppid() != launcher:  # the launcher died before the line above
            os._exit(1)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if niceness:
            os.nice(niceness)

    return set_up


def _not_needed(spec: ProcessSpec) -> ProcessSpec:
    return ProcessSpec(
        spec.name, spec.command, spec.niceness, spec.environment, False, spec.patience
    )


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """A second Ctrl-C must not keep the processes from being ended."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    previous = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
