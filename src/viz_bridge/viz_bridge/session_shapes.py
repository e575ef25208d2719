"""Shapes of a session that wait until somebody slower needs them."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

Positions = NDArray[np.float32]

MOST = 240
"""Shapes kept; beyond, every other one is given up: four seconds at full rate, then coarser."""


class SessionShapes:
    """Positions of one epoch by frame, a bounded number of them."""

    def __init__(self) -> None:
        """Begin with none."""
        self._epoch = b""
        self._by_frame: OrderedDict[int, Positions] = OrderedDict()

    def __len__(self) -> int:
        return len(self._by_frame)

    def put(self, epoch: bytes, frame: int, positions: Positions) -> None:
        """Keep a shape; one of another epoch ends all that came before."""
        if epoch != self._epoch:
            self._epoch = epoch
            self._by_frame.clear()
        self._by_frame[frame] = positions
        if len(self._by_frame) > MOST:
            for given_up in list(self._by_frame)[1:-1:2]:
                del self._by_frame[given_up]

    def has_come(self, epoch: bytes, frame: int) -> bool:
        """Whether a frame's shape, or a later one, is here."""
        return epoch == self._epoch and next(reversed(self._by_frame), 0) >= frame

    def at(self, epoch: bytes, frame: int) -> Positions | None:
        """Positions [m] in a frame, shape (node_rows, 3); None: not known."""
        return self._by_frame.get(frame) if epoch == self._epoch else None

    def before(self, epoch: bytes, frame: int) -> Positions | None:
        """Positions [m] in the last frame known before one; None: there is none."""
        earlier = [known for known in self._by_frame if known < frame]
        return self.at(epoch, earlier[-1]) if earlier else None

    def forget_before(self, epoch: bytes, frame: int) -> None:
        """Give up what is older than a frame."""
        if epoch == self._epoch:
            for known in [known for known in self._by_frame if known < frame]:
                del self._by_frame[known]
