"""What a fit came to, in a terminal."""

from __future__ import annotations

import shlex

from rich.console import Console
from rich.table import Table

from tissue_sim.compare.fit.outcome import FitOutcome
from tissue_sim.compare.fit.pareto import SpeedPoint
from tissue_sim.compare.fit.scene_lines import scene_lines
from tissue_sim.compare.report.text import figure, share
from tissue_sim.elastic import registry


def print_fit(outcome: FitOutcome, console: Console | None = None) -> None:
    """Print the best values, how good they are, and what can be done with them."""
    console = console or Console()
    for line in head_lines(outcome):
        _say(console, line)
    console.print()
    console.print(_values(outcome))
    console.print()
    for line in notes(outcome):
        _say(console, line)
    if outcome.front is not None:
        console.print()
        console.print(_speeds(outcome))
        console.print()
        _say(console, good_enough(outcome))
    console.print()
    _say(console, "as a target of tissue compare:")
    _say(console, f"  --target {shlex.quote(outcome.subject.text)}")
    _say(console, "in a scene's file, under /**/tissue_sim: ros__parameters:")
    for line in scene_lines(outcome.subject, outcome.problem.cases[0].interaction.rate_hz):
        _say(console, f"  {line}")


def head_lines(outcome: FitOutcome) -> list[str]:
    """How good the best is, and what it cost."""
    found, problem = outcome.found, outcome.problem
    names = ", ".join(case.interaction.name for case in problem.cases)
    lost = sum(not evaluation.stable for evaluation in found.evaluations)
    return [
        f"{problem.subject.name}, {problem.subject.effort}, on {problem.organ.name} under {names}, "
        f"fitted to {problem.cases[0].reference.label}:",
        f"{share(found.best.error)} of the worst, after {len(found.evaluations):,} evaluations in "
        f"{len(found.history)} generations ({outcome.seconds:.1f} s); {lost} were unstable",
    ]


def notes(outcome: FitOutcome) -> list[str]:
    """What should be known of the best values."""
    lines = ["1 of the worst: as far from the reference as tissue that does not follow at all"]
    if not outcome.found.best.stable:
        lines.append(f"no candidate was stable: {outcome.found.best.reason}")
    for name, side in outcome.at_bounds.items():
        hides = (
            "the model takes none beyond it"
            if _is_limit(outcome, name, side)
            else "a wider range may hold better values"
        )
        lines.append(f"{name} is at its {side} bound: {hides}")
    return lines


def value_rows(outcome: FitOutcome) -> list[tuple[str, str, str, str, str]]:
    """Name, best value, lower and upper bound, and the bound it is at, of each value."""
    best, sides = outcome.found.best.values, outcome.at_bounds
    return [
        (
            entry.name, f"{best[entry.name]:.6g}", f"{entry.low:g}", f"{entry.high:g}",
            f"at its {sides[entry.name]} bound" if entry.name in sides else "",
        )
        for entry in outcome.problem.space.parameters
    ]  # fmt: skip


def speed_rows(outcome: FitOutcome) -> list[tuple[str, ...]]:
    """Steps, time, error, whether on the front, and values of the best at each effort."""
    if outcome.front is None:
        return []
    front = outcome.front.front
    return [
        (
            f"{point.steps:g}", _ms(point), share(point.best.error),
            "yes" if point in front else "",
            ", ".join(f"{name} {value:.4g}" for name, value in point.best.values.items()),
        )
        for point in outcome.front.points
    ]  # fmt: skip


def good_enough(outcome: FitOutcome) -> str:
    """The fewest steps within the tolerance, in words."""
    if outcome.front is None:
        return ""
    try:
        point = outcome.front.fewest_steps_within(outcome.tolerance)
    except ValueError as error:
        return str(error)
    return (
        f"fewest steps within {outcome.tolerance:g} of the worst: {point.steps:g} a frame "
        f"({_ms(point)} ms here), {share(point.best.error)}"
    )


def _is_limit(outcome: FitOutcome, name: str, side: str) -> bool:
    """Whether the bound of a range is that of the model itself."""
    space, model = outcome.problem.space, outcome.problem.subject.model
    limits = {entry.name: entry for entry in registry.parameters_of(model)}
    if name not in limits:
        return False
    bound = space.parameters[space.names.index(name)]
    return (
        bound.high >= limits[name].maximum if side == "upper" else bound.low <= limits[name].minimum
    )


def _ms(point: SpeedPoint) -> str:
    return "" if point.ms_per_frame is None else figure(point.ms_per_frame)


def _values(outcome: FitOutcome) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    table.add_column("value", no_wrap=True, min_width=24)
    for heading in ("best", "from", "to"):
        table.add_column(heading, justify="right", no_wrap=True, min_width=8)
    table.add_column("", no_wrap=True)
    for row in value_rows(outcome):
        table.add_row(*row)
    return table


def _speeds(outcome: FitOutcome) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    for heading, least in (("steps", 5), ("ms", 6), ("of the worst", 12), ("front", 5)):
        table.add_column(heading, justify="right", no_wrap=True, min_width=least)
    table.add_column("values", overflow="fold")
    for row in speed_rows(outcome):
        table.add_row(*row)
    return table


def _say(console: Console, line: str) -> None:
    console.print(line, highlight=False, markup=False, soft_wrap=True)
