"""A hole in a wall, a patch beside it, and the patch sewn in: how far the hole is closed, drawn.

python examples/close_hole.py closure.png
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cut_service.patching import Wanted, plan_patch
from cut_service.rim import plan_rim
from cut_service.suturing import Sewing
from tissue_sim.elastic.model import Material
from tissue_sim.frame import Budget, FrameInputs
from tissue_sim.geometry.closure import Closure
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.holes import Hole, name_hole, surface_of
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

SIDE, THICKNESS, RADIUS, PATCH = 0.044, 0.004, 0.008, 0.010
"""Of the wall, of the hole and of the patch [m]."""

ASIDE = np.array([0.006, 0.003, THICKNESS + 0.0012])
"""Where the patch is laid, from the middle of the hole [m]."""

VIEW = np.array([[1.0, 0.0, 0.0], [0.0, 0.85, 0.53]])
"""Axes of the picture: from above and a little from the front."""

MIDDLE = np.array([0.5 * SIDE, 0.5 * SIDE, 0.0])


@dataclass(frozen=True)
class Moment:
    """One picture: the tissue, the hole's edge, the threads, and what was measured.

    Attributes:
        triangles: Corners of the surface that faces the viewer [m], shape (t, 3, 3).
        of_patch: Which are the patch's, shape (t,).
        loop: The edge [m], shape (n, 3).
        threads: Ends of the stitches [m], shape (s, 2, 3).
        closure: How far the hole is closed.
        title: What is shown.
    """

    triangles: NDArray[np.float64]
    of_patch: NDArray[np.bool_]
    loop: NDArray[np.float64]
    threads: NDArray[np.float64]
    closure: Closure
    title: str


def ring(radius: float, number: int) -> NDArray[np.float64]:
    """Places around the middle of the hole, at its height 0 [m], shape (number, 3)."""
    angles = 2.0 * np.pi * np.arange(number) / number
    flat = radius * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    return np.asarray(MIDDLE + flat)


def holed_wall() -> Simulation:
    """A wall fixed all around, with a round hole, as round as its elements let it be."""
    raw = block(33, 33, 3, SIDE, SIDE, THICKNESS)
    flat = raw.points[:, :2]
    fixed = np.asarray(((flat < 1e-6) | (flat > SIDE - 1e-6)).any(axis=1))
    mesh = Mesh(raw, fixed)
    middles = mesh.rest[mesh.tets[: mesh.element_rows]].mean(axis=1)
    gone = np.linalg.norm(middles[:, :2] - MIDDLE[:2], axis=1) < RADIUS
    mesh.apply(TopologyEdit(mesh.version, removed_elements=np.flatnonzero(gone).astype(np.uint32)))
    material = Material(young_modulus=5e4, poisson_ratio=0.3)
    return Simulation(
        mesh, Scene("finite_element", {"finite_element": {"corotated": 1.0}}, material)
    )


def frames(simulation: Simulation, count: int, edit: TopologyEdit | None = None) -> None:
    """Apply an edit and go on for some frames."""
    for number in range(count):
        edits = (edit,) if edit is not None and number == 0 else ()
        done = simulation.advance(FrameInputs(edits=edits), Budget(steps=10))
        if edits and not done.edits:
            raise RuntimeError(f"the edit was refused: {done.answers}")


def moment(simulation: Simulation, hole: Hole, title: str) -> Moment:
    """The wall as it is now."""
    mesh = simulation.mesh
    places = simulation.state.positions(mesh).astype(np.float64)
    surface = surface_of(mesh)
    triangles = places[np.concatenate([surface.tissue, surface.patches])]
    of_patch = np.arange(len(triangles)) >= len(surface.tissue)
    toward = np.cross(VIEW[0], VIEW[1])
    edges = triangles[:, 1:] - triangles[:, :1]
    facing = np.cross(edges[:, 0], edges[:, 1]) @ toward > 0.0
    order = np.argsort(triangles[facing].mean(axis=1) @ toward)
    closure = hole.closure(mesh, places)
    return Moment(
        triangles[facing][order], of_patch[facing][order], hole.loop(mesh, places),
        places[mesh.sutures.nodes], closure, title,
    )  # fmt: skip


def draw(moments: list[Moment], path: str) -> None:
    """Draw moments side by side, all at one scale."""
    figure = Figure(figsize=(10.5, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    for number, shown in enumerate(moments, start=1):
        axes = figure.add_subplot(1, len(moments), number)
        _draw(axes, shown)
    figure.savefig(path, dpi=130)


def _draw(axes: Axes, shown: Moment) -> None:
    def seen(places: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(1e3 * (places - MIDDLE) @ VIEW.T)

    colours = np.where(shown.of_patch[:, None], [[0.62, 0.76, 0.90]], [[0.93, 0.72, 0.68]])
    axes.add_collection(
        PolyCollection(
            list(seen(shown.triangles)), facecolors=colours, edgecolors="#00000040", linewidths=0.2
        )
    )
    edge = seen(np.concatenate([shown.loop, shown.loop[:1]]))
    axes.plot(*edge.T, color="black", linewidth=1.2)
    axes.add_collection(LineCollection(list(seen(shown.threads)), colors="#0a6b2d", linewidths=2.0))
    found = shown.closure
    if found.gap > 0.0:
        circle = ring(0.5 * found.gap, 60) - MIDDLE + found.gap_at
        axes.plot(*seen(np.concatenate([circle, circle[:1]])).T, color="#c00000", linewidth=1.5)
    text = f"{100 * found.covered:.0f} % covered, widest gap {1e3 * found.gap:.1f} mm"
    if np.isfinite(found.edge_gap):
        text += f"\npatch up to {1e3 * found.edge_gap:.1f} mm from the edge"
    axes.set_title(f"{shown.title}\n{text}", fontsize=9)
    axes.set(xlim=(-20, 20), ylim=(-17, 20), aspect="equal")
    axes.set_axis_off()


def main(path: str) -> None:
    """Name the hole, lay the patch beside it, sew it in, and draw each."""
    simulation = holed_wall()
    mesh = simulation.mesh
    around = ring(RADIUS, 24) + np.array([0.0, 0.0, THICKNESS])
    hole = name_hole(mesh, mesh.rest[: mesh.node_rows], "hole", around)
    moments = [moment(simulation, hole, "named")]
    outline = Wanted(ring(PATCH, 48) + ASIDE, edge=0.0016, name="patch")
    frames(simulation, 1, plan_patch(mesh, simulation.state.positions(mesh), outline).edit)
    moments.append(moment(simulation, hole, "a patch beside it"))
    shape = simulation.state.positions(mesh)
    (patch,) = mesh.patches
    wanted = Sewing(hole.loop(mesh, shape), spacing=0.002, length=0.0)
    frames(simulation, 60, plan_rim(mesh, shape, patch, wanted))
    moments.append(moment(simulation, hole, f"sewn, {len(mesh.sutures)} stitches"))
    for shown in moments:
        found = shown.closure
        print(
            f"{shown.title}: {100 * found.covered:.1f} % of {1e6 * found.area:.1f} mm2, "
            f"gap {1e3 * found.gap:.2f} mm, edge {1e3 * found.edge_gap:.2f} mm"
        )
    draw(moments, path)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "closure.png")
