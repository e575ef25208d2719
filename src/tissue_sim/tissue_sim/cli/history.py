"""`tissue undo` and `tissue redo`."""

from __future__ import annotations

from typing import Annotated

import typer

Namespace = Annotated[str, typer.Option(help="Namespace of the organ.")]
Times = Annotated[int, typer.Option("--times", "-n", min=1, help="How many edits.")]
Wait = Annotated[float, typer.Option(help="Longest wait for the simulation and its answers [s].")]


Stroke = Annotated[bool, typer.Option("--stroke", help="A progressive cut counts as one edit.")]


def undo(
    namespace: Namespace = "", times: Times = 1, timeout: Wait = 10.0, stroke: Stroke = False
) -> None:
    """Take back the newest edits of a running simulation, whoever made them."""
    _ask("undo", namespace, times, timeout, stroke)


def redo(
    namespace: Namespace = "", times: Times = 1, timeout: Wait = 10.0, stroke: Stroke = False
) -> None:
    """Make edits again that were undone last, in a running simulation."""
    _ask("redo", namespace, times, timeout, stroke)


def _ask(kind: str, namespace: str, times: int, timeout: float, strokes: bool) -> None:
    from tissue_sim.undo_client import ask

    for said in ask(kind, namespace, times, timeout, strokes):
        typer.echo(said)
