"""Equilibrium of corotated linear finite elements: Newton's method and conjugate gradients."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.corotation import Tangent
from tissue_sim.elastic.loose_parts import LooseParts
from tissue_sim.elastic.model import State
from tissue_sim.elastic.rigid_aggregates import RigidAggregates
from tissue_sim.elastic.springs import SpringNetwork
from tissue_sim.geometry.edit import EditChange
from tissue_sim.kernels.newton import (
    follow_held,
    largest_squared,
    next_conjugate_direction,
    residual_from,
    step_back,
    subtract,
)
from tissue_sim.kernels.responses import add_share
from tissue_sim.kernels.stiffness import Vectors, add_coarse, advance_solution, product

HASTE = 2
"""Parts of a renewal made in a step that has nothing else to do."""

BACK = 0.25
"""Share of the way that is left after a step that made the energy grow."""

REACH = 0.2
"""Sizes of the organ that nodes may move by with one linearisation."""

SOME = 16
"""Iterations between renewals far from the end."""

PROGRESS, ENOUGH = 0.1, 200
"""Share of its residual, or iterations, after which a linear problem is renewed near the end."""

NEAR = 0.02
"""Share of the energy lost between renewals below which the end is near."""

GROWTH = 1e-6
"""Share of the energy that rounding may add to it."""

ROUNDING = 8
"""Motions of so many roundings of the largest displacement count as none."""

PATIENCE = 20
"""Renewals without progress after which rounding is taken to be what is left."""


class Corotated:
    """One problem, f(x) = 0 in the free nodes, followed while what is prescribed moves.

    A step is one iteration of conjugate gradients on f(x_0) - W (x - x_0) and a part of the renewal
    of f and W at the newest shape x_0. Conjugate gradients go on across renewals and motions of
    what is held: each direction is conjugate to the last one.

    Attributes:
        tangent: f and W.
        settled: Whether forces at the present shape are exact and small enough.
        residual: Norm of the residual in free nodes [N].
        iterated: Whether the last step was an iteration.
    """

    def __init__(self, springs: SpringNetwork, tolerance: float, rest_tolerance: float) -> None:
        """Begin at rest.

        Args:
            springs: Network of the mesh, and what it is made of.
            tolerance: Residual over force on prescribed nodes that counts as none.
            rest_tolerance: Motion that counts as none [m].
        """
        self._springs = springs
        self._tolerance, self._rest_tolerance = tolerance, rest_tolerance
        self.tangent = Tangent(springs)
        self._aggregates = RigidAggregates(self.tangent)
        self._loose = LooseParts(springs.mesh)
        shape = (springs.mesh.node_capacity, 3)
        self._vectors = Vectors(*(np.zeros(shape, dtype=springs.dtype) for _ in range(5)))
        self._held = np.empty(0, dtype=np.int32)
        self._prescribed = springs.mesh.fixed.copy()
        self.settled, self.residual, self.iterated = False, 0.0, False
        self._motion = self._prescribed_force = self._floor = self._pq = 0.0
        self._renewing, self._unknown, self._stuck = False, False, False
        self._searching = False
        # Whether x has changed since the renewal began, and r since z was computed.
        self._changed, self._stale = True, True
        # Motions of what is prescribed so far, and up to the shapes of both linearisations.
        self._moves, self._moves_now, self._moves_next = 0, 0, 0
        self._stalled, self._best = 0, math.inf
        self._waited, self._first = 0, 0.0
        points = springs.mesh.rest[: springs.mesh.node_rows]
        self._room = self._reach = REACH * float(np.ptp(points, axis=0).max(initial=0.0))

        self._warm_up()

    def _warm_up(self) -> None:
        """Compile the kernels, or load them from the cache: steps must not have to."""
        nobody, vectors = self._prescribed, self._vectors
        shape, force = self.shape, self.tangent.now.force
        self.tangent.warm_up()
        follow_held(self._held, shape, self.tangent.rows, nobody, vectors)
        next_conjugate_direction(0, 0.0, vectors)
        subtract(0, shape, shape, vectors.z)
        residual_from(0, nobody, force, vectors.q, vectors.r)
        step_back(0, BACK, nobody, shape, shape, vectors.z)
        largest_squared(0, shape)
        largest_squared(0, force)
        product(0, self.tangent.rows, nobody, shape, vectors.q)
        add_share(0, nobody, shape, 0.0, shape, shape)
        self._loose.hold_still(nobody, self._vectors.z)
        self._precondition(nobody, 0.0)
        self._stale = True

    @property
    def shape(self) -> NDArray[np.floating]:
        """Displacements [m], shape (node_capacity, 3)."""
        return self._vectors.x

    @property
    def coarse_bytes(self) -> int:
        """Memory that the coarse part of the preconditioner reads in an iteration at least."""
        return self._aggregates.bytes

    @property
    def _count(self) -> int:
        return self._springs.mesh.node_rows

    def step(self, state: State) -> None:
        """One iteration. Writes the state's displacements of free nodes."""
        moved = follow_held(
            self._held, state.displacement, self.tangent.rows, state.prescribed, self._vectors
        )
        if moved > 0.0:
            self._moves += 1
            self._disturb()
            self._loose.hold_still(state.prescribed, self._vectors.r)
        self.iterated, self.tangent.renewed = False, 0
        if self.settled:
            return
        solved = not self._unknown and self._solved()
        outdated = solved and self._changed and self._moves == self._moves_next
        if outdated or (not self._renewing and (solved or self._worn())):
            self._begin_renewal()
        elif self._renewing and self.tangent.complete:
            self._renewed(state.prescribed)
        elif self._unknown or self._searching or solved:
            for _ in range(HASTE):
                self.tangent.go_on()
        else:
            self._iterate(state.prescribed)
            self.iterated = True
            self._waited += 1
            if self._renewing:
                self.tangent.go_on()
        add_share(self._count, state.prescribed, self.shape, 0.0, self.shape, state.displacement)

    def _disturb(self) -> None:
        """Something has changed from outside."""
        self.settled = self._stuck = self._searching = False
        self._changed = self._stale = True
        self._stalled, self._near = 0, NEAR
        self._best = self._lowest = math.inf
        self.tangent.keep = 0.0

    def _solved(self) -> bool:
        """Whether the linear problem is."""
        if self._stale:
            return False
        enough = 0.5 * self._tolerance * self._prescribed_force
        return self._stuck or self.residual <= enough or self._motion <= 0.5 * self._floor

    def _worn(self) -> bool:
        """Whether the linearisation should be renewed, though it is not solved yet."""
        return (
            self._unknown
            or self._searching
            or (self.tangent.keep == 0.0 and self._waited >= SOME)
            or self._waited >= ENOUGH
            or self.residual <= PROGRESS * self._first
        )

    def _iterate(self, prescribed: NDArray[np.bool_]) -> None:
        vectors, count = self._vectors, self._count
        if self._stale:
            self._precondition(prescribed, 0.0)
            if self._solved():
                return
        slope, widest = next_conjugate_direction(count, self._pq, vectors)
        if not slope > 0.0:
            slope, widest = next_conjugate_direction(count, 0.0, vectors)
        self._pq = self._product(prescribed, vectors.p)
        if not (self._pq > 0.0 and slope > 0.0 and math.isfinite(slope / self._pq)):
            self._stuck = self._changed = True
            self._retreat()
            return
        # Nothing is known of shapes far from that of the linearisation.
        way = math.sqrt(widest) * slope / self._pq
        share = min(1.0, self._room / way) if way > 0.0 else 1.0
        self._room -= share * way
        self._precondition(prescribed, share * slope / self._pq)
        self._changed, self._stuck = True, share < 1.0

    def _product(self, prescribed: NDArray[np.bool_], y: NDArray[np.floating]) -> float:
        """Q = W y without rigid motions of loose parts, of which y has none; y . q."""
        squared = product(self._count, self.tangent.rows, prescribed, y, self._vectors.q)
        self._loose.hold_still(prescribed, self._vectors.q)
        return float(squared)

    def _precondition(self, prescribed: NDArray[np.bool_], alpha: float) -> None:
        """Go alpha along p, and find z."""
        count, coarse = self._count, self._aggregates
        squared = advance_solution(
            count, alpha, self._vectors, self.tangent.inverse, coarse.arrays, coarse.force
        )
        coarse.solve()
        _, largest = add_coarse(count, prescribed, coarse.arrays, coarse.motion, self._vectors)
        if len(self._loose):
            self._loose.hold_still(prescribed, self._vectors.z)
            largest = largest_squared(count, self._vectors.z)
        self.residual, self._motion = math.sqrt(squared), math.sqrt(largest)
        self._stale = False

    def _begin_renewal(self) -> None:
        self.tangent.begin(self.shape)
        self._moves_next = self._moves
        self._renewing, self._changed = True, False

    def _renewed(self, prescribed: NDArray[np.bool_]) -> None:
        """Go on with the new linearisation, or go back if the energy has grown."""
        self._renewing = self._stuck = False
        now, new = self.tangent.now, self.tangent.next
        comparable = self._moves_next == self._moves_now and not self._unknown
        grown = comparable and new.energy > now.energy * (1.0 + GROWTH)
        lost = now.energy - new.energy if comparable else 0.0
        near = 0.0 < lost < self._near * new.energy
        if grown:
            self._searching = True
            step_back(self._count, BACK, prescribed, now.shape, new.shape, self.shape)
            self._changed = True
            self._retreat()
        else:
            self.tangent.keep = 1.0 if near else self.tangent.keep
            self.tangent.swap()
            self._moves_now = self._moves_next
            self._searching = False
        self._unknown = False
        exact = self._take_residual(prescribed)
        if exact:
            self._judge()

    def _retreat(self) -> None:
        """What was near the end is not near enough for what is not positive."""
        if self.tangent.keep > 0.0:
            self.tangent.keep, self._near = 0.0, self._near / 4.0

    def _take_residual(self, prescribed: NDArray[np.bool_]) -> bool:
        """Find r by the linearisation in use; whether x is its shape, so that r is exact."""
        now, vectors, count = self.tangent.now, self._vectors, self._count
        stitches = self._springs.stitches
        taut = stitches.lengths(now.shape) >= stitches.threads.length
        if len(taut) and self._loose.follow_threads(taut):
            self._loose.follow_prescribed(now.shape, prescribed)
        self._loose.follow_shape(now.shape, prescribed)
        away = subtract(count, vectors.x, now.shape, vectors.z)
        self._product(prescribed, vectors.z)
        squared = residual_from(count, prescribed, now.force, vectors.q, vectors.r)
        self._prescribed_force = math.sqrt(squared)
        self._loose.hold_still(prescribed, vectors.r)
        self._loose.hold_still(prescribed, vectors.p)
        self._pq = self._product(prescribed, vectors.p)
        precision = float(np.finfo(vectors.x.dtype).eps)
        reach = math.sqrt(largest_squared(count, vectors.x))
        self._floor = self._rest_tolerance + ROUNDING * precision * reach
        self._precondition(prescribed, 0.0)
        self._waited, self._first, self._room = 0, self.residual, self._reach
        return away == 0.0

    def _judge(self) -> None:
        """Whether the exact residual is small enough, or will not become smaller."""
        energy = self.tangent.now.energy
        if self.residual < 0.5 * self._best or energy < self._lowest * (1.0 - GROWTH):
            self._best, self._lowest = min(self._best, self.residual), energy
            self._stalled = 0
        else:
            self._stalled += 1
        self.settled = (
            self.residual <= self._tolerance * self._prescribed_force
            or self._motion <= self._floor
            or self._stalled > PATIENCE
        )

    def prescribed_changed(self, state: State, held: NDArray[np.int32]) -> None:
        """Go on from the present shape; one that is not known is linearised first."""
        rows, u, vectors = slice(self._count), state.displacement, self._vectors
        follow_held(self._held, u, self.tangent.rows, self._prescribed, vectors)
        self._moves += 1
        self._disturb()
        if not np.array_equal(u[rows], vectors.x[rows]):
            vectors.x[rows] = u[rows]
            vectors.r[:] = 0.0
            self._unknown, self._renewing = True, False
        before, now = self._prescribed[rows], state.prescribed[rows]
        self._take_forces(np.flatnonzero(before != now).astype(np.int32), state)
        self._held = held.astype(np.int32)

    def _take_forces(self, nodes: NDArray[np.int32], state: State) -> None:
        """Begin anew with exact forces on some nodes."""
        forces = np.zeros((len(nodes), 3))
        self.tangent.forces(nodes, self.shape, forces)
        forces[state.prescribed[nodes]] = 0.0
        self._vectors.r[nodes] = forces
        self._vectors.p[:] = 0.0
        self._pq = 0.0
        np.copyto(self._prescribed, state.prescribed)
        self._loose.follow_prescribed(self.shape, state.prescribed)
        self._loose.hold_still(state.prescribed, self._vectors.r)

    def follow(self, change: EditChange, state: State) -> None:
        """Follow an edit that the network has followed."""
        capacity, nodes = self._springs.mesh.node_capacity, change.nodes
        extra = capacity - len(self.shape)
        if extra > 0:
            self._vectors = Vectors(*(np.pad(a, ((0, extra), (0, 0))) for a in self._vectors))
            self._prescribed = np.pad(self._prescribed, (0, extra))
        self.shape[nodes] = state.displacement[nodes]
        self.tangent.follow_at(change, self.shape)
        self._aggregates.follow(change.copied_nodes, change.copy_parents, capacity)
        self._loose.follow(change)
        self._moves += 1
        self._renewing = False
        self._disturb()
        self._take_forces(nodes, state)

    def forces(self, state: State, rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Exact internal forces on nodes [N], shape (len(rows), 3)."""
        out = np.zeros((len(rows), 3))
        self.tangent.forces(np.asarray(rows, np.int32), state.displacement, out)
        return out

    def largest_residual(self, state: State) -> float:
        """Largest internal force on a free node [N].

        It is exact when `settled`, elsewhere by the linearisation in use.
        """
        if not self._unknown:
            return math.sqrt(largest_squared(self._count, self._vectors.r))
        free = np.flatnonzero(~state.prescribed[: self._count]).astype(np.int32)
        return math.sqrt(largest_squared(len(free), self.forces(state, free)))
