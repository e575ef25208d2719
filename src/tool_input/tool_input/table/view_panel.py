"""The choice of a view, and what its colours mean."""

from __future__ import annotations

import viser
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from tissue_sim.readings.fields import in_words
from tool_input.table.organ_view import OrganView
from tool_input.table.person import Person
from tool_input.table.range_controls import RangeControls
from tool_input.table.scalar_scale import DIFFERENCE
from tool_input.table.tissue_frame import TissueFrame
from tool_input.table.views import HEARD, VIEWS


class ViewPanel:
    """Chooses how the organ is drawn in one window."""

    def __init__(self, person: Person, gui: viser.GuiApi, organ: OrganView) -> None:
        """Add it to a window.

        Args:
            person: Whose window it is.
            gui: The window's controls.
            organ: What it draws.
        """
        self._person = person
        self._organ = organ
        names = {in_words(view.name): view.name for view in VIEWS.values()}
        choice = gui.add_dropdown("View", tuple(names), initial_value=next(iter(names)))
        self._bar = gui.add_html("", visible=False)
        self._range = RangeControls(person, gui, organ)
        self._missing = gui.add_markdown("", visible=False)
        choice.on_update(person.in_turn(lambda: self._choose(names[choice.value])))
        for shown, name in names.items():
            view = VIEWS[name]
            command = gui.add_command(
                f"view: {shown}", description=view.help, hotkey=view.key or None
            )
            command.on_trigger(person.in_turn(lambda to=shown: setattr(choice, "value", to)))
            command.on_trigger(person.in_turn(lambda to=name: self._choose(to)))

    def show(self, frame: TissueFrame) -> None:
        """Tell what the colours of a frame mean, and what is missing for them."""
        _tell(self._bar, self._organ.bar)
        self._range.show()
        _tell(self._missing, self._why_unknown(frame))

    def _choose(self, name: str) -> None:
        self._organ.choose(name)
        quantity = self._organ.view.quantity
        if quantity in HEARD:
            wanted = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=quantity)
            parameters = [Parameter(name="scalar", value=wanted)]
            self._person.request("set_readings", SetParameters.Request(parameters=parameters))

    def _why_unknown(self, frame: TissueFrame) -> str:
        quantity = self._organ.view.quantity
        if quantity == DIFFERENCE and frame.difference is None:
            return "Nothing is heard on `tissue/difference`: is the node `difference` running?"
        if quantity not in HEARD:
            return ""
        if frame.scalar is None:
            return "Nothing is heard on `tissue/scalar`: is the node `readings` running?"
        if frame.scalar.name != quantity:
            told = in_words(frame.scalar.name)
            return f"Another window asked for {told}: one quantity is told at a time."
        return ""


def _tell(control: viser.GuiHtmlHandle | viser.GuiMarkdownHandle, text: str) -> None:
    if control.content != text:
        control.content = text
        control.visible = bool(text)
