"""ChainMail on a network of links: where propagations start, and what relaxation keeps awake."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Parameter
from tissue_sim.elastic.quasi_static import REST_TOLERANCE
from tissue_sim.kernels.chain_averages import Awake, average, wake_all, wake_unbalanced
from tissue_sim.kernels.chain_bounds import COUNTS, STRAINED, Search
from tissue_sim.kernels.chain_mail import gather_sources, propagate
from tissue_sim.kernels.springs import SpringArrays

SHARES = (
    Parameter("stretch", 0.3, 0.01, 10.0, "", "share of an edge by which its ends may part"),
    Parameter("compression", 0.3, 0.01, 1.0, "", "share of an edge by which they may near"),
    Parameter("shear", 0.3, 0.01, 10.0, "", "share of an edge by which they may shift across it"),
)
PARAMETERS = (
    *SHARES,
    Parameter(
        "relaxations", 1, 0, 100, "", "sweeps of elastic relaxation in a step; 0: plastic",
        integer=True,
    ),
    Parameter("rate", 1.9, 0.01, 1.99, "", "share of the way to its neighbours' mean a node goes"),
    REST_TOLERANCE,
)  # fmt: skip
"""What can be set on ChainMail of any network."""


class Chains:
    """What moves on a network whose links give within limits, then pull.

    The nodes of the network are those of a mesh or voxels; whoever has them keeps their
    displacements and says which of them do not move.

    Attributes:
        visits: Visits of the last propagation.
    """

    def __init__(
        self, values: Mapping[str, float], dtype: type[np.floating], capacity: int
    ) -> None:
        """Start with nothing held and nothing awake.

        Args:
            values: Of `PARAMETERS`, by name.
            dtype: Precision of the kernels.
            capacity: Nodes there is room for.
        """
        self._dtype = dtype
        self._shares = np.array([values[share.name] for share in SHARES], dtype)
        self._relaxations = int(values["relaxations"])
        self._rate, self._tolerance = dtype(values["rate"]), dtype(values["rest_tolerance"])
        self._held = np.empty(0, dtype=np.int32)
        self._look_at_held = False
        self._doubtful = self._strained = self._awake_count = 0
        self.visits = 0
        self._allocate(capacity)

    def _allocate(self, capacity: int) -> None:
        dtype = self._dtype
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

    def step(
        self, links: SpringArrays, prescribed: NDArray[np.bool_], u: NDArray[np.floating]
    ) -> None:
        """One propagation and the sweeps of relaxation.

        Args:
            links: The network.
            prescribed: Nodes that do not move, shape (capacity,).
            u: Displacements [m], shape (capacity, 3), modified in place.
        """
        from_free = self._doubtful > 0
        self.visits = 0
        self._spread(links, prescribed, u)
        if from_free and self._strained:
            # What was let go of beyond its limits yields to what is fixed or held.
            self._look_at_held = True
            self._spread(links, prescribed, u)
        for _ in range(self._relaxations):
            if self._awake_count:
                self._relax(links, prescribed, u)

    def _spread(
        self, links: SpringArrays, prescribed: NDArray[np.bool_], u: NDArray[np.floating]
    ) -> None:
        search = self._search
        used = gather_sources(
            self._held, self._look_at_held, search.strained, self._strained, u,
            self._seen, self._sources, self._doubtful,
        )  # fmt: skip
        self._look_at_held, self._doubtful = False, 0
        if used == 0:
            return
        count = wake_all(self._sources, used, links, self._awake, self._awake_count)
        visits, self._awake_count = propagate(
            self._sources, used, links, self._shares, prescribed, u, search, self._awake, count,
        )  # fmt: skip
        self.visits += visits
        self._strained = int(search.counts[STRAINED])
        if self._relaxations == 0:
            self._sleep()

    def _relax(
        self, links: SpringArrays, prescribed: NDArray[np.bool_], u: NDArray[np.floating]
    ) -> None:
        arguments = (links, self._shares, prescribed, self._rate, self._tolerance, u, self._awake)
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

    @property
    def held(self) -> NDArray[np.int32]:
        """Rows of the held nodes."""
        return self._held

    def hold(self, held: NDArray[np.int32]) -> None:
        """Let the next propagation start from these nodes, and others whenever these move."""
        self._held = held.astype(np.int32)
        self._look_at_held = True

    def doubt(self, nodes: NDArray[np.integer]) -> None:
        """Let the next propagation start from these nodes too: they may be beyond their limits."""
        if self._doubtful:
            nodes = np.union1d(self._sources[: self._doubtful], nodes)
        self._doubtful = len(nodes)
        self._sources[: self._doubtful] = nodes

    def reserve(self, capacity: int) -> None:
        """Make room for so many nodes."""
        rows = len(self._seen)
        if capacity <= rows:
            return
        sources, awake, search, seen = self._sources, self._awake, self._search, self._seen
        self._allocate(capacity)
        self._sources[: self._doubtful] = sources[: self._doubtful]
        self._awake.nodes[:rows] = awake.nodes
        self._awake.member[:rows] = awake.member
        self._search.strained[:rows] = search.strained
        self._seen[:rows] = seen
