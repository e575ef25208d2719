"""How much memory a run of steps takes on the way."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable


def least_peak(run: Callable[[], object], repeats: int = 4) -> int:
    """Most memory in use at once during ``run``, least of some repeats [bytes].

    An array per step would show in every repeat. Python itself needs up to 20 kB for its calls:
    compare with an array that is clearly larger.
    """
    return min(_peak(run) for _ in range(repeats))


def _peak(run: Callable[[], object]) -> int:
    gc.collect()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        run()
        return tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
