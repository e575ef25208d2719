"""Warnings that begin and end once, however what they are about flickers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

NEAR, TOUCHED, CUT, STRESS = "near", "touched", "cut", "stress"


@dataclass(frozen=True, order=True)
class Cause:
    """What a warning is about.

    Attributes:
        region: Name of the risk region.
        what: NEAR, TOUCHED, CUT or STRESS.
        tool: Id of the tool; empty: none.
    """

    region: str
    what: str
    tool: str = ""


@dataclass(frozen=True)
class RiskWarning:
    """A warning.

    Attributes:
        cause: What it is about.
        value: Distance [m] for NEAR, stress [Pa] for STRESS, otherwise a number of nodes.
        begins: False: it is over.
    """

    cause: Cause
    value: float
    begins: bool = True


@dataclass(frozen=True)
class Finding:
    """What was found in one frame.

    Attributes:
        value: As in `RiskWarning`.
        beyond: Whether the limit itself is passed, so that a warning begins; otherwise only the
            wider limit is, within which one that is on goes on.
    """

    value: float
    beyond: bool = True


class Warnings:
    """The warnings that are on.

    One begins when something passes its limit. It ends when that has stayed clear of the wider
    limit for some time.
    """

    def __init__(self, lasting: float) -> None:
        """Begin with none.

        Args:
            lasting: Time that a warning lasts after what it is about [s].
        """
        self._lasting = lasting
        self._on: dict[Cause, tuple[float, float]] = {}

    def clear(self) -> None:
        """Forget all."""
        self._on.clear()

    def take(self, found: Mapping[Cause, Finding], time: float) -> list[RiskWarning]:
        """Take what was found at a time [s]; the warnings that are on, and those just over."""
        for cause, finding in found.items():
            if finding.beyond or cause in self._on:
                self._on[cause] = (finding.value, time)
        told = []
        for cause, (value, seen) in sorted(self._on.items()):
            over = time - seen > self._lasting
            if over:
                del self._on[cause]
            told.append(RiskWarning(cause, value, begins=not over))
        return told
