"""Relaxation: springs outside their limits are put at them, one after the other."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.ordering import NodeOrdering
from tissue_sim.elastic.spring_model import SpringModel
from tissue_sim.elastic.spring_ordering import SpringOrdering
from tissue_sim.elastic.springs import SpringChange, SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.relaxation import Nodes, relax_springs
from tissue_sim.kernels.vectors import ROW

SETTLED = 1e-8
"""Moves of sewn nodes up to which stitches count as within their limits [m]."""

PASSES = Parameter("passes", 1, 1, 100, "", "relaxation passes in a step", integer=True)
FULL_EXCESS = Parameter(
    "full_excess", 0, 0, 1, "",
    "1: each of two free ends moves the whole excess, as the thesis lists it; 0: half each",
    integer=True,
)  # fmt: skip


def linear_factor(default: float) -> Parameter:
    """The share of its rest length that a spring may be longer or shorter."""
    meaning = "share of its rest length that a spring may be longer or shorter"
    return Parameter("linear_factor", default, 0.0, 0.9, "", meaning)


class RelaxationPass:
    """Relaxation passes over all springs in the order of the nodes.

    Attributes:
        order: The springs in the order of a pass.
        looked: Places of the list that the last step looked at.
        sleeping: Whether springs that must be inside their limits are passed over; looking at all
            of them gives the same positions bit for bit.
    """

    def __init__(self, springs: SpringNetwork, values: dict[str, float]) -> None:
        """Prepare passes with the values of `linear_factor`, `passes` and `full_excess`."""
        eps = values["linear_factor"]
        share = 1.0 if values["full_excess"] else 0.5
        self.springs = springs
        self.order = SpringOrdering(springs)
        self.sleeping, self.looked = True, 0
        self._passes = int(values["passes"])
        self._limits = np.array([eps, eps * (2 + eps), -eps * (2 - eps), share], springs.dtype)
        self._nodes = _nodes(springs)
        self._look_at_all = True

    def run(self, state: State, limits: NDArray[np.float64] | None = None) -> int:
        """The passes of one step. Modifies the state in place.

        Args:
            state: Displacements and prescribed nodes.
            limits: Longest length of each stitch [m]; None: its rest length.

        Returns:
            Number of springs that the last pass found outside their limits, and 1 more if stitches
            were.
        """
        stitches = self.springs.stitches
        outside = self.looked = moved = 0
        for _ in range(self._passes):
            # Another order may list springs that the one before did not.
            look_at_all = self.order.advance() or self._look_at_all
            self._look_at_all = False
            outside, looked = relax_springs(
                self.springs.mesh.node_rows, self.order.used, self.order.list,
                look_at_all or not self.sleeping, state.prescribed, self._limits,
                self.springs.tiny, self._nodes, state.displacement,
            )  # fmt: skip
            self.looked += int(looked)
            if len(stitches):
                longest = stitches.threads.length if limits is None else limits
                far = stitches.limit(longest, state.prescribed, state.displacement)
                moved = int(far > SETTLED**2)
        return int(outside) + moved

    def complete_order(self) -> None:
        """Make a new order at once where nobody waits for a frame."""
        self.order.complete()
        self._look_at_all = True

    def prescribed_changed(self, nodes: NodeOrdering) -> None:
        """Order the springs anew along the nodes, which have been ordered anew."""
        self.order.order(nodes)
        # What was held inside its limits by a tool may be free now.
        self._look_at_all = True

    def follow(self, change: SpringChange) -> None:
        """Follow what an edit did to the springs; the order of nodes must have followed before."""
        self.order.follow(change)
        self._look_at_all = True
        if self.springs.mesh.node_capacity >= len(self._nodes.moved):
            self._nodes = _nodes(self.springs)


class OrganRelaxation(RelaxationPass):
    """Relaxation passes in the breadth-first order from what is held; it needs no other order."""

    def __init__(self, springs: SpringNetwork, values: dict[str, float]) -> None:
        """See `RelaxationPass`."""
        super().__init__(springs, values)
        self._breadth_first = NodeOrdering(springs)
        self._ordered = False

    def hold(self, held: NDArray[np.int32], prescribed: NDArray[np.bool_]) -> None:
        """Order the springs anew from the held nodes; with none held the last order stays."""
        if len(held) or not self._ordered:
            self._breadth_first.search(held.astype(np.int32), prescribed)
            self._ordered = bool(len(held))
        self.prescribed_changed(self._breadth_first)

    def follow_edit(self, change: EditChange, springs: SpringChange) -> None:
        """Follow an edit that the spring network has followed."""
        self._breadth_first.follow(change)
        self.follow(springs)


def _nodes(springs: SpringNetwork) -> Nodes:
    """Nodes of which nothing is known yet."""
    rows = springs.mesh.node_capacity + 1
    return Nodes(np.zeros((rows, ROW), dtype=springs.dtype), np.zeros(rows, dtype=np.uint8))


class Relaxation(SpringModel):
    """Every spring outside [l0 (1 - eps), l0 (1 + eps)] is put at that limit, half by each end.

    After each pass stitches longer than at rest are put at their rest length.

    Limitations: no forces; what lies within the limits does not return to rest; see
    docs/relaxation.md.
    """

    name: ClassVar[str] = "relaxation"
    parameters: ClassVar[tuple[Parameter, ...]] = (linear_factor(0.00035), PASSES, FULL_EXCESS)
    has_forces = False

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        self.relaxation = OrganRelaxation(self.springs, self.values)

    def step(self, state: State) -> None:
        """One step of `passes` passes over all springs. Modifies the state in place."""
        self.relaxation.run(state)

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Order the springs anew from the held nodes; with none held the last order stays."""
        self.relaxation.hold(held, state.prescribed)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit in time proportional to it."""
        self.relaxation.follow_edit(change, self.springs.follow(change))

    def residual(self, state: State) -> float:
        """Has no meaning without forces: nan."""
        return math.nan
