"""How faithful and how fast each way of cutting is; see docs/cutting.md.

python3 -m cut_service.cut_study --out docs/results/cuts.json
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
from numba import njit
from numpy.typing import NDArray

from cut_service.errors import CutError
from cut_service.planner import Plan, Settings, plan
from cut_service.quality import radius_ratios
from cut_service.sweep import Sweep
from cut_service.sweep_kernels import closest_on_sweep, elements_in_box
from cut_service.warm_up import warm_up
from tissue_sim.bench import hold_for, machine
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, State
from tissue_sim.elastic.spring_mass import SpringMass
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh

CUTS = 50
SIZES = (0.006, 0.012)
"""Smallest and largest half width of a square sweep [m]."""
SAMPLES = 24
"""Points along each side of a sweep at which is asked whether it is covered."""
COVERED = 0.25
"""A point of the sweep is covered if a face of the cut is nearer than this share of an edge."""
PULL = 0.003
"""Displacement of the hold when iterations are counted [m]."""
SETTLED = 1e-4
"""Largest residual, as a share of the first, that ends them."""
MOST_ITERATIONS = 5000
AS_IS, NOT_SNAPPED = Settings(remove_degeneracies=False), Settings(snap=False)
VARIANTS: dict[str, tuple[str, Settings]] = {
    "split": ("split", Settings()),
    "split, degeneracies left": ("split", AS_IS),
    "split, not snapped": ("split", NOT_SNAPPED),
    "subdivide": ("subdivide", Settings()),
    "subdivide, degeneracies left": ("subdivide", AS_IS),
    "subdivide, not snapped": ("subdivide", NOT_SNAPPED),
    "remove": ("remove", Settings()),
}
"""Method and settings: with all stages, without removing degeneracies, without either."""


@dataclass(frozen=True)
class CutRow:
    """Many cuts of one organ, one after the other, by one method.

    Lengths in mm. The heart as it is, without cuts, has a row too, with no method.

    Attributes:
        label: Which variant.
        cuts: Number of cuts made.
        missed: Sweeps that parted nothing.
        faces: Faces split or bared, median.
        distance_mean, distance_max: Of the cuts' faces from their sweeps: mean over the cuts, and
            the largest of all [mm].
        covered: Share of the sweeps within the tissue that the cuts' faces cover, mean.
        degenerate: Elements that the cuts had made degenerate.
        degenerate_left: Those that removing degeneracies has left.
        quality: Smallest radius ratio after all.
        poor: Elements with a radius ratio below 0.1 after all.
        volume: Change of rest volume by all, as a share.
        nodes, elements: After all.
        plan_ms, plan_ms_most: Processor time to plan, median and most [ms].
        apply_ms, apply_ms_most: Processor time of `Mesh.apply`, median and most [ms].
        step_us: Longest stable step of springs and masses afterwards [us].
        iterations: Conjugate gradient iterations until a pull of the hold has settled afterwards.
    """

    label: str
    cuts: int
    missed: int
    faces: float
    distance_mean: float
    distance_max: float
    covered: float
    degenerate: int
    degenerate_left: int
    quality: float
    poor: int
    volume: float
    nodes: int
    elements: int
    plan_ms: float
    plan_ms_most: float
    apply_ms: float
    apply_ms_most: float
    step_us: float
    iterations: int


@njit(cache=True, nogil=True, error_model="numpy")
def _lie_in(
    points: NDArray[np.float64],
    positions: NDArray[np.float64],
    tets: NDArray[np.int32],
    inside: NDArray[np.bool_],
) -> None:
    for e in range(tets.shape[0]):
        origin = positions[tets[e, 0]]
        u, v, w = (
            positions[tets[e, 1]] - origin, positions[tets[e, 2]] - origin,
            positions[tets[e, 3]] - origin,
        )  # fmt: skip
        # Barycentric weights of a point p are its products with these.
        whole = np.dot(u, np.cross(v, w))
        first, second, third = (
            np.cross(v, w) / whole,
            np.cross(w, u) / whole,
            np.cross(u, v) / whole,
        )
        for k in range(points.shape[0]):
            if inside[k]:
                continue
            x, y, z = points[k, 0] - origin[0], points[k, 1] - origin[1], points[k, 2] - origin[2]
            a = x * first[0] + y * first[1] + z * first[2]
            b = x * second[0] + y * second[1] + z * second[2]
            c = x * third[0] + y * third[1] + z * third[2]
            inside[k] = a >= 0.0 and b >= 0.0 and c >= 0.0 and a + b + c <= 1.0


def sweeps(mesh: Mesh, count: int, sizes: tuple[float, float] = SIZES) -> list[Sweep]:
    """Squares about random nodes, of random directions and sizes [m]; always the same ones."""
    random = np.random.default_rng(11)
    made = []
    for _ in range(count):
        centre = mesh.rest[random.integers(mesh.node_rows)]
        axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
        u, v = random.uniform(*sizes) * axes[:2]
        corners = [centre - u - v, centre + u - v, centre + u + v, centre - u + v]
        made.append(Sweep.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]))
    return made


def samples_within(mesh: Mesh, sweep: Sweep) -> NDArray[np.float64]:
    """Points of a square sweep, spread evenly, that lie in the tissue at rest [m], shape (n, 3)."""
    first, second, fourth = (sweep.vertices[k] for k in (0, 1, 3))
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    u, v = (way.reshape(-1, 1) for way in np.meshgrid(share, share))
    points = first + u * (second - first) + v * (fourth - first)
    tets, alive = mesh.tets[: mesh.element_rows], mesh.element_alive[: mesh.element_rows]
    rows = np.empty(len(tets), dtype=np.int32)
    rows = rows[: elements_in_box(mesh.rest, tets, alive, *sweep.box, rows)]
    inside = np.zeros(len(points), dtype=np.bool_)
    _lie_in(points, mesh.rest, np.ascontiguousarray(tets[rows]), inside)
    return points[inside]


def covered(points: NDArray[np.float64], lips: NDArray[np.float64], near: float) -> float:
    """Share of points that are within `near` [m] of the cut's faces."""
    if not len(points):
        return 1.0
    nearest, distance = np.empty_like(points), np.empty(len(points))
    closest_on_sweep(points, lips, nearest, distance, np.zeros(len(points), dtype=np.int32))
    return float((distance <= near).mean())


def measure(geometry: str, label: str, cuts: int, sizes: tuple[float, float] = SIZES) -> CutRow:
    """Cut an organ again and again by one of the `VARIANTS`; none if the label is not of one."""
    mesh = scene_geometry.load(geometry).mesh
    held = hold_for(mesh)
    tets, volume = mesh.tets[: mesh.element_rows], _volume(mesh)
    edge = float(np.linalg.norm(mesh.rest[tets[:, 1]] - mesh.rest[tets[:, 0]], axis=1).mean())
    method, how = VARIANTS.get(label, ("", NOT_SNAPPED))
    made: list[Plan] = []
    shares, planning, applied, missed = [], [], [], 0
    for sweep in sweeps(mesh, cuts, sizes) if method else []:
        begin = time.thread_time()
        try:
            planned = plan(mesh, mesh.rest[: mesh.node_rows], sweep, method, settings=how)
        except CutError:
            missed += 1
            continue
        planning.append(1e3 * (time.thread_time() - begin))
        made.append(planned)
        shares.append(covered(samples_within(mesh, sweep), planned.lips, COVERED * edge))
        checked = mesh.check(planned.edit)
        begin = time.thread_time()
        mesh.apply(planned.edit, checked)
        applied.append(1e3 * (time.thread_time() - begin))
    reports = [planned.report for planned in made]
    quality = _quality(mesh)
    return CutRow(
        label, len(made), missed,
        _median([report.faces_split for report in reports]),
        1e3 * _mean([report.distance_after[0] for report in reports]),
        1e3 * max((report.distance_after[1] for report in reports), default=0.0),
        _mean(shares), sum(report.degenerate[0] for report in reports),
        sum(report.degenerate[1] for report in reports),
        float(quality.min()), int((quality < 0.1).sum()),
        _volume(mesh) / volume - 1.0,
        int(mesh.node_alive.sum()), int(mesh.element_alive.sum()),
        _median(planning), max(planning, default=0.0),
        _median(applied), max(applied, default=0.0),
        *_afterwards(mesh, held),
    )  # fmt: skip


def _afterwards(mesh: Mesh, held: NDArray[np.int32]) -> tuple[float, int]:
    """Longest stable step of springs and masses [us]; iterations of finite elements."""
    dynamic = registry.build("spring_mass", mesh, Material(), {})
    assert isinstance(dynamic, SpringMass)
    held = held[mesh.node_alive[held]].astype(np.int32)
    state = State(mesh)
    model = registry.build("finite_element", mesh, Material(), {})
    model.prescribed_changed(state, held[:0])
    state.prescribed[held] = True
    model.prescribed_changed(state, held)
    state.displacement[held] = [0.0, 0.0, PULL]
    first, iterations = model.residual(state), 0
    while iterations < MOST_ITERATIONS:
        model.step(state)
        iterations += 1
        if model.residual(state) < SETTLED * first:
            break
    return 1e6 * dynamic.longest_time_step(), iterations


def _volume(mesh: Mesh) -> float:
    a, b, c, d = np.moveaxis(mesh.rest[_living(mesh)], 1, 0)
    return float(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)).sum() / 6.0)


def _living(mesh: Mesh) -> NDArray[np.int32]:
    rows = mesh.element_rows
    return np.ascontiguousarray(mesh.tets[:rows][mesh.element_alive[:rows]])


def _quality(mesh: Mesh) -> NDArray[np.float64]:
    tets = _living(mesh)
    out = np.empty(len(tets))
    radius_ratios(mesh.rest, tets, out)
    return out


def _median(values: Sequence[float]) -> float:
    return float(statistics.median(values)) if values else 0.0


def _mean(values: Sequence[float]) -> float:
    return float(statistics.fmean(values)) if values else 0.0


def spot() -> CutRow:
    """A few cuts of the wall, quickly made again to see whether the figures still are those."""
    return measure("wall", "subdivide", 3, (0.01, 0.02))


def run(geometry: str = "heart", cuts: int = CUTS, out: Path | None = None) -> dict[str, Any]:
    """Measure all variants, and the organ as it is; write the result if `out` says where."""
    warm_up()
    rows = []
    for label in ("not cut", *VARIANTS):
        rows.append(asdict(measure(geometry, label, cuts)))
        print(label, flush=True)
    result = {
        "machine": machine(), "geometry": geometry, "cuts": cuts, "rows": rows,
        "spot": asdict(spot()),
    }  # fmt: skip
    if out is not None:
        out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


_LINES: tuple[tuple[str, Callable[[dict[str, Any]], str]], ...] = (
    ("cuts made (sweeps that parted nothing)", lambda r: f"{r['cuts']} ({r['missed']})"),
    ("faces split or bared, median", lambda r: f"{r['faces']:.0f}"),
    (
        "distance of the faces from the sweep, mean (largest) [mm]",
        lambda r: f"{r['distance_mean']:.3g} ({r['distance_max']:.2g})",
    ),
    ("share of the sweep covered", lambda r: f"{r['covered']:.1%}"),
    (
        "degenerate elements made (left)",
        lambda r: f"{r['degenerate']} ({r['degenerate_left']})" if r["degenerate"] else "",
    ),
    ("smallest radius ratio after all cuts", lambda r: f"{r['quality']:.2g}"),
    ("elements below 0.1", lambda r: f"{r['poor']}"),
    ("change of rest volume", lambda r: f"{r['volume']:.2g}"),
    ("elements after all cuts", lambda r: f"{r['elements']}"),
    (
        "processor time to plan, median (most) [ms]",
        lambda r: f"{r['plan_ms']:.0f} ({r['plan_ms_most']:.0f})",
    ),
    (
        "that of `Mesh.apply`, median (most) [ms]",
        lambda r: f"{r['apply_ms']:.1f} ({r['apply_ms_most']:.1f})",
    ),
    ("longest stable step of springs and masses [us]", lambda r: f"{r['step_us']:.0f}"),
    ("conjugate gradient iterations of a pull", lambda r: f"{r['iterations']}"),
)
ALWAYS = {"smallest radius", "elements below", "elements after", "longest stable", "conjugate grad"}


def as_markdown(result: dict[str, Any]) -> str:
    """The rows as a table, a column each."""
    rows = result["rows"]
    lines = [
        "| | " + " | ".join(row["label"] for row in rows) + " |",
        "|---" * (len(rows) + 1) + "|",
    ]
    for title, shown in _LINES:
        always = any(title.startswith(start) for start in ALWAYS)
        cells = [shown(row) if row["cuts"] or always else "" for row in rows]
        lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="how faithful and fast each way of cutting is")
    parser.add_argument("--geometry", default="heart")
    parser.add_argument("--cuts", type=int, default=CUTS)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    print(as_markdown(run(chosen.geometry, chosen.cuts, chosen.out)))


if __name__ == "__main__":
    main()
