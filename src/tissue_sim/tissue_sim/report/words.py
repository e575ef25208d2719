"""Figures as people read them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tissue_sim.report.session import Session
from tissue_sim.report.summary import Figure

SHOWN = {
    "m": (1e3, "mm"), "m/s": (1e3, "mm/s"), "m^2": (1e6, "mm²"), "m^3": (1e6, "cm³"),
    "Pa": (1e-3, "kPa"), "Pa s": (1e-3, "kPa s"),
}  # fmt: skip
"""Factor and unit that a unit is shown in; the others as they are."""
LEAST = 0.001
"""Smaller values are only said to be smaller."""
NONE = "–"
"""Shown where there is no figure."""


def number(value: float) -> str:
    """About three significant digits, never in powers of ten; `NONE` where there is none."""
    if 0.0 < abs(value) < LEAST:
        return f"<{LEAST:g}"
    if not math.isfinite(value):
        return NONE
    if value == 0.0 or (float(value).is_integer() and abs(value) < 1e6):
        return f"{value:,.0f}"
    size = math.floor(math.log10(abs(value)))
    return f"{value:,.{min(max(2 - size, 0), 6)}f}"


def shown(value: float, unit: str) -> str:
    """A value in the unit it is shown in."""
    return number(value * SHOWN.get(unit, (1.0, unit))[0])


def with_unit(label: str, unit: str) -> str:
    """A label with the unit its values are shown in."""
    name = SHOWN.get(unit, (1.0, unit))[1]
    return f"{label} [{name}]" if name else label


def cell(figure: Figure) -> str:
    """A figure, or why there is none."""
    return shown(figure.value, figure.unit) if not figure.why else figure.why


def grouped(
    figures: Sequence[Sequence[Figure]],
) -> dict[str, list[tuple[str, list[Figure | None]]]]:
    """Figures of several sessions side by side: by group, rows of key and one figure each."""
    groups: dict[str, dict[str, None]] = {}
    for of in figures:
        for figure in of:
            groups.setdefault(figure.group, {})[figure.key] = None
    by_key = [{figure.key: figure for figure in of} for of in figures]
    return {
        group: [(key, [of.get(key) for of in by_key]) for key in keys]
        for group, keys in groups.items()
    }


def same_organ(sessions: Sequence[Session]) -> list[list[int]]:
    """Places of the sessions on each organ; one whose organ is not known is by itself."""
    groups: dict[str, list[int]] = {}
    for place, session in enumerate(sessions):
        groups.setdefault(session.digest or f"unknown {place}", []).append(place)
    return list(groups.values())
