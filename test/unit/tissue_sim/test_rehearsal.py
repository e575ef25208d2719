"""After the rehearsal no frame compiles anything."""

from __future__ import annotations

import numpy as np
from numba.core import event

from support.split_edit import split_at
from tissue_sim.frame import Budget, Edge, FrameInputs, ToolSample
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.shapes import block
from tissue_sim.interaction.tools import ToolSpec
from tissue_sim.rehearsal import rehearse
from tissue_sim.scene import Scene
from tissue_sim.simulation import Simulation


def test_frames_after_the_rehearsal_compile_nothing() -> None:
    rehearse()
    raw = block(5, 5, 5)
    fixed = np.zeros(len(raw.points), dtype=np.bool_)
    fixed[raw.node_sets["fixed"]] = True
    pose = np.array([0.03, 0.03, 0.06, 0.0, 0.0, 0.0, 1.0])
    with event.install_recorder("numba:compile") as compiled:
        for model in ("lr", "quasi_static", "relaxation", "spring_mass"):
            tool = ToolSpec("g", size=(0.02,), pose=tuple(pose))
            simulation = Simulation(Mesh(raw, fixed), Scene(model=model, tools=(tool,)))
            budget = Budget(steps=2)
            presses: tuple[tuple[bool, Edge], ...] = ((True, 1), (True, 0), (False, -1))
            for use, edge in presses:
                sample = ToolSample("g", pose, 1, use, edge)
                edits = (split_at(simulation.mesh, 0.03, 0.02),) if edge == 0 else ()
                frame = simulation.advance(FrameInputs(edits=edits, tools=(sample,)), budget)
                assert all(answer.success for answer in frame.answers)
    assert not compiled.buffer
