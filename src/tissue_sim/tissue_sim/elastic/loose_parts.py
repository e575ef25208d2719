"""Parts of an organ that nothing keeps from moving as a whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csgraph

from tissue_sim.geometry.components import connected_components, joined_as_before
from tissue_sim.geometry.edit import EditChange
from tissue_sim.geometry.mesh import Mesh
from tissue_sim.kernels.rigid_parts import measure_parts, remove_rigid_motions

RIGID = 1e-9
"""Share of the largest below which an eigenvalue of a sum of squares counts as zero."""


class LooseParts:
    """Connected parts with too few prescribed nodes, and their rigid motions.

    A part without prescribed nodes has six rigid motions, one that turns about a node three, about
    two nodes or a line of them one. None of them has a stiffness, so a method that divides by
    stiffness must leave them out: then the part keeps its place, and rounding does not move it.
    """

    def __init__(self, mesh: Mesh) -> None:
        """Find the connected parts; which of them are loose is found by `follow_prescribed`."""
        self._mesh = mesh
        self._nodes = np.empty(0, dtype=np.int32)
        self._begin = np.zeros(1, dtype=np.int64)
        self._arms, self._inverse = np.empty((0, 3)), np.empty((0, 6, 6))
        self._sums = np.empty((0, 2, 6, 6))
        # Part of each node by its elements, and with threads; what `joined_as_before` writes on.
        self._own = self._label = self._root = np.empty(0, dtype=np.int32)
        self._own_count = self._count = 0
        self._taut = np.empty(0, dtype=np.bool_)
        # Prescribed nodes when loose parts were looked for last, and whether parts are the same.
        self._given, self._known = np.zeros(mesh.node_capacity, dtype=np.bool_), False
        self.follow_elements()

    def follow(self, change: EditChange) -> None:
        """Follow an edit that the mesh has applied, in time proportional to it where it can be.

        If what it touched hangs together around it as it did before, all parts are what they were.
        Only if not, as when it separates a part, is everything looked at.
        """
        mesh = self._mesh
        if change.edit.sews or len(change.released):
            self._taut = self._taut[:0]
        if len(change.born_nodes):
            self.follow_elements()
            return
        extra = mesh.node_capacity - len(self._own)
        if extra > 0:
            self._own = np.append(self._own, np.full(extra, -1, dtype=np.int32))
            self._root = np.append(self._root, np.full(extra, -1, dtype=np.int32))
            self._given = np.append(self._given, np.zeros(extra, dtype=np.bool_))
        label, at = self._own, mesh.incident
        label[change.returned_nodes] = label[change.returned_like]
        label[change.copied_nodes] = label[change.copy_parents]
        label[change.vanished_nodes] = -1
        touched = change.nodes[mesh.node_alive[change.nodes]]
        self._known &= not self._given[change.vanished_nodes].any()
        if not joined_as_before(
            touched, label[touched], change.old_elements, mesh.node_alive, mesh.tets, at.start,
            at.count, at.data, self._root,
        ):  # fmt: skip
            self.follow_elements()
        self._sew()

    def follow_elements(self) -> None:
        """Find the connected parts anew."""
        mesh, rows = self._mesh, self._mesh.element_rows
        self._own_count, label = connected_components(
            mesh.tets[:rows], mesh.element_alive[:rows], mesh.node_rows
        )
        self._known = False
        self._own = np.full(mesh.node_capacity, -1, dtype=np.int32)
        self._own[: len(label)] = label
        self._root = np.full(mesh.node_capacity, -1, dtype=np.int32)
        self._sew()

    def follow_threads(self, taut: NDArray[np.bool_]) -> bool:
        """Let only taut threads hold parts together; until told, and after sewing, all do.

        Args:
            taut: Which of the mesh's sutures are, shape (n,).

        Returns:
            Whether that changes which parts there are: `follow_prescribed` finds the loose ones.
        """
        if np.array_equal(taut, self._taut):
            return False
        before, self._taut = self._label, taut.copy()
        self._sew()
        return not np.array_equal(before, self._label)

    def _sew(self) -> None:
        """What is sewn together hangs together."""
        nodes = self._mesh.sutures.nodes
        self._known &= self._label is self._own and not len(nodes)
        self._count, self._label = self._own_count, self._own
        if len(self._taut) == len(nodes):
            nodes = nodes[self._taut]
        if len(nodes):
            ends = self._own[nodes]
            shape = (self._own_count, self._own_count)
            joined = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape)
            self._count, whole = csgraph.connected_components(joined, directed=False)
            self._label = np.append(whole, -1)[self._own]

    def follow_prescribed(self, shape: NDArray[np.floating], prescribed: NDArray[np.bool_]) -> None:
        """Find which parts are loose.

        Args:
            shape: Displacements [m], shape (node_capacity, 3).
            prescribed: Nodes whose motion is given, shape (node_capacity,).
        """
        if self._known and not len(self) and not (self._given & ~prescribed).any():
            return  # What was fast stays so.
        self._given, self._known = prescribed.copy(), True
        loose = self._loose(shape, prescribed)
        if not len(loose) and not len(self._nodes):
            return
        place = np.full(self._count + 1, -1)
        place[loose] = np.arange(len(loose))
        part = place[self._label]
        nodes = np.flatnonzero(part >= 0)
        self._nodes = nodes[np.argsort(part[nodes], kind="stable")].astype(np.int32)
        sizes = np.bincount(part[nodes], minlength=len(loose))
        self._begin = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self._arms = np.zeros((len(nodes), 3))
        self._sums = np.zeros((len(loose), 2, 6, 6))
        self._inverse = np.zeros((len(loose), 6, 6))
        self.follow_shape(shape, prescribed)

    def _loose(
        self, shape: NDArray[np.floating], prescribed: NDArray[np.bool_]
    ) -> NDArray[np.int64]:
        """Numbers of parts whose prescribed nodes are none, at one place or in a line."""
        given = np.flatnonzero(prescribed[: len(self._label)] & (self._label >= 0))
        label = self._label[given]
        counts = np.bincount(label, minlength=self._count)
        divisor = counts.clip(min=1)[:, None]
        places = self._mesh.rest[given] + shape[given]
        middle = np.stack([self._sums_of(label, places[:, k]) for k in range(3)], axis=1)
        arms = places - (middle / divisor)[label]
        spread = np.empty((self._count, 3, 3))
        for i in range(3):
            for j in range(3):
                spread[:, i, j] = self._sums_of(label, arms[:, i] * arms[:, j])
        # Ascending: the second is zero when all are in a line.
        widths = np.linalg.eigvalsh(spread)
        loose: NDArray[np.int64] = np.flatnonzero(~(widths[:, 1] > RIGID * widths[:, 2]))
        return loose

    def _sums_of(
        self, label: NDArray[np.integer], values: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Sum of the values of each part."""
        return np.asarray(np.bincount(label, weights=values, minlength=self._count))

    def follow_shape(self, shape: NDArray[np.floating], prescribed: NDArray[np.bool_]) -> None:
        """Rigid motions turn about the middles of parts in the present shape; see above."""
        if not len(self._nodes):
            return
        measure_parts(
            self._nodes, self._begin, self._mesh.rest, shape, prescribed, self._arms, self._sums
        )
        if not np.isfinite(self._sums).all():
            self._inverse[:] = 0.0  # A lost state, which is about to be put back.
            return
        # Motions N y leave prescribed nodes where they are; G = N (N^T S N)^-1 N^T.
        values, N = np.linalg.eigh(self._sums[:, 1])
        N *= (values <= RIGID * values[:, -1:].clip(min=1.0))[:, None, :]
        Nt = N.swapaxes(1, 2)
        inner = np.linalg.pinv(Nt @ self._sums[:, 0] @ N, rcond=RIGID, hermitian=True)
        self._inverse[:] = N @ inner @ Nt

    def __len__(self) -> int:
        """How many parts are loose."""
        return len(self._begin) - 1

    @property
    def nodes(self) -> NDArray[np.int32]:
        """Rows of their nodes, part by part."""
        return self._nodes

    def hold_still(self, prescribed: NDArray[np.bool_], v: NDArray[np.floating]) -> None:
        """Take the rigid motions of loose parts out of a field of vectors. Modifies `v`."""
        remove_rigid_motions(self._nodes, self._begin, prescribed, self._arms, self._inverse, v)
