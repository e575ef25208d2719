"""Threads that join two nodes of the tissue: a table that edits replace."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tissue_sim.geometry.mesh import Mesh

FIRST_ID = 1
"""Id of a mesh's first suture; 0 is nobody's, so that it can stand for none in requests."""

DEFAULT_STIFFNESS = 1000.0
"""Stiffness of a stitch [N/m] that names none.

A node of soft tissue (50 kPa, edges of a millimetre or two) resists with 100 to 500 N/m: such a
stitch gives way less than the tissue it bites into, at 1 N by a millimetre. A thread of
polypropylene (4-0: 5000 N/m for a stitch of 10 mm) would move the tissue hardly differently, and
explicit integration would need several times as many steps.
"""

STIFFEST = 1e6
"""Largest stiffness of a stitch [N/m]."""

LONGEST = 10.0
"""Largest rest length of a stitch [m]: more is a mistake of units."""


def _ids() -> NDArray[np.uint32]:
    return np.empty(0, dtype=np.uint32)


def _reals() -> NDArray[np.float64]:
    return np.empty(0, dtype=np.float64)


@dataclass(frozen=True)
class Sutures:
    """The stitches of a mesh, ascending by id. A table is never changed: an edit makes another.

    Attributes:
        ids: Permanent ids, never used again, shape (n,).
        nodes: Node rows of the ends of each, shape (n, 2).
        lengths: Rest lengths [m]: a thread pulls when it is longer, and never pushes, shape (n,).
        stiffness: Stiffnesses [N/m], shape (n,).
        groups: Id of the first stitch of the thread that each belongs to; its own id for a single
            stitch, shape (n,).
        next_id: First id that no stitch has had.
    """

    ids: NDArray[np.uint32] = field(default_factory=_ids)
    nodes: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int32))
    lengths: NDArray[np.float64] = field(default_factory=_reals)
    stiffness: NDArray[np.float64] = field(default_factory=_reals)
    groups: NDArray[np.uint32] = field(default_factory=_ids)
    next_id: int = FIRST_ID

    def __len__(self) -> int:
        """How many there are."""
        return len(self.ids)

    def places_of(self, ids: NDArray[np.integer]) -> NDArray[np.int64]:
        """Place of each id in the table; -1 where there is no such suture."""
        wide = np.asarray(ids, dtype=np.int64)
        if not len(self):
            return np.full(len(wide), -1)
        place = np.minimum(np.searchsorted(self.ids, wide), len(self) - 1)
        return np.where(self.ids[place] == wide, place, -1)

    def at(self, which: NDArray[np.integer] | NDArray[np.bool_]) -> Sutures:
        """Some of them, by place or mask."""
        return Sutures(
            self.ids[which], self.nodes[which], self.lengths[which], self.stiffness[which],
            self.groups[which], self.next_id,
        )  # fmt: skip

    def joined(self, others: Sutures) -> Sutures:
        """These and others."""
        ids = np.concatenate([self.ids, others.ids])
        order = np.argsort(ids, kind="stable")
        last = int(ids.max()) + 1 if len(ids) else FIRST_ID
        return Sutures(
            ids[order],
            np.concatenate([self.nodes, others.nodes])[order],
            np.concatenate([self.lengths, others.lengths])[order],
            np.concatenate([self.stiffness, others.stiffness])[order],
            np.concatenate([self.groups, others.groups])[order],
            max(self.next_id, others.next_id, last),
        )

    def with_lengths(self, places: NDArray[np.integer], lengths: NDArray[np.float64]) -> Sutures:
        """The same with other rest lengths [m] at some places."""
        new = self.lengths.copy()
        new[places] = lengths
        return replace(self, lengths=new)

    def renumbered(self, row: NDArray[np.integer]) -> Sutures:
        """The same between the nodes' new rows; those with an end at -1 are left out."""
        nodes = row[self.nodes].astype(np.int32).reshape(-1, 2)
        return replace(self, nodes=nodes).at(np.flatnonzero((nodes >= 0).all(axis=1)))


def tensions(
    sutures: Sutures, rest: NDArray[np.float64], displacement: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Pull of each thread [N], k (l - l0) where it is longer than at rest and 0 elsewhere.

    Args:
        sutures: The stitches.
        rest: Rest positions by node row [m].
        displacement: Current minus rest position [m].
    """
    a, b = sutures.nodes[:, 0], sutures.nodes[:, 1]
    edge = rest[b] - rest[a] + (displacement[b].astype(np.float64) - displacement[a])
    lengths = np.linalg.norm(edge, axis=1)
    pulls: NDArray[np.float64] = sutures.stiffness * np.maximum(lengths - sutures.lengths, 0.0)
    return pulls


def checked_sutures(sutures: Sutures, alive: NDArray[np.bool_]) -> Sutures:
    """A table from a file, if it is sound.

    Args:
        sutures: What the file says.
        alive: Node rows that exist.

    Raises:
        ValueError: Ids are not ascending, an end is no node, or a number is not allowed.
    """
    ids, nodes = sutures.ids.astype(np.int64), sutures.nodes
    if len(ids) and (ids[0] < FIRST_ID or (np.diff(ids) <= 0).any() or sutures.next_id <= ids[-1]):
        raise ValueError("ids of sutures are not ascending")
    if (nodes < 0).any() or (nodes >= len(alive)).any() or not alive[nodes].all():
        raise ValueError("a suture is at a node that is not there")
    if (nodes[:, 0] == nodes[:, 1]).any():
        raise ValueError("both ends of a suture are at one node")
    if why := why_not(sutures.lengths, sutures.stiffness):
        raise ValueError(why)
    return sutures


def why_not(lengths: NDArray[np.float64], stiffness: NDArray[np.float64]) -> str:
    """Why rest lengths [m] or stiffnesses [N/m] are not allowed; "" if they are."""
    if not ((lengths >= 0.0) & (lengths <= LONGEST)).all():
        return f"the rest length of a suture is not allowed; allowed: 0 to {LONGEST:g} m"
    if not ((stiffness > 0.0) & (stiffness <= STIFFEST)).all():
        return (
            "the stiffness of a suture is not allowed; "
            f"allowed: more than 0, up to {STIFFEST:g} N/m"
        )
    return ""


def is_surface_node(mesh: Mesh, node: int) -> bool:
    """Whether a node is on the surface: one of its elements has a face there that no other has."""
    if mesh.sheet_rows is not None:
        return bool((mesh.tets[mesh.incident.of(node), 2] >= 0).any())
    tets = mesh.tets[mesh.incident.of(node)]
    others = np.sort(tets[tets != node].reshape(len(tets), 3), axis=1)
    faces = np.concatenate([others[:, [0, 1]], others[:, [0, 2]], others[:, [1, 2]]])
    _, counts = np.unique(faces, axis=0, return_counts=True)
    return bool((counts == 1).any())
