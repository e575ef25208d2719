"""Vertex block descent on a stable neo-Hookean solid, quasi-static or dynamic."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.acceleration import CHEBYSHEV
from tissue_sim.elastic.block_active_set import BlockActiveSet
from tissue_sim.elastic.block_problem import BlockProblem
from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.ordering import WHOLE_ORGAN
from tissue_sim.elastic.quasi_static import REST_TOLERANCE
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.block_sweeps import begin_time_step

FRAME = 1.0 / 60.0

LONGEST_WITH_MOMENTUM = 1.3
"""Longer steps and momentum together may overshoot for ever."""


class VertexBlockDescent(MeshModel):
    """Gauss-Seidel sweeps u_i += step K_i^-1 F_i with the 3x3 Hessian K_i of the elastic energy.

    Quasi-static: breadth-first from the held nodes, up to a cut-off level, as `QuasiStatic`.
    Dynamic: implicit Euler, each time step `iterations` sweeps over the whole organ.

    Limitations: sweeps spread a displacement by some levels each, slowly in large organs; dynamic
    steps lose energy, the more the longer they are; see docs/vertex_block_descent.md.

    References:
        A. H. Chen, Z. Liu, Y. Yang, C. Yuksel, Vertex block descent, ACM Transactions on Graphics
        43(4), 2024, doi 10.1145/3658179.
    """

    anisotropic: ClassVar[bool] = True
    needs_tetrahedra: ClassVar[bool] = True
    name: ClassVar[str] = "vertex_block_descent"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("step", 1.0, 0.1, 1.95, "", "share of Newton's step that a node takes"),
        Parameter(
            "levels", 12, 1, WHOLE_ORGAN, "",
            f"breadth-first levels around the held nodes that move; {WHOLE_ORGAN}: all",
            integer=True,
        ),
        Parameter(
            "momentum", 0.95, 0.0, 0.98, "",
            "share of its last move that a node repeats before a sweep; 0: none",
        ),
        CHEBYSHEV,
        REST_TOLERANCE,
        Parameter("dynamic", 0, 0, 1, "", "1: with inertia; a step is a time step", integer=True),
        Parameter("time_step", FRAME, 1e-5, 0.1, "s", "simulated time of a dynamic step"),
        Parameter("iterations", 10, 1, 1000, "", "sweeps in a dynamic step", integer=True),
        Parameter("damping", 0.05, 0.0, 0.9, "", "share of the velocity lost in a dynamic step"),
    )  # fmt: skip

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        dynamic = bool(self.values["dynamic"])
        tolerance, momentum = self.values["rest_tolerance"], self.values["momentum"]
        for name in ("momentum", "chebyshev"):
            if self.values[name] > 0.0 and self.values["step"] > LONGEST_WITH_MOMENTUM:
                raise ValueError(
                    f"step = {self.values['step']:g} is too long with {name} = "
                    f"{self.values[name]:g}; allowed: up to {LONGEST_WITH_MOMENTUM:g}, or "
                    f"{name} = 0"
                )
        self.time_step = self.values["time_step"] if dynamic else None
        # What a force moves in a time step goes with its square.
        of_frame = self.values["time_step"] / FRAME if dynamic else 1.0
        tolerance *= min(1.0, of_frame**2)
        self.problem = BlockProblem(self.springs, self.values["step"], tolerance)
        self.active = BlockActiveSet(
            self.problem, int(self.values["levels"]), tolerance, momentum, self.values["chebyshev"]
        )
        self._step = self.scalar(self.values["step"])
        self._keep = self.scalar(1.0 - self.values["damping"])
        # Momentum is gathered slowly: where there are few sweeps it would only overshoot.
        sweeps = range(int(self.values["iterations"]))
        self._most_momentum = [self.scalar(k / (k + 3.0)) for k in sweeps]
        if self.time_step is not None:
            self._weigh(np.arange(mesh.node_rows, dtype=np.int32))

    @property
    def idle(self) -> bool:
        """Whether a sweep would move nothing, were the held nodes to stay where they are."""
        return self.time_step is None and self.active.at_rest

    def step(self, state: State) -> None:
        """One sweep, or one time step. Modifies the state in place."""
        if self.time_step is None:
            self.active.sweep(state, self._step)
        else:
            self._time_step(state)

    def _time_step(self, state: State) -> None:
        problem, order = self.problem, self.active.ordering
        begin_time_step(
            self.mesh.node_rows, problem.problem, self._keep, problem.controls.tolerance,
            problem.motion(state), state.previous,
        )  # fmt: skip
        pace, chebyshev = self.active.pace, self.active.chebyshev
        if chebyshev is not None:
            chebyshev.begin()
        for most in self._most_momentum:
            if chebyshev is not None:
                moved, along = self.active.sweep_by_chebyshev(chebyshev, state, order.used), 0.0
            else:
                share = min(pace.share, most)
                moved, along = problem.sweep(
                    state, order.nodes, 0, order.used, share, pace.unfolding
                )
            if len(self.springs.stitches):
                free = ~state.prescribed[self.springs.stitches.nodes]
                moved = max(moved, problem.sweep_sewn(state, free, pace.unfolding))
            if moved <= problem.controls.tolerance:
                break
            pace.judge(along)

    def _weigh(self, nodes: NDArray[np.int32]) -> None:
        if self.time_step is not None:
            self.problem.set_masses(nodes, self.time_step)

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Order the nodes anew from the held ones."""
        self.active.prescribed_changed(state, held)

    def nodes_placed(self, nodes: NDArray[np.int32]) -> None:
        """Forget the last moves of nodes that were put elsewhere."""
        self.active.lingering.forget(nodes)

    @property
    def takes_guess(self) -> bool:
        """Sweeps go on from any shape; a time step begins where velocities lead."""
        return self.time_step is None

    def guess(
        self, state: State, before: NDArray[np.floating], after: NDArray[np.floating]
    ) -> None:
        """Move the nodes near holds; see `Model`. Modifies the state in place."""
        self.active.guess(state, before, after)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit in time proportional to it."""
        self.springs.follow(change)
        self.problem.follow(change)
        self._weigh(change.nodes)
        self.active.follow(change, state)

    def energy(self, state: State) -> float:
        """Elastic energy [J], zero at rest."""
        return self.problem.energy(state)

    def residual(self, state: State) -> float:
        """Largest internal force on a free active node [N]; with inertia, what is left over."""
        if self.time_step is None:
            return self.active.residual(state)
        force, _ = self.problem.largest(
            state, self.active.ordering.nodes, self.active.ordering.used
        )
        free = ~state.prescribed[self.springs.stitches.nodes]
        return math.sqrt(max(force, self.problem.largest_sewn(state, free)[0]))

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Internal elastic forces on nodes [N], shape (len(rows), 3)."""
        return self.problem.forces(state, rows)
