"""`tissue replay --watch`: a session that plays a recording, until people take over or it ends."""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from tissue_sim.free_domain import choose_domain
from tissue_sim.launcher import Launcher
from tissue_sim.playback.clock import checked_rate
from tissue_sim.playback.recorded_states import RecordedStates
from tissue_sim.playback.recording import Recording, read_recording
from tissue_sim.runner import RATE_HZ, STATE_HZ, empty_folder, print_page
from tissue_sim.scene_file import SIMULATION, SceneFile, find_scene
from tissue_sim.session import BAG, SessionPlan, end_session, start_session
from tissue_sim.terminal_keys import pressed_keys
from tissue_sim.watching_keys import HELP, act_on, status_line

if TYPE_CHECKING:
    from tissue_sim.playback_client import PlaybackClient

PARAMETERS = (
    "frame_id", "rate_hz", "budget_ms", "steps_per_frame", "realtime_priority", "data_dir",
    "max_tool_speed", "max_jump", "pose_timeout", "release_timeout",
    "max_force", "max_torque", "max_force_rate", "max_torque_rate",
)  # fmt: skip
"""Parameters of the recorded simulation that hold for what people do after a take-over."""

SAME_BITS = ("git_revision", "machine", "system", "python")
"""What must be as it was recorded for the same bits."""

POLL = 0.05
PATIENCE = 300.0
"""Longest wait for the recording to begin [s]."""

console = Console(highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class WatchOptions:
    """What `tissue replay --watch` was told.

    Attributes:
        bag: What is played.
        out: Folder to write.
        namespace: Namespace of the organ in the bag; None if there is only one.
        scene: Scene that it must be of; empty: any.
        rate: Recorded seconds a second.
        loop: Whether it begins again at its end.
        headless: Without page.
        viewer: Whether rerun's viewer is opened.
        states: Whether recorded states are shown, not simulated.
        memory_mb: For states to go back to [MB].
    """

    bag: Path
    out: Path
    namespace: str | None = None
    scene: str = ""
    rate: float = 1.0
    loop: bool = False
    headless: bool = False
    viewer: bool = False
    states: bool = False
    memory_mb: float = 1024.0


def watch(options: WatchOptions) -> int:
    """Play a recording to people; the exit code.

    Raises:
        ValueError: Something in the options is wrong; nothing has been started.
    """
    recording = read_recording(options.bag, options.namespace)
    plan = plan_watch(options, recording)
    watched = plan.out / "watched"
    shutil.rmtree(watched, ignore_errors=True)
    for line in told_differences(options.bag):
        console.print(line, markup=False)
    domain = choose_domain()
    console.print(f"{recording} of {recording.organ}", markup=False)
    console.print(f"in ROS domain {domain}; logs in {plan.out / 'logs'}", markup=False)
    from tissue_sim.playback_client import PlaybackClient

    with Launcher(plan.out / "logs") as launcher:
        start_session(launcher, plan)
        try:
            if plan.page:
                print_page(launcher, plan)
            with PlaybackClient() as client:
                _stay(launcher, client)
        except KeyboardInterrupt:
            console.print("ending")
        finally:
            end_session(launcher)
    _keep_branch(options, watched, plan.bag_folder)
    return 0


def plan_watch(options: WatchOptions, recording: Recording) -> SessionPlan:
    """What takes part.

    Raises:
        ValueError: The recording is of another organ than the scene, the rate is not allowed, or
            the bag has too few states to show.
    """
    if options.states:
        RecordedStates(options.bag, options.namespace, recording)
    scene = SceneFile(recording.name, {SIMULATION: {}})
    if options.scene:
        scene = find_scene(options.scene)
        organ = Path(str(scene.simulation.get("geometry", "wall"))).stem
        if organ != recording.organ:
            raise ValueError(
                f"{options.bag} is a session on {recording.organ}, the scene {options.scene} is "
                f"{organ}: the same organ is needed"
            )
    parameters: dict[str, Any] = {
        **recorded_parameters(options.bag),
        "playback.bag": str(options.bag.resolve()),
        "playback.rate": checked_rate(options.rate),
        "playback.loop": options.loop,
        "playback.states": options.states,
        "playback.memory_mb": float(options.memory_mb),
    }
    if options.namespace:
        parameters["playback.namespace"] = options.namespace
    out = empty_folder(options.out)
    return SessionPlan(
        scene=SceneFile(scene.name, {**scene.parameters, SIMULATION: parameters}),
        out=out,
        extra={BAG: {"bag": str(out / "watched"), "record_state_hz": STATE_HZ}},
        recording=False,
        viewer=options.viewer and not options.headless,
        page=not options.headless,
        monitor=False,
    )


def recorded_parameters(bag: Path) -> dict[str, Any]:
    """How the recorded simulation treated those that moved its tools, as far as the bag says."""
    from viz_bridge.bag_reader import attachments

    kept = attachments(bag).get("parameters.json", b"{}")
    try:
        values: dict[str, Any] = next(iter(json.loads(kept).values()), {})
    except (ValueError, AttributeError):
        return {}
    chosen = (*PARAMETERS, *(name for name in values if name.startswith("frames.")))
    return {name: values[name] for name in chosen if name in values}


def told_differences(bag: Path) -> list[str]:
    """What a person should know who expects the same bits."""
    from viz_bridge.bag_reader import metadata_of
    from viz_bridge.provenance import provenance

    there, here = metadata_of(bag), provenance()
    other = [name for name in SAME_BITS if there.get(name, here[name]) != here[name]]
    lines = [f"recorded with {name} {there[name]}, played with {here[name]}" for name in other]
    if lines:
        lines.append("so frames may not come out bit for bit as recorded; it is said if one is not")
    return lines


def _stay(launcher: Launcher, client: PlaybackClient) -> None:
    """Show how far it is and do what keys say, until it is over."""

    def begun() -> bool:
        client.poll(POLL)
        return client.playback is not None

    launcher.wait(begun, PATIENCE, "the beginning of the recording")
    with pressed_keys() as keys, _shown() as show:
        if console.is_terminal:
            console.print(HELP)
        while True:
            launcher.check()
            client.poll(POLL)
            show(client)
            for key in keys():
                if not act_on(key, client):
                    return
            watched = client.playback is not None and not client.playback.branch
            if client.at_end and watched and not sys.stdin.isatty():
                return


@contextlib.contextmanager
def _shown() -> Iterator[Any]:
    """Gives what shows how far it is: a bar on a terminal, a line now and then elsewhere."""
    if not console.is_terminal:
        told: list[str] = []

        def line(client: PlaybackClient) -> None:
            said = status_line(client, coarse=True)
            for text in (*client.said, *([said] if said not in told[-1:] else ())):
                console.print(text, markup=False)
            told.append(said)
            client.said.clear()

        yield line
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(bar_width=24))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def move(client: PlaybackClient) -> None:
            for text in client.said:
                console.print(text, markup=False)
            client.said.clear()
            told = client.playback
            if told is not None:
                share = client.time / max(told.duration, 1.0 / RATE_HZ)
                bar.update(task, completed=share, description=status_line(client))

        yield move


def _keep_branch(options: WatchOptions, watched: Path, target: Path) -> None:
    """Make the bag of the branch, if people took over; what was only watched is not kept."""
    from viz_bridge.bag_cli import progress_of
    from viz_bridge.branch_bag import write_branch

    with progress_of("writing the branch", None) as advance:
        point = write_branch(options.bag, watched, target, options.namespace, advance)
    shutil.rmtree(watched)
    if point is None:
        console.print("nobody took over: nothing is kept")
    else:
        console.print(
            f"{target}: branch {point.branch.hex()[:8]} of {options.bag}, "
            f"after its frame {point.frame}",
            markup=False,
        )
