"""Generalised 3D ChainMail: edges give within limits, then pull; what is beyond them is moved."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.mesh_model import MeshModel
from tissue_sim.elastic.model import Material, Parameter, State
from tissue_sim.elastic.quasi_static import REST_TOLERANCE
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.chain_averages import Awake, average, wake_all, wake_unbalanced
from tissue_sim.kernels.chain_bounds import COUNTS, STRAINED, Search
from tissue_sim.kernels.chain_mail import gather_sources, propagate

SHARES = (
    Parameter("stretch", 0.3, 0.01, 10.0, "", "share of an edge by which its ends may part"),
    Parameter("compression", 0.3, 0.01, 1.0, "", "share of an edge by which they may near"),
    Parameter("shear", 0.3, 0.01, 10.0, "", "share of an edge by which they may shift across it"),
)


class ChainMail(MeshModel):
    """Edges free within limits; who is beyond them follows its neighbour, farthest pushed first.

    A step is one propagation from the held nodes that moved and `relaxations` sweeps that pull
    every displaced node towards where its neighbours want it, within the limits.

    Limitations: no forces; limits are along the axes at rest, so that tissue turned as a whole is
    turned back; see docs/chain_mail.md.

    References:
        S. Gibson, 3D ChainMail: a fast algorithm for deforming volumetric objects, 1997,
        doi 10.1145/253284.253324; M. Schill and others, Biomechanical simulation of the vitreous
        humor in the eye using an enhanced ChainMail algorithm, 1998, doi 10.1007/BFb0056206; Y. Li
        and K. Brodlie, Soft object modelling with generalised ChainMail, 2003,
        doi 10.1111/j.1467-8659.2003.00719.x.
    """

    name: ClassVar[str] = "chain_mail"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *SHARES,
        Parameter(
            "relaxations", 1, 0, 100, "", "sweeps of elastic relaxation in a step; 0: plastic",
            integer=True,
        ),
        Parameter(
            "rate", 1.9, 0.01, 1.99, "", "share of the way to its neighbours' mean a node goes"
        ),
        REST_TOLERANCE,
    )  # fmt: skip
    has_forces = False

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        parameters: dict[str, float],
        springs: SpringNetwork | None = None,
    ) -> None:
        super().__init__(mesh, material, parameters, springs)
        dtype = self.springs.dtype
        self._shares = np.array([self.values[share.name] for share in SHARES], dtype)
        self._relaxations = int(self.values["relaxations"])
        self._rate = self.scalar(self.values["rate"])
        self._tolerance = self.scalar(self.values["rest_tolerance"])
        self._held = np.empty(0, dtype=np.int32)
        self._told = self._look_at_held = False
        self._doubtful = self._strained = self._awake_count = 0
        self.visits = 0
        self._allocate()

    def _allocate(self) -> None:
        capacity, dtype = self.mesh.node_capacity, self.springs.dtype
        self._search = Search(
            np.full((2, capacity), -np.inf, dtype), np.zeros((2, capacity), dtype=np.bool_),
            np.zeros(capacity, dtype=np.uint32), np.zeros(capacity, dtype=np.uint32),
            np.full(capacity, -1, dtype=np.int32), np.zeros(capacity, dtype=np.uint32),
            np.zeros(capacity, dtype=np.bool_), np.zeros(COUNTS, dtype=np.int64),
        )  # fmt: skip
        self._awake = Awake(np.zeros(capacity, dtype=np.uint32), np.zeros(capacity, dtype=np.bool_))
        self._seen = np.zeros((capacity, 3), dtype)
        self._sources = np.zeros(3 * capacity, dtype=np.uint32)

    @property
    def idle(self) -> bool:
        """Whether nothing moves as long as no held node does."""
        return self._awake_count == 0 and self._doubtful == 0 and not self._look_at_held

    @property
    def awake(self) -> NDArray[np.uint32]:
        """Rows of the nodes that the next sweep visits, in its order."""
        return self._awake.nodes[: self._awake_count]

    def step(self, state: State) -> None:
        """One propagation and the sweeps of relaxation. Modifies the state in place."""
        self._propagate(state)
        for _ in range(self._relaxations):
            if self._awake_count:
                self._relax(state)

    def _propagate(self, state: State) -> None:
        from_free = self._doubtful > 0
        self.visits = 0
        self._spread(state)
        if from_free and self._strained:
            # What was let go of beyond its limits yields to what is fixed or held.
            self._look_at_held = True
            self._spread(state)

    def _spread(self, state: State) -> None:
        search, arrays = self._search, self.springs.arrays
        used = gather_sources(
            self._held, self._look_at_held, search.strained, self._strained, state.displacement,
            self._seen, self._sources, self._doubtful,
        )  # fmt: skip
        self._look_at_held, self._doubtful = False, 0
        if used == 0:
            return
        count = wake_all(self._sources, used, arrays, self._awake, self._awake_count)
        visits, self._awake_count = propagate(
            self._sources, used, arrays, self._shares, state.prescribed, state.displacement,
            search, self._awake, count,
        )  # fmt: skip
        self.visits += visits
        self._strained = int(search.counts[STRAINED])
        if self._relaxations == 0:
            self._sleep()

    def _relax(self, state: State) -> None:
        arguments = (
            self.springs.arrays, self._shares, state.prescribed, self._rate, self._tolerance,
            state.displacement, self._awake,
        )  # fmt: skip
        largest, self._awake_count = average(*arguments, self._awake_count)
        if largest > self._tolerance:
            return
        # Neighbours may have been left behind by many moves that were each too small to wake them.
        count = wake_unbalanced(*arguments, self._awake_count)
        if count > self._awake_count:
            self._awake_count = count
        else:
            self._sleep()

    def _sleep(self) -> None:
        self._awake.member[self.awake] = False
        self._awake_count = 0

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Start from the held nodes; nodes let go of may be beyond their limits.

        Told the same again, or for the first time, it doubts every displaced node: another model,
        or something else, has moved them.
        """
        if not self._told or np.array_equal(held, self._held):
            rows = self.mesh.node_rows
            doubtful = np.flatnonzero(state.displacement[:rows].any(axis=1))
        else:
            doubtful = np.setdiff1d(self._held, held)
        self._held = held.astype(np.int32)
        self._told = self._look_at_held = True
        self._doubt(doubtful)

    def nodes_placed(self, nodes: NDArray[np.int32]) -> None:
        """Doubt nodes that were put elsewhere."""
        self._doubt(nodes)

    def topology_changed(self, change: EditChange, state: State) -> None:
        """Follow an edit in time proportional to it."""
        self.springs.follow(change)
        if self.mesh.node_capacity > len(self._seen):
            self._grow()
        self._doubt(change.nodes)

    def _doubt(self, nodes: NDArray[np.integer]) -> None:
        """Let the next propagation start from these nodes too."""
        if self._doubtful:
            nodes = np.union1d(self._sources[: self._doubtful], nodes)
        self._doubtful = len(nodes)
        self._sources[: self._doubtful] = nodes

    def _grow(self) -> None:
        sources, awake, search, seen = self._sources, self._awake, self._search, self._seen
        self._allocate()
        rows = len(seen)
        self._sources[: self._doubtful] = sources[: self._doubtful]
        self._awake.nodes[:rows] = awake.nodes
        self._awake.member[:rows] = awake.member
        self._search.strained[:rows] = search.strained
        self._seen[:rows] = seen

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Zero: it has no stiffness."""
        return np.zeros((len(rows), 3))

    def residual(self, state: State) -> float:
        """Has no meaning without forces: nan."""
        return math.nan
