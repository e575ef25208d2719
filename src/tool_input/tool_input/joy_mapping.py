"""Which axis and button of a device means what."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MOTIONS = ("x", "y", "z", "turn about x", "turn about y", "turn about z")
USE, NEXT_TOOL, CLUTCH, SLOW, HOME = "use", "next_tool", "clutch", "slow", "home"
BUTTONS = (USE, NEXT_TOOL, CLUTCH, SLOW, HOME)
NO_BUTTON = -1


class InputError(ValueError):
    """A message of a device that cannot be used."""


@dataclass(frozen=True)
class AxisChoice:
    """The axis of a device that drives one of six motions.

    Attributes:
        index: Which axis.
        sign: 1, or -1 for the opposite direction.
    """

    index: int
    sign: float


@dataclass(frozen=True)
class JoyReading:
    """What one message of a device says.

    Attributes:
        deflection: Of the six motions, from -1 to 1, shape (6,).
        pressed: The buttons that are down, by their meaning.
    """

    deflection: NDArray[np.float64]
    pressed: frozenset[str]


@dataclass(frozen=True)
class JoyMapping:
    """Reads the axes and buttons of `sensor_msgs/Joy`.

    Attributes:
        axes: For each of the six motions its axis; None: no axis drives it.
        buttons: Index of each button by its meaning.
    """

    axes: tuple[AxisChoice | None, ...]
    buttons: Mapping[str, int]

    @classmethod
    def parsed(cls, axes: Sequence[str], buttons: Mapping[str, int]) -> JoyMapping:
        """A mapping as parameters give it.

        Args:
            axes: For each of the six motions an axis with a sign, such as "+0" or "-3"; "" for
                none.
            buttons: Index of each button by its meaning; -1: no such button.

        Raises:
            ValueError: An axis cannot be read, or two meanings share a button.
        """
        chosen = []
        for motion, text in zip(MOTIONS, axes, strict=True):
            if text and not re.fullmatch(r"[+-]?\d{1,3}", text):
                raise ValueError(
                    f"axis {text!r} for {motion} is not allowed; allowed: a sign and the number "
                    'of an axis, such as "+0" or "-3", or "" for none'
                )
            sign = -1.0 if text.startswith("-") else 1.0
            chosen.append(AxisChoice(int(text.lstrip("+-")), sign) if text else None)
        used = {meaning: index for meaning, index in buttons.items() if index != NO_BUTTON}
        for meaning, index in used.items():
            same = [other for other, number in used.items() if number == index]
            if len(same) > 1:
                raise ValueError(f"button {index} means {' and '.join(same)}; allowed: one meaning")
            if index < 0:
                raise ValueError(
                    f"{meaning}_button = {index} is not allowed; allowed: 0 and more, -1 for none"
                )
        return cls(tuple(chosen), used)

    def read(self, axes: Sequence[float], buttons: Sequence[int]) -> JoyReading:
        """Read a message.

        Raises:
            InputError: It has fewer axes or buttons than are mapped, or a value is not finite.
        """
        values = np.asarray(axes, dtype=np.float64)
        needed = 1 + max((axis.index for axis in self.axes if axis is not None), default=-1)
        if len(values) < needed:
            raise InputError(f"{len(values)} axes where at least {needed} are mapped")
        needed = 1 + max(self.buttons.values(), default=-1)
        if len(buttons) < needed:
            raise InputError(f"{len(buttons)} buttons where at least {needed} are mapped")
        deflection = np.array(
            [0.0 if axis is None else axis.sign * values[axis.index] for axis in self.axes]
        )
        pressed = frozenset(name for name, index in self.buttons.items() if buttons[index])
        return JoyReading(checked_deflection(deflection), pressed)


def checked_deflection(deflection: NDArray[np.float64]) -> NDArray[np.float64]:
    """Deflections or a twist, shape (6,), if all are finite.

    Raises:
        InputError: One is not.
    """
    bad = [name for name, value in zip(MOTIONS, deflection, strict=True) if not np.isfinite(value)]
    if bad:
        raise InputError(f"{', '.join(bad)} not finite")
    return deflection
