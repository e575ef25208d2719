"""How soon finite elements are exact after grabs, releases and cuts; see docs/finite_element.md.

python3 -m tissue_sim.grab_study --out docs/results/grabs.json
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tissue_sim.bench import hold_for, machine
from tissue_sim.elastic import registry
from tissue_sim.elastic.direct_solver import dofs_of, rows_of
from tissue_sim.elastic.factorisation import factorised
from tissue_sim.elastic.finite_element import FiniteElement
from tissue_sim.frame import Budget, Command, FrameInputs, ToolSample
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.edit import PROVISIONAL, TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

FRAME_BUDGET = 0.012
"""Time for steps in a frame [s]."""
FRAMES = 180
RATE = 60.0
EXACT = 1e-3
"""Residual of free nodes over force on prescribed nodes, as norms, that counts as exact."""
COMPARED = 10
"""Frames compared with a direct solution."""
SPEED = 0.1
"""Speed of the holds [m/s]."""
GEOMETRIES = ("wall", "heart")
FIRST, SECOND = "grasper", "hook"
MOTIONS = {"moves": 0.0, "moves and turns": 0.35}
"""Largest turn about each axis [rad]."""


@dataclass(frozen=True)
class GrabRow:
    """One change of what is held, and the three seconds after it.

    Attributes:
        geometry, motion, event: What happened.
        change_ms: Time of the frame's change itself, outside the steps [ms].
        iterations: Iterations until every further frame was exact.
        exact_after: Seconds of 60 Hz from the change until every further frame was exact; None:
            the last one was not.
        known_ms: Median time of the steps of a frame once all motions were known [ms]; None: they
            were not within the time.
        error: Largest error of a node over the hold's largest motion against a direct solution, in
            frames spread over those that count as exact; None: not compared.
    """

    geometry: str
    motion: str
    event: str
    change_ms: float
    iterations: int
    exact_after: float | None
    known_ms: float | None
    error: float | None


class Operation:
    """A simulation whose tools move on two paths, frame by frame."""

    def __init__(self, geometry: str, turn: float) -> None:
        """Stand with nothing held.

        Args:
            geometry: Name of a generated geometry.
            turn: Largest turn about each axis [rad].
        """
        mesh = scene_geometry.load(geometry).mesh
        self.turn, self.frame = turn, 0
        self.centres = {FIRST: _centre(mesh, hold_for(mesh))}
        self.centres[SECOND] = mesh.rest[_second(mesh, self.centres[FIRST])]
        size = float(np.ptp(mesh.rest[: mesh.node_rows], axis=0).max())
        self.radius = size / 12
        tools = tuple(
            ToolSpec(name, size=(self.radius,), pose=(*centre, 0.0, 0.0, 0.0, 1.0)).checked()
            for name, centre in self.centres.items()
        )
        self.simulation = Simulation(mesh, Scene(model="finite_element", tools=tools))
        self.model = self.simulation.model
        assert isinstance(self.model, FiniteElement)

    def advance(
        self, *commands: Command, edits: tuple[TopologyEdit, ...] = ()
    ) -> tuple[float, list[float]]:
        """One frame; seconds of what is not stepping, and seconds of each step."""
        self.frame += 1
        samples = tuple(ToolSample(tool, self._pose(tool)) for tool in self.centres)
        begun = time.perf_counter()
        frame = self.simulation.advance(
            FrameInputs(commands, edits, samples), Budget(seconds=FRAME_BUDGET)
        )
        for answer in frame.answers:
            if not answer.success:
                raise RuntimeError(answer.message)
        steps = list(frame.step_seconds)
        return time.perf_counter() - begun - sum(steps), steps

    def _pose(self, tool: str) -> NDArray[np.float64]:
        """Around its centre, along all axes at `SPEED`, turning about all of them."""
        t = self.frame / RATE + (0.0 if tool == FIRST else 1.7)
        reach = 0.005
        rate = SPEED / (reach * math.sqrt(3.0))
        move = reach * np.sin(rate * t * np.array([1.0, 0.83, 0.61]) + [0.0, 1.0, 2.0])
        turned = Rotation.from_rotvec(self.turn * np.sin(np.array([1.9, 2.7, 2.3]) * t))
        return np.array([*(self.centres[tool] + move), *turned.as_quat()])

    def residual(self) -> float:
        """Force in free nodes over force on prescribed ones, as norms."""
        mesh, prescribed = self.simulation.mesh, self.simulation.state.prescribed
        nodes = np.flatnonzero(mesh.node_alive[: mesh.node_rows]).astype(np.int32)
        forces = self.model.forces(self.simulation.state, nodes)
        given = prescribed[nodes]
        return float(np.linalg.norm(forces[~given]) / np.linalg.norm(forces[given]))

    def crack(self) -> TopologyEdit:
        """Split the organ across, through its middle, within two radii of a free node there."""
        mesh = self.simulation.mesh
        points = mesh.rest[: mesh.node_rows]
        free = mesh.node_alive[: mesh.node_rows] & ~self.simulation.state.prescribed[: len(points)]
        middle = points[free].mean(axis=0)
        centre = points[free][np.linalg.norm(points[free] - middle, axis=1).argmin()]
        near = free & (np.linalg.norm(points - centre, axis=1) < 2 * self.radius)
        tets = mesh.tets[: mesh.element_rows]
        alive = mesh.element_alive[: mesh.element_rows]
        behind = alive & (points[tets].mean(axis=1)[:, 0] > centre[0])
        sides = np.zeros((2, len(points)), dtype=bool)
        sides[0, tets[alive & ~behind]] = sides[1, tets[behind]] = True
        parents = np.flatnonzero(near & sides[0] & sides[1])
        rewritten = np.flatnonzero(behind & np.isin(tets, parents).any(axis=1))
        place = np.full(len(points), -1)
        place[parents] = np.arange(len(parents))
        nodes = tets[rewritten].astype(np.int64)
        nodes = np.where(place[nodes] >= 0, PROVISIONAL + place[nodes], nodes)
        return TopologyEdit(
            base_version=mesh.version,
            copied_nodes=(PROVISIONAL + np.arange(len(parents))).astype(np.uint32),
            copy_parents=mesh.node_ids[parents].astype(np.uint32),
            rewritten_elements=mesh.element_ids[rewritten].astype(np.uint32),
            rewritten_nodes=np.where(
                nodes >= PROVISIONAL, nodes, mesh.node_ids[np.minimum(nodes, len(points) - 1)]
            ).astype(np.uint32),
        )


def _centre(mesh: Mesh, rows: NDArray[np.int32]) -> NDArray[np.float64]:
    """The node in the middle of some nodes."""
    points = mesh.rest[rows]
    nearest = np.linalg.norm(points - points.mean(axis=0), axis=1).argmin()
    return points[nearest].copy()


def _second(mesh: Mesh, first: NDArray[np.float64]) -> int:
    """The free node for a second hold: half as far from the first as the farthest."""
    points = mesh.rest[: mesh.node_rows]
    distance = np.linalg.norm(points - first, axis=1)
    distance[mesh.fixed[: mesh.node_rows]] = np.inf
    return int(np.abs(distance - distance[np.isfinite(distance)].max() / 2).argmin())


def observe(
    operation: Operation,
    geometry: str,
    motion: str,
    event: str,
    change: Callable[[], tuple[float, list[float]]],
    direct: bool,
) -> GrabRow:
    """Let something change and watch the three seconds after it."""
    change_seconds, steps = change()
    counts, residuals, times = [len(steps)], [operation.residual()], [sum(steps)]
    shapes: list[NDArray[np.floating]] = []
    known: list[bool] = [operation.model.idle]
    for _ in range(FRAMES - 1):
        _, steps = operation.advance()
        counts.append(len(steps))
        residuals.append(operation.residual())
        times.append(sum(steps))
        known.append(operation.model.idle)
        shapes.append(operation.simulation.state.displacement.copy())
    inexact = np.flatnonzero(np.array(residuals) > EXACT)
    first = int(inexact[-1]) + 1 if len(inexact) else 0
    idle = [1e3 * t for t, k in zip(times, known, strict=True) if k]
    error = None
    if direct and first < FRAMES - 1:
        chosen = np.linspace(first, FRAMES - 1, COMPARED).astype(int)
        error = largest_error(operation, [shapes[max(k - 1, 0)] for k in chosen])
    return GrabRow(
        geometry, motion, event, 1e3 * change_seconds, sum(counts[:first]),
        first / RATE if first < FRAMES else None,
        statistics.median(idle) if len(idle) > 10 else None, error,
    )  # fmt: skip


def largest_error(operation: Operation, shapes: Iterable[NDArray[np.floating]]) -> float:
    """Largest error of a node over the largest motion of a held one, against a factorisation."""
    mesh, model = operation.simulation.mesh, operation.model
    assert isinstance(model, FiniteElement)
    rows = mesh.node_rows
    alive = np.flatnonzero(mesh.node_alive[:rows] & (model.springs.arrays.degree[:rows] > 0))
    prescribed = operation.simulation.state.prescribed[alive]
    free, given = dofs_of(alive[~prescribed]), dofs_of(alive[prescribed])
    matrix = rows_of(model.stiffness, alive[~prescribed])
    factors = factorised(matrix[:, free])
    worst = 0.0
    for shape in shapes:
        u = shape[:rows].astype(np.float64).ravel()
        exact = factors.solve(-(matrix[:, given] @ u[given]))
        error = np.linalg.norm((u[free] - exact).reshape(-1, 3), axis=1).max()
        motion = np.linalg.norm(u[given].reshape(-1, 3), axis=1).max()
        worst = max(worst, float(error / motion))
    return worst


def grab(operation: Operation, tool: str) -> tuple[float, list[float]]:
    """Grab where a tool is."""
    return operation.advance(Command("grab", {"tool": tool, "radius": operation.radius}))


def operate(geometry: str, motion: str, direct: bool) -> list[GrabRow]:
    """Everything that changes what is held, one after the other."""
    operation = Operation(geometry, MOTIONS[motion])

    def watch(event: str, change: Callable[[], tuple[float, list[float]]], compare: bool) -> None:
        rows.append(observe(operation, geometry, motion, event, change, compare))
        print(rows[-1], flush=True)

    def release() -> tuple[float, list[float]]:
        number = operation.simulation.holds.of_tool(FIRST)[0].id
        return operation.advance(Command("release", {"hold_id": number, "tool": FIRST}))

    rows: list[GrabRow] = []
    operation.advance()
    watch("first grab", lambda: grab(operation, FIRST), direct)
    watch("second grab, the first active", lambda: grab(operation, SECOND), False)
    watch("release of the first", release, False)
    watch("cut", lambda: operation.advance(edits=(operation.crack(),)), False)
    watch("grab after the cut", lambda: grab(operation, FIRST), direct and geometry == "wall")
    return rows


def run(geometries: Iterable[str], out: Path | None, direct: bool = True) -> dict[str, Any]:
    """Run all operations.

    Args:
        geometries: Some of `GEOMETRIES`.
        out: File to write; None writes nothing.
        direct: Whether to compare with direct solutions, which takes minutes for the heart.
    """
    registry.warm_up()
    rows = [
        row
        for geometry in geometries
        for motion in MOTIONS
        for row in operate(geometry, motion, direct)
    ]
    result = {
        "machine": machine(),
        "budget_ms": 1e3 * FRAME_BUDGET,
        "exact": EXACT,
        "rows": [asdict(row) for row in rows],
    }
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def as_markdown(result: dict[str, Any]) -> str:
    """The rows as a table."""
    lines = [
        "| | the hold | event | change [ms] | steps until exact | exact after [s] "
        "| a frame when all is known [ms] | error |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in result["rows"]:
        after = "not in 3 s" if row["exact_after"] is None else f"{row['exact_after']:.2f}"
        known = "" if row["known_ms"] is None else f"{row['known_ms']:.2f}"
        error = "" if row["error"] is None else f"{row['error']:.2%}"
        lines.append(
            f"| {row['geometry']} | {row['motion']} | {row['event']} | {row['change_ms']:.1f} "
            f"| {row['iterations']} | {after} | {known} | {error} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="how soon finite elements are exact")
    parser.add_argument("--geometry", choices=GEOMETRIES, action="append")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--no-direct", action="store_true", help="compare with no factorisation")
    chosen = parser.parse_args()
    result = run(chosen.geometry or GEOMETRIES, chosen.out, not chosen.no_direct)
    print(as_markdown(result))


if __name__ == "__main__":
    main()
