"""`tissue replay`."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress

from tissue_sim.elastic import registry
from tissue_sim.operation_report import OperationReport, operation_report
from tissue_sim.session_bag import RecordedEpoch, read_epochs
from tissue_sim.watching import WatchOptions
from tissue_sim.watching import watch as watch_recording

console = Console(highlight=False, soft_wrap=True)


def replay(
    bag: Annotated[Path, typer.Argument(help="Bag directory or MCAP file.")],
    model: Annotated[str, typer.Option(help="Run another model instead.")] = "",
    out: Annotated[
        Path | None,
        typer.Option(help="File for the final positions; default beside the bag."),
    ] = None,
    namespace: Annotated[str | None, typer.Option(help="Namespace of the organ.")] = None,
    watch: Annotated[
        bool, typer.Option("--watch", "-w", help="Play it to people, who can take over.")
    ] = False,
    rate: Annotated[
        float, typer.Option(help="With --watch: recorded seconds a second, 0.05 to 20.")
    ] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="With --watch: begin again at the end.")] = (
        False
    ),
    headless: Annotated[bool, typer.Option("--headless", help="With --watch: no page.")] = False,
    viewer: Annotated[
        bool, typer.Option("--viewer", help="With --watch: open rerun's viewer.")
    ] = False,
    states: Annotated[
        bool, typer.Option("--states", help="With --watch: show recorded states, not simulated.")
    ] = False,
    scene: Annotated[
        str, typer.Option(help="With --watch: scene that the session must be of.")
    ] = "",
    memory_mb: Annotated[
        float, typer.Option(min=0.0, help="With --watch: for states to go back to [MB].")
    ] = 1024.0,
) -> None:
    """Simulate a recorded session again from its journal.

    Says whether every frame came out as recorded, bit for bit, and writes the final positions in m.
    With another model there is nothing to compare: it shows what that model does with the same
    hands. Exit code 1 if a frame came out differently.

    With --watch it is played on the page, as fast as wished, and at any moment people take over
    its tools: then --out is the folder of the new session (docs/playback.md).
    """
    if watch:
        if model:
            raise ValueError("--watch plays the recorded model; --model is for without it")
        folder = out or Path("out/watch") / datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
        raise typer.Exit(
            watch_recording(
                WatchOptions(
                    bag, folder, namespace, scene, rate, loop, headless, viewer, states, memory_mb
                )
            )
        )
    if model:
        registry.parameters_of(model)
    _print_branch(bag)
    epochs = read_epochs(bag, namespace)
    identical = True
    for number, epoch in enumerate(epochs):
        report = _replayed(epoch, model)
        identical &= not report.mismatches
        _print(epoch, report, model)
        _write(_file_of(bag, out, model, number, len(epochs)), epoch, report)
    raise typer.Exit(0 if identical else 1)


def _print_branch(bag: Path) -> None:
    """Say where a session began as another one."""
    from viz_bridge.bag_reader import metadata_of

    told = metadata_of(bag)
    if "branch" in told:
        console.print(
            f"branch {told['branch'][:8]} of {told['parent_bag']}, after its frame "
            f"{told['branch_frame']}",
            markup=False,
        )


def _replayed(epoch: RecordedEpoch, model: str) -> OperationReport:
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task(f"epoch {epoch.epoch.hex()[:8]}", total=len(epoch.entries))
        return operation_report(
            epoch.entries,
            epoch.start,
            model or None,
            on_frame=lambda frame: progress.update(task, completed=frame),
            holes=tuple(epoch.holes.values()),
        )


def _print(epoch: RecordedEpoch, report: OperationReport, model: str) -> None:
    console.print(
        f"epoch {epoch.epoch.hex()[:8]} of {epoch.organ}: {report.frames} frames, "
        f"{report.steps} steps, {len(report.grabs)} grabs, {len(report.cuts)} cuts"
        + (f", {len(report.patches)} patches" if report.patches else ""),
        markup=False,
    )
    if model:
        console.print(f"final positions are those of model {model}; nothing to compare")
    elif report.mismatches:
        console.print(
            f"final positions are not bit-identical: {len(report.mismatches)} frames differ, "
            f"the first is frame {report.mismatches[0]}"
        )
    else:
        console.print("final positions are bit-identical to the recorded session's")
    for hole in report.holes:
        console.print(f"hole {hole.hole.name} at the end: {hole}", markup=False)
    if not report.finite:
        console.print("some positions are not finite")


def _file_of(bag: Path, out: Path | None, model: str, number: int, count: int) -> Path:
    name = f"replayed{f'_{model}' if model else ''}.npz"
    file = out or bag.resolve().parent / name
    return file if count == 1 else file.with_stem(f"{file.stem}_{number + 1}")


def _write(file: Path, epoch: RecordedEpoch, report: OperationReport) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        file,
        positions=report.positions,
        frames=report.frames,
        epoch=np.frombuffer(epoch.epoch, dtype=np.uint8),
    )
    console.print(f"wrote {file}", markup=False)
