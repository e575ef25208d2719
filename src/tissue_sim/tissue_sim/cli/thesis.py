"""`tissue thesis`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def thesis(
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("out/thesis.json"),
    quick: Annotated[
        bool, typer.Option("--quick", help="One amplitude and a short search: a minute.")
    ] = False,
    influences: Annotated[
        bool,
        typer.Option(
            "--influences", help="Instead: what each thing does that the text leaves open."
        ),
    ] = False,
    processes: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: one for each processor.")
    ] = None,
) -> None:
    """The thesis' comparison of models on the wall, its tables beside ours; about ten minutes.

    Interrupted, it goes on where it was; see docs/thesis.md.
    """
    if out.suffix != ".json" or out.is_dir():
        raise ValueError(f"--out {out} is not possible; allowed: a file that ends in .json")
    from tissue_sim.compare.thesis import run

    if influences:
        out = out.with_name("thesis_influences.json")
        run.influences(out, quick, processes)
        typer.echo(f"written to {out}")
        return
    from viz_bridge.thesis_picture import draw_ranges

    picture = out.with_suffix(".png")
    draw_ranges(run.experiment(out, quick, processes), picture)
    typer.echo(f"written to {out} and {picture}")
