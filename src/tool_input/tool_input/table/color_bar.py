"""The bar that tells what the colours of a view mean, with numbers and unit, as HTML."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from tissue_sim.readings.fields import in_words
from tool_input.table.scalar_scale import Scale
from tool_input.table.surface_parts import Color

WIDTH, HEIGHT, MARGIN = 300, 16, 16
"""Of the bar, and what is left beside it for its numbers [pixels]."""


@dataclass(frozen=True)
class ShownUnit:
    """How a quantity is written.

    Attributes:
        name: The unit that is written.
        factor: Of it in one SI unit.
    """

    name: str
    factor: float

    @classmethod
    def of(cls, quantity: str, unit: str) -> ShownUnit:
        """What people read best: mm, kPa, and percent for strains.

        Args:
            quantity: Such as "spring_strain".
            unit: SI unit, as in NodeScalar.
        """
        if "strain" in quantity and not unit:
            return cls("%", 100.0)
        return {"m": cls("mm", 1e3), "Pa": cls("kPa", 1e-3)}.get(unit, cls(unit, 1.0))

    def write(self, value: float) -> str:
        """A value in SI units as people read it, without the unit."""
        return f"{value * self.factor:.4g}"


def title(quantity: str, unit: ShownUnit) -> str:
    """What is written over the bar."""
    words = in_words(quantity)
    return f"{words} [{unit.name}]" if unit.name else words


def color_bar(
    quantity: str, unit: str, scale: Scale, colors: Sequence[Color], largest: float | None
) -> str:
    """The bar.

    Args:
        quantity: What is shown, such as "von_mises_stress".
        unit: Its SI unit; empty for a plain number.
        scale: The range.
        colors: Of the bands, that of the lowest values first.
        largest: The largest value there is now; None: nothing is known.

    Returns:
        HTML.
    """
    shown = ShownUnit.of(quantity, unit)
    width = WIDTH / len(colors)
    boxes = "".join(
        f'<rect x="{MARGIN + place * width:.1f}" y="0" width="{width + 0.5:.1f}" '
        f'height="{HEIGHT}" fill="rgb{color}"/>'
        for place, color in enumerate(colors)
    )
    step = (scale.high - scale.low) / 5
    numbers = "".join(
        f'<text x="{MARGIN + part * WIDTH / 5:.1f}" y="{HEIGHT + 14}">'
        f"{shown.write(round(scale.low + part * step, 12))}</text>"
        for part in range(6)
    )
    now = "no values yet"
    if largest is not None:
        # A thousandth of the range is as much as can be seen.
        places = 3 - math.floor(math.log10(scale.high - scale.low))
        now = f"largest now {shown.write(round(largest, places))} {shown.name}"
    return (
        '<div style="padding:0 1em 0 0.75em;font-size:0.85em">'
        f"<b>{escape(title(quantity, shown))}</b>"
        f'<span style="float:right;opacity:0.75">{escape(now)}</span>'
        f'<svg viewBox="0 0 {WIDTH + 2 * MARGIN} {HEIGHT + 18}" width="100%" '
        'style="display:block;margin-top:0.3em" font-size="11" fill="currentColor" '
        f'text-anchor="middle">{boxes}{numbers}</svg></div>'
    )


def legend(entries: Sequence[tuple[str, Color]]) -> str:
    """What single colours mean, as HTML.

    Args:
        entries: A text for each colour.
    """
    lines = "".join(
        f'<div><span style="display:inline-block;width:1.6em;height:0.25em;margin-right:0.6em;'
        f'vertical-align:middle;background:rgb{color}"></span>{escape(text)}</div>'
        for text, color in entries
    )
    return f'<div style="padding:0 1em 0 0.75em;font-size:0.85em">{lines}</div>'
