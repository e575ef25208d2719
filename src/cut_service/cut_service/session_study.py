"""Random sessions of every kind of edit, each edit checked.

`python3 -m cut_service.property_study` runs them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from cut_service import random_edits
from cut_service.planner import Settings, plan
from cut_service.sweep import Sweep
from cut_service.trial import Trial
from cut_service.validity import look_at
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.scene_geometry import SceneGeometry
from tissue_sim.geometry.sheet_geometry import CONNECTED, SURFACE, SheetSettings

SHELL = {"subdivisions": 3, "layers": 2}
ORGANS: dict[str, Callable[[], SceneGeometry]] = {
    "wall": lambda: scene_geometry.load("wall"),
    "shell": lambda: scene_geometry.load("sphere_shell", parameters=SHELL),
    "shell, surfaces": lambda: scene_geometry.load(
        "sphere_shell", parameters=SHELL, sheet=SheetSettings(SURFACE)
    ),
    "shell, connected surfaces": lambda: scene_geometry.load(
        "sphere_shell", parameters=SHELL, sheet=SheetSettings(CONNECTED)
    ),
    "wall, connected surfaces": lambda: scene_geometry.load("wall", sheet=SheetSettings(CONNECTED)),
    "heart": lambda: scene_geometry.load("heart"),
}
SESSIONS = {
    "wall": 100, "shell": 20, "shell, surfaces": 12, "shell, connected surfaces": 12,
    "wall, connected surfaces": 12, "heart": 10,
}  # fmt: skip
STEPS = 60
"""Operations in a session; one that undoes or makes again is up to ten edits."""

PLANES = 100
"""Planes right through an organ's middle."""


@dataclass
class SessionTally:
    """What came of the sessions of one organ.

    Attributes:
        organ: Which.
        sessions: Number of sessions, each with a new mesh.
        done: Edits carried out, by what made them.
        missed: Requests that changed nothing, by what made them.
        most_parts: Largest number of parts.
        deepest: Most edits undone in a row.
        volume: Largest change of rest volume by one edit that takes out and adds nothing, as a
            share.
        ratio: Smallest radius ratio.
        parted: Planes right through the organ's middle.
        parted_in_two: Those that left two parts of each that there was.
        faults: What was wrong, in words, with the session it happened in; empty if nothing was.
    """

    organ: str
    sessions: int = 0
    done: dict[str, int] = field(default_factory=dict)
    missed: dict[str, int] = field(default_factory=dict)
    most_parts: int = 0
    deepest: int = 0
    volume: float = 0.0
    ratio: float = 1.0
    parted: int = 0
    parted_in_two: int = 0
    faults: list[str] = field(default_factory=list)

    def add(self, trial: Trial) -> None:
        """Take note of a session."""
        for mine, theirs in ((self.done, trial.done), (self.missed, trial.missed)):
            for what, number in theirs.items():
                mine[what] = mine.get(what, 0) + number
        self.most_parts = max(self.most_parts, trial.most_parts)
        self.deepest = max(self.deepest, trial.deepest)
        self.volume, self.ratio = max(self.volume, trial.volume), min(self.ratio, trial.ratio)
        self.faults += [f"session {self.sessions}: {fault}" for fault in trial.faults]
        self.sessions += 1


@cache
def geometry(organ: str) -> SceneGeometry:
    """One of `ORGANS`, made once."""
    return ORGANS[organ]()


def new_trial(organ: str, random: np.random.Generator) -> Trial:
    """An organ that nothing has happened to, with its fixed nodes."""
    made = geometry(organ)
    return Trial(made.raw, made.mesh.fixed[: len(made.raw.points)], random)


def sessions(organ: str, number: int, seed: int, steps: int = STEPS) -> Iterator[SessionTally]:
    """So many sessions of an organ; the tally after each, always the same one."""
    tally = SessionTally(organ)
    for k in range(number):
        trial = new_trial(organ, np.random.default_rng([seed, k]))
        random_edits.session(trial, steps)
        tally.add(trial)
        yield tally


def plane_through(mesh: Mesh, seed: int, number: int) -> Sweep:
    """A plane right through an organ, near its middle."""
    random = np.random.default_rng([seed, 7, number])
    rest = mesh.rest[: mesh.node_rows]
    middle = rest.mean(axis=0) + random.uniform(-0.2, 0.2, 3) * np.ptp(rest, axis=0)
    normal = np.array([0.0, 0.0, 1.0])
    # A plane along a wall, which is two layers of nodes thin, passes between them.
    while abs(normal[2]) >= 0.5:
        axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
        normal = axes[2]
    u, v = axes[:2]
    corners = [middle - u - v, middle + u - v, middle + u + v, middle - u + v]
    return Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])


def part_in_two(tally: SessionTally, number: int, seed: int) -> None:
    """Split an organ by planes right through, near its middle: each part becomes two."""
    for k in range(number):
        mesh = Mesh(geometry(tally.organ).raw)
        parts = look_at(mesh).parts
        rest = mesh.rest[: mesh.node_rows]
        mesh.apply(plan(mesh, rest, plane_through(mesh, seed, k), settings=Settings()).edit)
        seen = look_at(mesh)
        tally.parted += 1
        tally.parted_in_two += seen.parts == 2 * parts
        tally.faults += [f"plane {k}: {fault}" for fault in seen.faults]


def _sum(row: dict[str, Any], *names: str) -> int:
    return sum(n for what, n in row["done"].items() if any(map(what.startswith, names)))


_COLUMNS: tuple[tuple[str, Callable[[dict[str, Any]], str]], ...] = (
    ("organ", lambda r: r["organ"]),
    ("sessions", lambda r: f"{r['sessions']}"),
    ("cuts", lambda r: f"{_sum(r, 'cut')}"),
    ("tears", lambda r: f"{_sum(r, 'tear')}"),
    ("burns", lambda r: f"{_sum(r, 'burn')}"),
    ("patches (sewn in)", lambda r: f"{_sum(r, 'patch')} ({_sum(r, 'rim')})"),
    ("sewn, tightened, taken out", lambda r: ", ".join(
        f"{_sum(r, what)}" for what in ("sew", "tighten", "unsew")
    )),
    ("threads cut", lambda r: f"{_sum(r, 'threads')}"),
    ("undone, made again", lambda r: f"{_sum(r, 'undo')}, {_sum(r, 'redo')}"),
    ("in a row", lambda r: f"{r['deepest']}"),
    ("changed nothing", lambda r: f"{sum(r['missed'].values())}"),
    ("largest change of volume", lambda r: f"{r['volume']:.1g}"),
    ("smallest ratio", lambda r: f"{r['ratio']:.2g}"),
    ("most parts", lambda r: f"{r['most_parts']}"),
    ("two parts", lambda r: f"{r['parted_in_two']} of {r['parted']}" if r["parted"] else ""),
    ("faults", lambda r: f"{len(r['faults'])}"),
)  # fmt: skip


def as_markdown(rows: list[dict[str, Any]]) -> str:
    """The tallies as a table."""
    lines = ["| " + " | ".join(title for title, _ in _COLUMNS) + " |", "|---" * len(_COLUMNS) + "|"]
    lines += ["| " + " | ".join(shown(row) for _, shown in _COLUMNS) + " |" for row in rows]
    return "\n".join(lines)
