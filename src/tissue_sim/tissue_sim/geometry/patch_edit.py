"""What an edit does to patches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.edit import NO_PARENT, PROVISIONAL, EditError, TopologyEdit
from tissue_sim.geometry.incidence import among
from tissue_sim.geometry.patches import FIRST_ID, MOST_PATCHES, Patch, Patches

if TYPE_CHECKING:
    from tissue_sim.geometry.mesh import Mesh

Rows = NDArray[np.int32]


@dataclass(frozen=True)
class Patching:
    """What an edit does to the patches of a mesh.

    Attributes:
        added: The new one, with its permanent id, label and name; None: there is none.
        removed: Those that are taken out.
        after: All of them after it.
    """

    added: Patch | None
    removed: tuple[Patch, ...]
    after: Patches


def patching_of(mesh: Mesh, edit: TopologyEdit, brings_back: bool) -> Patching:
    """Find out what an edit does to patches.

    Args:
        mesh: The mesh before it.
        edit: The edit; `refuse_malformed` has let it pass.
        brings_back: Whether it names a new patch by an id it has had (a redo).

    Raises:
        EditError: It names a patch that is not there, or its region is another's.
    """
    there = mesh.patches
    found = [there.get(patch_id) for patch_id in edit.removed_patches.tolist()]
    removed = tuple(patch for patch in found if patch is not None)
    if len(removed) != len(found):
        raise EditError(f"the edit removes a patch that is not there: {edit.removed_patches}")
    after = there.without(edit.removed_patches)
    if not edit.added_patches:
        return Patching(None, removed, after)
    added = _permanent(mesh, edit.added_patches[0], brings_back)
    if len(after) >= MOST_PATCHES:
        raise EditError(f"the organ has {len(after)} patches; allowed: up to {MOST_PATCHES}")
    if added.name in mesh.region_names.values():
        raise EditError(f"the organ has a region named {added.name!r}; give the patch another name")
    return Patching(added, removed, after.joined(added))


def _permanent(mesh: Mesh, patch: Patch, brings_back: bool) -> Patch:
    """The patch with a permanent id, a region label of its own and a name."""
    first = mesh.patches.next_id
    if brings_back:
        if not FIRST_ID <= patch.id < first or mesh.patches.get(patch.id) is not None:
            raise EditError("the edit brings back a patch that has not been removed")
    elif patch.id not in (PROVISIONAL, first):
        raise EditError(
            f"the new patch's id is {patch.id}; allowed: {PROVISIONAL} in a plan, or {first}, the "
            "next free one, in an applied edit"
        )
    if patch.id == PROVISIONAL:
        # Rows of removed elements keep their labels, so that no label is used again.
        labels = mesh.regions[: mesh.element_rows]
        label = 1 + max([int(labels.max(initial=0)), *mesh.region_names])
        patch = replace(patch, id=first, label=label)
    elif patch.label in mesh.region_names:
        raise EditError(f"region label {patch.label} of the new patch is another region's")
    return patch if patch.name else replace(patch, name=f"patch {patch.id}")


def refuse_bad_patch(edit: TopologyEdit, born: Rows, added_to: Rows) -> None:
    """Refuse elements without parent that are not a part of their own.

    Args:
        edit: The edit; `refuse_malformed` has let it pass.
        born: Rows of its nodes without parent.
        added_to: Node rows of its new elements, -1 for none, shape (a, 4).

    Raises:
        EditError: An element without parent has another node, or a node without parent is in an
            element that has one.
    """
    if not edit.added_patches:
        return
    own = np.asarray(edit.added_parents) == NO_PARENT
    nodes, others = added_to[own].ravel(), added_to[~own].ravel()
    if not among(nodes[nodes >= 0], born).all() or among(others, born).any():
        raise EditError(
            "a patch is a part of its own: its elements have its own nodes and no others"
        )
