"""Where a region lies: the small language of scene files.

- `` (nothing): the region of the mesh with the name it has in the scene
- `name:NAME`: the region of the mesh with another name, for instance one with spaces
- `label:NUMBER`: elements with this label, such as TetGen's element attribute
- `sphere:x,y,z,r` or `box:x0,x1,y0,y1,z0,z1`: elements whose centroid lies in it [m], at rest
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.raw_mesh import RawMesh

GRAMMAR = (
    "nothing (a region of the mesh with this name), name:NAME, label:NUMBER, sphere:x,y,z,r or "
    "box:x0,x1,y0,y1,z0,z1 [m]"
)
_NUMBERS = {"sphere": 4, "box": 6}


class RegionError(ValueError):
    """A region that is not there, or a description of one that is not understood."""


def region_key(name: str, where: str) -> str:
    """What a scene's region is called in the mesh: a name, or a label in digits.

    Raises:
        RegionError: The description is not understood.
    """
    kind, _, rest = where.strip().partition(":")
    if not kind:
        return name
    if kind == "name" and rest:
        return rest
    if kind == "label":
        try:
            return str(int(rest))
        except ValueError:
            raise RegionError(
                f"region {name}: {where!r} names no whole number; allowed: {GRAMMAR}"
            ) from None
    if kind in _NUMBERS:
        _numbers(name, where)
        return name
    raise RegionError(f"region {name}: {where!r} is not understood; allowed: {GRAMMAR}")


def label_of(region: str, labels: NDArray[np.integer], names: Mapping[int, str]) -> int:
    """Label of a region by its name in the mesh or by the label itself, in digits.

    Args:
        region: Name or label.
        labels: Labels of the mesh's elements.
        names: Names of labels.

    Raises:
        RegionError: The mesh has none.
    """
    for label, name in names.items():
        if name == region:
            return label
    there = np.unique(labels).tolist()
    if region.lstrip("-").isdigit() and int(region) in there:
        return int(region)
    known = [names.get(label, str(label)) for label in there]
    known += [name for label, name in names.items() if label not in there]
    raise RegionError(f"the mesh has no region {region!r}; its regions: {', '.join(known)}")


def paint(raw: RawMesh, regions: Mapping[str, str]) -> RawMesh:
    """Give the elements in a scene's spheres and boxes labels of their own; later ones win.

    Args:
        raw: The mesh.
        regions: Where each region lies, by name.

    Raises:
        RegionError: A description is not understood or takes no element, or a region that the
            mesh should bring is not there.
    """
    labels = raw.regions if len(raw.regions) else np.zeros(len(raw.tetrahedra), dtype=np.int32)
    labels, names = labels.copy(), dict(raw.region_names)
    centroids = raw.points[raw.tetrahedra].mean(axis=1)
    for name, where in regions.items():
        key = region_key(name, where)
        if where.partition(":")[0].strip() not in _NUMBERS:
            label_of(key, labels, names)
            continue
        inside = _inside(name, where, centroids)
        if name in names.values():
            raise RegionError(
                f"region {name}: the mesh has a region of this name; give {where!r} another one"
            )
        if not inside.any():
            low, high = raw.points.min(axis=0), raw.points.max(axis=0)
            raise RegionError(
                f"region {name}: {where!r} takes no element; {raw.name} lies from "
                f"{low.tolist()} to {high.tolist()} m"
            )
        label = 1 + max([int(labels.max(initial=0)), *names])
        labels[inside], names[label] = label, name
    return replace(raw, regions=labels, region_names=names)


def _inside(name: str, where: str, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    numbers = np.array(_numbers(name, where))
    if where.strip().startswith("sphere"):
        return np.asarray(np.linalg.norm(points - numbers[:3], axis=1) <= numbers[3])
    return np.asarray(((points >= numbers[::2]) & (points <= numbers[1::2])).all(axis=1))


def _numbers(name: str, where: str) -> list[float]:
    kind, _, rest = where.strip().partition(":")
    try:
        numbers = [float(word) for word in rest.split(",")]
    except ValueError:
        numbers = []
    sound = len(numbers) == _NUMBERS[kind] and bool(np.isfinite(numbers).all())
    if sound and kind == "sphere":
        sound = numbers[3] > 0
    elif sound:
        sound = all(a < b for a, b in zip(numbers[::2], numbers[1::2], strict=True))
    if not sound:
        raise RegionError(f"region {name}: {where!r} is not understood; allowed: {GRAMMAR}")
    return numbers
