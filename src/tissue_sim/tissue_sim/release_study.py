"""How fast tissue returns after a release, with and without seeding; see docs/seeded_release.md.

python3 -m tissue_sim.release_study --out docs/results/seeded_release.json
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.bench import hold_for
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.frame import Budget, Command, FrameInputs, ToolSample
from tissue_sim.geometry import scene_geometry
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.quality import signed_volumes
from tissue_sim.interaction.seeding import Seeding
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

TOOL = "grasper"
PULL = np.array([0.0, 0.006, 0.008])
"""How far the tool pulls: a centimetre [m]."""
PULL_STEPS = 40
SETTLE_STEPS = 200
SHARES = (0.05, 0.01)
"""Shares of the pull within which the tissue has returned."""
STAYS = 100
"""Steps for which it must stay so."""
FRAME_BUDGET = 0.006
"""Time for steps of static models in a frame [s]."""
RADII = (0.0, 0.01, 0.02, 0.04)
MODELS = {
    "wall": (
        "lr", "quasi_static", "relaxation", "spring_mass", "vertex_block_descent",
        "finite_element",
    ),
    "heart": ("lr", "vertex_block_descent", "finite_element"),
}  # fmt: skip
MOST_STEPS = {"wall": 6000, "heart": 4000}


@dataclass(frozen=True)
class ReleaseRow:
    """One release.

    Attributes:
        geometry, model: What returned.
        radius: Radius of the seeding [m]; 0: none.
        seeded: Nodes that the seeding moved.
        steps: Steps until every node was within each of `SHARES` of the pull from rest, to stay;
            None: not within `MOST_STEPS`.
        frames: The same in frames of 60 Hz: by simulated time, and for static models as many as
            the median step takes of `FRAME_BUDGET`.
        start: Largest displacement before the first step, as a share of the pull.
        inverted: Elements inverted before the first step.
        seed_ms: Processor time of the seeding alone, best of three [ms].
    """

    geometry: str
    model: str
    radius: float
    seeded: int
    steps: tuple[int | None, ...]
    frames: tuple[int | None, ...]
    start: float
    inverted: int
    seed_ms: float


def pulled(geometry: str, model: str, radius: float) -> Simulation:
    """A simulation whose free end has been pulled and has come to rest so."""
    mesh = scene_geometry.load(geometry).mesh
    held = hold_for(mesh)
    points = mesh.rest[held]
    centre = points.mean(axis=0)
    reach = float(np.linalg.norm(points - centre, axis=1).max())
    tool = ToolSpec(TOOL, size=(reach,), pose=(*centre, 0.0, 0.0, 0.0, 1.0)).checked()
    simulation = Simulation(mesh, Scene(model=model, tools=(tool,), seeded_release=radius))
    grab = Command("grab", {"tool": TOOL, "radius": reach})
    simulation.advance(FrameInputs((grab,)), Budget(steps=0))
    for step in range(PULL_STEPS):
        pose = np.array([*(centre + PULL * (step + 1) / PULL_STEPS), 0.0, 0.0, 0.0, 1.0])
        simulation.advance(FrameInputs(tools=(ToolSample(TOOL, pose),)), Budget(steps=1))
    simulation.advance(FrameInputs(), Budget(steps=SETTLE_STEPS))
    return simulation


def released(geometry: str, model: str, radius: float, most: int) -> ReleaseRow:
    """Let go and count the steps of the return."""
    simulation = pulled(geometry, model, radius)
    mesh, state, pull = simulation.mesh, simulation.state, float(np.linalg.norm(PULL))
    before, freed = state.displacement.copy(), simulation.holds.rows
    let_go = Command("release", {"hold_id": 0, "tool": TOOL})
    simulation.advance(FrameInputs((let_go,)), Budget(steps=0))
    start = largest(state.displacement) / pull
    moved = int((state.displacement != before).any(axis=1).sum())
    inverted = int((volumes(mesh, state.displacement) < 0.0).sum())
    steps: list[int | None] = [None] * len(SHARES)
    seconds: list[float] = []
    for step in range(most + 1):
        share = largest(state.displacement) / pull
        for place, wanted in enumerate(SHARES):
            if share > wanted:
                steps[place] = None
            elif steps[place] is None:
                steps[place] = step
        last = steps[-1]
        if last is not None and step >= last + STAYS:
            break
        frame = simulation.advance(FrameInputs(), Budget(steps=1))
        seconds += list(frame.step_seconds)
    frames = tuple(
        None if count is None else _frames(simulation, count, seconds) for count in steps
    )
    return ReleaseRow(
        geometry, model, radius, moved, tuple(steps), frames, start, inverted,
        seeding_ms(simulation, before, freed, radius),
    )  # fmt: skip


def seeding_ms(
    simulation: Simulation,
    displacement: NDArray[np.floating],
    freed: NDArray[np.int32],
    radius: float,
) -> float:
    """Processor time of the seeding of a release [ms], best of three."""
    if radius == 0.0:
        return 0.0
    mesh, springs = simulation.mesh, SpringNetwork(simulation.mesh, simulation.scene.material)
    seeding, state, times = Seeding(mesh, radius), State(mesh), []
    for _ in range(3):
        state.displacement[:] = displacement
        begin = time.thread_time()
        seeding.seed(state, freed, springs)
        times.append(time.thread_time() - begin)
    return 1e3 * min(times)


def largest(displacement: NDArray[np.floating]) -> float:
    """Largest displacement of a node [m]."""
    return math.sqrt(float((displacement.astype(np.float64) ** 2).sum(axis=1).max()))


def volumes(mesh: Mesh, displacement: NDArray[np.floating]) -> NDArray[np.float64]:
    """Signed volumes of the elements as deformed [m^3], shape (element_rows,)."""
    points = mesh.rest + displacement
    return signed_volumes(points, mesh.tets[: mesh.element_rows])


def _frames(simulation: Simulation, steps: int, seconds: list[float]) -> int:
    time_step = simulation.model.time_step
    if time_step is not None:
        return math.ceil(steps * time_step * simulation.scene.rate_hz - 1e-6)
    # A step that takes longer than the time for steps is done all the same.
    in_a_frame = max(int(FRAME_BUDGET / float(np.median(seconds))), 1) if seconds else 1
    return math.ceil(steps / in_a_frame)


def run(geometries: Iterable[str], out: Path | None) -> dict[str, Any]:
    """Measure every model with every radius.

    Args:
        geometries: Keys of `MODELS`.
        out: File to write; None writes nothing.
    """
    registry.warm_up()
    rows = []
    for geometry in geometries:
        for model in MODELS[geometry]:
            for radius in RADII:
                rows.append(released(geometry, model, radius, MOST_STEPS[geometry]))
                print(rows[-1], flush=True)
    result = {
        "machine": {"processor": platform.machine(), "python": platform.python_version()},
        "pull": float(np.linalg.norm(PULL)),
        "shares": SHARES,
        "most_steps": MOST_STEPS,
        "rows": [asdict(row) for row in rows],
    }
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def as_markdown(result: dict[str, Any]) -> str:
    """The releases as a table."""
    lines = [
        "| | | radius [mm] | nodes moved | largest at once | inverted | steps to 5 % | to 1 % "
        "| frames to 5 % | to 1 % | seeding [ms] |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in result["rows"]:
        most = result["most_steps"][row["geometry"]]
        steps = [f"> {most}" if value is None else str(value) for value in row["steps"]]
        frames = ["" if value is None else str(value) for value in row["frames"]]
        lines.append(
            f"| {row['geometry']} | `{row['model']}` | {1e3 * row['radius']:g} | {row['seeded']} "
            f"| {row['start']:.0%} | {row['inverted']} | {' | '.join(steps + frames)} "
            f"| {row['seed_ms']:.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="steps and frames of the return after a release")
    parser.add_argument("--geometry", choices=sorted(MODELS), action="append")
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    print(as_markdown(run(chosen.geometry or MODELS, chosen.out)))


if __name__ == "__main__":
    main()
