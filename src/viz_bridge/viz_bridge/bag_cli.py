"""`tissue bag`: record, play, look at, check, mend and convert bags."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from viz_bridge.bag_reader import BagError, metadata_of, summaries, topic_counts, topic_types

app = typer.Typer(
    help="Record, play, check and convert bags (MCAP, as rosbag2 writes them).",
    no_args_is_help=True,
)
console = Console(highlight=False, soft_wrap=True)
BAG = Annotated[Path, typer.Argument(help="Bag directory, or one .mcap file.")]
NAMESPACE = Annotated[
    str | None, typer.Option(help="Namespace of the organ, where a bag holds several.")
]


@contextmanager
def progress_of(what: str, total: int | None) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal, a line now and then elsewhere."""
    if not console.is_terminal:
        step = max(1, (total or 0) // 4) if total else 50_000

        def line(done: int) -> None:
            if done % step == 0:
                console.print(f"{what}: {done}" + (f" of {total}" if total else ""))

        yield line
        return
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def _messages(bag: Path) -> int | None:
    try:
        return sum(topic_counts(bag).values())
    except BagError:
        return None


@app.command()
def record(
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Directory of the bag; default: by time.")
    ] = None,
    record_state_hz: Annotated[
        float, typer.Option(help="States kept a second; 60: all.", min=0.0, max=1000.0)
    ] = 10.0,
    compression: Annotated[str, typer.Option(help="none, lz4 or zstd.")] = "lz4",
    min_free_gb: Annotated[
        float, typer.Option(help="End the bag when less is free on its disk.", min=0.0)
    ] = 1.0,
    topics: Annotated[
        list[str] | None, typer.Option(help="Further topic, as name:package/msg/Type.")
    ] = None,
    namespace: Annotated[str, typer.Option(help="Namespace of the organ.")] = "",
) -> None:
    """Record until Ctrl-C: inputs, journal, edits, states, forces, diagnostics."""
    from viz_bridge.bag_node import main

    name = output or Path(f"session_{datetime.now(UTC):%Y_%m_%d-%H_%M_%S}")
    arguments = ["--ros-args", "-p", f"bag:={name}", "-p", f"record_state_hz:={record_state_hz}"]
    arguments += ["-p", f"compression:={compression}", "-p", f"min_free_gb:={min_free_gb}"]
    if topics:
        arguments += ["-p", f"extra_topics:={topics}"]
    if namespace:
        arguments += ["-r", f"__ns:=/{namespace.strip('/')}"]
    main(arguments)


@app.command()
def play(
    bag: BAG,
    rate: Annotated[float, typer.Option("-r", "--rate", help="Times faster.")] = 1.0,
    topics: Annotated[
        list[str] | None, typer.Option(help="Topic to play; several times for several.")
    ] = None,
    loop: Annotated[bool, typer.Option("-l", "--loop", help="Begin again at the end.")] = False,
    start_offset: Annotated[float, typer.Option(help="Skip so many seconds.")] = 0.0,
) -> None:
    """Publish the topics of a bag at the times they were recorded."""
    from viz_bridge.bag_play import run_player
    from viz_bridge.bag_player import PlayOptions, check_options

    options = PlayOptions(rate, tuple(topics or ()), loop, start_offset)
    check_options(bag, options)
    with progress_of("playing", None if loop else _messages(bag)) as advance:
        played = run_player(bag, options, advance)
    console.print(f"{played} messages played")


@app.command()
def info(bag: BAG) -> None:
    """Say what a bag holds."""
    found = summaries(bag)
    table = Table("topic", "type", "messages", "Hz", box=None, pad_edge=False)
    counts = topic_counts(bag)
    statistics = [s.statistics for s in found.values() if s.statistics is not None]
    full = [s for s in statistics if s.message_count]
    start = min((s.message_start_time for s in full), default=0)
    seconds = (max((s.message_end_time for s in full), default=0) - start) / 1e9
    types = topic_types(bag)
    for topic in sorted(counts):
        hz = counts[topic] / seconds if seconds > 0 else 0.0
        table.add_row(topic, types.get(topic, ""), str(counts[topic]), f"{hz:.1f}")
    size = sum(path.stat().st_size for path in found) / 1e6
    begun = datetime.fromtimestamp(start / 1e9, UTC).isoformat(sep=" ", timespec="milliseconds")
    console.print(f"{bag}: {len(found)} files, {size:.1f} MB, {seconds:.2f} s from {begun}")
    for key, value in metadata_of(bag).items():
        console.print(f"{key}: {value}", markup=False)
    console.print(table)


@app.command()
def check(bag: BAG) -> None:
    """Read every message; exit code 1 where something is wrong."""
    from viz_bridge.bag_recovery import check as check_bag

    with progress_of("checking", _messages(bag)) as advance:
        findings = check_bag(bag, advance)
    for line in findings.notes:
        console.print(f"note: {line}", markup=False)
    for line in findings.problems:
        console.print(f"problem: {line}", markup=False)
    verdict = "whole" if not findings.problems else f"{len(findings.problems)} problems"
    console.print(f"{bag}: {findings.messages} messages, {verdict}", markup=False)
    if findings.problems:
        raise typer.Exit(1)


@app.command()
def recover(
    bag: BAG,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The new bag; default: BAG_recovered.")
    ] = None,
) -> None:
    """Make a whole bag out of one whose recorder was killed."""
    from viz_bridge.bag_recovery import recover as recover_bag

    target = output or bag.with_name(f"{bag.stem}_recovered")
    with progress_of("recovering", None) as advance:
        saved = recover_bag(bag, target, advance)
    for line in saved.torn:
        console.print(f"torn: {line}", markup=False)
    console.print(f"{target}: {saved.messages} messages, {saved.seconds:.2f} s", markup=False)


@app.command("to-rrd")
def convert_to_rrd(
    bag: BAG,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The .rrd file; default: BAG.rrd.")
    ] = None,
    max_hz: Annotated[float, typer.Option(help="States a second at most; 0: all.", min=0.0)] = 0.0,
    namespace: NAMESPACE = None,
) -> None:
    """Draw a bag into a recording for rerun's viewer."""
    from viz_bridge.to_rrd import to_rrd

    target = output or bag.with_name(f"{bag.stem}.rrd")
    with progress_of("drawing", None) as advance:
        states = to_rrd(bag, target, namespace, max_hz, advance)
    console.print(f"{target}: {states} states; open it with: rerun {target}", markup=False)


@app.command()
def pictures(
    bag: BAG,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for the PNG files.")
    ] = None,
    namespace: NAMESPACE = None,
) -> None:
    """Render pictures of a session: before, pulled, cut open, released."""
    from viz_bridge.pictures import render

    with progress_of("looking for moments", _messages(bag)) as advance:
        drawn = render(bag, output or bag.parent, namespace, advance)
    for picture in drawn.files:
        console.print(str(picture), markup=False)
    if drawn.message:
        console.print(drawn.message, markup=False)


def main() -> None:
    """Run on its own; the `tissue` command mounts the same."""
    try:
        app()
    except (ValueError, OSError) as error:
        console.print(f"error: {error}", markup=False)
        sys.exit(2)


if __name__ == "__main__":
    main()
