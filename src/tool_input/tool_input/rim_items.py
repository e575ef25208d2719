"""Rims of patches and edges of holes as a procedure file writes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tool_input.located_yaml import Item
from tool_input.procedure_items import Stitching, points_of

FEWEST_CORNERS = 3
"""Of a loop around a hole."""


@dataclass(frozen=True)
class HoleItem:
    """A hole that a `closure` step names or asks for.

    Attributes:
        loop: Places around it, on the tissue [m], shape (n, 3); none: it has been named before.
        reach: Longest way from a place to the tissue [m]; 0: the service's default.
        depth: How far over and under it a patch covers it [m]; 0: the service's default.
    """

    loop: NDArray[np.float64]
    reach: float
    depth: float


def rim_of(item: Item, keys: dict[str, Item], scale: float) -> Stitching:
    """What a `sew_rim` step sews.

    Args:
        item: `{patch: NAME}`, and `hole: NAME` or `loop: [points]` of the edge it is sewn to, or
            neither: the tissue that is closest.
        keys: The step's `spacing`, `running`, `reach` and `stiffness` [N/m].
        scale: Metres per unit of length of the file.
    """
    subject = item.mapping(("patch", "hole", "loop"), ("patch",))
    if {"hole", "loop"} <= set(subject):
        raise item.error("either hole or loop")
    if "spacing" not in keys:
        raise item.error("the key 'spacing' is missing: the distance of stitches along the rim")
    loop = _loop(subject["loop"], scale) if "loop" in subject else np.empty((0, 3))

    def number(name: str, unit: float) -> float:
        return keys[name].number(above=0.0) * unit if name in keys else 0.0

    return Stitching(
        loop,
        number("spacing", scale),
        keys["running"].flag() if "running" in keys else False,
        number("reach", scale),
        number("stiffness", 1.0),
        patch=subject["patch"].text(),
        hole=subject["hole"].text() if "hole" in subject else "",
    )


def hole_of(item: Item, keys: dict[str, Item], scale: float) -> HoleItem:
    """The hole that a `closure` step names, with its `loop`, `reach` and `depth`, or asks for."""
    if "loop" not in keys and {"reach", "depth"} & set(keys):
        raise item.error("reach and depth go with loop: they are chosen when a hole is named")

    def number(name: str) -> float:
        return keys[name].number(above=0.0) * scale if name in keys else 0.0

    loop = _loop(keys["loop"], scale) if "loop" in keys else np.empty((0, 3))
    return HoleItem(loop, number("reach"), number("depth"))


def _loop(item: Item, scale: float) -> NDArray[np.float64]:
    points = points_of(item, scale)
    if len(points) < FEWEST_CORNERS:
        raise item.error(f"must have at least {FEWEST_CORNERS} points, not {len(points)}")
    return points
