"""The models of this library as simulators among the others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Model, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.peers.task import Task

ALL: dict[str, Any] = {"levels": WHOLE_ORGAN}

SETTINGS: dict[str, tuple[dict[str, Any], ...]] = {
    "finite_element": ({}, {"corotated": 1}),
    "vertex_block_descent": tuple(
        {"step": step, "momentum": momentum, **ALL}
        for step, momentum in ((1.0, 0.9), (1.0, 0.95), (1.0, 0.98), (1.3, 0.95), (1.9, 0.0))
    ),
    "quasi_static": tuple({"step": step, **ALL} for step in (1.0, 1.5, 1.9)),
    "spring_mass": tuple({"damping": damping} for damping in (0.005, 0.02, 0.08)),
    "lr": ({}, ALL, {"sweeps": 10}),
}
"""Parameters tried, by model."""


class OwnModel:
    """A model from the registry, in single precision as everywhere."""

    def __init__(self, name: str, task: Task, settings: dict[str, Any]) -> None:
        """Build the model and grab, at rest, what is held."""
        self._task = task
        parameters = {key: float(value) for key, value in settings.items()}
        self.model: Model = registry.build(name, task.mesh, task.material, parameters)
        self.state = State(task.mesh)
        self.model.prescribed_changed(self.state, task.held[:0])
        self.state.prescribed[task.held] = True
        self.model.prescribed_changed(self.state, task.held)

    def pull(self, share: float = 1.0) -> None:
        """Put the held nodes where they are pulled to."""
        self.state.displacement[self._task.held] = share * self._task.vector

    def step(self) -> None:
        """One step of the model."""
        self.model.step(self.state)

    def displacement(self) -> NDArray[np.floating]:
        """Displacements of all nodes [m]."""
        return self.state.displacement[: self._task.mesh.node_rows]


class KnownMotion(OwnModel):
    """Finite elements whose hold has moved the same way before: every pose after the first frames.

    The pull comes from rest all the same.
    """

    def __init__(self, task: Task, settings: dict[str, Any]) -> None:
        """Build the model, solve for a tenth of the pull, and go back."""
        super().__init__("finite_element", task, settings)
        for share in (0.1, 0.0):
            self.pull(share)
            self.step()
            while not self.model.idle:
                self.step()
