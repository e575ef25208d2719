"""Which nodes never move: the small language of scene files and `--fixed`.

Terms joined by `+`; a node is fixed if any term takes it:

- `auto`: the mesh's node set `fixed` if it brings one, else `low:` along its longest axis
- `none`: no node
- `set:NAME`: a node set of the mesh
- `box:x0,x1,y0,y1,z0,z1`: nodes in an axis-aligned box [m]
- `low:AXIS:SHARE`, `high:AXIS:SHARE`: the lowest or highest share of the extent along x, y or z
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.geometry.raw_mesh import RawMesh

DEFAULT_SHARE = 0.1
GRAMMAR = (
    "auto, none, set:NAME, box:x0,x1,y0,y1,z0,z1 [m], low:AXIS:SHARE or high:AXIS:SHARE "
    "(such as low:z:0.1), several joined by +"
)


def fixed_nodes(raw: RawMesh, text: str) -> NDArray[np.bool_]:
    """Nodes that a description fixes.

    Args:
        raw: The mesh.
        text: Terms joined by `+`.

    Returns:
        True for each fixed node, shape (node_count,).

    Raises:
        ValueError: A term is not understood, names an unknown set, or takes no node.
    """
    fixed = np.zeros(len(raw.points), dtype=np.bool_)
    for term in text.split("+"):
        fixed |= _term(raw, term.strip())
    if len(fixed) and fixed.all():
        raise ValueError(f"fixed: {text!r} fixes all nodes of {raw.name}; nothing could move")
    return fixed


def _term(raw: RawMesh, term: str) -> NDArray[np.bool_]:
    kind, _, rest = term.partition(":")
    if term == "none":
        return np.zeros(len(raw.points), dtype=np.bool_)
    if term == "auto":
        if len(raw.node_sets.get("fixed", ())):
            return _of_set(raw, "fixed")
        longest = int(np.argmax(np.ptp(raw.points, axis=0)))
        return _end(raw, "xyz"[longest], DEFAULT_SHARE, highest=False)
    if kind == "set":
        return _of_set(raw, rest)
    if kind == "box":
        return _in_box(raw, term, rest)
    if kind in ("low", "high"):
        axis, _, share = rest.partition(":")
        return _end(raw, axis, _number(term, share or str(DEFAULT_SHARE)), kind == "high")
    raise ValueError(f"fixed: {term!r} is not understood; allowed: {GRAMMAR}")


def _of_set(raw: RawMesh, name: str) -> NDArray[np.bool_]:
    if name not in raw.node_sets:
        sets = ", ".join(sorted(raw.node_sets)) or "none"
        raise ValueError(f"fixed: {raw.name} has no node set {name!r}; its node sets: {sets}")
    fixed = np.zeros(len(raw.points), dtype=np.bool_)
    fixed[raw.node_sets[name]] = True
    return fixed


def _number(term: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(
            f"fixed: {text!r} in {term!r} is not a number; allowed: {GRAMMAR}"
        ) from None


def _in_box(raw: RawMesh, term: str, text: str) -> NDArray[np.bool_]:
    limits = [_number(term, word) for word in text.split(",")]
    if len(limits) != 6 or not all(a <= b for a, b in zip(limits[::2], limits[1::2], strict=True)):
        raise ValueError(
            f"fixed: {term!r} must be box:x0,x1,y0,y1,z0,z1 with x0 <= x1 and so on [m]"
        )
    low, high = np.array(limits[::2]), np.array(limits[1::2])
    inside = ((raw.points >= low) & (raw.points <= high)).all(axis=1)
    if not inside.any():
        lower, upper = raw.points.min(axis=0), raw.points.max(axis=0)
        raise ValueError(
            f"fixed: {term!r} takes no node; {raw.name} lies from {lower.tolist()} to "
            f"{upper.tolist()} m"
        )
    return np.asarray(inside)


def _end(raw: RawMesh, axis: str, share: float, highest: bool) -> NDArray[np.bool_]:
    if axis not in ("x", "y", "z") or not 0 < share < 1:
        raise ValueError(
            f"fixed: axis {axis!r} and share {share:g}; allowed: x, y or z, and between 0 and 1"
        )
    place = raw.points[:, "xyz".index(axis)]
    low, high = place.min(), place.max()
    if highest:
        return np.asarray(place >= high - share * (high - low))
    return np.asarray(place <= low + share * (high - low))
