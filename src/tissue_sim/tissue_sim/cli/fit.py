"""`tissue fit`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from tissue_sim.cli.subject_options import Fixed, Kind, Poisson, Units, Young, organ_of
from tissue_sim.compare.sources.motions import MOTIONS

console = Console(highlight=False)
progress_console = Console(stderr=True, highlight=False)

SUFFIXES = (".yaml", ".yml")


def fit(
    what: Annotated[
        str | None,
        typer.Argument(
            help="A file of settings (.yaml), or the organ: a shape, a mesh file; left out: the "
            "organ of the recording.",
            show_default=False,
        ),
    ] = None,
    interaction: Annotated[
        list[str] | None,
        typer.Option(
            "--interaction", "-i",
            help=f"A motion ({', '.join(MOTIONS)}; NAME:MILLIMETRES), a procedure (.yaml), an "
            "interaction or markers (.npz), or a bag; several times.",
        ),
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            "--reference", "-r",
            help='A model as in --target, a kept trajectory or markers (.npz), or "measured".',
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option("--target", "-t", help="The model: MODEL[:VALUE=NUMBER,...][@EFFORT]."),
    ] = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range", help="What is looked for: VALUE=LOW..HIGH, or VALUE=LOW..HIGH:log; several."
        ),
    ] = None,
    strategy: Annotated[
        str | None,
        typer.Option(help="cma (CMA-ES; default) or ea (the thesis' evolutionary algorithm)."),
    ] = None,
    population: Annotated[int | None, typer.Option(help="Candidates of a generation.")] = None,
    generations: Annotated[int | None, typer.Option(help="Generations; default 30.")] = None,
    seed: Annotated[int | None, typer.Option(help="Of the random numbers; default 1.")] = None,
    processes: Annotated[
        int | None, typer.Option(help="Processes; default: one for each processor.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Instead: a Dask scheduler, such as tcp://host:8786.")
    ] = None,
    pareto: Annotated[
        str | None, typer.Option(help="Fitted at each of these steps a frame, such as 1,2,4,8.")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option(help="Error that is good enough, 1: the worst; default 0.25.")
    ] = None,
    landscape: Annotated[
        str | None, typer.Option(help="The error over two values: VALUE,VALUE[:POINTS].")
    ] = None,
    rate: Annotated[float | None, typer.Option(help="Frames a second; default 30.")] = None,
    units: Units = "",
    fixed: Fixed = "",
    kind: Kind = "",
    young: Young = None,
    poisson: Poisson = None,
    namespace: Annotated[str | None, typer.Option(help="Namespace of a bag's organ.")] = None,
    epoch: Annotated[int | None, typer.Option(help="Epoch of a bag, counted from 1.")] = None,
    out: Annotated[
        str | None, typer.Option(help="Folder to write; default out/fit/<time>.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the fit that is in --out.")
    ] = False,
) -> None:  # fmt: skip
    """The values with which a model comes closest to a reference, over time.

    Prints the best values and writes report.html and result.json. What a file of settings says and
    an option says too, the option decides. Interrupted, it goes on with --resume.
    """
    # Here, so that the command's help needs none of it.
    from tissue_sim.compare.fit.fit_report import write_report
    from tissue_sim.compare.fit.fit_text import print_fit
    from tissue_sim.compare.fit.outcome import run_fit
    from tissue_sim.compare.fit.settings import read_settings
    from tissue_sim.compare.fit.task import problem_of

    file = Path(what) if what is not None and Path(what).suffix.lower() in SUFFIXES else None
    options = {
        "organ": None if file else what, "interactions": interaction, "reference": reference,
        "target": target, "ranges": ranges, "strategy": strategy, "population": population,
        "generations": generations, "seed": seed, "processes": processes, "scheduler": scheduler,
        "pareto": pareto, "tolerance": tolerance, "landscape": landscape, "rate_hz": rate,
        "units": units or None, "fixed": fixed or None, "kind": kind or None, "young": young,
        "poisson": poisson, "namespace": namespace, "epoch": epoch, "out": out,
    }  # fmt: skip
    settings = read_settings(file, options)
    folder = _folder(settings.out, resume)
    organ = organ_of(
        settings.organ, settings.units, settings.fixed, settings.kind, settings.young,
        settings.poisson,
    )  # fmt: skip
    with _bar() as bar:
        problem = problem_of(settings, organ, bar.reference, _say)
        try:
            outcome = run_fit(settings, problem, folder, bar.told)
        except KeyboardInterrupt:
            progress_console.print(_how_to_resume(folder), markup=False, soft_wrap=True)
            raise
    print_fit(outcome, console)
    command = f"tissue {shlex.join(sys.argv[1:])}"
    files = (folder / "report.html", folder / "result.json")
    write_report(files[0], outcome, command)
    outcome.write(files[1], command)
    for written in files:
        _say(f"wrote {written}")


class _Bar:
    """A progress bar for each thing that is done, with the smallest error so far."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._tasks: dict[str, TaskID] = {}

    def told(self, what: str, done: int, of: int, error: float | None) -> None:
        """Show how far something is."""
        if what not in self._tasks:
            self._tasks[what] = self._progress.add_task(what, total=of, error="")
        words = "" if error is None else f"best {error:.3g}"
        self._progress.update(self._tasks[what], completed=done, error=words)

    def reference(self, name: str, done: int, of: int) -> None:
        """Show how far a reference is."""
        self.told(name, done, of, None)


@contextmanager
def _bar() -> Iterator[_Bar]:
    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(bar_width=20),
        TextColumn("{task.completed}/{task.total}"), TextColumn("{task.fields[error]}"),
        TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=progress_console) as progress:
        yield _Bar(progress)


def _folder(out: Path | None, resume: bool) -> Path:
    """The folder to write.

    Raises:
        ValueError: It holds a fit already, or there is nothing to resume.
    """
    from tissue_sim.compare.fit.outcome import CHECKPOINT

    if out is None:
        if resume:
            raise ValueError("--resume needs --out: the folder of the fit to go on with")
        return Path("out/fit") / datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
    there = sorted(path.name for path in out.glob("*")) if out.is_dir() else []
    if resume and CHECKPOINT not in there:
        raise ValueError(
            f"there is no fit to resume in {out}: it has no {CHECKPOINT}; it holds "
            f"{', '.join(there) or 'nothing'}"
        )
    if not resume and CHECKPOINT in there:
        raise ValueError(
            f"{out} holds a fit already; allowed: --resume to go on with it, or another --out"
        )
    return out


def _how_to_resume(folder: Path) -> str:
    """The command that goes on with an interrupted fit."""
    from tissue_sim.compare.fit.outcome import CHECKPOINT

    if not (folder / CHECKPOINT).exists():
        return "interrupted before the first generation was done: there is nothing to resume"
    words = ["tissue", *sys.argv[1:]]
    if "--out" not in words:
        words += ["--out", str(folder)]
    if "--resume" not in words:
        words += ["--resume"]
    return f"to go on: {shlex.join(words)}"


def _say(line: str) -> None:
    console.print(line, markup=False, soft_wrap=True)
