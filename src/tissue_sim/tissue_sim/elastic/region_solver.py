"""Direct solution with a region of interest: precomputed outside, cuttable inside.

Symbols: K the stiffness matrix; o the free nodes outside of the region, r those in it, b those of r
with neighbours outside; f and h the free and the held nodes of r.

What is outside only ever answers to the region's border. With K_oo factorised once,

    X = K_oo^-1 K_ob,    C = K_bo X,    u_o = -X u_b,

and the region alone has the stiffness A = K_rr - C (static condensation; C counts in b only): the
same solution as that of the whole organ. A is small and dense. A cut inside changes some rows of
K_rr, and A is made and factorised anew; X and C stay, as no element with a node in o may change.

References:
    R. J. Guyan, Reduction of stiffness and mass matrices, AIAA Journal 3(2), 1965,
    doi 10.2514/3.2874. M. Bro-Nielsen, S. Cotin, Real-time volumetric deformable models for
    surgery simulation using finite elements and condensation, Computer Graphics Forum 15(3), 1996,
    doi 10.1111/1467-8659.1530057.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from tissue_sim.elastic.direct_solver import dofs_of, refuse_loose, rows_of
from tissue_sim.elastic.factorisation import factorised
from tissue_sim.elastic.stiffness import Stiffness
from tissue_sim.geometry.edit import EditChange

MOST_INSIDE = 700
"""Nodes in the region; its dense matrix is factorised within a step after a grab or a cut."""

AT_ONCE = 48
"""Columns of X solved for at once."""

SINGULAR = 1e-6
"""Share of the largest pivot below which the smallest one is rounding."""


class RegionSolver:
    """The condensed outside of a region, and the region's own matrix, which follows cuts.

    Attributes:
        ready: Whether the matrix is factorised for the nodes held now.
    """

    def __init__(self, stiffness: Stiffness, centre: NDArray[np.float64], radius: float) -> None:
        """Condense the outside.

        Args:
            stiffness: Of the whole organ, which follows its edits.
            centre: Of the region, at rest [m], shape (3,).
            radius: Free nodes within this distance of it are in the region [m].

        Raises:
            ValueError: The organ or the region is too large, no free node is in it, or a part of
                the organ has no fixed node.
        """
        mesh, self._stiffness = stiffness.springs.mesh, stiffness
        count = mesh.node_rows
        refuse_loose(stiffness, "interest_radius")
        near = np.linalg.norm(mesh.rest[:count] - centre, axis=1) <= radius
        free = mesh.node_alive[:count] & ~mesh.fixed[:count]
        inside = int((near & free).sum())
        if not 0 < inside <= MOST_INSIDE:
            raise ValueError(
                f"interest_radius = {radius:g} m takes {inside} free nodes about "
                f"{centre.tolist()} m; allowed: 1 to {MOST_INSIDE} nodes"
            )
        self._is_outside = free & ~near
        self._outside = np.flatnonzero(self._is_outside)
        self._condense(np.flatnonzero(near & free))
        self._held = np.empty(0, dtype=np.int32)
        self.ready = self._possible = False
        self._fresh = False
        self.hold(self._held)

    def _condense(self, inside: NDArray[np.int64]) -> None:
        o = dofs_of(self._outside)
        K_o = rows_of(self._stiffness, self._outside)
        couples = np.zeros(K_o.shape[1] // 3, dtype=np.bool_)
        couples[K_o.indices // 3] = True
        border = couples[inside]
        # Nodes of the border come first, copies of nodes will come last.
        self._region = np.concatenate([inside[border], inside[~border]])
        self._border = int(border.sum())
        b = dofs_of(self._region[: self._border])
        self._K_b_o = rows_of(self._stiffness, self._region[: self._border])[:, o]
        fixed = np.flatnonzero(self._stiffness.springs.mesh.fixed[: K_o.shape[1] // 3])
        self._fixed, self._K_o_x = dofs_of(fixed), K_o[:, dofs_of(fixed)]
        self._X = np.zeros((len(o), len(b)))
        K_o_b = K_o[:, b]
        if len(o):
            self._factor = factorised(0.5 * (K_o[:, o] + K_o[:, o].T))
            for k in range(0, len(b), AT_ONCE):
                columns = slice(k, k + AT_ONCE)
                self._X[:, columns] = self._factor.solve(K_o_b[:, columns].toarray())
        C = self._K_b_o @ self._X
        self._C = 0.5 * (C + C.T)

    def hold(self, held: NDArray[np.int32]) -> None:
        """Hold these nodes, none of them fixed; outside of the region nothing is precomputed."""
        self._held = held
        self._possible = not self._is_outside[held[held < len(self._is_outside)]].any()
        self.ready = False

    def follow(self, change: EditChange) -> str:
        """Follow an edit that the stiffness has followed; why that is not possible, or nothing."""
        if self.refusal(change.nodes):
            return "a cut outside of the region of interest; conjugate gradients go on"
        # Copies that a redo makes again are in the region already.
        news = np.setdiff1d(change.copied_nodes.astype(np.int64), self._region)
        self._region = np.concatenate([self._region, news])
        # A copy of a held node is held, and what a held node vanishes into.
        copies = change.copied_nodes[np.isin(change.copy_parents, self._held)]
        merged = change.merged_into[np.isin(change.merged_nodes, self._held)]
        held = np.unique(np.concatenate([self._held, copies, merged]))
        mesh = self._stiffness.springs.mesh
        self._fresh = False
        self.hold(held[mesh.node_alive[held] & ~mesh.fixed[held]])
        return ""

    def refusal(self, nodes: NDArray[np.int32]) -> str:
        """Why an edit that changes the elements of these nodes is not possible, or nothing."""
        old = nodes[nodes < len(self._is_outside)]
        out = int(self._is_outside[old].sum())
        if not out:
            return ""
        return (
            f"it changes elements at {out} nodes outside of the region of interest, where all is "
            "precomputed; allowed: elements whose free nodes are all in it"
        )

    def go_on(self) -> bool:
        """Make what is missing; whether nothing is."""
        if self.ready or not self._possible:
            return self.ready
        if not self._fresh:
            self._assemble()
        mesh = self._stiffness.springs.mesh
        free = mesh.node_alive[self._region]
        free[np.isin(self._region, self._held)] = False
        self._free = np.flatnonzero(np.repeat(free, 3))
        try:
            self._cholesky = cho_factor(self._A[np.ix_(self._free, self._free)])
        except LinAlgError:
            self._possible = False
            return False
        pivots = np.diag(self._cholesky[0]) ** 2
        # A part that is cut free has no equilibrium of its own.
        self._possible = bool(pivots.min(initial=1.0) > SINGULAR * pivots.max(initial=0.0))
        self.ready = self._possible
        return self.ready

    def _assemble(self) -> None:
        self._K_r = rows_of(self._stiffness, self._region)
        A = self._K_r[:, dofs_of(self._region)].toarray()
        self._A = 0.5 * (A + A.T)
        size = 3 * self._border
        self._A[:size, :size] -= self._C
        self._fresh = True

    def change(self, shape: NDArray[np.floating]) -> NDArray[np.float64]:
        """What a shape lacks to equilibrium in free nodes [m], shape (len(shape), 3).

        Args:
            shape: Displacements [m], those of fixed and held nodes as they have to be.
        """
        count, size = self._K_r.shape[1] // 3, 3 * self._border
        given = np.zeros(3 * count)
        values = shape[:count].astype(np.float64).ravel()
        for dofs in (dofs_of(self._held), self._fixed):
            given[dofs] = values[dofs]
        region = dofs_of(self._region)
        b = -(self._K_r @ given)
        b[:size] += self._C @ given[region[:size]]
        still = np.zeros(len(self._X))
        if given[self._fixed].any() and len(self._outside):
            still = self._factor.solve(self._K_o_x @ given[self._fixed])
            b[:size] += self._K_b_o @ still
        given[region[self._free]] = cho_solve(self._cholesky, b[self._free])
        given[dofs_of(self._outside)] = -(self._X @ given[region[:size]]) - still
        out = np.zeros((len(shape), 3))
        known = np.concatenate([region[self._free], dofs_of(self._outside)])
        out.reshape(-1)[known] = given[known] - values[known]
        return out
