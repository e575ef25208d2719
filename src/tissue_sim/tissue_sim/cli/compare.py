"""`tissue compare`."""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from tissue_sim.cli.subject_options import (
    DefaultEffort,
    Fixed,
    Kind,
    Machine,
    OrganName,
    Poisson,
    Targets,
    Units,
    Young,
    organ_of,
    subjects_of,
    with_efforts,
)
from tissue_sim.compare.comparison import Comparison
from tissue_sim.compare.comparison import compare as play_all
from tissue_sim.compare.report.text import print_comparison, print_summary
from tissue_sim.compare.sources.choose import interaction_from, reference_from
from tissue_sim.compare.sources.motions import MOTIONS
from tissue_sim.compare.sources.recorded import Recording
from tissue_sim.compare.subject import Subject, parse_subject
from tissue_sim.compare.trajectory import Trajectory
from tissue_sim.elastic import registry

console = Console(highlight=False)
progress_console = Console(stderr=True, highlight=False)

EXACT = "exact=finite_element:tolerance=1e-6@rest"
"""The reference if nobody names one."""
MEASURED = "measured"
"""The reference that is what the recording measured."""


def compare(
    organ: OrganName = None,
    interaction: Annotated[
        list[str] | None,
        typer.Option(
            "--interaction",
            "-i",
            help=f"A motion ({', '.join(MOTIONS)}; NAME:MILLIMETRES), a procedure (.yaml), an "
            "interaction or markers (.npz), or a bag; several times.",
        ),
    ] = None,
    reference: Annotated[
        str,
        typer.Option(
            "--reference", "-r", help='A model as in --target, a kept trajectory or "measured".'
        ),
    ] = EXACT,
    target: Targets = None,
    effort: DefaultEffort = "",
    machine: Machine = "",
    amplitude: Annotated[
        float | None, typer.Option(help="Of motions that have none of their own [mm].")
    ] = None,
    rate: Annotated[float, typer.Option(help="Frames a second.")] = 30.0,
    units: Units = "",
    fixed: Fixed = "",
    kind: Kind = "",
    young: Young = None,
    poisson: Poisson = None,
    namespace: Annotated[str | None, typer.Option(help="Namespace of a bag's organ.")] = None,
    epoch: Annotated[int | None, typer.Option(help="Epoch of a bag, counted from 1.")] = None,
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("out/compare"),
    pictures: Annotated[
        bool, typer.Option("--pictures/--no-pictures", help="Pictures in the report.")
    ] = True,
    rrd: Annotated[bool, typer.Option("--rrd", help="Also a recording for rerun.")] = False,
    keep: Annotated[
        bool, typer.Option("--keep", help="Also the interaction and all trajectories (.npz).")
    ] = False,
    show: Annotated[bool, typer.Option("--open", help="Open the report in a browser.")] = False,
) -> None:
    """How far models are from a reference, over time, under the same interaction.

    Prints the targets, the closest first, and writes report.html and result.json.
    """
    subjects = subjects_of(target)
    model = _model_of(reference)
    if not interaction:
        raise ValueError(
            "there is no interaction: name one with --interaction, for example --interaction "
            f"oblique; motions: {', '.join(MOTIONS)}"
        )
    named = organ_of(organ, units, fixed, kind, young, poisson)
    comparisons = []
    for text in interaction:
        recording = interaction_from(_with(text, amplitude), named, rate, namespace, epoch)
        for note in recording.notes:
            console.print(note, markup=False, soft_wrap=True)
        chosen = with_efforts(
            subjects, target or [], effort, machine, recording.organ, recording.interaction.rate_hz
        )
        comparisons.append(_compared(recording, reference, model, chosen))
        print_comparison(comparisons[-1], console)
        console.print()
    if len(comparisons) > 1:
        print_summary(comparisons, console)
        console.print()
    for file in _write(out, comparisons, pictures, rrd, keep):
        console.print(f"wrote {file}", markup=False, soft_wrap=True)
    if show:
        typer.launch(str((out / "report.html").resolve()))


def _model_of(reference: str) -> Subject | None:
    """The model that a reference is; None: it is a file, or was measured."""
    if reference == MEASURED or Path(reference).suffix.lower() == ".npz":
        return None
    return parse_subject(reference)


def _with(text: str, amplitude: float | None) -> str:
    """An interaction with the amplitude that all motions have."""
    return f"{text}:{amplitude!r}" if amplitude is not None and text in MOTIONS else text


def _compared(
    recording: Recording, reference: str, model: Subject | None, targets: list[Subject]
) -> Comparison:
    # Here, so that bad input is refused without waiting for it.
    from tissue_sim.compare.reference_cache import cached

    organ, interaction = recording.organ, recording.interaction
    frames = interaction.frames
    for subject in (*targets, *([] if model is None else [model])):
        registry.check_geometry(subject.model, organ.mesh)
    with _progress() as shown:
        if model is not None:
            task = shown.add_task(f"reference: {model.name}", total=frames)
            moved: Trajectory = cached(
                model, organ, interaction,
                on_frame=lambda frame: shown.update(task, completed=frame + 1),
            )  # fmt: skip
            shown.update(task, completed=frames)
        elif reference == MEASURED:
            moved = recording.reference()
        else:
            moved = reference_from(Path(reference), organ, interaction)
        tasks = {subject.name: shown.add_task(subject.name, total=frames) for subject in targets}
        compared = play_all(
            organ, interaction, moved, targets,
            lambda name, done, _: shown.update(tasks[name], completed=done),
        )  # fmt: skip
    return replace(compared, reference_subject=model)


def _progress() -> Progress:
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    return Progress(
        *columns, TimeElapsedColumn(), console=progress_console, transient=True,
        disable=not progress_console.is_terminal,
    )  # fmt: skip


def _write(
    out: Path, comparisons: list[Comparison], pictures: bool, rrd: bool, keep: bool
) -> list[Path]:
    # Here, because they take a second to import.
    from tissue_sim.compare.report.page import write_page
    from tissue_sim.compare.report.pictures import Pictures, draw
    from tissue_sim.compare.report.result import write_result

    command = "tissue " + shlex.join(sys.argv[1:])
    files = [out / "report.html", out / "result.json"]
    without = Pictures((), "No pictures: left out with --no-pictures.")
    write_page(files[0], comparisons, command, draw if pictures else lambda _: without)
    write_result(files[1], comparisons, command)
    for number, comparison in enumerate(comparisons):
        ending = f"_{number + 1}" if len(comparisons) > 1 else ""
        if rrd:
            from viz_bridge.comparison_rrd import write_rrd

            files.append(out / f"comparison{ending}.rrd")
            write_rrd(files[-1], comparison)
        if keep:
            files += _keep(out / f"trajectories{ending}", comparison)
    return files


def _keep(folder: Path, comparison: Comparison) -> list[Path]:
    """Write the interaction and all trajectories, to compare with them again."""
    comparison.interaction.save(folder / "interaction.npz")
    comparison.reference.save(folder / "reference.npz")
    for target in comparison.targets:
        name = re.sub(r"[^A-Za-z0-9_.=,-]+", "_", target.subject.name)
        target.trajectory.save(folder / f"target_{name}.npz")
    return [folder]
