"""Parameters of nodes: what each is called, what it may be, and what it means."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

Kind = Literal["bool", "integer", "double", "string", "doubles", "strings"]

_WORDS: dict[Kind, str] = {
    "bool": "true or false",
    "integer": "a whole number",
    "double": "a number",
    "string": "a text",
    "doubles": "a list of numbers",
    "strings": "a list of texts",
}


class ParameterError(ValueError):
    """A parameter that is unknown or has a value that is not allowed."""


@dataclass(frozen=True)
class Spec:
    """One parameter of a node.

    Attributes:
        name: Full name, such as "tool.grasper.size".
        kind: Type of the value.
        default: Value when none is given.
        description: One sentence for people.
        unit: SI unit; "" for none.
        minimum: Smallest value allowed, of each item of a list; None for no limit.
        maximum: Largest value allowed; None for no limit.
        choices: Texts allowed; empty for any.
        length: Number of items of a list; 0 for any.
        live: Whether it may change while the node runs.
    """

    name: str
    kind: Kind
    default: Any
    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    length: int = 0
    live: bool = False

    @property
    def allowed(self) -> str:
        """What is allowed, in words."""
        words = _WORDS[self.kind]
        if self.length:
            words += f" ({self.length} items)"
        if self.choices:
            words += f" among {', '.join(self.choices)}"
        unit = f" {self.unit}" if self.unit else ""
        if self.minimum is not None and self.maximum is not None:
            words += f" from {self.minimum:g} to {self.maximum:g}{unit}"
        elif self.minimum is not None:
            words += f" of at least {self.minimum:g}{unit}"
        elif self.maximum is not None:
            words += f" of at most {self.maximum:g}{unit}"
        return words

    def checked(self, value: Any) -> Any:
        """The value in the type of this parameter, if it is allowed.

        Raises:
            ParameterError: It is not; the message names the limits.
        """
        try:
            return self._converted(value)
        except (TypeError, ValueError, OverflowError):
            raise ParameterError(
                f"parameter {self.name} = {value!r} is not allowed; allowed: {self.allowed}"
            ) from None

    def _converted(self, value: Any) -> Any:
        if self.kind == "doubles":
            return self._counted([self._number(item) for item in _items(value)])
        if self.kind == "strings":
            return self._counted([self._text(item) for item in _items(value)])
        if self.kind == "bool":
            if not isinstance(value, bool):
                raise TypeError
            return value
        if self.kind == "string":
            return self._text(value)
        number = self._number(value)
        if self.kind == "integer":
            if number != int(number):
                raise ValueError
            return int(number)
        return number

    def _counted(self, items: list[Any]) -> list[Any]:
        if self.length and len(items) != self.length:
            raise ValueError
        return items

    def _text(self, value: Any) -> str:
        if not isinstance(value, str):
            raise TypeError
        if self.choices and value not in self.choices:
            raise ValueError
        return value

    def _number(self, value: Any) -> float:
        if isinstance(value, (bool, str)):
            raise TypeError
        number = float(value)
        below = self.minimum is not None and number < self.minimum
        above = self.maximum is not None and number > self.maximum
        if not math.isfinite(number) or below or above:
            raise ValueError
        return number


def _items(value: Any) -> list[Any]:
    if isinstance(value, str):
        raise TypeError
    return list(value)


def refuse_unknown(given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse parameters that nobody declared.

    Raises:
        ParameterError: Naming each unknown parameter, and the known one it may be meant to be.
    """
    names = sorted(set(known))
    unknown = sorted(set(given) - set(names))
    if not unknown:
        return
    lines = []
    for name in unknown:
        close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
        hint = f" (did you mean {close[0]}?)" if close else ""
        lines.append(f"unknown parameter {name}{hint}")
    plain = [name for name in names if name.count(".") == 0]
    raise ParameterError("; ".join(lines) + f". Known: {', '.join(plain or names)}")
