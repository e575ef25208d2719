"""The ways to look at the organ: the founding thesis' six views, and the quantities of tissue."""

from __future__ import annotations

from dataclasses import dataclass

from tissue_sim.readings.fields import (
    DISPLACEMENT,
    LARGEST_STRAIN,
    LARGEST_STRESS,
    RISK,
    SMALLEST_STRESS,
    SPRING_STRAIN,
    VON_MISES,
)
from tool_input.table.scalar_scale import DIFFERENCE

SMOOTH, FLAT, WIREFRAME, BOTH, SPRINGS = "smooth", "flat", "wireframe", "both", "springs"


@dataclass(frozen=True)
class View:
    """A way to look at the organ.

    Attributes:
        name: What the person chooses.
        help: What it shows, for the help panel.
        key: Digit that chooses it, as in the thesis; empty: none.
        quantity: What the surface's colours show; empty: its tissue.
        flat: Whether each triangle has a shade of its own.
        lines: Whether only the triangles' edges are drawn.
        edges: Whether they are drawn over the surface.
        springs: Whether the springs are drawn, the surface like a veil.
    """

    name: str
    help: str
    key: str = ""
    quantity: str = ""
    flat: bool = False
    lines: bool = False
    edges: bool = False
    springs: bool = False


_VIEWS = (
    View(SMOOTH, "tissue, shaded smoothly", "1"),
    View(FLAT, "tissue, every triangle in one shade", "2", flat=True),
    View(WIREFRAME, "the edges of the surface's triangles", "3", lines=True),
    View(BOTH, "tissue with the edges on it", "4", flat=True, edges=True),
    View(SPRINGS, "the springs by category, inside too", "5", springs=True),
    View(DIFFERENCE, "distance from the second model (node difference)", "6", quantity=DIFFERENCE),
    View(DISPLACEMENT, "distance from the place at rest", quantity=DISPLACEMENT),
    View(VON_MISES, "what changes the tissue's shape", quantity=VON_MISES),
    View(LARGEST_STRESS, "the strongest pull", quantity=LARGEST_STRESS),
    View(SMALLEST_STRESS, "the strongest push, negative", quantity=SMALLEST_STRESS),
    View(LARGEST_STRAIN, "the largest stretch", quantity=LARGEST_STRAIN),
    View(SPRING_STRAIN, "how much the springs are lengthened or shortened", quantity=SPRING_STRAIN),
    View(RISK, "how near risk regions are to harm, 0 to 1", quantity=RISK),
)

VIEWS: dict[str, View] = {view.name: view for view in _VIEWS}
"""All views by name, in the order they are offered."""

HEARD = frozenset({VON_MISES, LARGEST_STRESS, SMALLEST_STRESS, LARGEST_STRAIN, SPRING_STRAIN, RISK})
"""Quantities that are heard on `tissue/scalar`, when the node `readings` is asked for them."""


def view_named(name: str) -> View:
    """A view by name.

    Raises:
        ValueError: There is none.
    """
    if name not in VIEWS:
        raise ValueError(f"there is no view '{name}'; allowed: {', '.join(VIEWS)}")
    return VIEWS[name]
