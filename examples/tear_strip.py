"""A notched strip of tissue is pulled until it tears in two: drawn as three pictures in one file.

python examples/tear_strip.py tearing.png
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cut_service.planner import Settings, plan
from cut_service.sweep import Sweep
from cut_service.tearing import Tear, TearSettings, plan_tear
from cut_service.unswept import work_without_sweep
from tissue_sim.elastic.material_field import MaterialField
from tissue_sim.elastic.model import Material
from tissue_sim.elastic.stress import element_material, stresses_of
from tissue_sim.frame import Budget, FrameInputs, ToolSample
from tissue_sim.geometry.components import parts_of
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.geometry.surface import boundary_triangles
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

WIDTH, THICKNESS, HEIGHT = 0.03, 0.004, 0.05
NOTCH = 0.025
THRESHOLD = 30e3
MATERIAL = Material(young_modulus=5e4, poisson_ratio=0.3)


@dataclass(frozen=True)
class Picture:
    """One moment: corners of the triangles that face the viewer [m], their stress [Pa], a title."""

    triangles: NDArray[np.float64]
    stress: NDArray[np.float64]
    title: str


def notched_strip() -> Simulation:
    """A strip held at its bottom, a grip at its top, a notch across a third of its width."""
    raw = block(19, 4, 31, WIDTH, THICKNESS, HEIGHT)
    fixed = np.zeros(len(raw.points), dtype=np.bool_)
    fixed[raw.node_sets["fixed"]] = True
    mesh = Mesh(raw, fixed)
    deep, far = WIDTH / 3, 1.0
    corners = [[-far, -far], [deep, -far], [deep, far], [-far, far]]
    sweep = Sweep.from_arrays([[x, y, NOTCH] for x, y in corners], [[0, 1, 2], [0, 2, 3]])
    mesh.apply(plan(mesh, mesh.rest[: mesh.node_rows], sweep, settings=Settings(snap=False)).edit)
    grip = ToolSpec(
        "grip", pose=(WIDTH / 2, THICKNESS / 2, HEIGHT + 0.1, 0.0, 0.0, 0.0, 1.0), size=(0.1014,)
    )
    parameters = {"finite_element": {"corotated": 1.0}}
    scene = Scene("finite_element", parameters, MATERIAL, (grip.checked(),))
    return Simulation(mesh, scene)


def pull(simulation: Simulation, far: float, tear: Tear | None, first: bool) -> None:
    """One frame with the grip moved up so far [m]."""
    pose = np.array(simulation.tools["grip"].pose)
    pose[2] += far
    sample = ToolSample("grip", pose, 1, True, 1 if first else 0)
    edits = (tear.edit,) if tear is not None and tear.edit is not None else ()
    simulation.advance(FrameInputs(edits=edits, tools=(sample,)), Budget(steps=60))


def look(simulation: Simulation) -> Tear:
    """What tears now."""
    mesh = simulation.mesh
    held = mesh.node_ids[simulation.holds.rows]
    work = work_without_sweep(mesh, simulation.state.positions(mesh), held)
    tear = plan_tear(work, element_material(MaterialField(mesh, MATERIAL)), TearSettings(THRESHOLD))
    if tear.edit is None:
        return tear
    return replace(tear, edit=replace(tear.edit, request_id=f"tear-{mesh.version}"))


def picture(simulation: Simulation, title: str) -> Picture:
    """The strip as it is now, seen along y."""
    mesh = simulation.mesh
    places = simulation.state.positions(mesh).astype(np.float64)
    tets = mesh.tets[: mesh.element_rows]
    alive = mesh.element_alive[: mesh.element_rows]
    triangles, elements = boundary_triangles(tets, alive, mesh.node_rows)
    rest = mesh.rest[: mesh.node_rows]
    front = (rest[triangles][:, :, 1] < 1e-9).all(axis=1)
    lame = element_material(MaterialField(mesh, MATERIAL)).lame
    state = stresses_of(rest, places, tets[elements[front]], np.repeat(lame, front.sum(), axis=0))
    return Picture(places[triangles[front]][:, :, [0, 2]], state.largest, title)


def draw(pictures: list[Picture], path: str) -> None:
    """Draw pictures side by side, all at one scale."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    top = max(float(picture.triangles[:, :, 1].max()) for picture in pictures)
    for number, shown in enumerate(pictures, start=1):
        axes = figure.add_subplot(1, len(pictures), number)
        patches = PolyCollection(
            list(1e3 * shown.triangles), array=shown.stress / 1e3, cmap="viridis", linewidth=0.2,
            edgecolor="#00000055", clim=(0.0, THRESHOLD / 1e3),
        )  # fmt: skip
        axes.add_collection(patches)
        axes.set(xlim=(-4, 1e3 * WIDTH + 4), ylim=(-2, 1e3 * top + 2), aspect="equal")
        axes.set_title(shown.title, fontsize=9)
        axes.tick_params(labelsize=8)
    bar = figure.colorbar(patches, ax=figure.axes, shrink=0.6)
    bar.set_label("largest principal stress [kPa]", fontsize=9)
    figure.savefig(path, dpi=130)


def main(path: str) -> None:
    """Pull until the strip is in two, and draw it before, within and after."""
    simulation = notched_strip()
    pull(simulation, 0.0, None, True)
    far, torn, pictures = 0.0, 0, []
    while parts_of(simulation.mesh) < 2 and far < HEIGHT:
        tear = look(simulation)
        if tear.edit is None:
            far += 0.0005
        elif not torn:
            pictures.append(picture(simulation, f"about to tear, pulled {1e3 * far:.1f} mm"))
        torn += tear.faces
        pull(simulation, far, tear, False)
        pull(simulation, far, None, False)
        if len(pictures) == 1 and torn > 30:
            pictures.append(picture(simulation, f"{torn} faces torn"))
    for _ in range(10):
        pull(simulation, far, None, False)
    parts = parts_of(simulation.mesh)
    pictures.append(picture(simulation, f"{torn} faces torn, {parts} parts"))
    print(f"{parts} parts after {torn} faces and a pull of {1e3 * far:.1f} mm")
    draw(pictures, path)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "tearing.png")
