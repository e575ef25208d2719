"""MuJoCo's flex: Saint Venant-Kirchhoff tetrahedra, implicit in position."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.peers.task import Task

SETTINGS: tuple[dict[str, Any], ...] = tuple(
    {"solver": solver, "time_step": time_step, "iterations": iterations}
    for solver, time_step, iterations in (
        *(("CG", time_step, n) for time_step in (0.01, 0.1, 1.0) for n in (30, 60, 100, 200)),
        ("Newton", 0.1, 60),
        ("Newton", 0.1, 100),
    )
)
"""Settings tried: `solver`, `time_step` [s] and `iterations` in each."""

SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))

MODEL = """
<mujoco>
  <option gravity="0 0 0" integrator="discrete" solver="{solver}" timestep="{time_step}"
          iterations="{iterations}">
    <flag contact="disable"/>
  </option>
  <worldbody><body name="hold"/>{bodies}</worldbody>
  <deformable>
    <flex name="tissue" dim="3" body="{owners}" vertex="{vertices}" element="{elements}">
      <elasticity young="{young}" poisson="{poisson}"/>
      <contact contype="0" conaffinity="0" selfcollide="none"/>
    </flex>
  </deformable>
</mujoco>
"""


class MujocoFlex:
    """A body with three slide joints for every free node; what is held is one body without joints.

    Contacts and gravity are off. MuJoCo's `discrete` integrator solves for a whole implicit step,
    so that long time steps make it a static solver.
    """

    def __init__(self, task: Task, settings: dict[str, Any]) -> None:
        """Compile the model.

        Raises:
            ImportError: MuJoCo is not installed.
        """
        import mujoco

        # It would write a log file into the working directory.
        mujoco.set_mju_user_warning(lambda _: None)
        self._task = task
        self._model = mujoco.MjModel.from_xml_string(_model(task, settings))
        self._data = mujoco.MjData(self._model)
        self._step = mujoco.mj_step
        self._hold = self._model.body("hold").id
        self._displacement = np.zeros((len(task.points), 3))

    def pull(self) -> None:
        """Put the body of the held nodes where they are pulled to."""
        self._model.body_pos[self._hold] = self._task.vector
        self._displacement[self._task.held] = self._task.vector

    def step(self) -> None:
        """One time step."""
        self._step(self._model, self._data)

    def displacement(self) -> NDArray[np.floating]:
        """Displacements of all nodes [m]: joint positions of the free ones."""
        self._displacement[self._task.free] = self._data.qpos.reshape(-1, 3)
        return self._displacement


def _model(task: Task, settings: dict[str, Any]) -> str:
    bodies, owners, vertices = [], [], task.points.copy()
    vertices[task.free] = 0.0
    held = set(task.held.tolist())
    for node, (point, mass) in enumerate(zip(task.points, task.masses, strict=True)):
        if task.free[node]:
            inertia = f'<inertial pos="0 0 0" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/>'
            bodies.append(f'<body name="n{node}" pos="{_text(point)}">{inertia}{SLIDES}</body>')
            owners.append(f"n{node}")
        else:
            owners.append("hold" if node in held else "world")
    return MODEL.format(
        bodies="".join(bodies),
        owners=" ".join(owners),
        vertices=_text(vertices),
        elements=_text(task.tets),
        young=task.material.young_modulus,
        poisson=task.material.poisson_ratio,
        **settings,
    )


def _text(numbers: NDArray[Any]) -> str:
    return " ".join(map(repr, numbers.ravel().tolist()))
