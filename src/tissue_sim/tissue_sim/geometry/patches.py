"""Patches: soft sheets that edits add to an organ, each with a material of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

FIRST_ID = 1
"""Id of a mesh's first patch; 0 is nobody's, so that it can stand for none in requests."""

MOST_PATCHES = 64
"""Patches that an organ has at a time."""

LONGEST_NAME = 100
"""Most characters of a name."""

RANGES = {
    "young_modulus": (1.0, 1e12, "Pa"),
    "density": (1.0, 1e5, "kg/m^3"),
    "thickness": (1e-6, 1.0, "m"),
}
"""Smallest and largest value of each number of a patch, and its unit."""


@dataclass(frozen=True)
class Patch:
    """A soft sheet that an edit has added. Its elements are those with its region label.

    Attributes:
        young_modulus: Young's modulus [Pa]; Poisson's ratio is the tissue's own.
        density: Mass density [kg/m^3].
        thickness: Thickness [m].
        normal: Unit normal of the flat sheet at rest, x y z.
        name: Name of its region; "" in a plan: "patch ID".
        id: Permanent id, never used again; `edit.PROVISIONAL` in a plan.
        label: Region label of its elements; in a plan the mesh chooses it.
    """

    young_modulus: float
    density: float
    thickness: float
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    name: str = ""
    id: int = 1 << 31
    label: int = 0


@dataclass(frozen=True)
class Patches:
    """The patches of a mesh, ascending by id. A table is never changed: an edit makes another.

    Attributes:
        items: The patches.
        next_id: First id that no patch has had.
    """

    items: tuple[Patch, ...] = field(default=())
    next_id: int = FIRST_ID

    def __len__(self) -> int:
        """How many there are."""
        return len(self.items)

    def __iter__(self) -> Iterator[Patch]:
        """One after the other."""
        return iter(self.items)

    @property
    def ids(self) -> NDArray[np.uint32]:
        """Their ids, ascending, shape (n,)."""
        return np.array([patch.id for patch in self.items], dtype=np.uint32)

    @property
    def labels(self) -> NDArray[np.int32]:
        """Their region labels, shape (n,)."""
        return np.array([patch.label for patch in self.items], dtype=np.int32)

    def get(self, patch_id: int) -> Patch | None:
        """The patch with an id; None: there is none."""
        return next((patch for patch in self.items if patch.id == patch_id), None)

    def of_label(self, label: int) -> Patch | None:
        """The patch whose elements have a region label; None: there is none."""
        return next((patch for patch in self.items if patch.label == label), None)

    def joined(self, patch: Patch) -> Patches:
        """These and another, whose id they do not have."""
        items = tuple(sorted((*self.items, patch), key=lambda item: item.id))
        return Patches(items, max(self.next_id, patch.id + 1))

    def without(self, patch_ids: NDArray[np.integer]) -> Patches:
        """These but for some."""
        if not len(patch_ids):
            return self
        gone = set(np.asarray(patch_ids).tolist())
        return replace(self, items=tuple(item for item in self.items if item.id not in gone))


def why_not(patch: Patch) -> str:
    """Why a patch is not allowed; "" if it is."""
    for name, (low, high, unit) in RANGES.items():
        value = getattr(patch, name)
        if not low <= value <= high:
            allowed = f"allowed: {low:g} to {high:g} {unit}"
            return f"the patch's {name} = {value:g} is not allowed; {allowed}"
    normal = np.asarray(patch.normal, dtype=np.float64)
    if normal.shape != (3,) or not abs(float(np.linalg.norm(normal)) - 1.0) <= 1e-6:
        return f"the patch's normal {patch.normal} is not allowed; allowed: three numbers, length 1"
    if len(patch.name) > LONGEST_NAME or not (patch.name == "" or patch.name.isprintable()):
        return (
            f"the patch's name is not allowed; allowed: up to {LONGEST_NAME} printable characters"
        )
    return ""


def checked_patches(patches: Patches, labels: NDArray[np.integer]) -> Patches:
    """A table from a file, if it is sound.

    Args:
        patches: What the file says.
        labels: Labels of regions that have a name.

    Raises:
        ValueError: Ids are not ascending, a label has no name or is another's, or a number is not
            allowed.
    """
    ids = patches.ids.astype(np.int64)
    if len(ids) and (ids[0] < FIRST_ID or (np.diff(ids) <= 0).any() or patches.next_id <= ids[-1]):
        raise ValueError("ids of patches are not ascending")
    if len(patches) > MOST_PATCHES:
        raise ValueError(f"there are {len(patches)} patches; allowed: up to {MOST_PATCHES}")
    own = patches.labels
    if len(np.unique(own)) != len(own) or not np.isin(own, labels).all():
        raise ValueError("a patch's region has no name, or is that of another patch")
    for patch in patches:
        if why := why_not(patch):
            raise ValueError(why)
    return patches
