"""`tissue run`: a session on a scene or on any mesh, until Ctrl-C or for some frames."""

from __future__ import annotations

import contextlib
import re
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from tissue_sim.default_procedure import tool_parameters, write_default_procedure
from tissue_sim.elastic import registry
from tissue_sim.free_domain import choose_domain
from tissue_sim.geometry.scene_geometry import load, suggest_interaction
from tissue_sim.geometry.sheet_geometry import KINDS
from tissue_sim.launcher import Launcher, LaunchError, describe_exit
from tissue_sim.run_report import print_report, read_report
from tissue_sim.scene import Scene
from tissue_sim.scene_file import SIMULATION, SceneFile, find_scene, is_mesh_file
from tissue_sim.session import (
    BAG,
    SCRIPT,
    SIMULATION_PROCESS,
    TABLE,
    SessionPlan,
    check_page_address,
    check_second_model,
    end_session,
    start_session,
    tools_of,
)
from tissue_sim.simulation_parameters import shape_of, sheet_settings

RATE_HZ = 60.0
STATE_HZ = 10.0
"""Positions that a bag keeps a second if nobody says how many."""

HEADLESS_SECONDS = 10.0
"""Length of a headless run that is told nothing else."""

SLOWEST = 0.02
"""Share of real time below which a run of some frames is given up."""

SCRIPT_ENDS_WITHIN = 5.0
"""Longest wait for a script that has played all of its procedure to end [s]."""

console = Console(highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class RunOptions:
    """What `tissue run` was told.

    Attributes:
        scene: Scene, scene file or mesh file.
        units: Unit of a mesh file.
        fixed: Nodes that never move; empty: as the scene says.
        model: Elastic model; empty: as the scene says.
        kind: What the geometry is made of (`geometry.sheet_geometry.KINDS`); empty: as the scene
            says.
        headless: Without page and viewer; a procedure is played.
        frames: Frames to run; 0: no limit.
        seconds: Seconds to run; 0: no limit.
        procedure: Procedure to play; None: the default one when headless.
        out: Folder to write.
        bag: Whether to record a bag.
        record_state_hz: Positions that it keeps a second.
        recording: Whether to record for rerun.
        viewer: Whether to open rerun's viewer.
        difference: Second model to compare the session with (`compare.subject.parse_subject`);
            empty: none.
        readings: Whether stress, strain and risk regions are told.
        bind: Address the page listens on; empty: loopback.
    """

    scene: str
    units: str
    fixed: str
    model: str
    kind: str
    headless: bool
    frames: int
    seconds: float
    procedure: Path | None
    out: Path
    bag: bool
    record_state_hz: float
    recording: bool
    viewer: bool
    readings: bool = False
    difference: str = ""
    bind: str = ""


def run_scene(options: RunOptions) -> int:
    """Run a session and print what came of it; the exit code."""
    plan, frames = plan_run(options)
    domain = choose_domain()
    console.print(f"{plan.scene.name} in ROS domain {domain}; logs in {plan.out / 'logs'}")
    problems: list[str] = []
    with Launcher(plan.out / "logs") as launcher:
        start_session(launcher, plan)
        try:
            _stay(launcher, plan, frames)
            problems = _script_problems(launcher)
        except KeyboardInterrupt:
            console.print("ending")
            if frames:
                raise
        finally:
            end_session(launcher)
    if not options.headless:
        return 0
    report = read_report(plan)
    report.problems += problems
    print_report(console, plan, report)
    return 0 if report.good else 1


def plan_run(options: RunOptions) -> tuple[SessionPlan, int]:
    """What takes part in a run, and its frames (0: no limit).

    Raises:
        ValueError: Something in the options is wrong; nothing has been started.
    """
    changes: dict[str, Any] = {}
    if options.model:
        registry.parameters_of(options.model)
        changes["model"] = options.model
    if options.kind:
        if options.kind not in KINDS:
            raise ValueError(f"unknown kind {options.kind!r}; allowed: {', '.join(KINDS)}")
        changes["geometry_kind"] = options.kind
    if options.fixed:
        changes["fixed"] = options.fixed
    if options.procedure is not None:
        tools_of(options.procedure)
    if options.difference:
        check_second_model(options.difference)
    extra: dict[str, dict[str, Any]] = {BAG: {"record_state_hz": float(options.record_state_hz)}}
    if options.bind:
        if options.headless:
            raise ValueError("--bind is for the page, and with --headless there is none")
        check_page_address(options.bind)
        extra[TABLE] = {"host": options.bind}
    viewer = options.viewer and not options.headless
    frames = options.frames or round(options.seconds * RATE_HZ)
    if options.headless and not frames and options.procedure is None:
        frames = round(HEADLESS_SECONDS * RATE_HZ)
    if frames:
        changes["frames"] = frames
    procedure = options.procedure
    if is_mesh_file(options.scene):
        changes |= {
            "geometry": str(Path(options.scene).resolve()),
            "units": options.units,
            "fixed": options.fixed or "auto",
        }
        scene = SceneFile(Path(options.scene).stem, {SIMULATION: {}})
        needs_place = True
    else:
        scene = find_scene(options.scene)
        needs_place = options.headless and procedure is None
    if needs_place:
        chosen, procedure = _suggested(options, scene.with_simulation(changes), frames)
        changes |= chosen
    plan = SessionPlan(
        scene=scene.with_simulation(changes),
        out=empty_folder(options.out),
        procedure=procedure if options.headless or options.procedure else None,
        clock="simulation" if options.headless else "wall",
        bag=options.bag,
        extra=extra,
        # What is compared is to be seen somewhere.
        recording=options.recording or (bool(options.difference) and not viewer),
        viewer=viewer,
        page=not options.headless,
        monitor=options.headless,
        difference=options.difference,
        readings=options.readings,
    )
    return plan, frames


def _suggested(
    options: RunOptions, scene: SceneFile, frames: int
) -> tuple[dict[str, Any], Path | None]:
    """Tools for a geometry nobody has chosen any for, and the default procedure when headless."""
    values = scene.simulation
    sheet = sheet_settings(values)
    geometry = load(
        values["geometry"],
        values.get("units", ""),
        values.get("fixed", "auto"),
        parameters=shape_of(values),
        sheet=sheet,
    )
    model = values.get("model", Scene.model)
    registry.parameters_of(model)
    registry.check_geometry(model, geometry.mesh)
    for line in geometry.report.lines():
        console.print(f"  {line}", markup=False)
    interaction = suggest_interaction(geometry.mesh)
    tools = tool_parameters(interaction, values.get("tools", []))
    if not options.headless or options.procedure is not None:
        return tools, options.procedure
    procedure = options.out / "procedure.yaml"
    seconds = (frames or HEADLESS_SECONDS * RATE_HZ) / float(values.get("rate_hz", RATE_HZ))
    write_default_procedure(procedure, interaction, seconds)
    return tools, procedure


def empty_folder(out: Path) -> Path:
    """The folder to write, without what an earlier session left there."""
    out.mkdir(parents=True, exist_ok=True)
    for name in ("session", "logs"):
        shutil.rmtree(out / name, ignore_errors=True)
    for name in ("session.rrd", "monitor.json", "script.json", "parameters.yaml"):
        (out / name).unlink(missing_ok=True)
    return out


def _stay(launcher: Launcher, plan: SessionPlan, frames: int) -> None:
    """Wait until the run is over."""
    if plan.page:
        print_page(launcher, plan)
    if frames:
        rate = float(plan.scene.simulation.get("rate_hz", RATE_HZ))
        patience = 300.0 + frames / rate / SLOWEST
        _must_be_good(
            launcher, SIMULATION_PROCESS, launcher.wait_for_end(SIMULATION_PROCESS, patience)
        )
    elif plan.procedure is not None:
        _must_be_good(launcher, SCRIPT, launcher.wait_for_end(SCRIPT))
    else:
        while True:
            launcher.check()
            time.sleep(0.2)


def _script_problems(launcher: Launcher) -> list[str]:
    """What a script did wrong that has ended by itself; requests it reports itself are left out."""
    script = launcher.processes.get(SCRIPT)
    if script is None:
        return []
    with contextlib.suppress(LaunchError):
        launcher.wait_for_end(SCRIPT, SCRIPT_ENDS_WITHIN)
    if script.exit_code == 0:
        return []
    if script.exit_code is None:
        return ["the run ended before the procedure was over"]
    return [f"the procedure failed: {script.last_words(1)}"]


def _must_be_good(launcher: Launcher, name: str, code: int) -> None:
    if code:
        words = launcher.processes[name].last_words()
        raise LaunchError(f"{name} ended with {describe_exit(code)}\n{words}")


def print_page(launcher: Launcher, plan: SessionPlan) -> None:
    """Show the page's addresses."""
    take_part, watch = page_addresses(launcher, plan)
    console.print(f"Open [bold]{take_part}[/bold] to operate; every window is another person.")
    console.print(f"Who opens {watch} only watches. Ctrl-C ends it.")


def page_addresses(launcher: Launcher, plan: SessionPlan) -> tuple[str, str]:
    """What to open to take part, and what to watch: the page's node prints it, tokens included."""
    log = plan.out / "logs" / f"{TABLE}.log"

    def addresses() -> list[str]:
        return re.findall(r"http://\S+token=\S+", log.read_text(encoding="utf-8", errors="replace"))

    launcher.wait(lambda: log.is_file() and len(addresses()) > 1, 120.0, "the page's addresses")
    take_part, watch = addresses()[:2]
    return take_part, watch
