"""Thousands of random edits and undos, each checked for all that it owes; see docs/cutting.md.

Cuts by each method (`study`), and sessions of cuts, tears, burns and stitches (`session_study`).

python3 -m cut_service.property_study --out docs/results/cut_properties.json
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cut_service import session_study
from cut_service.errors import CutError
from cut_service.planner import METHODS, Settings, plan
from cut_service.random_edits import WAYS, wave
from cut_service.sweep import Sweep
from cut_service.trial import VOLUME_KEPT, VOLUME_SNAPPED, remembered
from cut_service.validity import Validity, look_at
from tissue_sim.bench import machine, target
from tissue_sim.elastic.model import State
from tissue_sim.geometry.edit_history import EditHistory
from tissue_sim.geometry.heart import heart
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.raw_mesh import RawMesh
from tissue_sim.geometry.shapes import sphere_shell, wall

SEED = 20
ORGANS: dict[str, Callable[[], RawMesh]] = {
    "wall": wall,
    "shell": lambda: sphere_shell(subdivisions=3, layers=2),
    "heart": heart,
}
RUNS = {"wall": 300, "shell": 150, "heart": 16}
"""Runs of each organ by each method; a run is `CUTS_IN_A_RUN` sweeps, all undone, some redone."""
CUTS_IN_A_RUN = 4
SPOT_SESSIONS = ("wall", "wall, connected surfaces")
"""Organs whose first session is made again to see whether it still comes out so."""
SHARES = (0.05, 0.15, 0.4, 3.0)
"""Half widths of sweeps as shares of the organ: from scratches to right through."""


@dataclass
class Tally:
    """What came of all runs of one organ by one method.

    Attributes:
        organ, way: Which.
        runs: Number of runs, each on a new mesh.
        cuts: Cuts made.
        missed: Sweeps that parted nothing.
        undone, redone: Cuts undone, and made again.
        most_parts: Largest number of parts after a cut.
        parted: Planes right through the wall's middle.
        parted_in_two: Those that left two parts.
        volume: Largest change of rest volume by one cut, as a share.
        ratio: Smallest radius ratio after any cut.
        faults: What was wrong, in words, with the run it happened in; empty if nothing ever was.
    """

    organ: str
    way: str
    runs: int = 0
    cuts: int = 0
    missed: int = 0
    undone: int = 0
    redone: int = 0
    most_parts: int = 0
    parted: int = 0
    parted_in_two: int = 0
    volume: float = 0.0
    ratio: float = 1.0
    faults: list[str] = field(default_factory=list)

    def fault(self, what: str) -> None:
        """Write down what is wrong."""
        self.faults.append(f"run {self.runs}: {what}")


@cache
def _raw(organ: str) -> RawMesh:
    return ORGANS[organ]()


def _square(
    centre: NDArray[np.float64], random: np.random.Generator, half: float
) -> tuple[Sweep, NDArray[np.float64]]:
    """A flat square of random direction, and its normal."""
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    u, v = half * axes[:2]
    corners = [centre - u - v, centre + u - v, centre + u + v, centre - u + v]
    return Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]), axes[2]


def run(tally: Tally, seed: int) -> None:
    """Cut an organ a few times, take everything back and make some of it again."""
    random = np.random.default_rng([seed, tally.runs])
    method, how = WAYS[tally.way]
    mesh, history = Mesh(_raw(tally.organ)), EditHistory()
    state = State(mesh, np.float64)
    if random.integers(2):
        rows = mesh.node_rows
        state.displacement[:rows] = wave(mesh.rest[:rows], random)
        state.previous[:rows] = state.displacement[:rows]
    seen, before = [remembered(mesh)], look_at(mesh)
    for _ in range(CUTS_IN_A_RUN):
        after = _cut(tally, mesh, state, history, random, method, how, before)
        if after is not None:
            before = after
            seen.append(remembered(mesh))
    _back_and_forth(tally, mesh, state, history, seen, random)
    tally.runs += 1


def _cut(
    tally: Tally,
    mesh: Mesh,
    state: State,
    history: EditHistory,
    random: np.random.Generator,
    method: str,
    how: Settings,
    before: Validity,
) -> Validity | None:
    """Cut once and check; None: the sweep parted nothing."""
    places = np.asarray(state.positions(mesh), dtype=np.float64)
    living = np.flatnonzero(mesh.node_alive[: mesh.node_rows])
    size = np.ptp(places[living], axis=0).max()
    half = random.choice(SHARES) * size
    sweep, _ = _square(places[random.choice(living)], random, half)
    fine = _upright(mesh, places)
    try:
        planned = plan(mesh, places, sweep, method, settings=how)
    except CutError as error:
        if not error.code.nothing_to_cut:
            tally.fault(f"{error.code.name}: {error}")
        tally.missed += 1
        return None
    change = mesh.apply(planned.edit)
    state.follow(mesh, change)
    history.record(change)
    after = look_at(mesh)
    tally.cuts += 1
    tally.most_parts = max(tally.most_parts, after.parts)
    tally.ratio = min(tally.ratio, after.ratio)
    for fault in after.faults:
        tally.fault(fault)
    if after.parts != planned.report.components:
        tally.fault(f"{after.parts} parts, {planned.report.components} reported")
    if fine and not _upright(mesh, np.asarray(state.positions(mesh), dtype=np.float64)):
        tally.fault("an element turned over in the deformed shape")
    grown = after.volume / before.volume - 1.0
    if abs(grown - planned.report.volume_change / before.volume) > VOLUME_KEPT:
        tally.fault(f"rest volume grew by {grown:.3g}, reported otherwise")
    if method != "remove":
        tally.volume = max(tally.volume, abs(grown))
        kept = VOLUME_SNAPPED if method == "split" and how.snap else VOLUME_KEPT
        if abs(grown) > kept:
            tally.fault(f"rest volume grew by {grown:.3g}")
    return after


def _upright(mesh: Mesh, places: NDArray[np.float64]) -> bool:
    tets = mesh.tets[: mesh.element_rows][mesh.element_alive[: mesh.element_rows]]
    a, b, c, d = (places[tets[:, k]] for k in range(4))
    return bool((np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) > 0.0).all())


def _back_and_forth(
    tally: Tally,
    mesh: Mesh,
    state: State,
    history: EditHistory,
    seen: list[dict[str, str]],
    random: np.random.Generator,
) -> None:
    """Undo everything, make some of it again, and undo that."""
    back = [seen[k] for k in range(len(seen) - 2, -1, -1)]
    again = int(random.integers(len(seen)))
    moves = [("undo", wanted) for wanted in back]
    moves += [("redo", seen[k]) for k in range(1, again + 1)]
    moves += [("undo", seen[k]) for k in range(again - 1, -1, -1)]
    for name, wanted in moves:
        edit = history.undo(mesh) if name == "undo" else history.redo(mesh)
        change = mesh.apply(edit)
        state.follow(mesh, change)
        history.record(change)
        tally.undone += name == "undo"
        tally.redone += name == "redo"
        if remembered(mesh) != wanted:
            tally.fault(f"the mesh is not what it was before, after a {name}")
    if faults := look_at(mesh).faults:
        tally.fault(f"after undoing everything: {', '.join(faults)}")


def part_in_two(tally: Tally, seed: int) -> None:
    """Cut the wall by a plane right through, near its middle: two parts are left."""
    random = np.random.default_rng([seed, 7, tally.parted])
    method, how = WAYS[tally.way]
    mesh = Mesh(_raw("wall"))
    rest = mesh.rest[: mesh.node_rows]
    middle = rest.mean(axis=0) + random.uniform(-0.2, 0.2, 3) * np.ptp(rest, axis=0)
    while True:
        sweep, normal = _square(middle, random, 1.0)
        # A plane along the wall, which is two layers of nodes thin, passes between them.
        if abs(normal[2]) < 0.5:
            break
    mesh.apply(plan(mesh, rest, sweep, method, settings=how).edit)
    seen = look_at(mesh)
    tally.parted += 1
    tally.parted_in_two += seen.parts == 2
    for fault in seen.faults:
        tally.fault(fault)


def study(organ: str, way: str, runs: int, seed: int = SEED) -> Tally:
    """All runs of an organ by one method."""
    tally = Tally(organ, way)
    for _ in range(runs):
        run(tally, seed)
    if organ == "wall":
        for _ in range(runs):
            part_in_two(tally, seed)
    return tally


def spot(seed: int = SEED) -> list[Tally]:
    """The first runs of the small organs, to see whether they still come out so."""
    return [study(organ, way, 3, seed) for organ in ("wall", "shell") for way in WAYS]


def spot_session(organ: str, seed: int = SEED) -> session_study.SessionTally:
    """The first session of an organ, to see whether it still comes out so."""
    *_, tally = session_study.sessions(organ, 1, seed)
    return tally


_COLUMNS: tuple[tuple[str, Callable[[dict[str, Any]], str]], ...] = (
    ("organ", lambda r: r["organ"]),
    ("method", lambda r: r["way"]),
    ("cuts (missed)", lambda r: f"{r['cuts']} ({r['missed']})"),
    ("undone, made again", lambda r: f"{r['undone']}, {r['redone']}"),
    ("largest change of volume", lambda r: f"{r['volume']:.1g}" if r["way"] != "remove" else ""),
    ("smallest ratio", lambda r: f"{r['ratio']:.2g}"),
    ("most parts", lambda r: f"{r['most_parts']}"),
    ("two parts", lambda r: f"{r['parted_in_two']} of {r['parted']}" if r["parted"] else ""),
    ("faults", lambda r: f"{len(r['faults'])}"),
)


def as_markdown(result: dict[str, Any]) -> str:
    """The rows as a table."""
    lines = ["| " + " | ".join(title for title, _ in _COLUMNS) + " |", "|---" * len(_COLUMNS) + "|"]
    lines += [
        "| " + " | ".join(shown(row) for _, shown in _COLUMNS) + " |" for row in result["rows"]
    ]
    return "\n".join(lines)


def _cuts(share: float, organs: list[str], seed: int) -> list[dict[str, Any]]:
    begin, rows = time.perf_counter(), []
    for organ in organs:
        for way in WAYS:
            tally = study(organ, way, max(1, round(share * RUNS[organ])), seed)
            rows.append(asdict(tally))
            print(
                f"{organ}, {way}: {tally.cuts} cuts, {tally.missed} missed, {tally.undone} undone, "
                f"{len(tally.faults)} faults, {time.perf_counter() - begin:.0f} s", flush=True,
            )  # fmt: skip
    return rows


def _sessions(share: float, organs: list[str], seed: int) -> list[dict[str, Any]]:
    begin, rows = time.perf_counter(), []
    for organ in organs:
        number = max(1, round(share * session_study.SESSIONS[organ]))
        tally = session_study.SessionTally(organ)
        for tally in session_study.sessions(organ, number, seed):
            print(
                f"{organ}, session {tally.sessions} of {number}: {sum(tally.done.values())} edits, "
                f"{len(tally.faults)} faults, {time.perf_counter() - begin:.0f} s", flush=True,
            )  # fmt: skip
        if organ != "heart":
            session_study.part_in_two(tally, max(1, round(share * session_study.PLANES)), seed)
        rows.append(asdict(tally))
    return rows


def main() -> None:
    """Run from the command line; what is not asked for is kept as the result has it."""
    parser = argparse.ArgumentParser(description="random edits and undos, checked")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--share", type=float, default=1.0, help="of the runs to make")
    parser.add_argument("--only", choices=("cuts", "sessions"), help="default: both")
    parser.add_argument("--organs", nargs="*", help="of which; default: all there are")
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    result: dict[str, Any] = {}
    if chosen.out is not None and chosen.out.exists():
        result = json.loads(chosen.out.read_text(encoding="utf-8"))
    result |= {"machine": machine(), "seed": chosen.seed, "methods": list(METHODS)}

    def keep(name: str, rows: list[dict[str, Any]], order: list[str]) -> None:
        new = {row["organ"] for row in rows}
        rows += [row for row in result.get(name, []) if row["organ"] not in new]
        result[name] = sorted(rows, key=lambda row: order.index(row["organ"]))

    def wanted(organs: list[str]) -> list[str]:
        return [organ for organ in organs if chosen.organs is None or organ in chosen.organs]

    if chosen.only != "sessions":
        organs = list(ORGANS)
        keep("rows", _cuts(chosen.share, wanted(organs), chosen.seed), organs)
    if chosen.only != "cuts":
        organs = list(session_study.ORGANS)
        keep("sessions", _sessions(chosen.share, wanted(organs), chosen.seed), organs)
    result["target"] = target()
    result["spot"] = [asdict(tally) for tally in spot(chosen.seed)]
    result["spot_sessions"] = [asdict(spot_session(organ, chosen.seed)) for organ in SPOT_SESSIONS]
    if chosen.out is not None:
        chosen.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
