"""Which of the frames of tissue/state a bag keeps."""

from __future__ import annotations

import struct
from dataclasses import dataclass


@dataclass(frozen=True)
class StateHead:
    """The beginning of a TissueState, read without touching its positions.

    Attributes:
        stamp: Time at the start of the frame [ns since 1970].
        epoch: 16 bytes.
        version: Of the topology.
        frame: Number within the epoch.
    """

    stamp: int
    epoch: bytes
    version: int
    frame: int


def state_head(data: bytes) -> StateHead:
    """Read the beginning of a TissueState in CDR.

    Raises:
        ValueError: The bytes are too short.
    """
    order = "<" if data[1:2] == b"\x01" else ">"
    try:
        seconds, nanoseconds, length = struct.unpack_from(order + "iII", data, 4)
        at = 4 + _aligned(12 + length, 8) + 8  # behind the frame's name and sim_time
        epoch = data[at : at + 16]
        (version,) = struct.unpack_from(order + "I", data, at + 16)
        (frame,) = struct.unpack_from(order + "Q", data, 4 + _aligned(at + 20 - 4, 8))
    except struct.error as error:
        raise ValueError(f"not a TissueState: {error}") from None
    return StateHead(seconds * 10**9 + nanoseconds, bytes(epoch), version, frame)


def _aligned(offset: int, size: int) -> int:
    return offset + -offset % size


class StateThinning:
    """Keeps states evenly spaced in time, and the first of each version: every cut is seen.

    Attributes:
        hz: States kept a second; 0 or at least 60: all.
    """

    def __init__(self, hz: float) -> None:
        self.hz = hz
        self._due = 0.0
        self._version: tuple[bytes, int] | None = None

    def keeps(self, data: bytes) -> bool:
        """Whether this state, the next in time, goes into the bag."""
        if self.hz <= 0 or self.hz >= 60:
            return True
        head = state_head(data)
        period = 1e9 / self.hz
        changed = self._version != (head.epoch, head.version)
        if changed:
            self._version = (head.epoch, head.version)
        # Half a period of tolerance: jitter of the frames must not halve the rate.
        if head.stamp < self._due - period / 2 and not changed:
            return False
        self._due += period
        if abs(head.stamp - self._due) > 2 * period:
            self._due = head.stamp + period
        return True
