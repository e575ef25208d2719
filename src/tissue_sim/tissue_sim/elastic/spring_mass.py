"""Dynamic springs and masses."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.integrators import (
    INTEGRATOR,
    NAMES,
    VERLET,
    RungeKutta,
    stability_limit,
)
from tissue_sim.elastic.internal_forces import PARAMETERS, InternalForces
from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.relaxation import FULL_EXCESS, OrganRelaxation, linear_factor
from tissue_sim.elastic.spring_model import SpringModel
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.integrators import Nodes, verlet_move
from tissue_sim.kernels.springs import largest_force

FRAME = 1.0 / 60.0
"""The time step chosen by default divides this [s]."""

AS_THEY_ARE = 2
"""Value of `mass_scaling` with which masses stay as they are, also under a time step too long."""

SAFETY = 0.8
"""Share of the largest stable time step that is used."""


class SpringMass(SpringModel):
    """m a = F - m (d / h) v for every node, integrated explicitly.

    By default with Verlet's method, x(t+h) = (2 - d) x(t) - (1 - d) x(t-h) + h^2 F/m. Stable while
    h^2 omega^2 < `stability_limit` for the fastest oscillation, for which omega^2 <= 2 max_i
    (sum_j k_ij / m_i).

    With `passes`, springs beyond `linear_factor` are put at that limit after each step, and the
    velocities with them (Provot 1995).

    Limitations: stiff small elements need very short time steps, unless mass is added to their
    nodes; home forces end with the first cut; see docs/spring_mass.md.
    """

    name: ClassVar[str] = "spring_mass"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "time_step", 0.0, 0.0, FRAME, "s",
            "simulated time of a step; 0: the longest stable one that divides 1/60 s",
        ),
        Parameter("damping", 0.02, 0.0, 0.9, "", "share of the velocity lost in a step"),
        Parameter(
            "mass_scaling", 0, 0, 2, "",
            "1: nodes too light for the time step get as much mass as stability needs; "
            "0: such a time step is refused; 2: it is taken, stable or not",
            integer=True,
        ),
        INTEGRATOR,
        *PARAMETERS,
        Parameter(
            "passes", 0, 0, 100, "", "relaxation passes after a step; 0: none", integer=True
        ),
        linear_factor(0.1),
        FULL_EXCESS,
    )  # fmt: skip

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        """Build the model; see `MeshModel`.

        Raises:
            ValueError: The time step is not stable, no time step is, or the forces are not
                possible.
        """
        super().__init__(mesh, material, parameters, springs)
        damping, dtype, capacity = self.values["damping"], self.springs.dtype, mesh.node_capacity
        self.internal = InternalForces(self.springs, self.values)
        self._integrator = int(self.values["integrator"])
        self._limit = stability_limit(self._integrator, damping)
        self._damping, self._keep = self.scalar(damping), self.scalar(1.0 - damping)
        last_bits = 4.0 * float(np.finfo(dtype).eps)
        self._sticks = self.scalar(last_bits if damping > 0.0 else 0.0)
        self._stiffness = np.zeros(capacity)
        self._rows = np.arange(capacity, dtype=np.uint32)
        rows = np.arange(mesh.node_rows, dtype=np.int32)
        self._stiffness[rows] = self.internal.stiffness(rows)
        self.time_step = self._step_time = self._choose_time_step()
        self._scale = np.zeros(capacity, dtype=dtype)
        self._weigh(rows)
        self._forces = np.zeros((capacity, 3), dtype=dtype)
        self._runge_kutta = (
            None if self._integrator == VERLET else RungeKutta(self.internal, self._integrator)
        )
        self.relaxation = self._relaxation()
        self._compile()

    def _relaxation(self) -> OrganRelaxation | None:
        if not self.values["passes"]:
            return None
        if self._integrator != VERLET:
            raise ValueError(
                f"passes = {self.values['passes']:g} does not go with integrator = "
                f"{self._integrator} ({NAMES[self._integrator]}): what relaxation does to places "
                "must be what it does to velocities; allowed: integrator = 0 (Verlet), or no passes"
            )
        return OrganRelaxation(self.springs, self.values)

    def _compile(self) -> None:
        """Compile, or load from the cache, what only some steps need: no frame has to wait."""
        state = State(self.mesh, self.springs.dtype)
        nodes = self._nodes(state, 0)
        self.internal.compile(state, self._forces)
        verlet_move(nodes, self._sticks, self._forces, state.displacement, state.previous)
        if self._runge_kutta:
            self._runge_kutta.step(nodes, state, self._forces)

    def _nodes(self, state: State, rows: int) -> Nodes:
        springs = self.springs
        return Nodes(
            rows, springs.arrays.degree, state.prescribed, self._scale, self._damping, springs.tiny
        )

    def longest_time_step(self) -> float:
        """The longest time step [s] that needs no added mass."""
        free = (self._stiffness > 0) & ~self.mesh.fixed
        if not free.any():
            return FRAME
        fastest = 2.0 * float((self._stiffness[free] / self.springs.masses[free]).max())
        return math.sqrt(self._limit / fastest) * SAFETY

    def _choose_time_step(self) -> float:
        if self._limit <= 0.0:
            raise ValueError(
                f"damping = 0 is not stable with integrator = {self._integrator} "
                f"({NAMES[self._integrator]}), whatever the time step; "
                "allowed: more than 0, up to 0.9"
            )
        longest, wanted = self.longest_time_step(), self.values["time_step"]
        if wanted == 0.0:
            return FRAME / math.ceil(FRAME / longest)
        if wanted > longest and not self.values["mass_scaling"]:
            raise ValueError(
                f"time_step = {wanted:g} s is not stable on this mesh and material with "
                f"{NAMES[self._integrator]} and damping = {self.values['damping']:g}; allowed: "
                f"up to {longest:.3g} s, or 0 to choose it, or mass_scaling = 1"
            )
        return wanted

    def _weigh(self, nodes: NDArray[np.int32]) -> None:
        """h^2/m of nodes, with the mass that stability needs where theirs is less."""
        stiffness, masses = self._stiffness[nodes], self.springs.masses[nodes]
        if self.values["mass_scaling"] != AS_THEY_ARE:
            enough = (self._step_time / SAFETY) ** 2 * 2.0 * stiffness
            enough /= self._limit
            masses = np.maximum(masses, enough)
        used = stiffness > 0
        self._scale[nodes] = np.divide(
            self._step_time**2, masses, out=np.zeros(len(nodes)), where=used
        )

    def added_mass(self) -> float:
        """Mass added for stability [kg]."""
        used = self._scale > 0
        masses = self._step_time**2 / self._scale[used].astype(np.float64)
        return float((masses - self.springs.masses[used]).clip(min=0.0).sum())

    def step(self, state: State) -> None:
        """One time step. Modifies the state in place."""
        self.internal.look(state.displacement)
        nodes = self._nodes(state, self.mesh.node_rows)
        if self._runge_kutta:
            self._runge_kutta.step(nodes, state, self._forces)
            return
        self.internal.evaluate(state.displacement, self._forces)
        verlet_move(nodes, self._sticks, self._forces, state.displacement, state.previous)
        if self.relaxation:
            self.relaxation.run(state)

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Follow what was done to velocities; a prescribed node has none to fall out of step."""
        if self.relaxation:
            self.relaxation.hold(held, state.prescribed)
        if self._runge_kutta:
            self._runge_kutta.prescribed_changed(state)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit in time proportional to it; home forces end."""
        springs = self.springs.follow(change)
        if self.relaxation:
            self.relaxation.follow_edit(change, springs)
        self._grow(self.mesh.node_capacity)
        news = self.internal.follow(change)
        if news:
            self.events.append(news)
        self._stiffness[change.nodes] = self.internal.stiffness(change.nodes)
        self._weigh(change.nodes)
        sewn = change.edit.sews and len(self.springs.stitches) > 0
        if sewn or len(change.born_nodes):
            which = "sewn ones" if sewn else "those of a patch"
            self.events.append(
                f"spring_mass: {1e3 * self.added_mass():.3g} g are added to nodes, {which} among "
                f"them, to be stable with steps of {1e6 * self._step_time:.3g} us"
            )

    def _grow(self, capacity: int) -> None:
        extra = capacity - len(self._scale)
        if extra <= 0:
            return
        self._scale = np.concatenate([self._scale, np.zeros(extra, self._scale.dtype)])
        self._stiffness = np.concatenate([self._stiffness, np.zeros(extra)])
        self._rows = np.arange(capacity, dtype=np.uint32)
        self._forces = np.zeros((capacity, 3), dtype=self._forces.dtype)
        if self._runge_kutta:
            self._runge_kutta.grow(capacity)

    def residual(self, state: State) -> float:
        """Largest internal force on a free node [N]."""
        if not self.internal.plain:
            F = self._all_forces(state)
            return self.internal.largest(F, state.prescribed)
        force, _ = largest_force(
            self._rows, 0, self.mesh.node_rows, self.springs.arrays, state.prescribed,
            state.displacement, self.springs.tiny,
        )  # fmt: skip
        return math.sqrt(force)

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Internal elastic forces on nodes [N], shape (len(rows), 3)."""
        if self.internal.plain:
            return super().forces(state, rows)
        return self._all_forces(state)[rows].astype(np.float64)

    def _all_forces(self, state: State) -> NDArray[np.floating]:
        self.internal.evaluate(state.displacement, self._forces)
        return self._forces
