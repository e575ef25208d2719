"""Controls and a scene of a window that is nowhere, for tests that do what a person does."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest


class FakeControl:
    """One control, or one mark of the scene.

    Attributes:
        label: What the person reads.
        value: What it is set to.
        removed: Whether it is gone.
        options: Of a choice.
        content: Of a text.
        disabled: Whether nobody can set it.
    """

    options: tuple[str, ...]
    content: str
    disabled: bool

    def __init__(self, label: str, value: Any = None, **fields: Any) -> None:
        self.label, self.removed = label, False
        self.visible = True
        self.__dict__.update(fields)
        self._callbacks: list[Callable[[Any], Any]] = []
        self._value = value

    @property
    def value(self) -> Any:
        return self._value

    @value.setter
    def value(self, value: Any) -> None:
        """As viser does, tell who listens if it is another one."""
        if value != self._value:
            self._value = value
            self._tell(None)

    def set(self, value: Any) -> None:
        """A person sets it."""
        self._value = value
        self._tell("window")

    def click(self) -> None:
        """A person presses it, or its key."""
        self._tell("window")

    def on_update(self, callback: Callable[[Any], Any]) -> None:
        self._callbacks.append(callback)

    on_click = on_trigger = on_update

    def remove(self) -> None:
        self.removed = True

    close = remove

    def __enter__(self) -> FakeControl:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def _tell(self, client: str | None) -> None:
        for callback in self._callbacks:
            running = callback(SimpleNamespace(client=client, target=self))
            with pytest.raises(StopIteration):
                running.send(None)  # It waits for nothing; another may be running already.


class FakeGui:
    """Makes controls and remembers them."""

    def __init__(self) -> None:
        self.controls: list[FakeControl] = []

    def __getitem__(self, label: str) -> FakeControl:
        """The newest control of this label that is there."""
        return next(c for c in reversed(self.controls) if c.label == label and not c.removed)

    def _add(self, label: str, value: Any = None, **fields: Any) -> FakeControl:
        control = FakeControl(label, value, **fields)
        self.controls.append(control)
        return control

    def add_slider(
        self, label: str, low: float, high: float, step: float, initial_value: float, **more: Any
    ) -> FakeControl:
        assert low <= initial_value <= high, label
        assert step > 0, label
        return self._add(label, initial_value, min=low, max=high, **more)

    def add_dropdown(
        self, label: str, options: tuple[str, ...], initial_value: str | None = None, **_: Any
    ) -> FakeControl:
        chosen = options[0] if initial_value is None else initial_value
        assert chosen in options, label
        return self._add(label, chosen, options=options)

    def add_button_group(self, label: str, options: tuple[str, ...], **more: Any) -> FakeControl:
        return self._add(label, options[0], options=options, **more)

    def add_checkbox(self, label: str, initial_value: bool, **_: Any) -> FakeControl:
        return self._add(label, initial_value)

    add_text = add_number = add_vector3 = add_checkbox

    def add_button(self, label: str, **_: Any) -> FakeControl:
        return self._add(label)

    add_folder = add_modal = add_button

    def add_markdown(self, content: str, **_: Any) -> FakeControl:
        return self._add("text", content=content)

    def add_command(self, label: str, **more: Any) -> FakeControl:
        return self._add(f"/{label}", **more)


class FakeScene:
    """What is drawn, by name; stands in for viser's scene."""

    def __init__(self) -> None:
        self.nodes: dict[str, FakeControl] = {}

    @property
    def shown(self) -> set[str]:
        """Names of what is drawn now."""
        return {name for name, node in self.nodes.items() if not node.removed}

    def _add(self, name: str, *_: Any, **__: Any) -> FakeControl:
        self.nodes[name] = FakeControl(name)
        return self.nodes[name]

    add_line_segments = add_mesh_simple = add_point_cloud = add_transform_controls = _add
