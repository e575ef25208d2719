"""What a cut costs on meshes of very different size; see docs/cutting.md.

python3 -m cut_service.size_study --out docs/results/cut_sizes.json
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cut_service.errors import CutError
from cut_service.organ import Organ, organ_of
from cut_service.planner import METHODS, plan
from cut_service.sweep import Sweep
from cut_service.warm_up import warm_up
from tissue_sim.bench import machine
from tissue_sim.elastic import registry
from tissue_sim.elastic.local_relaxation import LocalRelaxation
from tissue_sim.elastic.model import Material, Model, State
from tissue_sim.geometry.heart import heart
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block

CUTS = 20
EDGE = 0.001
"""Distance of the blocks' nodes [m]."""
HALF, DEPTH = 6.0, 6.0
"""Half width and depth of a cut in a block, in those."""
WINDOW = 0.008
"""Half width of a cut through the heart's wall [m]."""
MODEL = "lr"
REACH = 0.004
"""Nodes so far from the organ's first one are held [m], so that there is an order to keep."""


def _block(nodes: int) -> Mesh:
    size = (nodes - 1) * EDGE
    return Mesh(block(nodes, nodes, nodes, size, size, size))


ORGANS: dict[str, Callable[[], Mesh]] = {
    "block of 9,261 nodes": lambda: _block(21),
    "block of 35,937 nodes": lambda: _block(33),
    "block of 357,911 nodes": lambda: _block(71),
    "heart of 36,386 nodes": lambda: Mesh(heart()),
}


@dataclass(frozen=True)
class SizeRow:
    """The same cuts, one after the other, in an organ of some size.

    Times are the processor's for the one thread that works: what else runs on the machine counts
    little.

    Attributes:
        organ: Which.
        method: How it was cut.
        nodes, elements: Of the organ before.
        cuts: Number of cuts.
        faces: Faces split or bared, median.
        first_ms: Time to look at the whole organ, once [ms].
        plan_ms, plan_ms_most: Time to plan, median and most [ms].
        check_ms: Time of `Mesh.check`, beside the loop, median [ms].
        apply_ms, apply_ms_most: Time of `Mesh.apply`, `State.follow` and the model's change, in the
            loop, median and most [ms].
        both_ms: Planning, checking and applying, median [ms].
        follow_ms: Time for the planner's figures to follow an edit, median [ms].
    """

    organ: str
    method: str
    nodes: int
    elements: int
    cuts: int
    faces: float
    first_ms: float
    plan_ms: float
    plan_ms_most: float
    check_ms: float
    apply_ms: float
    apply_ms_most: float
    both_ms: float
    follow_ms: float


def _sweeps(mesh: Mesh, organ: str, count: int) -> list[Sweep]:
    """Squares of the same size at random places; in a block always the same ones, from its top."""
    random = np.random.default_rng(5)
    rest = mesh.rest[: mesh.node_rows]
    made = []
    for _ in range(count):
        axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
        if organ.startswith("block"):
            top = rest.max(axis=0)
            centre = np.array([*(0.5 * top[:2] + random.uniform(-3, 3, 2) * EDGE), top[2]])
            turn = random.uniform(0.0, np.pi)
            u = HALF * EDGE * np.array([np.cos(turn), np.sin(turn), 0.0])
            v = DEPTH * EDGE * (np.array([0.0, 0.0, 1.0]) + 0.2 * random.normal(size=3))
        else:
            centre = rest[random.integers(mesh.node_rows)]
            u, v = WINDOW * axes[:2]
        corners = [centre - u - v, centre + u - v, centre + u + v, centre - u + v]
        made.append(Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]))
    return made


def _hold(mesh: Mesh, model: Model, state: State) -> None:
    """Hold some nodes, and order the rest from there, as in a session."""
    rest = mesh.rest[: mesh.node_rows]
    held = np.flatnonzero(np.linalg.norm(rest - rest[0], axis=1) < REACH).astype(np.int32)
    state.prescribed[held] = True
    model.prescribed_changed(state, held)
    if isinstance(model, LocalRelaxation):
        model.relaxation.complete_order()


def measure(organ: str, method: str, cuts: int) -> SizeRow:
    """Cut an organ some times; every cut is of the organ as the others have left it."""
    mesh = ORGANS[organ]()
    nodes, elements = mesh.node_rows, mesh.element_rows
    model, state = registry.build(MODEL, mesh, Material(), {}), State(mesh)
    _hold(mesh, model, state)
    first, _ = _timed(lambda: Organ(mesh))
    organ_of(mesh)
    planned, checked, applied, followed, faces = [], [], [], [], []
    for sweep in _sweeps(mesh, organ, cuts):
        places = state.positions(mesh)
        begin = time.thread_time()
        try:
            made = plan(mesh, places, sweep, method)
        except CutError:
            continue
        planned.append(1e3 * (time.thread_time() - begin))
        faces.append(made.report.faces_split)
        begin = time.thread_time()
        ready = mesh.check(made.edit)
        checked.append(1e3 * (time.thread_time() - begin))
        begin = time.thread_time()
        change = mesh.apply(made.edit, ready)
        state.follow(mesh, change)
        model.topology_changed(change, state)
        applied.append(1e3 * (time.thread_time() - begin))
        followed.append(_timed(lambda: organ_of(mesh))[0])
    both = np.sum([planned, checked, applied], axis=0)
    return SizeRow(
        organ, method, nodes, elements, len(planned), _median(faces), first, _median(planned),
        max(planned), _median(checked), _median(applied), max(applied), _median(both),
        _median(followed),
    )  # fmt: skip


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.thread_time()
    outcome = work()
    return 1e3 * (time.thread_time() - begin), outcome


def _median(values: Sequence[float] | NDArray[np.float64]) -> float:
    return float(statistics.median(values))


def run(cuts: int = CUTS, out: Path | None = None) -> dict[str, Any]:
    """Measure everything; write the result if `out` says where."""
    warm_up()
    measure("block of 9,261 nodes", METHODS[0], 2)
    rows = []
    for organ in ORGANS:
        for method in METHODS:
            rows.append(asdict(measure(organ, method, cuts)))
            print(organ, method, flush=True)
    result = {"machine": machine(), "model": MODEL, "rows": rows}
    if out is not None:
        out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


_COLUMNS: tuple[tuple[str, Callable[[dict[str, Any]], str]], ...] = (
    ("organ", lambda r: r["organ"]),
    ("method", lambda r: f"`{r['method']}`"),
    ("faces", lambda r: f"{r['faces']:.0f}"),
    ("plan (most)", lambda r: f"{r['plan_ms']:.1f} ({r['plan_ms_most']:.0f})"),
    ("check", lambda r: f"{r['check_ms']:.2f}"),
    ("apply (most)", lambda r: f"{r['apply_ms']:.2f} ({r['apply_ms_most']:.1f})"),
    ("all three", lambda r: f"{r['both_ms']:.1f}"),
    ("follow", lambda r: f"{r['follow_ms']:.1f}"),
    ("whole organ, once", lambda r: f"{r['first_ms']:.0f}"),
)


def as_markdown(result: dict[str, Any]) -> str:
    """The rows as a table."""
    lines = ["| " + " | ".join(title for title, _ in _COLUMNS) + " |", "|---" * len(_COLUMNS) + "|"]
    lines += [
        "| " + " | ".join(shown(row) for _, shown in _COLUMNS) + " |" for row in result["rows"]
    ]
    return "\n".join(lines)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="what a cut costs on meshes of different size")
    parser.add_argument("--cuts", type=int, default=CUTS)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    print(as_markdown(run(chosen.cuts, chosen.out)))


if __name__ == "__main__":
    main()
