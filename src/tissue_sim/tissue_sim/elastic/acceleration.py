"""What makes sweeps over one list of nodes converge in fewer of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Parameter, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kernels.extrapolation import add_difference, compare, extrapolate, remember

CHEBYSHEV = Parameter(
    "chebyshev", 0.0, 0.0, 0.999, "",
    "estimated spectral radius of a sweep: Chebyshev's method instead of momentum; 0: not used",
)  # fmt: skip

GROWTH = 8.0
"""So many times the smallest sum of squared moves since the last restart is divergence."""

Sweep = Callable[[float], float]
"""Sweeps the list once after every node repeated a share of its last move; largest squared move."""


class Acceleration(Protocol):
    """A way to accelerate the sweeps over one list of nodes."""

    def begin(self) -> None:
        """Forget all moves: holds or the mesh have changed."""

    def shift(
        self,
        state: State,
        nodes: NDArray[np.uint32],
        end: int,
        before: NDArray[np.floating],
        after: NDArray[np.floating],
    ) -> None:
        """Nodes were moved by after - before between the sweeps, which is no move to go on with."""

    def sweep(self, state: State, nodes: NDArray[np.uint32], end: int, sweep: Sweep) -> float:
        """One accelerated sweep over nodes[:end]. Modifies the state in place.

        Returns:
            Largest squared distance a node moved [m^2].
        """


class _Remembering:
    """Keeps where nodes were before the last two sweeps.

    Attributes:
        before: Displacements before the last sweep [m], shape (node_capacity, 3).
    """

    def __init__(self, springs: SpringNetwork) -> None:
        self._springs = springs
        self.before = np.zeros((springs.mesh.node_capacity, 3), dtype=springs.dtype)
        self._older = np.zeros_like(self.before)
        self._sweeps = 0
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile the kernels, or load them from the cache: sweeps must not have to."""
        nodes, u, one = np.empty(0, dtype=np.uint32), self.before, self._springs.dtype(1)
        nobody = np.empty(0, dtype=np.bool_)
        remember(nodes, 0, 0, u, u, u)
        compare(nodes, 0, 0, nobody, one, u, u, u)
        extrapolate(nodes, 0, 0, nobody, one, self._springs.tiny, u, u, u)
        add_difference(nodes, 0, 0, nobody, u, u, u)

    def shift(
        self,
        state: State,
        nodes: NDArray[np.uint32],
        end: int,
        before: NDArray[np.floating],
        after: NDArray[np.floating],
    ) -> None:
        """Carry what is remembered along with the nodes; see `Acceleration`."""
        self._match_capacity()
        add_difference(nodes, 0, end, state.prescribed, before, after, self.before)

    def _match_capacity(self) -> None:
        extra = self._springs.mesh.node_capacity - len(self.before)
        if extra > 0:
            more = ((0, extra), (0, 0))
            self.before, self._older = np.pad(self.before, more), np.pad(self._older, more)

    def _remember(self, state: State, nodes: NDArray[np.uint32], end: int) -> None:
        self._match_capacity()
        remember(nodes, 0, end, state.displacement, self.before, self._older)
        self._sweeps += 1

    def _compare(
        self, state: State, nodes: NDArray[np.uint32], end: int, share: float
    ) -> tuple[float, float, float]:
        moves, along, shifted = compare(
            nodes, 0, end, state.prescribed, self._springs.dtype(share), self._older, self.before,
            state.displacement,
        )  # fmt: skip
        return float(moves), float(along), float(shifted)


class Momentum(_Remembering):
    """Every node repeats a share of its last move before a sweep (Polyak's heavy ball).

    With a brake: when a sweep turns round more than half of what the nodes have just repeated, the
    next one repeats nothing.

    References:
        B. T. Polyak, Some methods of speeding up the convergence of iteration methods, 1964, doi
        10.1016/0041-5553(64)90137-5.
    """

    def __init__(self, springs: SpringNetwork, share: float) -> None:
        """Begin without any moves.

        Args:
            springs: Network of the mesh.
            share: Share of its last move that every node repeats.
        """
        super().__init__(springs)
        self._full = share
        self._braked = True

    def begin(self) -> None:
        """Forget all moves."""
        self._sweeps = 0
        self._braked = True

    def sweep(self, state: State, nodes: NDArray[np.uint32], end: int, sweep: Sweep) -> float:
        """One sweep; see `Acceleration`. Modifies the state in place."""
        share = 0.0 if self._braked else self._full
        self._remember(state, nodes, end)
        moved = sweep(share)
        _, along, _ = self._compare(state, nodes, end, share)
        self._braked = share > 0.0 and along < 0.0
        return moved


class Chebyshev(_Remembering):
    """The semi-iterative method around sweeps: u <- older + omega (u - older) after each of them.

    omega_1 = 1, omega_2 = 2 / (2 - rho^2), omega_{k+1} = 4 / (4 - rho^2 omega_k). An estimate of
    rho that is too large diverges: when the sum of squared moves grows to eight times its smallest
    since the last restart, the method starts again with rho^2 for rho, until holds or the mesh
    change.

    Limitations: it is made for sweeps whose errors decay without oscillating; Gauss-Seidel sweeps
    in one direction do so only nearly.

    References:
        H. Wang, A Chebyshev semi-iterative approach for accelerating projective and position-based
        dynamics, ACM Transactions on Graphics 34(6), 2015, doi 10.1145/2816795.2818063.

    Attributes:
        radius: rho in use.
    """

    def __init__(self, springs: SpringNetwork, radius: float) -> None:
        """Begin without any moves.

        Args:
            springs: Network of the mesh.
            radius: Estimated spectral radius rho of a sweep, below 1.
        """
        super().__init__(springs)
        self._estimate = self.radius = radius
        self._omega, self._smallest = 1.0, math.inf

    def begin(self) -> None:
        """Forget all moves and trust the estimate again."""
        self._sweeps = 0
        self.radius, self._smallest = self._estimate, math.inf

    def sweep(self, state: State, nodes: NDArray[np.uint32], end: int, sweep: Sweep) -> float:
        """One sweep; see `Acceleration`. Modifies the state in place."""
        self._remember(state, nodes, end)
        moved = sweep(0.0)
        moves, _, shifted = self._compare(state, nodes, end, 0.0)
        # What moves on because the hold has moved does not diverge.
        self._smallest = max(self._smallest, shifted)
        self._choose_omega(moves)
        if self._omega == 1.0:
            return moved
        extrapolated = extrapolate(
            nodes, 0, end, state.prescribed, self._springs.dtype(self._omega),
            self._springs.tiny, self._older, self.before, state.displacement,
        )  # fmt: skip
        return max(moved, float(extrapolated))

    def _choose_omega(self, moves: float) -> None:
        squared = self.radius**2
        if not moves <= GROWTH * self._smallest:
            self.radius, self._smallest = squared, moves
            self._sweeps = 1
        self._smallest = min(self._smallest, moves)
        if self._sweeps == 1:
            self._omega = 1.0
        elif self._sweeps == 2:
            self._omega = 2.0 / (2.0 - squared)
        else:
            self._omega = 4.0 / (4.0 - squared * self._omega)


def acceleration_of(
    springs: SpringNetwork, momentum: float, chebyshev: float
) -> Momentum | Chebyshev | None:
    """The acceleration that two parameters ask for; Chebyshev's method comes first.

    Args:
        springs: Network of the mesh.
        momentum: Share of its last move that every node repeats; 0: none.
        chebyshev: Estimated spectral radius; 0: not used.
    """
    if chebyshev > 0.0:
        return Chebyshev(springs, chebyshev)
    return Momentum(springs, momentum) if momentum > 0.0 else None
