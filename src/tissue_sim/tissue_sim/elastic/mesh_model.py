"""What every model on a mesh shares."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh


class MeshModel(ABC):
    """Mesh, material, parameters and the network of the mesh's edges: the base of the models.

    The network is more than springs: it is which nodes are neighbours, kept up to date under edits.

    Attributes:
        mesh: The mesh that is simulated.
        material: What it is made of.
        values: The model's parameters by name.
        springs: The network, possibly shared with other models of the same mesh.
        events: What people should know of what an edit did to the model; `Simulation` reports and
            clears it.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    time_step: float | None = None
    has_forces = True
    anisotropic: ClassVar[bool] = False
    """Whether fibres take part."""
    needs_tetrahedra: ClassVar[bool] = False
    """Whether it is made of elements, and not of edges only."""

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        """Build the model; `registry.build` checks the parameters first.

        Args:
            mesh: The mesh to simulate.
            material: What it is made of.
            parameters: Values by name; defaults for those left out.
            springs: A network of this mesh and material to share.
        """
        self.mesh, self.material = mesh, material
        defaults = {parameter.name: parameter.default for parameter in self.parameters}
        self.values = defaults | parameters
        self.events: list[str] = []
        self.springs = springs if springs is not None else SpringNetwork(mesh, material)

    @property
    def idle(self) -> bool:
        """Whether a further step would change nothing; a model that cannot tell says no."""
        return False

    def scalar(self, value: float) -> np.floating:
        """A number in the precision of the kernels."""
        return self.springs.dtype(value)

    @abstractmethod
    def step(self, state: State) -> None:
        """Advance by one sweep or time step. Modifies the state in place."""

    @abstractmethod
    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Holds were made, released or taken over; see `Model`."""

    def nodes_placed(self, nodes: NDArray[np.int32]) -> None:  # noqa: B027
        """Nodes were put elsewhere; see `Model`. A model that remembers no moves does nothing."""

    @property
    def takes_guess(self) -> bool:
        """Whether `guess` helps: iterations without time towards one equilibrium."""
        return False

    def guess(
        self, state: State, before: NDArray[np.floating], after: NDArray[np.floating]
    ) -> None:
        """Free nodes will probably move by after - before; see `Model`."""
        raise ValueError(f"model {self.name} takes no guess")

    def refusal(self, nodes: NDArray[np.int32]) -> str:
        """Why an edit is not possible; see `Model`. A model that follows all of them says so."""
        return ""

    def sewing_refusal(self) -> str:
        """Why an edit that makes or changes sutures is not possible; "" if it is; see `Model`."""
        return ""

    def patch_refusal(self) -> str:
        """Why an edit that adds a patch is not possible; "" if it is; see `Model`."""
        return ""

    @abstractmethod
    def topology_changed(self, change: EditChange, state: State) -> None:
        """The mesh applied an edit and the state followed; see `Model`."""

    @abstractmethod
    def residual(self, state: State) -> float:
        """Largest internal force on a free active node [N]; nan if it has no meaning."""

    @abstractmethod
    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Internal elastic forces on nodes [N], shape (len(rows), 3)."""


class ForcelessModel(MeshModel):
    """A model that moves nodes by limits on lengths: it has no stiffness."""

    has_forces = False

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Zero: it has no stiffness."""
        return np.zeros((len(rows), 3))

    def residual(self, state: State) -> float:
        """Has no meaning without forces: nan."""
        return math.nan
