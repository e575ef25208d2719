"""What a window tells in words: the simulation, its readings, warnings and holes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import viser
from tissue_interfaces.msg import Hole, Reading, RiskWarning, Status

from tissue_sim.readings.fields import in_words
from tool_input.table.desk import Desk

STATES = {
    Status.LOADING: "loading", Status.READY: "running", Status.PAUSED: "paused",
    Status.FAILED: "failed",
}  # fmt: skip
PERIOD = 0.25
"""A text changes at most once in so long [s]."""

_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"))


class Readout:
    """The text of one window."""

    def __init__(
        self, desk: Desk, gui: viser.GuiApi, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Add it to a window.

        Args:
            desk: What is heard.
            gui: The window's controls.
            clock: Seconds.
        """
        self._desk = desk
        self._clock = clock
        self._text = gui.add_markdown("Waiting for the simulation ...")
        self._next = 0.0

    def update(self) -> None:
        """Tell what has been heard since."""
        now = self._clock()
        if now < self._next:
            return
        self._next = now + PERIOD
        text = told(self._desk.status, self._desk.readings, self._desk.holes)
        if text != self._text.content:
            self._text.content = text


def told(status: Any, readings: Any, holes: Any) -> str:
    """What is heard, in Markdown.

    Args:
        status: `Status`, or None.
        readings: `Readings`, or None.
        holes: `Holes`, or None.
    """
    if status is None:
        return "Waiting for the simulation ..."
    lines = [f"**{status.organ}**, {status.model}, {STATES.get(status.state, '?')}"]
    if status.request:
        lines.append(f"{status.request}: {status.progress:.0%}")
    if status.message:
        lines.append(status.message)
    if readings is not None:
        lines += [_warning(warning) for warning in readings.warnings if warning.begins]
        lines += [_reading(reading) for reading in readings.readings]
    if holes is not None:
        lines += [_hole(hole) for hole in holes.holes]
    return "  \n".join(lines)


def quantity(value: float, unit: str) -> str:
    """A value with three digits and a prefix, such as "12.3 kPa"; no mPa, which reads as MPa."""
    if not unit:
        return f"{value:.3g}"
    if unit == "%":
        return f"{100.0 * value:.1f} %"
    size = abs(value)
    known = _PREFIXES[:4] if unit == "Pa" else _PREFIXES
    scale, prefix = next((one for one in known if size >= one[0]), known[-1])
    if size == 0.0:
        scale, prefix = 1.0, ""
    return f"{value / scale:.3g} {prefix}{unit}"


def _warning(warning: RiskWarning) -> str:
    by = f" ({warning.tool})" if warning.tool else ""
    return {
        RiskWarning.NEAR: f"⚠ **{warning.region}**: {quantity(warning.value, 'm')} away{by}",
        RiskWarning.TOUCHED: f"⚠ **{warning.region}** is touched{by}",
        RiskWarning.CUT: f"⚠ **{warning.region}** is cut{by}",
        RiskWarning.STRESS: f"⚠ **{warning.region}**: stress {quantity(warning.value, 'Pa')}",
    }.get(warning.what, f"⚠ **{warning.region}**: {warning.what}{by}")


def _reading(reading: Reading) -> str:
    name = in_words(reading.name)
    unit = "%" if "strain" in reading.name and not reading.unit else reading.unit
    peak, highest = (quantity(value, unit) for value in (reading.peak, reading.highest))
    return f"{name}: {peak}, max {highest}"


def _hole(hole: Hole) -> str:
    if hole.problem:
        return f"{hole.name}: {hole.problem}"
    return f"{hole.name}: {hole.covered:.0%} closed, gap {quantity(hole.gap, 'm')}"
