"""What a fit is asked for: a YAML file, the command line, or both.

Both are read alike, as values that know where they stand; what the command line says counts
instead of what the file says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from tissue_sim.compare.fit.space import FitParameter, Space, parse_range
from tissue_sim.compare.subject import Subject, parse_subject
from tissue_sim.geometry.sheet_geometry import KINDS
from tool_input.located_yaml import Item, ProcedureError, read_located_file

T = TypeVar("T")

MEASURED = "measured"
"""The reference of a recording that says how the tissue moved."""

STRATEGIES = ("cma", "ea")
KEYS = (
    "organ", "units", "fixed", "kind", "young", "poisson", "interactions", "rate_hz", "namespace",
    "epoch", "reference", "target", "ranges", "strategy", "population", "generations", "seed",
    "processes", "scheduler", "pareto", "tolerance", "landscape", "out",
)  # fmt: skip
"""Keys of the file."""

OPTIONS = {"ranges": "--range", "interactions": "--interaction", "rate_hz": "--rate"}
"""Options of the command that have another name than the key."""

ELSEWHERE = {"processes": "scheduler", "scheduler": "processes"}
"""Of these, what the command line says replaces the other one of the file."""

POINTS = 25
MOST_POINTS = 200


@dataclass(frozen=True)
class Grid:
    """A landscape that is asked for.

    Attributes:
        names: The two values along its sides.
        points: Points along each side.
    """

    names: tuple[str, str]
    points: int = POINTS


@dataclass(frozen=True)
class FitSettings:
    """What is fitted to what, where it is looked for, and how.

    Attributes:
        organ: Shape, scene or mesh file; None: that of the recording.
        interactions: What is done to it: motions, files or recordings.
        units, fixed, kind, young, poisson: Of the organ, as the options of `tissue compare`.
        rate_hz: Frames per second [1/s]; a recorded interaction that has its own keeps it.
        namespace: Of a recording: that of the organ; empty: it has one only.
        epoch: Of a recording: which, counted from 1; None: it has one only.
        reference: The model to come close to, a file (.npz) of how the tissue moved, or `MEASURED`:
            the recording says it.
        target: The model whose values are looked for.
        ranges: The values that are looked for.
        strategy: One of `STRATEGIES`.
        population: Candidates of a generation; None: as many as the strategy thinks good.
        generations: How many of them.
        seed: Of the strategy's random numbers.
        processes: Processes on this machine; None: one for each processor.
        scheduler: Address of a Dask scheduler; None: this machine.
        pareto: Steps a frame that the target is fitted at, each by itself; may be empty.
        tolerance: Error relative to the worst that is good enough.
        landscape: The landscape that is drawn; None: none.
        out: Folder to write; None: one named after the time.
    """

    organ: str | None
    interactions: tuple[str, ...]
    reference: Subject | Path | str
    target: Subject
    ranges: tuple[FitParameter, ...]
    units: str = ""
    fixed: str = ""
    kind: str = ""
    young: float | None = None
    poisson: float | None = None
    rate_hz: float = 30.0
    namespace: str = ""
    epoch: int | None = None
    strategy: str = "cma"
    population: int | None = None
    generations: int = 30
    seed: int = 1
    processes: int | None = None
    scheduler: str | None = None
    pareto: tuple[float, ...] = ()
    tolerance: float = 0.25
    landscape: Grid | None = None
    out: Path | None = None

    @property
    def space(self) -> Space:
        """Where the values are looked for."""
        return Space(self.ranges).checked(self.target)


def read_settings(file: Path | None, options: Mapping[str, object]) -> FitSettings:
    """Settings of a file and of what the command line says instead.

    Args:
        file: The YAML file; None: the command line says it all.
        options: Values of the command's options by key of the file: texts, numbers, or lists of
            them; None and empty ones are not given.

    Raises:
        ValueError: Something is missing or makes no sense; the message says where it stands and
            what is allowed.
    """
    items: dict[str, Item] = {}
    if file is not None:
        items |= read_located_file(file, "fit").mapping(KEYS)
        for key in ("organ", "interactions", "reference") & items.keys():
            items[key] = _beside(file, items[key])
    for key, value in options.items():
        if value is not None and value != []:
            items[key] = _option(key, value)
            items.pop(ELSEWHERE.get(key, ""), None)
    for key in ("interactions", "reference", "target", "ranges"):
        if key not in items:
            or_in_file = f", or {key} in {file}" if file else ""
            raise ValueError(f"a fit needs {key}: give {_option_name(key)}{or_in_file}")
    return _settings(items)


def _settings(items: Mapping[str, Item]) -> FitSettings:
    def read(key: str, reader: Callable[[Item], T], otherwise: T) -> T:
        return _located(items[key], reader) if key in items else otherwise

    target = _located(items["target"], lambda item: parse_subject(item.text()))
    ranges = _ranges(items["ranges"], target)
    return FitSettings(
        organ=read("organ", Item.text, None),
        interactions=tuple(item.text() for item in _not_empty(items["interactions"])),
        reference=_located(items["reference"], _reference),
        target=target,
        ranges=ranges,
        units=read("units", lambda item: item.one_of(("mm", "m")), ""),
        fixed=read("fixed", Item.text, ""),
        kind=read("kind", lambda item: item.one_of(KINDS), ""),
        young=read("young", lambda item: item.number(above=0.0), None),
        poisson=read("poisson", lambda item: item.number(minimum=0.0, maximum=0.4999), None),
        rate_hz=read("rate_hz", lambda item: item.number(minimum=1.0, maximum=1000.0), 30.0),
        namespace=read("namespace", Item.text, ""),
        epoch=read("epoch", lambda item: item.whole(1, 1_000_000), None),
        strategy=read("strategy", lambda item: item.one_of(STRATEGIES), "cma"),
        population=read("population", lambda item: item.whole(4, 10_000), None),
        generations=read("generations", lambda item: item.whole(1, 100_000), 30),
        seed=read("seed", lambda item: item.whole(0, 2**31 - 1), 1),
        processes=read("processes", lambda item: item.whole(1, 4096), None),
        scheduler=read("scheduler", Item.text, None),
        pareto=read("pareto", _steps, ()),
        tolerance=read("tolerance", lambda item: item.number(above=0.0), 0.25),
        landscape=read("landscape", lambda item: _grid(item, ranges), None),
        out=read("out", lambda item: Path(item.text()), None),
    )


def _option(key: str, value: object) -> Item:
    """What the command line says, as if it stood in a file."""
    name = _option_name(key)
    if isinstance(value, list | tuple):
        value = [Item(entry, "command line", name) for entry in value]
    return Item(value, "command line", name)


def _option_name(key: str) -> str:
    return OPTIONS.get(key, f"--{key}")


def _beside(file: Path, item: Item) -> Item:
    """An item whose texts that name files lie beside the file it stands in."""
    if isinstance(item.value, list):
        return Item([_beside(file, entry) for entry in item.value], item.where, item.name)
    if isinstance(item.value, str) and (file.parent / item.value).exists():
        return Item(str(file.parent / item.value), item.where, item.name)
    return item


def _located(item: Item, reader: Callable[[Item], T]) -> T:
    """What a reader makes of an item; whatever it refuses is told with the place."""
    try:
        return reader(item)
    except ProcedureError:
        raise
    except ValueError as error:
        raise item.error(str(error)) from error


def _reference(item: Item) -> Subject | Path | str:
    text = item.text()
    if text == MEASURED:
        return text
    return Path(text) if Path(text).suffix == ".npz" else parse_subject(text)


def _ranges(item: Item, target: Subject) -> tuple[FitParameter, ...]:
    """Ranges as a mapping from names to LOW..HIGH[:log], or as a list of NAME=LOW..HIGH[:log]."""
    if isinstance(item.value, dict):
        entries = [
            Item(f"{name}={entry.text()}", entry.where, entry.name)
            for name, entry in item.value.items()
        ]
    else:
        entries = _not_empty(item)

    def checked(entry: Item) -> FitParameter:
        return Space((parse_range(entry.text()),)).checked(target).parameters[0]

    ranges = tuple(_located(entry, checked) for entry in entries)
    _located(item, lambda _: Space(ranges))
    return ranges


def _not_empty(item: Item) -> list[Item]:
    entries = [item] if isinstance(item.value, str) else item.list()
    if not entries:
        raise item.error("is empty; at least one is needed")
    return entries


def _steps(item: Item) -> tuple[float, ...]:
    """Steps a frame, from a list or a text with commas, the fewest first."""
    entries = (
        [Item(text.strip(), item.where, item.name) for text in item.value.split(",")]
        if isinstance(item.value, str)
        else _not_empty(item)
    )
    steps = sorted({entry.number(minimum=0.01) for entry in entries})
    return tuple(steps)


def _grid(item: Item, ranges: tuple[FitParameter, ...]) -> Grid:
    """The grid of NAME,NAME[:POINTS]."""
    text, colon, count = item.text().partition(":")
    names = [name.strip() for name in text.split(",")]
    known = [parameter.name for parameter in ranges]
    if len(set(names)) != 2 or len(names) != 2 or not set(names) <= set(known):
        raise item.error(
            f"{item.text()!r} is not understood; allowed: two of the ranges ({', '.join(known)}) "
            f"and the points along each side, for example step,springs.stiffness:{POINTS}"
        )
    points = Item(count, item.where, item.name).whole(2, MOST_POINTS) if colon else POINTS
    return Grid((names[0], names[1]), points)
