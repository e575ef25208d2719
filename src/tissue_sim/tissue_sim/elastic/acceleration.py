"""What makes sweeps over one list of nodes converge in fewer of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import Parameter, State
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.kernels.extrapolation import compare, extrapolate, remember

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

    def sweep(self, state: State, nodes: NDArray[np.uint32], end: int, sweep: Sweep) -> float:
        """One accelerated sweep over nodes[:end]. Modifies the state in place.

        Returns:
            Largest squared distance a node moved [m^2].
        """


class _Memory:
    """Where nodes were before the last two sweeps."""

    def __init__(self, springs: SpringNetwork) -> None:
        self.springs = springs
        self.before = np.zeros((springs.mesh.node_capacity, 3), dtype=springs.dtype)
        self.older = np.zeros_like(self.before)
        self.count = 0

    def remember(self, state: State, nodes: NDArray[np.uint32], end: int) -> None:
        if len(self.before) < len(state.displacement):
            self.before, self.older = (
                np.zeros_like(state.displacement, self.springs.dtype) for _ in range(2)
            )
            self.count = 0
        remember(nodes, 0, end, state.displacement, self.before, self.older)
        self.count += 1

    def compare(
        self, state: State, nodes: NDArray[np.uint32], end: int, share: float
    ) -> tuple[float, float, float]:
        residual, along, shifted = compare(
            nodes, 0, end, state.prescribed, self.springs.dtype(share), self.older, self.before,
            state.displacement,
        )  # fmt: skip
        return float(residual), float(along), float(shifted)


class Momentum:
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
        self._memory = _Memory(springs)
        self._full = share
        self._braked = True

    def begin(self) -> None:
        """Forget all moves."""
        self._memory.count = 0
        self._braked = True

    def sweep(self, state: State, nodes: NDArray[np.uint32], end: int, sweep: Sweep) -> float:
        """One sweep; see `Acceleration`. Modifies the state in place."""
        share = 0.0 if self._braked else self._full
        self._memory.remember(state, nodes, end)
        moved = sweep(share)
        _, along, _ = self._memory.compare(state, nodes, end, share)
        self._braked = share > 0.0 and along < 0.0
        return moved


class Chebyshev:
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
        self._springs, self._memory = springs, _Memory(springs)
        self._estimate = self.radius = radius
        self._omega, self._smallest = 1.0, math.inf

    def begin(self) -> None:
        """Forget all moves and trust the estimate again."""
        self._memory.count = 0
        self.radius, self._smallest = self._estimate, math.inf

    @property
    def before(self) -> NDArray[np.floating]:
        """Displacements before the last sweep [m], shape (node_capacity, 3)."""
        return self._memory.before

    def sweep(self, state: State, nodes: NDArray[np.uint32], end: int, sweep: Sweep) -> float:
        """One sweep; see `Acceleration`. Modifies the state in place."""
        self._memory.remember(state, nodes, end)
        moved = sweep(0.0)
        moves, _, shifted = self._memory.compare(state, nodes, end, 0.0)
        # What moves on because the hold has moved does not diverge.
        self._smallest = max(self._smallest, shifted)
        self._choose_omega(moves)
        if self._omega == 1.0:
            return moved
        extrapolated = extrapolate(
            nodes, 0, end, state.prescribed, self._springs.dtype(self._omega),
            self._springs.tiny, self._memory.older, self._memory.before, state.displacement,
        )  # fmt: skip
        return max(moved, float(extrapolated))

    def _choose_omega(self, moves: float) -> None:
        squared = self.radius**2
        if not moves <= GROWTH * self._smallest:
            self.radius, self._smallest = squared, moves
            self._memory.count = 1
        self._smallest = min(self._smallest, moves)
        if self._memory.count == 1:
            self._omega = 1.0
        elif self._memory.count == 2:
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
