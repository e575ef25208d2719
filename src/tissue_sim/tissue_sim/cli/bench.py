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
    growth: Annotated[
        bool, typer.Option(help="Instead: time of a step on blocks of up to 360,000 nodes.")
    ] = False,
    peers: Annotated[
        bool, typer.Option(help="Instead: MuJoCo, newton and PyBullet on the same tissue.")
    ] = False,
    acceleration: Annotated[
        bool,
        typer.Option(help="Instead: momentum, Chebyshev's method and predictors; some minutes."),
    ] = False,
) -> None:
    """Steps a second of every model, next to what the machine's memory allows.

    With --peers, twenty times --seconds is the longest that a simulator is given to arrive.
    """
    if loop:
        from tissue_sim.loop_study import run_study

        run_study(out.parent / "loop", loop)
        return
    if acceleration:
        _compare_accelerations(out.with_name("acceleration.json"))
        return
    if growth:
        from tissue_sim.bench_growth import print_growth, run_growth

        out = out.with_name("growth.json")
        print_growth(run_growth(out, seconds))
        typer.echo(f"written to {out}")
        return
    if peers:
        from tissue_sim.bench_peers import print_table as print_peers
        from tissue_sim.bench_peers import run_peers

        out = out.with_name("bench_peers.json")
        print_peers(run_peers(out, 20.0 * seconds, report=typer.echo))
        typer.echo(f"written to {out}")
        return
    from tissue_sim.bench import run_bench
    from tissue_sim.bench_table import print_table

    print_table(run_bench(out, seconds, report=typer.echo))
    typer.echo(f"written to {out}")


def _compare_accelerations(out: Path) -> None:
    """Write the study's figures, and its curves beside them."""
    from tissue_sim import acceleration_study, prediction_study
    from viz_bridge.error_curves import draw_curves

    result = acceleration_study.run(out, say=typer.echo)
    for table in (
        acceleration_study.as_markdown,
        prediction_study.frames_as_markdown,
        prediction_study.responses_as_markdown,
    ):
        typer.echo(table(result))
    draw_curves(result, out.with_suffix(".png"))
    typer.echo(f"written to {out} and {out.with_suffix('.png')}")
