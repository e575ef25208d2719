"""Why a request cannot be met."""

from __future__ import annotations

from enum import IntEnum
from typing import Generic, TypeVar

Code = TypeVar("Code", bound=IntEnum)


class RequestError(ValueError, Generic[Code]):
    """A request that cannot be met; nothing was changed.

    Attributes:
        code: Which kind of failure, for programs.
    """

    def __init__(self, code: Code, message: str) -> None:
        super().__init__(message)
        self.code = code


class CutCode(IntEnum):
    """Error codes of a cut; the numbers are those of `tissue_interfaces/srv/Cut`."""

    NONE = 0
    INVALID_SWEEP = 1
    UNKNOWN_FRAME = 2
    UNKNOWN_METHOD = 3
    NO_TISSUE = 4
    MISSED = 5
    STALE = 6
    SIMULATION_LOST = 7
    REFUSED = 8
    STATE_FRAME_GONE = 9
    HELD = 10

    @property
    def nothing_to_cut(self) -> bool:
        """Whether the sweep is sound, but there is nothing that it could open."""
        return self in (CutCode.MISSED, CutCode.HELD)


class CutError(RequestError[CutCode]):
    """A cut that cannot be made, or what any request for an edit can fail for."""

    def code_in(self, codes: type[Code], otherwise: Code) -> Code:
        """The code of the same name among those of another service.

        Args:
            codes: Codes of that service.
            otherwise: The one to use if it has none of this name.
        """
        return codes.__members__.get(self.code.name, otherwise)


class SweepError(CutError):
    """A sweep that is not finite, is degenerate or enormous, or names vertices it does not have."""

    def __init__(self, message: str) -> None:
        super().__init__(CutCode.INVALID_SWEEP, message)
