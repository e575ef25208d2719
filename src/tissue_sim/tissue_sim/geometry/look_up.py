"""Loops that look up the ids of an edit, quick enough for use in a frame."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def living_rows(
    ids: NDArray[np.integer], rows: int, alive: NDArray[np.bool_], out: NDArray[np.int32]
) -> None:
    """Write the row of each id, which is its number; -1 where nothing alive has it.

    Args:
        ids: Ids, shape (n,).
        rows: Rows in use.
        alive: Which of them are alive.
        out: Result, shape (n,).
    """
    for k in range(len(ids)):
        row = np.int64(ids[k])
        out[k] = row if 0 <= row < rows and alive[row] else -1


@njit(cache=True, nogil=True)
def any_changed(rows: NDArray[np.int32], versions: NDArray[np.int64], base: int) -> bool:
    """Whether any of the rows is -1 or was changed after version `base`."""
    changed = False
    for row in rows:
        changed = changed or row < 0 or versions[row] > base
    return changed
