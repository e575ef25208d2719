"""The stitches of a mesh as elastic models carry them; see docs/sutures.md."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from tissue_sim.elastic.model import State
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.geometry.sutures import Sutures
from tissue_sim.kernels.stitches import Sewn, Threads, add_pulls, limit_threads, sewn_pulls


class Stitches:
    """Stitches by row and by node, made anew after every edit: there are few of them.

    Sweeps over nodes leave the sewn nodes out (`set_aside`), which then are swept by themselves
    with the pull of their stitches: a Gauss-Seidel sweep in another order, which costs models
    nothing where nothing is sewn.

    Attributes:
        mesh: The mesh that is followed.
        sutures: Its sutures.
        threads: They by row, for kernels.
        sewn: They by node, nodes of one part (see `parts`) after the other.
        parts: Where parts begin and end in `sewn.nodes`: no stitch joins two nodes of one part.
    """

    def __init__(self, mesh: Mesh) -> None:
        """Take the mesh's sutures over."""
        self.mesh = mesh
        self.sutures: Sutures = mesh.sutures
        self._take(mesh.sutures)

    def __len__(self) -> int:
        """How many there are."""
        return len(self.sutures)

    @property
    def nodes(self) -> NDArray[np.int32]:
        """Rows of the sewn nodes, in the order of `sewn`."""
        return self.sewn.nodes

    def follow(self) -> bool:
        """Take the mesh's sutures over as they are now; whether they are others than before."""
        before, now = self.sutures, self.mesh.sutures
        self.sutures = now
        if (
            np.array_equal(before.nodes, now.nodes)
            and np.array_equal(before.lengths, now.lengths)
            and np.array_equal(before.stiffness, now.stiffness)
        ):
            return False
        self._take(now)
        return True

    def _take(self, table: Sutures) -> None:
        self.threads = Threads(
            np.ascontiguousarray(table.nodes, dtype=np.int32).reshape(-1, 2),
            np.ascontiguousarray(table.stiffness), np.ascontiguousarray(table.lengths),
        )  # fmt: skip
        nodes, ends = np.unique(self.threads.ends, return_inverse=True)
        ends = ends.reshape(-1, 2)
        part = _parts(len(nodes), ends)
        order = np.argsort(part, kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        at = place[ends]
        own = np.concatenate([at[:, 0], at[:, 1]])
        by_node = np.argsort(own, kind="stable")
        start = np.zeros(len(nodes) + 1, dtype=np.int32)
        start[1:] = np.cumsum(np.bincount(own, minlength=len(nodes)))
        other = np.concatenate([at[:, 1], at[:, 0]])[by_node]
        thread = np.tile(np.arange(len(ends)), 2)[by_node]
        self.sewn = Sewn(
            nodes[order].astype(np.int32), start, other.astype(np.int32), thread.astype(np.int32)
        )
        ends_of_parts = np.cumsum(np.bincount(part, minlength=1)).tolist()
        self.parts = list(zip([0, *ends_of_parts[:-1]], ends_of_parts, strict=True))

    @contextmanager
    def set_aside(self, state: State) -> Iterator[None]:
        """Within it sewn nodes count as prescribed. Modifies the state and puts it back."""
        nodes = self.nodes
        if not len(nodes):
            yield
            return
        before = state.prescribed[nodes]
        state.prescribed[nodes] = True
        try:
            yield
        finally:
            state.prescribed[nodes] = before

    def add_forces(self, u: NDArray[np.floating], F: NDArray[np.floating]) -> float:
        """Add the pull of all to forces on nodes [N], shape (node_capacity, 3); the energy [J]."""
        if not len(self):
            return 0.0
        return float(add_pulls(self.threads, self.mesh.rest, u, F))

    def at_nodes(self, u: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pull of the taut ones at each sewn node [N], shape (s, 3); their stiffness [N/m], (s,).

        In the order of `nodes`.
        """
        F, K = np.zeros((len(self.nodes), 3)), np.zeros(len(self.nodes))
        sewn_pulls(self.sewn, self.threads, self.mesh.rest, u, F, K)
        return F, K

    def forces(self, u: NDArray[np.floating], rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Pull of the stitches at nodes [N], shape (len(rows), 3)."""
        return self.spread(self.at_nodes(u)[0], rows)

    def spread(self, values: NDArray[np.float64], rows: NDArray[np.int32]) -> NDArray[np.float64]:
        """Values by sewn node, shape (s, 3), at rows; zero at others, shape (len(rows), 3)."""
        out = np.zeros((len(rows), 3))
        if len(self):
            order = np.argsort(self.nodes)
            place = np.searchsorted(self.nodes, rows, sorter=order).clip(max=len(order) - 1)
            found = order[place]
            has = self.nodes[found] == rows
            out[has] = values[found[has]]
        return out

    def node_stiffness(self, nodes: NDArray[np.int32]) -> NDArray[np.float64]:
        """Sum of the stiffnesses of the stitches at nodes, taut or not [N/m], (len(nodes),)."""
        sums = np.zeros(self.mesh.node_capacity)
        np.add.at(sums, self.threads.ends, self.threads.stiffness[:, None])
        return np.asarray(sums[nodes])

    def limit(
        self, limits: NDArray[np.float64], prescribed: NDArray[np.bool_], u: NDArray[np.floating]
    ) -> float:
        """Put stitches longer than limits [m] at them; the farthest squared move [m^2].

        Modifies `u` in place.
        """
        if not len(self):
            return 0.0
        return float(limit_threads(self.threads, limits, self.mesh.rest, prescribed, u))

    def _edges(self, u: NDArray[np.floating]) -> NDArray[np.float64]:
        """From the first to the second end of each [m], shape (n, 3)."""
        a, b = self.threads.ends[:, 0], self.threads.ends[:, 1]
        rest = self.mesh.rest
        return np.asarray(rest[b] - rest[a] + (u[b].astype(np.float64) - u[a]))

    def lengths(self, u: NDArray[np.floating]) -> NDArray[np.float64]:
        """Present lengths [m], shape (n,)."""
        if not len(self):
            return np.empty(0)
        return np.asarray(np.linalg.norm(self._edges(u), axis=1))

    def directions(self, u: NDArray[np.floating]) -> NDArray[np.float64]:
        """Unit vectors along the edges of all, shape (n, 3); zero for one without length."""
        edge = self._edges(u)
        return edge / np.maximum(np.linalg.norm(edge, axis=1), 1e-300)[:, None]

    def tangents(
        self, u: NDArray[np.floating], taut: NDArray[np.bool_], least: float = 0.0
    ) -> NDArray[np.float64]:
        """How the pull of each grows with its edge [N/m], shape (n, 3, 3).

        k (n n^T + (1 - l0 / l)(I - n n^T)) with n the direction of the edge: never negative.

        Args:
            u: Displacements [m], shape (node_capacity, 3).
            taut: Which of them count as taut, shape (n,); others have none.
            least: Least stiffness across, as a share of k.
        """
        n = self.directions(u)
        along = n[:, :, None] * n[:, None, :]
        across = self.across(u, least)[:, None, None]
        blocks = along + across * (np.eye(3) - along)
        return np.asarray((self.threads.stiffness * taut)[:, None, None] * blocks)

    def across(self, u: NDArray[np.floating], least: float) -> NDArray[np.float64]:
        """Stiffness across a thread as a share of that along it, 1 - l0 / l or more, shape (n,)."""
        share = 1.0 - self.threads.length / np.maximum(self.lengths(u), 1e-300)
        # Without a rest length it is the same in all directions.
        return np.where(self.threads.length == 0.0, 1.0, np.clip(share, least, 1.0))


def _parts(count: int, ends: NDArray[np.int64]) -> NDArray[np.int64]:
    """Part of each node such that no pair of ends is in one part; few parts."""
    part = np.full(count, -1)
    others: list[list[int]] = [[] for _ in range(count)]
    for a, b in ends.tolist():
        others[a].append(b)
        others[b].append(a)
    # Along the threads, so that the two edges of a wound get two parts.
    for seed in range(count):
        waiting = [seed]
        while waiting:
            node = waiting.pop()
            if part[node] >= 0:
                continue
            taken = {int(part[other]) for other in others[node]}
            part[node] = next(k for k in range(len(taken) + 1) if k not in taken)
            waiting += [other for other in others[node] if part[other] < 0]
    return part
