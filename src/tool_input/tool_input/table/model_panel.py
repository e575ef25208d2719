"""The elastic model and its parameters, changed while the simulation runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser
from tissue_interfaces.srv import SetModel

from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Parameter
from tool_input.table.person import Person

STEPS = 200
"""Of a slider."""

COARSEST = 0.02
"""A parameter whose default is a smaller share of its range has a field in place of a slider."""

_WIDEST = 100.0
"""Neither has one a slider whose range is larger."""


class ModelPanel:
    """A choice of models, and sliders for the parameters of the one chosen.

    Only parameters that the person has changed are asked for: of the others the simulation keeps
    what the scene says, which may differ from the defaults shown.
    """

    def __init__(self, person: Person, gui: viser.GuiApi) -> None:
        """Add it to a window.

        Args:
            person: Whose window it is.
            gui: The window's controls.
        """
        self._person = person
        self._gui = gui
        self._folder = gui.add_folder("Model", expand_by_default=False)
        with self._folder:
            self._choice = gui.add_dropdown("Model", tuple(registry.names()))
            self._apply = gui.add_button("Apply", hint="Change to this model and these parameters")
        self._controls: list[Any] = []
        self._changed: dict[str, Callable[[], float]] = {}
        self._heard = ""
        self._choice.on_update(person.in_turn(self._show_parameters))
        self._apply.on_click(person.in_turn(self._ask))
        self._show_parameters()

    def update(self) -> None:
        """Show the model that runs, whoever has chosen it."""
        status = self._person.desk.status
        if status is not None and status.model != self._heard:
            self._heard = status.model
            if self._heard in registry.MODELS:
                self._choice.value = self._heard

    def _show_parameters(self) -> None:
        for control in self._controls:
            control.remove()
        self._controls.clear()
        self._changed.clear()
        with self._folder:
            for parameter in registry.parameters_of(self._choice.value):
                self._add(parameter)

    def _add(self, parameter: Parameter) -> None:
        control, value = parameter_control(self._gui, parameter)
        self._controls.append(control)

        def change() -> None:
            self._changed[parameter.name] = value

        control.on_update(self._person.in_turn(change))

    def _ask(self) -> None:
        values = {name: value() for name, value in self._changed.items()}
        model = self._choice.value
        registry.checked_parameters(model, values)
        request = SetModel.Request(
            model=model, parameter_names=list(values), parameter_values=list(values.values())
        )
        self._person.request("set_model", request, lambda answer: self._told(model, answer))

    def _told(self, model: str, answer: SetModel.Response) -> None:
        self._person.tell(answer.message or f"The model is {model} now.")


def slides(parameter: Parameter) -> bool:
    """Whether a slider can set a parameter: its default is no tiny share of its range."""
    extent = parameter.maximum - parameter.minimum
    if extent > _WIDEST:
        return False
    return parameter.default == parameter.minimum or abs(parameter.default) >= COARSEST * extent


def parameter_control(gui: viser.GuiApi, parameter: Parameter) -> tuple[Any, Callable[[], float]]:
    """Add what sets a parameter: a checkbox, a slider, or a field for numbers of any size.

    Returns:
        The control, and what gives its value; that raises ValueError for what is no number.
    """
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    label = parameter.name.replace("_", " ") + unit
    hint = (
        f"{parameter.meaning}; {parameter.minimum:g} to {parameter.maximum:g}"
        f"{' ' + parameter.unit if parameter.unit else ''}, by default {parameter.default:g}"
    )
    low, high, default = parameter.minimum, parameter.maximum, parameter.default
    if parameter.integer and (low, high) == (0, 1):
        box = gui.add_checkbox(label, bool(default), hint=hint)
        return box, lambda: float(box.value)
    if slides(parameter) or (parameter.integer and high - low <= _WIDEST):
        if parameter.integer:
            slider = gui.add_slider(label, int(low), int(high), 1, int(default), hint=hint)
        else:
            slider = gui.add_slider(label, low, high, (high - low) / STEPS, default, hint=hint)
        return slider, lambda: float(slider.value)
    field = gui.add_text(label, f"{default:g}", hint=hint)

    def number() -> float:
        try:
            return float(field.value)
        except ValueError:
            raise ValueError(
                f"{parameter.name} = {field.value!r} is no number; allowed: {low:g} to {high:g}"
            ) from None

    return field, number
