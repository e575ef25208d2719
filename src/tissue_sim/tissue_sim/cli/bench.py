"""`tissue bench`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def bench(
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("out/bench.json"),
    seconds: Annotated[float, typer.Option(min=0.05, help="Time to measure each row.")] = 1.0,
    loop: Annotated[
        int, typer.Option(min=0, help="Instead: pairs of real-time runs with and without cuts.")
    ] = 0,
) -> None:
    """Steps a second of every model, next to what the machine's memory allows."""
    if loop:
        from tissue_sim.loop_study import run_study

        run_study(out.parent / "loop", loop)
        return
    from tissue_sim.bench import print_table, run_bench

    print_table(run_bench(out, seconds))
    typer.echo(f"written to {out}")
