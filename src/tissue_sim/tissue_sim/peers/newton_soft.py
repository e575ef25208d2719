"""Newton's particle solvers: vertex block descent and XPBD, on one CPU thread."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.peers.task import Task

FRAME = 1.0 / 60.0

VBD_SETTINGS: tuple[dict[str, Any], ...] = tuple(
    {"time_step": time_step, "iterations": iterations}
    for time_step in (FRAME / 2, FRAME, 2 * FRAME)
    for iterations in (3, 10)
)
"""Settings tried with vertex block descent: `time_step` [s] and `iterations` in each."""

XPBD_SETTINGS: tuple[dict[str, Any], ...] = tuple(
    {"time_step": time_step, "iterations": iterations, "soft_body_relaxation": relaxation}
    for time_step, iterations, relaxation in (
        (FRAME, 2, 0.9), (FRAME, 5, 0.1), (1e-3, 5, 0.1), (3e-4, 2, 0.3), (1e-4, 1, 0.9),
    )
)  # fmt: skip
"""Settings tried with XPBD: `time_step` [s], `iterations` in each, and share of a correction."""


class NewtonSoft(ABC):
    """Particles without mass where the tissue is fixed or held; no contacts, gravity or damping."""

    def __init__(self, task: Task, settings: dict[str, Any]) -> None:
        """Build the model and the solver.

        Raises:
            ImportError: newton or Warp is not installed.
        """
        import newton
        import warp

        warp.config.log_level = warp.LOG_ERROR
        lam, mu = task.lame
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        builder.add_soft_mesh(
            pos=warp.vec3(0.0, 0.0, 0.0), rot=warp.quat_identity(), scale=1.0,
            vel=warp.vec3(0.0, 0.0, 0.0), vertices=[warp.vec3(*point) for point in task.points],
            indices=task.tets.ravel().tolist(), density=task.material.density,
            k_mu=mu, k_lambda=lam, k_damp=0.0, add_surface_mesh_edges=False, particle_radius=1e-4,
        )  # fmt: skip
        for node in np.flatnonzero(~task.free):
            builder.particle_mass[node] = 0.0
        builder.color()
        with warp.ScopedDevice("cpu"):
            model = builder.finalize(device="cpu")
            self._solver = self._solver_of(newton.solvers, model, settings)
            self._states = [model.state(), model.state()]
            self._control = model.control()
        self._task, self._time_step = task, settings["time_step"]
        # In Newton's own single precision, so that nothing moves before the pull.
        self._rest = model.particle_q.numpy().copy()

    @abstractmethod
    def _solver_of(self, solvers: Any, model: Any, settings: dict[str, Any]) -> Any:
        """The solver of `newton.solvers` for a model."""

    def pull(self) -> None:
        """Put the particles of the held nodes where they are pulled to."""
        task = self._task
        for state in self._states:
            state.particle_q.numpy()[task.held] = self._rest[task.held] + task.vector

    def step(self) -> None:
        """One time step."""
        before, after = self._states
        self._solver.step(before, after, self._control, None, self._time_step)
        self._states.reverse()

    def displacement(self) -> NDArray[np.floating]:
        """Displacements of all nodes [m]."""
        displacement: NDArray[np.floating] = self._states[0].particle_q.numpy() - self._rest
        return displacement


class NewtonVbd(NewtonSoft):
    """Vertex block descent on a stable neo-Hookean solid, nodes coloured."""

    def _solver_of(self, solvers: Any, model: Any, settings: dict[str, Any]) -> Any:
        return solvers.SolverVBD(
            model, iterations=settings["iterations"], particle_enable_self_contact=False,
            particle_enable_tile_solve=False,
        )  # fmt: skip


class NewtonXpbd(NewtonSoft):
    """XPBD with two constraints for every element, |F|^2 = 3 and det F = 1, solved side by side.

    The energies of these constraints, mu/2 (|F|^2 - 3)^2 and lam/2 (J - 1)^2, resist no shear at
    small strain: their equilibrium is not that of linear elasticity, however well it is solved for.
    """

    def _solver_of(self, solvers: Any, model: Any, settings: dict[str, Any]) -> Any:
        return solvers.SolverXPBD(
            model, iterations=settings["iterations"],
            soft_body_relaxation=settings["soft_body_relaxation"],
        )  # fmt: skip
