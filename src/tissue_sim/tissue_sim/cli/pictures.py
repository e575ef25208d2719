"""`tissue pictures`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tissue_sim.model_study import Row


def pictures(
    out: Annotated[Path, typer.Option(help="Folder of the PNG files.")] = Path("out/pictures"),
    results: Annotated[Path, typer.Option(help="JSON file for the figures.")] = Path(
        "out/models.json"
    ),
    geometry: Annotated[
        list[str] | None, typer.Option(help="What to pull; default: wall and heart.")
    ] = None,
    surfaces: Annotated[
        bool,
        typer.Option(
            "--surfaces", help="Tetrahedra, connected surfaces and a surface instead of the models."
        ),
    ] = False,
) -> None:
    """Every model on the wall and the heart, pulled the same way: pictures and figures.

    Takes some minutes, most of them for the heart.
    """
    from viz_bridge.model_pictures import draw_models
    from viz_bridge.surface_pictures import draw_surfaces

    chosen = tuple(geometry or ("wall", "heart"))
    if surfaces:
        drawn = draw_surfaces(out, chosen, _say)
    else:
        drawn = draw_models(out, results, chosen, _say)
        typer.echo(f"figures {results}")
    for file in drawn.files:
        typer.echo(f"picture {file}")
    if drawn.message:
        typer.echo(drawn.message)


def _say(row: Row) -> None:
    typer.echo(
        f"{row.geometry}, {row.label}: {row.steps} steps, mean difference from finite elements "
        f"{row.mean_difference_mm:.2f} mm, largest {row.largest_difference_mm:.2f} mm, "
        f"{row.inverted} inverted elements"
    )
