"""`tissue report`."""

from __future__ import annotations

import shlex
import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from tissue_sim.report.motion import IDLE_SPEED
from tissue_sim.report.session import Session
from tissue_sim.report.study import Entry, named_apart, parse_entry, read_study, with_experts

console = Console(highlight=False)
progress_console = Console(stderr=True, highlight=False)


def report(
    bags: Annotated[
        list[str] | None,
        typer.Argument(help="Bags of sessions: BAG, BAG@PERSON or BAG@PERSON:SESSION."),
    ] = None,
    study: Annotated[
        Path | None, typer.Option(help="File with sessions, people and raters' scores (YAML).")
    ] = None,
    expert: Annotated[
        list[str] | None, typer.Option(help="Person or bag that is an expert's; several times.")
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(help="Where cuts were planned: lines, or a procedure with cuts (YAML)."),
    ] = None,
    hand: Annotated[
        list[str] | None,
        typer.Option(help="NAME=TOOL,TOOL: tools of a hand; default: each tool is a hand."),
    ] = None,
    idle_speed: Annotated[float, typer.Option(help="A tip slower than this is idle [mm/s].")] = 1e3
    * IDLE_SPEED,
    risk: Annotated[
        Path | None, typer.Option(help="Risk regions to watch afterwards (YAML or NPZ).")
    ] = None,
    namespace: Annotated[str | None, typer.Option(help="Namespace of the organ.")] = None,
    epoch: Annotated[
        int | None, typer.Option(help="Epoch, counted from 1; default: the longest.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("out/report"),
    pictures: Annotated[
        bool, typer.Option("--pictures/--no-pictures", help="Pictures of key moments.")
    ] = True,
    show: Annotated[bool, typer.Option("--open", help="Open the report in a browser.")] = False,
) -> None:
    """What was done in recorded sessions: how tools moved, what tissue bore, what was cut.

    Several sessions on one organ are put side by side. Writes report.html and result.json.
    """
    entries = with_experts(_entries(bags or [], study), expert or [])
    # Here, because they take a second to import.
    from tissue_sim.report.document import report_document
    from tissue_sim.report.making import comparisons_of, reported_of
    from tissue_sim.report.page import page
    from tissue_sim.report.pictures import draw
    from tissue_sim.report.plan import read_plan
    from tissue_sim.report.summary import Settings
    from tissue_sim.report.text import print_report
    from tissue_sim.whole_files import write_json, write_text

    if not 0.0 < idle_speed <= 1e3:
        raise ValueError(f"--idle-speed {idle_speed:g} is not allowed; allowed: 0 to 1000 mm/s")
    plans = read_plan(plan) if plan is not None else ()
    settings = Settings(1e-3 * idle_speed, _hands(hand or []), plans)
    reported = [
        reported_of(entry, _session(entry, name, namespace, epoch, risk), settings)
        for entry, name in zip(entries, named_apart(entries), strict=True)
    ]
    comparisons = comparisons_of(reported)
    print_report(reported, console)
    command = "tissue " + shlex.join(sys.argv[1:])
    drawing = partial(draw, namespace=namespace) if pictures else _no_pictures
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "report.html", page(reported, comparisons, settings, drawing, command))
    write_json(out / "result.json", report_document(reported, comparisons, settings, command))
    for name in ("report.html", "result.json"):
        console.print(f"wrote {out / name}", markup=False, soft_wrap=True)
    if show:
        typer.launch(str((out / "report.html").resolve()))


def _entries(bags: list[str], study: Path | None) -> list[Entry]:
    entries = [*(read_study(study) if study is not None else ()), *map(parse_entry, bags)]
    if not entries:
        raise ValueError("there is no session: name bags, or a study file with --study")
    return entries


def _hands(texts: list[str]) -> dict[str, tuple[str, ...]]:
    hands: dict[str, tuple[str, ...]] = {}
    for text in texts:
        name, _, tools = text.partition("=")
        each = tuple(tool.strip() for tool in tools.split(",") if tool.strip())
        if not (name.strip() and each):
            raise ValueError(f"--hand {text!r} is not allowed; allowed: NAME=TOOL,TOOL")
        every = [*each, *(tool for tools in hands.values() for tool in tools)]
        if name.strip() in hands or len(set(every)) < len(every):
            raise ValueError(
                f"--hand {text!r} names a hand or a tool again; allowed: each once, in one hand"
            )
        hands[name.strip()] = each
    return hands


def _session(
    entry: Entry, name: str, namespace: str | None, epoch: int | None, risk: Path | None
) -> Session:
    from viz_bridge.session_reader import read_session

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(
        *columns, console=progress_console, transient=True,
        disable=not progress_console.is_terminal,
    ) as progress:  # fmt: skip
        task = progress.add_task(f"reading {name}", total=None)
        return read_session(
            entry.bag, name, namespace, epoch, risk,
            lambda done, total: progress.update(task, completed=done, total=total),
        )  # fmt: skip


def _no_pictures(_: object) -> tuple[list[tuple[bytes, str]], str]:
    return [], "No pictures: left out with --no-pictures."
