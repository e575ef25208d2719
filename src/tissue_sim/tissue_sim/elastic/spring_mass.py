"""Dynamic springs and masses, integrated by Verlet's method."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.spring_model import SpringModel
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.springs import largest_force, verlet_step

FRAME = 1.0 / 60.0
"""The time step chosen by default divides this [s]."""

SAFETY = 0.8
"""Share of the largest stable time step that is used."""


class SpringMass(SpringModel):
    """x(t+h) = (2 - d) x(t) - (1 - d) x(t-h) + h^2 F/m for every node.

    Stable while h^2 omega^2 < 4 - 2d for the fastest oscillation, for which omega^2 <= 2 max_i
    (sum_j k_ij / m_i).

    Limitations: stiff small elements need very short time steps, unless mass is added to their
    nodes; see docs/spring_mass.md.
    """

    name: ClassVar[str] = "spring_mass"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "time_step", 0.0, 0.0, FRAME, "s",
            "simulated time of a step; 0: the longest stable one that divides 1/60 s",
        ),
        Parameter("damping", 0.02, 0.0, 0.9, "", "share of the velocity lost in a step"),
        Parameter(
            "mass_scaling", 0, 0, 1, "",
            "1: nodes too light for the time step get as much mass as stability needs; "
            "0: such a time step is refused",
            integer=True,
        ),
    )  # fmt: skip

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        self._keep = self.scalar(1.0 - self.values["damping"])
        last_bits = 4.0 * float(np.finfo(self.springs.dtype).eps)
        self._sticks = self.scalar(last_bits if self.values["damping"] > 0.0 else 0.0)
        self._stiffness = np.zeros(mesh.node_capacity)
        self._rows = np.arange(mesh.node_capacity, dtype=np.uint32)
        rows = np.arange(mesh.node_rows, dtype=np.int32)
        self._stiffness[rows] = self.springs.node_stiffness(rows)
        self.time_step = self._step_time = self._choose_time_step()
        self._scale = np.zeros(mesh.node_capacity, dtype=self.springs.dtype)
        self._weigh(rows)

    def longest_time_step(self) -> float:
        """The longest time step [s] that needs no added mass."""
        free = (self._stiffness > 0) & ~self.mesh.fixed
        if not free.any():
            return FRAME
        fastest = 2.0 * float((self._stiffness[free] / self.springs.masses[free]).max())
        return math.sqrt((4.0 - 2.0 * self.values["damping"]) / fastest) * SAFETY

    def _choose_time_step(self) -> float:
        longest, wanted = self.longest_time_step(), self.values["time_step"]
        if wanted == 0.0:
            return FRAME / math.ceil(FRAME / longest)
        if wanted > longest and not self.values["mass_scaling"]:
            raise ValueError(
                f"time_step = {wanted:g} s is not stable on this mesh and material; allowed: up to "
                f"{longest:.3g} s, or 0 to choose it, or mass_scaling = 1"
            )
        return wanted

    def _weigh(self, nodes: NDArray[np.int32]) -> None:
        """h^2/m of nodes, with the mass that stability needs where theirs is less."""
        stiffness, masses = self._stiffness[nodes], self.springs.masses[nodes]
        enough = (self._step_time / SAFETY) ** 2 * 2.0 * stiffness
        enough /= 4.0 - 2.0 * self.values["damping"]
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
        verlet_step(
            self.mesh.node_rows, self.springs.arrays, state.prescribed, self._scale, self._keep,
            self._sticks, self.springs.tiny, state.displacement, state.previous,
        )  # fmt: skip

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Nothing to do: a prescribed node has no velocity to fall out of step."""

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit in time proportional to it."""
        self.springs.follow(change)
        extra = self.mesh.node_capacity - len(self._scale)
        if extra > 0:
            self._scale = np.concatenate([self._scale, np.zeros(extra, self._scale.dtype)])
            self._stiffness = np.concatenate([self._stiffness, np.zeros(extra)])
            self._rows = np.arange(self.mesh.node_capacity, dtype=np.uint32)
        self._stiffness[change.nodes] = self.springs.node_stiffness(change.nodes)
        self._weigh(change.nodes)

    def residual(self, state: State) -> float:
        """Largest internal force on a free node [N]."""
        force, _ = largest_force(
            self._rows, 0, self.mesh.node_rows, self.springs.arrays, state.prescribed,
            state.displacement, self.springs.tiny,
        )  # fmt: skip
        return math.sqrt(force)
