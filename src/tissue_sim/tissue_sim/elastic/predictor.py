"""A fast model that goes ahead of a precise one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Model, State
from tissue_sim.elastic.spring_mass import SpringMass
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange

MOST_STEPS = 1000


class Predictor:
    """What the fast model does in a frame is where the precise one starts its own steps from.

    The fast model keeps its own state and follows holds and edits. In a frame in which what is held
    moves it takes its steps first, and the free nodes of the precise model are moved by what they
    changed; in other frames it goes on for itself, until it is idle. Everything depends on what is
    held and on the number of frames only, not on time.

    Attributes:
        model: The fast model.
        state: Its state.
    """

    def __init__(
        self,
        name: str,
        steps: int,
        springs: SpringNetwork,
        parameters: Mapping[str, float],
        state: State,
    ) -> None:
        """Stand where the precise model stands.

        Args:
            name: Name of the fast model.
            steps: Its steps in a frame.
            springs: The network of the precise model, to share.
            parameters: Parameters of the fast model that differ from its defaults.
            state: The precise model's.

        Raises:
            ValueError: The model or a number is not allowed.
        """
        if name not in allowed_names():
            raise ValueError(
                f"there is no predictor {name!r}; allowed: {', '.join(allowed_names())}"
            )
        if not 1 <= steps <= MOST_STEPS:
            raise ValueError(
                f"predictor_steps = {steps} is out of range; allowed: 1 to {MOST_STEPS}"
            )
        mesh = springs.mesh
        self.model = registry.build(name, mesh, springs.material, dict(parameters), springs)
        if self.model.time_step is not None:
            raise ValueError(
                f"predictor {name}, as it is set, goes by time and cannot go ahead; allowed: "
                "without dynamic"
            )
        self._mesh, self._springs, self._steps = mesh, springs, steps
        self._held = np.empty(0, dtype=np.int32)
        self.state = State(mesh)
        self._before = np.zeros_like(self.state.displacement)
        self.restart(state)

    def restart(self, state: State) -> None:
        """Stand where the precise model stands."""
        for mine, its in (
            (self.state.displacement, state.displacement),
            (self.state.previous, state.displacement),
            (self.state.prescribed, state.prescribed),
        ):
            np.copyto(mine, its)
        self.model.prescribed_changed(self.state, self._held)

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Holds were made, released or taken over; see `Model`."""
        self._held = held.astype(np.int32)
        np.copyto(self.state.prescribed, state.prescribed)
        self._place(state)
        self.model.prescribed_changed(self.state, self._held)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """The mesh applied an edit and the precise model followed; see `Model`."""
        self.state.follow(self._mesh, change)
        if len(self._before) < len(self.state.displacement):
            self._before = np.zeros_like(self.state.displacement)
        np.copyto(self.state.prescribed, state.prescribed)
        self.model.topology_changed(change, self.state)
        self.model.events.clear()

    def predict(self, model: Model, state: State) -> None:
        """Begin a frame: go ahead. Modifies `state` in place.

        Args:
            model: The precise model; one that takes no guess is left alone.
            state: Its state, held nodes where they are in this frame.
        """
        rows = self._mesh.node_rows
        moves = self._place(state)
        if not moves and self.model.idle:
            return
        np.copyto(self._before[:rows], self.state.displacement[:rows])
        for _ in range(self._steps):
            self.model.step(self.state)
            if self.model.idle:
                break
        if moves and model.takes_guess and model.name != self.model.name:
            model.guess(state, self._before, self.state.displacement)

    def _place(self, state: State) -> bool:
        """Put held nodes where they are; whether one of them has moved."""
        places = state.displacement[self._held]
        moves = bool((self.state.displacement[self._held] != places).any())
        self.state.displacement[self._held] = places
        return moves


def predictor_of(
    name: str,
    steps: int,
    model: Model,
    springs: SpringNetwork,
    parameters: Mapping[str, float],
    state: State,
) -> Predictor | None:
    """The predictor that a scene asks for; None if it asks for none.

    Args:
        name: Name of the fast model; "": none.
        steps: Its steps in a frame.
        model: The precise model.
        springs: Its network.
        parameters: Parameters of the fast model that differ from its defaults.
        state: Displacements and prescribed nodes of the precise model.

    Raises:
        ValueError: The models or a number are not allowed.
    """
    if not name:
        return None
    if not model.takes_guess:
        raise ValueError(
            f"model {model.name}, as it is set, takes no prediction; allowed with a predictor: "
            "quasi_static, vertex_block_descent without dynamic, finite_element without corotated"
        )
    if name == model.name:
        raise ValueError(f"model {name} cannot be its own predictor; allowed: another model")
    return Predictor(name, steps, springs, parameters, state)


def allowed_names() -> tuple[str, ...]:
    """Names of the models that can go ahead."""
    return tuple(name for name in registry.names() if name != SpringMass.name)
