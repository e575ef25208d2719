"""What an edit may do to a sheet, whose elements are triangles and springs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import EditError, TopologyEdit
from tissue_sim.geometry.sheet import CATEGORIES, SURFACE, triangle_areas
from tissue_sim.geometry.sheet_rows import NO_ROW, WALL

if TYPE_CHECKING:
    from tissue_sim.geometry.mesh import Mesh

NO_NODE = 0xFFFFFFFF
"""Where a triangle or a spring of an edit has no node."""

Rows = NDArray[np.int32]


def item_nodes(ids: NDArray[np.uint32], known: Callable[[NDArray[np.integer]], Rows]) -> Rows:
    """Node rows of the triangles and springs of an edit, -1 for none, shape (n, 4).

    Args:
        ids: Node ids, `NO_NODE` for none, shape (n, 4).
        known: Rows of node ids.

    Raises:
        EditError: Nodes are missing elsewhere than at the end, or are there twice.
    """
    none = np.asarray(ids) == NO_NODE
    if none[:, :2].any() or not none[:, 3].all():
        raise EditError(
            f"an element of a sheet has two nodes or three and {NO_NODE} in place of the others"
        )
    rows = known(np.where(none, np.asarray(ids)[:, :1], ids))
    rows[none] = NO_ROW
    twice = (rows[:, 0] == rows[:, 1]) | (rows[:, 1] == rows[:, 2]) | (rows[:, 0] == rows[:, 2])
    if twice.any():
        raise EditError(f"{int(twice.sum())} triangles or springs would have a node twice")
    return rows


def refuse_bad_items(
    mesh: Mesh,
    rewritten: tuple[Rows, Rows],
    added: tuple[Rows, Rows],
    removed: Rows,
    copies: Rows,
) -> None:
    """Refuse what would turn one kind into another, or leave copies without tissue.

    Args:
        mesh: The mesh.
        rewritten: Rows of elements whose nodes change, and their new nodes.
        added: Rows of the parents of new elements, and their nodes.
        removed: Rows of elements that are removed.
        copies: Rows of the new nodes.

    Raises:
        EditError: See above.
    """
    kinds = mesh.sheet_rows.kinds if mesh.sheet_rows is not None else np.zeros(0, np.uint8)
    elements, nodes = rewritten
    was_spring = mesh.tets[elements, 2] == NO_ROW
    if (was_spring != (nodes[:, 2] == NO_ROW)).any():
        raise EditError("a triangle would become a spring, or a spring a triangle")
    descends = added[0] != NO_ROW
    parents, made = added[0][descends], added[1][descends]
    springs = parents[made[:, 2] == NO_ROW]
    if (mesh.tets[springs, 2] != NO_ROW).any() or not np.isin(springs, removed).all():
        raise EditError("a new spring takes the place of a spring that the edit removes")
    if not len(copies):
        return
    solid = [nodes[~was_spring & (kinds[elements] != WALL)], made[kinds[parents] == 0]]
    named = np.concatenate([part[:, :3].ravel() for part in solid])
    uses = np.bincount(named[named >= copies[0]] - copies[0], minlength=len(copies))
    if not uses.all():
        raise EditError(f"{int((uses == 0).sum())} copied nodes would belong to no triangle")


def refuse_bad_sheet(edit: TopologyEdit, nodes: Rows) -> None:
    """Refuse triangles and springs of a new patch that are not what the edit says they are.

    Args:
        edit: The edit; `refuse_malformed` has let it pass.
        nodes: Nodes of its elements without parent, -1 for none, shape (k, 4).

    Raises:
        EditError: A spring has three nodes or a triangle two, a node belongs to no triangle, or a
            thickness or volume is not positive.
    """
    kinds, tissue = edit.born_kinds, edit.born_tissue
    if len(kinds) != len(nodes):
        raise EditError(f"born_kinds has {len(kinds)} items; allowed: one for each of {len(nodes)}")
    is_spring, is_wall = nodes[:, 2] == NO_ROW, kinds == WALL
    springs = (kinds != SURFACE) & ~is_wall
    if (springs != is_spring).any() or (kinds > WALL).any():
        raise EditError(
            f"a triangle's kind is {SURFACE}, a spring's {SURFACE + 1} to {len(CATEGORIES) - 1}, "
            f"a wall's {WALL}"
        )
    if not (np.isfinite(tissue) & ((tissue > 0.0) != is_wall) & (tissue >= 0.0)).all():
        raise EditError("a triangle has no thickness, a spring no volume of tissue, or a wall some")
    if len(np.unique(nodes[kinds == SURFACE, :3])) != len(edit.born_nodes):
        raise EditError("a node without parent would belong to no triangle")


def count_without_size(
    rest: NDArray[np.float64], place_of: Rows, places: NDArray[np.float64], items: Rows
) -> int:
    """Number of triangles without area and springs without length.

    Args:
        rest: Rest positions before the edit [m], shape (node_capacity, 3).
        place_of: Place in `places` of the nodes that move or are new, -1 for others.
        places: Where the edit puts them [m].
        items: Nodes of triangles and springs after the edit, -1 for none, shape (n, 4).
    """
    used, local = np.unique(items, return_inverse=True)
    local = local.reshape(items.shape)
    at = place_of[used]
    points = np.where(
        (at >= 0)[:, None],
        places[at] if len(places) else np.zeros((len(used), 3)),
        rest[np.minimum(used, len(rest) - 1)],
    )
    is_spring = items[:, 2] == NO_ROW
    ends = points[local[is_spring, :2]]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    sizes = np.concatenate([lengths, triangle_areas(points, local[~is_spring, :3])])
    return int((~(np.isfinite(sizes) & (sizes > 0.0))).sum())
