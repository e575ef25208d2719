"""Steps a second of every model, next to what the machine allows and to the thesis' figures."""

from __future__ import annotations

import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np
from numpy.typing import NDArray

from tissue_sim.bench_work import done_by, work_of
from tissue_sim.elastic import registry
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.elastic.integrators import RUNGE_KUTTA_4
from tissue_sim.elastic.local_relaxation import LocalRelaxation
from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import Material, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.relaxation import Relaxation
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.elastic.vertex_block_descent import VertexBlockDescent
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sheet import SheetStiffness
from tissue_sim.geometry.sheet_geometry import CONNECTED, SURFACE, SheetSettings
from tissue_sim.kernels.machine import multiply_and_add, root_and_quotient, triad

REPEATS = 5
TRIAD_NUMBERS = 32 * 1024 * 1024
HOLD_SPEED = 0.1
"""Speed of the hold while a model is timed [m/s]."""


SHAKE_EVERY = 4
"""Steps after which all nodes are displaced again where every node is to be active."""

FINE_HEART = "fine heart"
FINE_CELL = 0.6e-3
"""Size of the elements of a heart with ten times the nodes [m]."""

SHEETS = {
    "heart, surface": SheetSettings(SURFACE, stiffness=SheetStiffness(torsion=1.0)),
    "heart, connected surfaces": SheetSettings(CONNECTED),
}
"""The heart made of its surface, as scenes have it by default."""


@dataclass(frozen=True)
class Limits:
    """What one thread of the machine can do.

    Attributes:
        bandwidth: Memory traffic [B/s].
        roots: Square roots a second, each with a division.
        operations: Additions and multiplications a second.
    """

    bandwidth: float
    roots: float
    operations: float


@dataclass(frozen=True)
class Case:
    """What one row measures.

    Attributes:
        label: Name of the row.
        model: Name of the model.
        geometry: Name of the generated geometry.
        parameters: Values that differ from the defaults.
        released: Whether the hold is let go before the timing.
        settled: Whether everything is solved for before the timing.
        disturbed: Whether all free nodes are displaced at random before each timing, every few
            steps of it, and whenever the model has come to rest: every node is active.
        sleeping: Whether relaxation passes over resting tissue.
        times: Time for this row over that for others.
        thesis_fps: The thesis' frames a second on its 2003 desktop.
    """

    label: str
    model: str
    geometry: str
    parameters: tuple[tuple[str, float], ...] = ()
    released: bool = False
    settled: bool = False
    disturbed: bool = False
    sleeping: bool = True
    times: float = 1.0
    thesis_fps: float | None = None


FIBRES = "heart, fibres"
"""The heart with fibres, five times as stiff as the rest, in every element."""

ALL_NODES = (("levels", float(WHOLE_ORGAN)),)
RUNGE_KUTTA = (("integrator", float(RUNGE_KUTTA_4)),)
MORE_FORCES = (("volume_stiffness", 1e4), ("home_stiffness", 1e6))
COROTATED = (("corotated", 1.0),)
CASES = (
    Case("quasi_static, all nodes", "quasi_static", "wall", ALL_NODES, thesis_fps=57),
    Case("spring_mass", "spring_mass", "wall", thesis_fps=86),
    Case("relaxation, one pass", "relaxation", "wall", thesis_fps=106),
    Case("lr, L = 4, one pass", "lr", "wall"),
    Case("finite_element, motions known", "finite_element", "wall", settled=True, thesis_fps=12),
    Case("quasi_static, all nodes", "quasi_static", "heart", ALL_NODES),
    Case("quasi_static, L = 4", "quasi_static", "heart", (("levels", 4.0),)),
    Case("spring_mass", "spring_mass", "heart"),
    Case("spring_mass, all active", "spring_mass", "heart", disturbed=True),
    Case("spring_mass, Runge-Kutta 4", "spring_mass", "heart", RUNGE_KUTTA, disturbed=True),
    Case("spring_mass, volume and home", "spring_mass", "heart", MORE_FORCES, disturbed=True),
    Case("spring_mass, relaxed", "spring_mass", "heart", (("passes", 1.0),), disturbed=True),
    Case("relaxation, one pass", "relaxation", "heart"),
    Case("relaxation, all active", "relaxation", "heart", disturbed=True),
    Case("lr, all active", "lr", "heart", (("linear_factor", 0.00035),), disturbed=True),
    Case("lr, L = 4, one pass", "lr", "heart", times=10.0, thesis_fps=20),
    Case("lr, L = 4, one pass, no sleeping", "lr", "heart", sleeping=False, times=10.0),
    Case("lr, after a release", "lr", "heart", released=True),
    Case("finite_element, iterating", "finite_element", "heart", disturbed=True),
    Case("finite_element, motions known", "finite_element", "heart", settled=True),
    Case("finite_element, corotated", "finite_element", "heart", COROTATED),
    Case("vertex_block_descent, all nodes", "vertex_block_descent", "wall", ALL_NODES),
    Case(
        "vertex_block_descent, all active",
        "vertex_block_descent",
        "heart",
        ALL_NODES,
        disturbed=True,
    ),
    Case(
        "vertex_block_descent, all active",
        "vertex_block_descent",
        FIBRES,
        ALL_NODES,
        disturbed=True,
    ),
    Case("vertex_block_descent, L = 4", "vertex_block_descent", "heart", (("levels", 4.0),)),
    Case("chain_mail", "chain_mail", "heart"),
    Case("voxel_chain_mail", "voxel_chain_mail", "heart"),
    Case("quasi_static, all nodes", "quasi_static", "heart, surface", ALL_NODES),
    Case("lr, L = 4, one pass", "lr", "heart, surface"),
    Case("spring_mass, all active", "spring_mass", "heart, surface", disturbed=True),
    Case("quasi_static, all nodes", "quasi_static", "heart, connected surfaces", ALL_NODES),
    Case("relaxation, all active", "relaxation", "heart, connected surfaces", disturbed=True),
    Case("lr, L = 4, one pass", "lr", "heart, connected surfaces"),
    Case("spring_mass, all active", "spring_mass", "heart, connected surfaces", disturbed=True),
    Case("spring_mass", "spring_mass", FINE_HEART, disturbed=True),
    Case("relaxation, all active", "relaxation", FINE_HEART, disturbed=True),
    Case("lr, L = 4, one pass", "lr", FINE_HEART),
    Case("finite_element, iterating", "finite_element", FINE_HEART, disturbed=True),
    Case(
        "vertex_block_descent, all active",
        "vertex_block_descent",
        FINE_HEART,
        ALL_NODES,
        disturbed=True,
    ),
)


def run_bench(
    out: Path | None = Path("out/bench.json"),
    seconds: float = 1.0,
    report: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Measure every case.

    Args:
        out: File to write; None writes nothing.
        seconds: Time for each row [s].
        report: Told what takes long before it begins.

    Returns:
        Machine, triad and rows as in the file.
    """
    registry.warm_up()
    limits = Limits(measure_triad(), 1.0 / measure_roots(), measure_operations())
    meshes: dict[str, Mesh] = {}
    networks: dict[str, SpringNetwork] = {}
    rows = []
    for case in CASES:
        if case.geometry not in meshes:
            if case.geometry == FINE_HEART:
                report(scene_geometry.announcement("heart", {"cell": FINE_CELL}))
            meshes[case.geometry] = geometry(case.geometry)
            networks[case.geometry] = SpringNetwork(meshes[case.geometry], material(case.geometry))
        rows.append(measure(case, networks[case.geometry], seconds, limits))
    result = {
        "machine": machine(),
        "triad_GBps": limits.bandwidth / 1e9,
        "roots_per_second": limits.roots,
        "operations_per_second": limits.operations,
        "rows": rows,
    }
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(result, indent=2) + "\n")
    return result


def geometry(name: str) -> Mesh:
    """A geometry of the rows."""
    if name == FINE_HEART:
        return scene_geometry.load("heart", parameters={"cell": FINE_CELL}).mesh
    if name == FIBRES:
        mesh = scene_geometry.load("heart").mesh
        mesh.fibres[: mesh.element_rows] = (0.0, 0.6, 0.8)
        return mesh
    if name in SHEETS:
        return scene_geometry.load(name.partition(",")[0], sheet=SHEETS[name]).mesh
    return scene_geometry.load(name).mesh


def material(name: str) -> Material:
    """What a geometry of the rows is made of."""
    plain = Material()
    if name != FIBRES:
        return plain
    return replace(plain, fibre_stiffness=5.0 * plain.young_modulus)


def machine() -> dict[str, Any]:
    """What was measured on."""
    name = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        name = names[0].partition(":")[2].strip() if names else name
    return {
        "processor": name,
        "cores": len(os.sched_getaffinity(0)),
        "load_average": os.getloadavg()[0],
        "python": platform.python_version(),
        "numba": numba.__version__,
        "system": platform.platform(),
    }


def target() -> str:
    """The processor that kernels are compiled for: results are the same bit for bit on one kind.

    On another one products and sums are rounded together or one by one, and a blade that just
    misses a node hits it.
    """
    return str(llvmlite.binding.get_host_cpu_name())


def measure_triad() -> float:
    """Memory bandwidth of one thread, a = b + s c with single precision numbers [B/s]."""
    a, b, c = (np.ones(TRIAD_NUMBERS, dtype=np.float32) for _ in range(3))
    triad(a, b, c, np.float32(3.0))
    return (
        3 * a.nbytes / min(_timed(lambda: triad(a, b, c, np.float32(3.0))) for _ in range(REPEATS))
    )


def measure_roots() -> float:
    """Time of a square root and the division that waits for it, eight at once [s]."""
    numbers = np.linspace(1.0, 2.0, 4096, dtype=np.float32)
    one = np.float32(1.0)
    root_and_quotient(numbers, one)
    times = [_timed(lambda: root_and_quotient(numbers, one)) for _ in range(40 * REPEATS)]
    return min(times) / len(numbers)


def measure_operations() -> float:
    """Single precision operations a second that wait for nothing, half of them products."""
    numbers = np.linspace(0.1, 1.0, 4096, dtype=np.float32)
    s, c = np.float32(0.999), np.float32(0.001)
    multiply_and_add(numbers, s, c)
    times = [_timed(lambda: multiply_and_add(numbers, s, c)) for _ in range(40 * REPEATS)]
    return 32 * len(numbers) / min(times)


def _timed(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def measure(case: Case, springs: SpringNetwork, seconds: float, limits: Limits) -> dict[str, Any]:
    """Measure one case.

    Args:
        case: What to measure.
        springs: Network of the case's geometry.
        seconds: Time for all repeats together [s].
        limits: What the machine can do.

    Returns:
        A row of the table.
    """
    mesh = springs.mesh
    model = registry.MODELS[case.model](
        mesh,
        springs.material,
        registry.checked_parameters(case.model, dict(case.parameters)),
        springs,
    )
    state, held = State(mesh), hold_for(mesh)
    model.prescribed_changed(state, held[:0])
    state.prescribed[held] = True
    model.prescribed_changed(state, held)
    _pull(model, state, held, seconds / REPEATS)
    while case.settled and not model.idle:
        model.step(state)
    if case.released:
        state.prescribed[held] = mesh.fixed[held]
        model.prescribed_changed(state, held[:0])
        held = held[:0]
    if isinstance(model, (Relaxation, LocalRelaxation)):
        model.relaxation.sleeping = case.sleeping
    rates, done = [], []
    for _ in range(REPEATS):
        if case.disturbed:
            disturb(model, state, held)
        part = case.times * seconds / REPEATS
        pulled = _pull(model, state, held, part, case.disturbed)
        rates.append(pulled[0])
        done.append(pulled[1])
    rate = statistics.median(rates)
    work = work_of(model, state, np.mean(done, axis=0))
    at_memory = work.moved / limits.bandwidth
    at_arithmetic = max(work.roots / limits.roots, work.operations / limits.operations)
    return {
        "model": case.label,
        "geometry": case.geometry,
        "nodes": int(mesh.node_alive.sum()),
        "elements": int(mesh.element_alive.sum()),
        "active_nodes": work.nodes,
        "springs_visited": work.springs,
        "threads": 1,
        "steps_per_second": rate,
        "ms_per_step": 1e3 / rate,
        "bytes_per_step": work.moved,
        "limit": "memory" if at_memory >= at_arithmetic else "arithmetic",
        "limit_share": max(at_memory, at_arithmetic) * rate,
        "thesis_fps": case.thesis_fps,
        "parameters": asdict(case)["parameters"],
    }


def hold_for(mesh: Mesh) -> NDArray[np.int32]:
    """Free nodes of a sphere of a twelfth of the organ's size around its free node farthest out."""
    points = mesh.rest[: mesh.node_rows]
    free = ~mesh.fixed[: mesh.node_rows]
    fixed = points[~free].mean(axis=0) if (~free).any() else points.mean(axis=0)
    distance = np.where(free, np.linalg.norm(points - fixed, axis=1), 0.0)
    centre = points[np.argmax(distance)]
    radius = float(np.ptp(points, axis=0).max()) / 12
    near = free & (np.linalg.norm(points - centre, axis=1) <= radius)
    return np.flatnonzero(near).astype(np.int32)


def disturb(model: MeshModel, state: State, held: NDArray[np.int32]) -> None:
    """Displace all free nodes at random by a few hundredths of a typical edge."""
    springs, rows = model.springs, model.mesh.node_rows
    edge = float(
        np.median(springs.springs.length[: springs.rows][springs.springs.alive[: springs.rows]])
    )
    random = np.random.default_rng(1)
    free = ~state.prescribed[:rows]
    state.displacement[:rows][free] = random.normal(0, 0.03 * edge, (int(free.sum()), 3))
    state.previous[:] = state.displacement
    model.prescribed_changed(state, held)


def _keep_active(model: MeshModel, state: State, shaken: NDArray[np.floating], held: Any) -> None:
    """Displace all nodes again; nobody has let go, and no order has to be made anew."""
    if isinstance(model, FiniteElement):
        if model.idle:
            disturb(model, state, held)
        return
    state.displacement[:] = shaken
    state.previous[:] = shaken
    if isinstance(model, VertexBlockDescent):
        model.problem.wake(state)
        model.problem.last_move[:] = 0


def height(travel: float, most: float = 0.01) -> float:
    """Where a hold is [m] that goes to and fro between -most and most at constant speed."""
    return most - abs((travel + most) % (4 * most) - 2 * most)


def _pull(
    model: MeshModel,
    state: State,
    held: NDArray[np.int32],
    seconds: float,
    disturbed: bool = False,
) -> tuple[float, NDArray[np.float64]]:
    """Step while the hold goes to and fro by a centimetre; at least three steps are done.

    Only the steps are timed, and their time is the time in which the hold moves.

    Returns:
        Steps a second, and what they did on average that differs from step to step.
    """
    shaken = state.displacement.copy()
    if isinstance(model, (Relaxation, LocalRelaxation)):
        model.relaxation.complete_order()
    steps, passed, done = 0, 0.0, 0.0 * done_by(model)
    while passed < seconds or steps < 3:
        if disturbed and (model.idle or steps % SHAKE_EVERY == 0):
            _keep_active(model, state, shaken, held)
        if len(held):
            state.displacement[held, 2] = height(passed * HOLD_SPEED)
        begin = time.perf_counter()
        model.step(state)
        passed += time.perf_counter() - begin
        steps += 1
        done += done_by(model)
    return steps / passed, done / steps


def as_markdown(result: dict[str, Any]) -> str:
    """The rows of a result as a table for a page."""
    lines = [
        "| geometry | model | nodes | active | springs, blocks or elements a step | ms a step "
        "| steps a second | of the limit | limit | thesis, 2003 |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in result["rows"]:
        thesis = f"{row['thesis_fps']:.0f}" if row["thesis_fps"] else ""
        lines.append(
            f"| {row['geometry']} | {row['model']} | {row['nodes']:,} | {row['active_nodes']:,} "
            f"| {row['springs_visited']:,} | {row['ms_per_step']:.3f} "
            f"| {row['steps_per_second']:,.0f} | {row['limit_share']:.0%} | {row['limit']} "
            f"| {thesis} |"
        )
    return "\n".join(lines)
