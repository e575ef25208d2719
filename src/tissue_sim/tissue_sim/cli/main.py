"""`tissue`: one command for people."""

from __future__ import annotations

import sys

import typer
from rich.console import Console

from tissue_sim.cli import (
    bench,
    compare,
    demo,
    fit,
    history,
    mesh,
    pictures,
    replay,
    report,
    run,
    thesis,
)
from tissue_sim.launcher import LaunchError

BAD_INPUT = 2
FAILED = 1
INTERRUPTED = 130

app = typer.Typer(
    name="tissue",
    help="Real-time soft-tissue surgery. Research software, not for clinical use.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("run")(run.run)
app.command("demo")(demo.demo)
app.command("replay")(replay.replay)
app.command("report")(report.report)
app.command("undo")(history.undo)
app.command("redo")(history.redo)
app.command("compare")(compare.compare)
app.command("fit")(fit.fit)
app.command("bench")(bench.bench)
app.command("thesis")(thesis.thesis)
app.command("pictures")(pictures.pictures)
app.add_typer(mesh.app, name="mesh", help="Look at mesh files, check and convert them.")


def _add_bag_commands() -> None:
    from viz_bridge.bag_cli import app as bag_app

    app.add_typer(bag_app, name="bag", help="Record, play, check and convert bags.")


def main() -> None:
    """Entry point: what a person did wrong is one line and exit code 2, not a traceback."""
    if "bag" in sys.argv[1:2] or "--help" in sys.argv or "-h" in sys.argv:
        _add_bag_commands()
    errors = Console(stderr=True, soft_wrap=True, highlight=False)
    try:
        app()
    except LaunchError as error:
        errors.print(f"error: {error}", markup=False)
        sys.exit(FAILED)
    except (ValueError, OSError) as error:
        errors.print(f"error: {' '.join(str(error).split())}", markup=False)
        sys.exit(BAD_INPUT)
    except KeyboardInterrupt:
        errors.print("interrupted")
        sys.exit(INTERRUPTED)
