"""`tissue demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tissue_sim.demo import run_demo


def demo(
    out: Annotated[Path, typer.Option(help="Folder to write; its contents are replaced.")] = Path(
        "out/demo"
    ),
    scene: Annotated[str, typer.Option(help="Scene to operate on.")] = "heart",
    procedure: Annotated[
        Path | None, typer.Option(help="Procedure to play; default: the demo's own.")
    ] = None,
    pictures: Annotated[
        bool, typer.Option("--pictures/--no-pictures", help="Render pictures afterwards.")
    ] = True,
) -> None:
    """A scripted operation on the heart in real time: grab, pull, cut, pull open, let go.

    Writes a bag, a recording for rerun, a summary and pictures.
    """
    raise typer.Exit(run_demo(out, scene, procedure, pictures))
