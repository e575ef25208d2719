"""Which kernels frames compile, or load, that a rehearsal has not: a program for a fresh process.

A kernel that other tests have called already is there, rehearsed or not. So every scene has a
process of its own, forked off where the rehearsal ended.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import traceback
from dataclasses import replace
from multiprocessing.connection import Connection

import numpy as np
from numba.core.dispatcher import Dispatcher

from support.patches import patch_edit
from support.sewn_blocks import sew_edit
from support.split_edit import split_at
from tissue_sim.elastic.registry import names
from tissue_sim.frame import Budget, Command, Edge, FrameInputs, ToolSample
from tissue_sim.geometry.edit import TopologyEdit
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.interaction.coupling import FORCE
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.rehearsal import rehearse
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation

PROGRAM = "support.frames_after_rehearsal"

NODES, SIZE = 5, 0.06
POSE = (0.03, 0.03, 0.06, 0.0, 0.0, 0.0, 1.0)

VARIANTS: dict[str, tuple[str, dict[str, float]]] = {
    **{name: (name, {}) for name in names()},
    "corotated": ("finite_element", {"corotated": 1}),
    "direct": ("finite_element", {"direct": 1}),
    "region of interest": (
        "finite_element",
        {"interest_radius": 0.05, "interest_x": 0.03, "interest_z": 0.03},
    ),
    "dynamic": ("vertex_block_descent", {"dynamic": 1}),
    "dynamic with Chebyshev": ("vertex_block_descent", {"dynamic": 1, "chebyshev": 0.9}),
    "descent without momentum": ("vertex_block_descent", {"momentum": 0.0}),
    "descent with Chebyshev": ("vertex_block_descent", {"chebyshev": 0.9}),
    "springs with momentum": ("quasi_static", {"momentum": 0.5}),
    "springs with Chebyshev": ("quasi_static", {"chebyshev": 0.9}),
    "springs with a threshold": ("quasi_static", {"threshold": 1e-4}),
    "nodes stop where they are": ("quasi_static", {"keep_until_rest": 0}),
    "explicit Euler": ("spring_mass", {"integrator": 1, "damping": 0.2}),
    "Runge-Kutta 2": ("spring_mass", {"integrator": 2}),
    "Runge-Kutta 4": ("spring_mass", {"integrator": 3}),
    "mass scaling": ("spring_mass", {"mass_scaling": 1, "time_step": 1 / 600}),
    "biphasic": ("spring_mass", {"spring_law": 1}),
    "cubic": ("spring_mass", {"spring_law": 2}),
    "volume forces": ("spring_mass", {"volume_stiffness": 1000.0}),
    "home forces": ("spring_mass", {"home_stiffness": 1e6}),
    "relaxation after steps": ("spring_mass", {"passes": 1}),
}


def signatures() -> dict[str, int]:
    """How many signatures of each kernel are compiled or loaded, by module and name."""
    count: dict[str, int] = {}
    for module in [m for name, m in sys.modules.items() if name.startswith("tissue_sim.")]:
        for name, kernel in vars(module).items():
            if isinstance(kernel, Dispatcher):
                count[f"{kernel.__module__}.{name}"] = len(kernel.signatures)
    return count


def scenes() -> dict[str, Scene]:
    """What is looked at, by label."""
    tool = ToolSpec("g", size=(0.02,), pose=POSE)
    made = {
        label: Scene(model=model, parameters={model: values}, tools=(tool,))
        for label, (model, values) in VARIANTS.items()
    }
    made["held by a force"] = Scene(tools=(replace(tool, hold=FORCE),))
    made["predicted"] = Scene(model="vertex_block_descent", tools=(tool,), predictor="lr")
    made["released from rest"] = Scene(tools=(tool,), seeded_release=0.02)
    return made


def called_first(scene: Scene) -> list[str]:
    """Grab, pull, patch, cut, sew, let go, grab by command, patch; kernels not there before."""
    raw = block(NODES, NODES, NODES, SIZE, SIZE, SIZE)
    fixed = np.zeros(len(raw.points), dtype=np.bool_)
    fixed[raw.node_sets["fixed"]] = True
    pose = np.array(POSE)
    simulation = Simulation(Mesh(raw, fixed), scene)
    steps = 2 if simulation.model.time_step is None else None
    before = signatures()
    for number in range(9):
        edge: Edge = 1 if number == 0 else -1 if number == 6 else 0
        moved = pose + 0.001 * number * np.eye(7)[2]
        edits = (split_at(simulation.mesh, 0.03, 0.02),) if number == 4 else ()
        if number == 5 and not simulation.model.sewing_refusal():
            edits = (_stitch(simulation.mesh),)
        if number in (2, 8) and not simulation.model.patch_refusal():
            edits = (patch_edit(simulation.mesh, (0.0, 0.03, 0.07)),)
        grab = (Command("grab", {"tool": "g", "radius": 0.02}),) if number == 7 else ()
        sample = ToolSample("g", moved, 1, number < 6, edge)
        inputs = FrameInputs(edits=edits, tools=(sample,), commands=grab)
        frame = simulation.advance(inputs, Budget(steps=steps))
        assert all(answer.success for answer in frame.answers), frame.answers
        simulation.model.residual(simulation.state)
        assert bool(len(simulation.holds.rows)) == (number != 6)
    after = signatures()
    return sorted(name for name in after if after[name] > before.get(name, 0))


def _stitch(mesh: Mesh) -> TopologyEdit:
    """Sew a copy to its parent."""
    copy = mesh.node_rows - 1
    return sew_edit(mesh, mesh.node_parents[[copy]].astype(np.int64), np.array([copy]))


def _in_child(reply: Connection, scene: Scene) -> None:
    try:
        reply.send(called_first(scene))
    except Exception:  # whatever it is, the parent has to tell
        reply.send([traceback.format_exc()])


def main() -> None:
    """Rehearse, then print what the frames of every scene still call first, as JSON."""
    rehearse()
    fork = multiprocessing.get_context("fork")
    found: dict[str, list[str]] = {}
    for label, scene in scenes().items():
        ours, theirs = fork.Pipe(duplex=False)
        child = fork.Process(target=_in_child, args=(theirs, scene))
        child.start()
        theirs.close()
        try:
            found[label] = ours.recv()
        except EOFError:
            found[label] = ["the process ended"]
        child.join()
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
