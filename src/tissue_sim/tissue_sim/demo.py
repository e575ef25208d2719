"""`tissue demo`: a scripted operation on the heart in real time, and its summary and pictures."""

from __future__ import annotations

import os
import time
from pathlib import Path

from rich.console import Console

from tissue_sim.demo_summary import demo_summary, print_summary, write_summary
from tissue_sim.free_domain import choose_domain
from tissue_sim.launcher import Launcher, LaunchError
from tissue_sim.runner import empty_folder
from tissue_sim.scene_file import config_folder, find_scene
from tissue_sim.session import (
    BAG,
    MONITOR,
    RERUN,
    SCRIPT,
    SIMULATION_PROCESS,
    SessionPlan,
    end_session,
    start_session,
)

LONGEST_START = 180.0
"""Seconds the first start may take: kernels are compiled then."""

console = Console(highlight=False, soft_wrap=True)


def run_demo(out: Path, scene: str, procedure: Path | None, pictures: bool) -> int:
    """Operate, then write the summary and the pictures; the exit code."""
    began = time.monotonic()
    load_before = os.getloadavg()[0]
    plan = SessionPlan(
        scene=find_scene(scene),
        out=empty_folder(out),
        procedure=procedure or config_folder() / "procedures" / "demo.yaml",
    )
    domain = choose_domain()
    console.print(f"{plan.scene.name} in ROS domain {domain}; logs in {plan.out / 'logs'}")
    cpu_shares = operate(plan)
    if pictures:
        _draw(plan)
    summary = demo_summary(plan, cpu_shares, load_before)
    summary["wall_seconds"] = time.monotonic() - began
    write_summary(plan.out / "summary.json", summary)
    print_summary(console, summary)
    return 0


def operate(plan: SessionPlan, quiet: bool = False) -> dict[str, float]:
    """Run all processes of a session until its procedure is over.

    Args:
        plan: What takes part; it has a procedure.
        quiet: Whether to keep what the script says to its log.

    Returns:
        Share of a core each process used, by name.

    Raises:
        LaunchError: The procedure failed, or a process that is needed ended.
    """
    with Launcher(plan.out / "logs") as launcher:
        start_session(launcher, plan)
        _follow(launcher, plan, quiet)
        code = launcher.processes[SCRIPT].exit_code
        if code != 0:
            words = launcher.processes[SCRIPT].last_words()
            raise LaunchError(f"the procedure failed; its log ends with\n{words}")
        end_session(launcher)
        for name in (SIMULATION_PROCESS, BAG, RERUN, MONITOR):
            ended = launcher.processes.get(name)
            if ended is not None and ended.exit_code not in (0, None):
                console.print(f"{name} ended badly; its log ends with\n{ended.last_words()}")
        return {name: process.cpu_share for name, process in launcher.processes.items()}


def _follow(launcher: Launcher, plan: SessionPlan, quiet: bool) -> None:
    """Show what the script says until it is over."""
    log = plan.out / "logs" / f"{SCRIPT}.log"
    shown = 0

    def over() -> bool:
        nonlocal shown
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
        for line in lines[shown:]:
            _, found, text = line.partition("[script]: ")
            if found and not quiet:
                console.print(f"  {text}", markup=False)
        shown = len(lines)
        return launcher.processes[SCRIPT].exit_code is not None

    from tool_input.procedure import load_procedure

    seconds = load_procedure(Path(str(plan.procedure))).end
    launcher.wait(over, LONGEST_START + 3.0 * seconds, "the end of the procedure")


def _draw(plan: SessionPlan) -> None:
    from viz_bridge.pictures import render

    pictures = render(plan.bag_folder, plan.out)
    for file in pictures.files:
        console.print(f"  picture {file}", markup=False)
    if pictures.message:
        console.print(f"  {pictures.message}", markup=False)
