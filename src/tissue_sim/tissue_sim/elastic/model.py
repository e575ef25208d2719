"""The protocol every elastic model follows, and what models share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.incidence import among
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.positions import carry_moved


@dataclass(frozen=True)
class Parameter:
    """A number a model can be given, checked by one validator.

    Attributes:
        name: Name in scene files and requests.
        default: Value when none is given.
        minimum: Smallest value allowed.
        maximum: Largest value allowed.
        unit: SI unit; "" for a plain number.
        meaning: One sentence for people.
        integer: Whether only whole numbers are allowed.
    """

    name: str
    default: float
    minimum: float
    maximum: float
    unit: str
    meaning: str
    integer: bool = False

    def checked(self, value: float) -> float:
        """The value, if it is allowed.

        Raises:
            ValueError: The value is not finite, not whole where it must be, or out of range.
        """
        allowed = (
            f"allowed: {self.minimum:g} to {self.maximum:g}{' ' + self.unit if self.unit else ''}"
        )
        if not np.isfinite(value) or not self.minimum <= value <= self.maximum:
            raise ValueError(f"{self.name} = {value:g} is out of range; {allowed}")
        if self.integer and value != int(value):
            raise ValueError(f"{self.name} = {value:g} must be a whole number; {allowed}")
        return float(value)


@dataclass(frozen=True)
class RegionMaterial:
    """What one region of the tissue is made of; see docs/materials.md.

    Attributes:
        region: Name of the region in the mesh, or its label in digits.
        young_modulus: Young's modulus E [Pa].
        poisson_ratio: Poisson's ratio nu, in [0, 0.5).
        density: Mass density [kg/m^3].
        fibre_stiffness: What fibres add to the stiffness along them [Pa].
    """

    region: str
    young_modulus: float
    poisson_ratio: float
    density: float
    fibre_stiffness: float = 0.0


@dataclass(frozen=True)
class Material:
    """What the tissue is made of.

    Attributes:
        young_modulus: Young's modulus E [Pa].
        poisson_ratio: Poisson's ratio nu, in [0, 0.5).
        density: Mass density [kg/m^3].
        fibre_stiffness: What fibres add to the stiffness along them [Pa]; the mesh says how they
            run.
        regions: Regions made of something else; of several for the same elements the last counts.
    """

    young_modulus: float = 5e4
    poisson_ratio: float = 0.45
    density: float = 1060.0
    fibre_stiffness: float = 0.0
    regions: tuple[RegionMaterial, ...] = ()

    @property
    def parts(self) -> tuple[RegionMaterial, ...]:
        """What there is: the tissue everywhere else, then the regions."""
        rest = RegionMaterial(
            "", self.young_modulus, self.poisson_ratio, self.density, self.fibre_stiffness
        )
        return (rest, *self.regions)

    @classmethod
    def from_arguments(cls, arguments: Mapping[str, Any]) -> Material:
        """The material of plain JSON values, as `dataclasses.asdict` gives them."""
        regions = tuple(RegionMaterial(**region) for region in arguments.get("regions", ()))
        return cls(**{**arguments, "regions": regions})


class State:
    """What changes from step to step.

    Arrays have the mesh's node capacity; rows in use are [:mesh.node_rows].
    Displacements from rest keep float32 precise where coordinates would not.

    Attributes:
        displacement: Current minus rest position [m], shape (node_capacity, 3), float32 (float64 in
            verification).
        previous: Displacement one time step earlier [m], same shape; dynamic models only.
        prescribed: Nodes whose displacement the model must not change: fixed or held, shape
            (node_capacity,).
    """

    def __init__(self, mesh: Mesh, dtype: type[np.floating] = np.float32) -> None:
        self.displacement = np.zeros((mesh.node_capacity, 3), dtype=dtype)
        self.previous = np.zeros_like(self.displacement)
        self.prescribed = mesh.fixed.copy()

    def positions(self, mesh: Mesh) -> NDArray[np.floating]:
        """Current positions [m], shape (node_rows, 3), in the state's own precision."""
        rows = mesh.node_rows
        return (mesh.rest[:rows] + self.displacement[:rows]).astype(self.displacement.dtype)

    def follow(self, mesh: Mesh, change: EditChange) -> None:
        """Carry the state over an edit that `mesh` has just applied. Modifies the state in place.

        A moved node, or a new one with a place of its own, goes to the weighted mean of its anchors
        as they were; any other copy starts where its parent is. Both go for the current and the
        previous position, so that no force jumps and no velocity appears. Before that, nodes that
        vanish into another leave it at the mean of its places and theirs, and a node that comes
        back is displaced like another one near it; one without parent is where it is at rest.
        """
        capacity, old_capacity = mesh.node_capacity, len(self.displacement)
        if capacity > old_capacity:
            more = ((0, capacity - old_capacity), (0, 0))
            self.displacement = np.pad(self.displacement, more)
            self.previous = np.pad(self.previous, more)
            self.prescribed = np.pad(self.prescribed, more[0])
        for array in (self.displacement, self.previous, self.prescribed):
            array[change.returned_nodes] = array[change.returned_like]
            array[change.born_nodes] = 0
        if len(change.merged_nodes):
            merge_nodes(change, self.displacement)
            merge_nodes(change, self.previous)
            self.prescribed[change.merged_into] |= self.prescribed[change.merged_nodes]
        if len(change.moved_nodes):
            self._move(mesh, change)
        stays = change.stays
        copies, parents = change.copied_nodes[stays], change.copy_parents[stays]
        for array in (self.displacement, self.previous, self.prescribed):
            array[copies] = array[parents]
        placed = change.copied_nodes[~stays]
        self.prescribed[placed] = mesh.fixed[placed]

    def _move(self, mesh: Mesh, change: EditChange) -> None:
        order = np.argsort(change.moved_nodes)
        for array in (self.displacement, self.previous):
            carry_moved(
                change.moved_nodes, change.moved_anchors, change.moved_weights,
                change.old_moved_rest, order, mesh.rest, array,
            )  # fmt: skip


def merge_nodes(change: EditChange, values: NDArray[np.floating]) -> None:
    """Give nodes that others vanish into the mean of their values; one that was not there has none.

    Args:
        change: What an edit touched.
        values: Places or displacements by node row, shape (n, 3); modified in place.
    """
    into, group = np.unique(change.merged_into, return_inverse=True)
    count = (~among(into, change.returned_nodes)).astype(np.float64)
    total = values[into] * count[:, None]
    np.add.at(total, group, values[change.merged_nodes].astype(np.float64))
    np.add.at(count, group, 1.0)
    values[into] = total / count[:, None]


@runtime_checkable
class Model(Protocol):
    """An elastic model: parameters and derived data.

    `step` is exactly one sweep, time step or iteration.

    A model is built as `ModelClass(mesh, material, parameters)`; `registry.build` checks the
    parameters first.

    Attributes:
        name: Name in scene files.
        parameters: What can be set.
        time_step: Simulated time of one step [s]; None for static models, which run as many steps
            as fit the frame.
        has_forces: Whether `forces` means newtons; models without stiffness publish no force on the
            tool.
        events: What people should know of what an edit did to the model; `Simulation` reports and
            clears it.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    time_step: float | None
    has_forces: bool
    events: list[str]

    @property
    def idle(self) -> bool:
        """Whether a further step would change nothing: the frame's time can be given back."""

    def step(self, state: State) -> None:
        """Advance by one sweep, time step or iteration. Modifies the state in place."""

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Holds were made, released or taken over.

        Args:
            state: With `prescribed` already up to date.
            held: Rows of all nodes held now, sorted, fixed nodes not included.
        """

    def nodes_placed(self, nodes: NDArray[np.int32]) -> None:
        """Free nodes were put elsewhere: forget how they moved. `prescribed_changed` follows."""

    @property
    def takes_guess(self) -> bool:
        """Whether `guess` helps: iterations without time towards one equilibrium."""

    def guess(
        self, state: State, before: NDArray[np.floating], after: NDArray[np.floating]
    ) -> None:
        """Free nodes will probably move by after - before: start from there.

        Only models that `takes_guess` have it. Modifies the state in place.

        Args:
            state: With held nodes where they are in this frame.
            before: Displacements of a fast model before it went ahead [m], shape
                (node_capacity, 3).
            after: The same after it [m].
        """

    def refusal(self, nodes: NDArray[np.int32]) -> str:
        """Why an edit that changes the elements of these nodes is not possible; "" if it is."""

    def sewing_refusal(self) -> str:
        """Why an edit that makes or changes sutures is not possible; "" if it is."""

    def patch_refusal(self) -> str:
        """Why an edit that adds a patch is not possible; "" if it is."""

    def topology_changed(self, change: EditChange, state: State) -> None:
        """The mesh applied an edit and the state followed; follow in time proportional to it."""

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Internal elastic forces on nodes [N], shape (len(rows), 3); zero without `has_forces`."""

    def residual(self, state: State) -> float:
        """Largest internal force on a free active node [N]; nan if it has no meaning."""
