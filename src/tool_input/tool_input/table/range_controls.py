"""The controls that set the range of a view's colours."""

from __future__ import annotations

import viser

from tool_input.table.color_bar import ShownUnit
from tool_input.table.organ_view import OrganView
from tool_input.table.person import Person
from tool_input.table.scalar_scale import Scale
from tool_input.table.scalar_source import unit_of

STEP = 0.001
"""Of the ends of a range, in the unit they are written in."""


class RangeControls:
    """Whether the range follows the values, and if not, where it begins and ends."""

    def __init__(self, person: Person, gui: viser.GuiApi, organ: OrganView) -> None:
        """Add them to a window; they are seen while a quantity is shown.

        Args:
            person: Whose window it is.
            gui: The window's controls.
            organ: What it draws.
        """
        self._organ = organ
        self._fixed = gui.add_checkbox("Fixed range", initial_value=False, visible=False)
        self._low = gui.add_number("From", 0.0, step=STEP, visible=False)
        self._high = gui.add_number("To", 1.0, step=STEP, visible=False)
        self._fixed.on_update(person.in_turn(self._hold))
        self._low.on_update(person.in_turn(self._set))
        self._high.on_update(person.in_turn(self._set))

    def show(self) -> None:
        """Follow the view: another quantity has a range that follows its values."""
        fixed = self._organ.fixed_scale is not None
        if self._fixed.visible != bool(self._organ.view.quantity):
            self._fixed.visible = bool(self._organ.view.quantity)
        if self._low.visible != fixed:
            self._fixed.value = self._low.visible = self._high.visible = fixed

    @property
    def _factor(self) -> float:
        quantity = self._organ.view.quantity
        return ShownUnit.of(quantity, unit_of(quantity)).factor

    def _hold(self) -> None:
        """Begin with the range as it is."""
        scale = self._organ.scale if self._fixed.value else None
        if scale is not None:
            factor = self._factor
            self._low.value, self._high.value = scale.low * factor, scale.high * factor
        self._organ.fixed_scale = scale

    def _set(self) -> None:
        if self._fixed.value:
            factor = self._factor
            self._organ.fixed_scale = Scale(self._low.value / factor, self._high.value / factor)
