"""`tissue run`."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from tissue_sim.runner import STATE_HZ, RunOptions, run_scene

HELP_SCENE = "A scene (wall, block, sphere_shell, heart), a scene file, or a mesh file."
HELP_FIXED = (
    "Nodes that never move: auto, none, set:NAME, box:x0,x1,y0,y1,z0,z1 [m], low:z:0.1, "
    "high:z:0.1; several joined by +."
)

HELP_DIFFERENCE = (
    "Second model beside the session, such as finite_element@rest: its difference is drawn as "
    "colour (docs/viewing.md); implies --rrd without --viewer."
)

HELP_BIND = (
    "Address the page listens on, so that others can join from their machines: one of this "
    "machine's, or 0.0.0.0 for all of them. It asks for the token, but nothing is encrypted."
)


def run(
    scene: Annotated[str, typer.Argument(help=HELP_SCENE)],
    units: Annotated[str, typer.Option(help="Unit of a mesh file: mm or m.")] = "",
    fixed: Annotated[str, typer.Option(help=HELP_FIXED)] = "",
    model: Annotated[str, typer.Option(help="Elastic model.")] = "",
    kind: Annotated[
        str, typer.Option(help="What it is made of: volume, surface or connected_surfaces.")
    ] = "",
    headless: Annotated[
        bool, typer.Option("--headless", help="No page and no viewer; a procedure is played.")
    ] = False,
    frames: Annotated[int, typer.Option(min=0, help="End after so many frames; 0: never.")] = 0,
    duration: Annotated[float, typer.Option(min=0.0, help="End after so many seconds.")] = 0.0,
    procedure: Annotated[Path | None, typer.Option(help="Procedure to play (YAML).")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; default out/run/<time>.")
    ] = None,
    bag: Annotated[bool, typer.Option("--bag/--no-bag", help="Record a bag.")] = True,
    record_state_hz: Annotated[
        float, typer.Option(help="Positions kept in the bag a second; 0 or at least 60: all.")
    ] = STATE_HZ,
    rrd: Annotated[bool, typer.Option("--rrd/--no-rrd", help="Record for rerun.")] = False,
    viewer: Annotated[bool, typer.Option("--viewer", help="Open rerun's viewer.")] = False,
    difference: Annotated[str, typer.Option(metavar="MODEL", help=HELP_DIFFERENCE)] = "",
    readings: Annotated[
        bool | None,
        typer.Option(
            "--readings/--no-readings",
            help="Tell stress, strain and risk regions; by default for the page.",
        ),
    ] = None,
    bind: Annotated[str, typer.Option(metavar="ADDRESS", help=HELP_BIND)] = "",
) -> None:
    """Simulate a scene or any mesh until Ctrl-C, or for some frames.

    The operating table, a page in the browser, is served unless --headless is given. A mesh file
    needs --units; without a procedure, --headless grabs, pulls and cuts it where that looks
    sensible.
    """
    options = RunOptions(
        scene=scene,
        units=units,
        fixed=fixed,
        model=model,
        kind=kind,
        headless=headless,
        frames=frames,
        seconds=duration,
        procedure=procedure,
        out=out or Path("out/run") / datetime.now(UTC).strftime("%Y%m%d-%H%M%S"),
        bag=bag,
        record_state_hz=record_state_hz,
        recording=rrd,
        viewer=viewer,
        difference=difference,
        readings=not headless if readings is None else readings,
        bind=bind,
    )
    raise typer.Exit(run_scene(options))
