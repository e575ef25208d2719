"""Loops of ChainMail on a regular grid: breadth-first over six neighbours, nothing stored by link.

Voxels are numbered (x ny + y) nz + z. A link along axis a allows each component c of w = u_j - u_i
to be `box[a, c, 0]` below zero and `box[a, c, 1]` above it, j being the end farther along a. Bounds
L and U and where they put a voxel are those of `kernels.chain_bounds`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

BELOW, ABOVE = 0, 1


class Grid(NamedTuple):
    """A grid of voxels and what its links allow.

    Attributes:
        size: Voxels along each axis, shape (3,), int64.
        box: Limits of links [m], shape (3, 3, 2).
        filled: Whether there is a voxel, shape (n,).
        prescribed: Voxels that do not move, shape (n,).
    """

    size: NDArray[np.int64]
    box: NDArray[np.floating]
    filled: NDArray[np.bool_]
    prescribed: NDArray[np.bool_]


class Wave(NamedTuple):
    """What a propagation writes on; clean between two of them.

    Attributes:
        reach: L and -U [m], -inf where there is none, shape (2, n, 3).
        touched: Voxels with bounds, shape (n,).
        is_touched: Whether a voxel has bounds, shape (n,).
        queue: Voxels waiting for their visit, a ring, shape (n,).
        queued: Whether a voxel waits, shape (n,).
    """

    reach: NDArray[np.floating]
    touched: NDArray[np.int64]
    is_touched: NDArray[np.bool_]
    queue: NDArray[np.int64]
    queued: NDArray[np.bool_]


@njit(inline="always")
def _neighbour(size, i, link):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
    """Neighbour of voxel i along axis link // 2, farther if `link` is odd; -1 for none."""
    z, y, x = i % size[2], (i // size[2]) % size[1], i // (size[1] * size[2])
    axis, step = link // 2, 2 * (link % 2) - 1
    at = x if axis == 0 else (y if axis == 1 else z)
    if not 0 <= at + step < size[axis]:
        return -1
    stride = size[1] * size[2] if axis == 0 else (size[2] if axis == 1 else 1)
    return i + step * stride


@njit(cache=True, nogil=True, error_model="numpy")
def spread(
    sources: NDArray[np.int64],
    everywhere: bool,
    grid: Grid,
    u: NDArray[np.floating],
    wave: Wave,
) -> tuple[int, int, bool]:
    """Bound voxels by the sources, breadth-first. Modifies `wave` in place.

    Args:
        sources: Voxels that bound the others by where they are.
        everywhere: Bounds matter everywhere, not only where a voxel is beyond them.
        grid: The grid.
        u: Displacements [m], shape (n, 3).
        wave: To write on.

    Returns:
        Voxels touched, visits, and whether bounds cross each other or a voxel that does not move.
    """
    size, box, filled, prescribed = grid
    reach, touched, is_touched, queue, queued = wave
    count = first = waiting = visits = 0
    crossed = False
    for i in sources:
        if is_touched[i] or not filled[i]:
            continue
        for c in range(3):
            reach[BELOW, i, c], reach[ABOVE, i, c] = u[i, c], -u[i, c]
        is_touched[i] = queued[i] = True
        touched[count] = queue[waiting] = i
        count += 1
        waiting += 1
    while waiting > 0:
        i = queue[first]
        first = (first + 1) % len(queue)
        waiting -= 1
        queued[i] = False
        visits += 1
        for link in range(6):
            j = _neighbour(size, i, link)
            if j < 0 or not filled[j]:
                continue
            changed = False
            for c in range(3):
                for side in range(2):
                    sign = 1 - 2 * side
                    # Along a link the bound from below falls by what w may be below zero.
                    pushed = reach[side, i, c] - box[link // 2, c, (side + link + 1) % 2]
                    if not pushed > reach[side, j, c]:
                        continue
                    if not (everywhere or pushed > sign * u[j, c]):
                        continue
                    if prescribed[j]:
                        crossed = True
                        continue
                    reach[side, j, c] = pushed
                    crossed |= reach[BELOW, j, c] > -reach[ABOVE, j, c]
                    changed = True
            if not changed:
                continue
            if not is_touched[j]:
                is_touched[j] = True
                touched[count] = j
                count += 1
            if not queued[j]:
                queued[j] = True
                queue[(first + waiting) % len(queue)] = j
                waiting += 1
    return count, visits, crossed


@njit(cache=True, nogil=True, error_model="numpy")
def settle(count: int, apply: bool, grid: Grid, u: NDArray[np.floating], wave: Wave) -> int:
    """Put the touched voxels within their bounds, if asked to, and clean up.

    Modifies `u` and `wave` in place.

    Returns:
        Voxels that moved.
    """
    reach, touched, is_touched, _, _ = wave
    prescribed = grid.prescribed
    half = u.dtype.type(0.5)
    moved = 0
    for place in range(count):
        i = touched[place]
        is_touched[i] = False
        moves = False
        for c in range(3):
            low, high = reach[BELOW, i, c], -reach[ABOVE, i, c]
            reach[BELOW, i, c] = reach[ABOVE, i, c] = -np.inf
            goal = low + (high - low) * half if low > high else min(max(u[i, c], low), high)
            if apply and not prescribed[i] and goal != u[i, c]:
                u[i, c] = goal
                moves = True
        moved += moves
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def average(rate: np.floating, grid: Grid, u: NDArray[np.floating]) -> np.floating:
    """One Gauss-Seidel sweep towards the mean of the neighbours, within the limits.

    Modifies `u` in place.

    Returns:
        Largest move along an axis [m].
    """
    size, box, filled, prescribed = grid
    zero = rate - rate
    largest = zero
    for i in range(len(u)):
        if prescribed[i] or not filled[i]:
            continue
        for c in range(3):
            total, neighbours = zero, 0
            low, high = -zero - np.inf, zero + np.inf
            for link in range(6):
                j = _neighbour(size, i, link)
                if j < 0 or not filled[j]:
                    continue
                w = u[j, c] - u[i, c]
                below = box[link // 2, c, (link + 1) % 2]
                above = box[link // 2, c, link % 2]
                total += w
                neighbours += 1
                low = max(low, min(w - above, zero))
                high = min(high, max(w + below, zero))
            if neighbours > 0:
                move = min(max(rate * total / neighbours, low), high)
                u[i, c] += move
                largest = max(largest, abs(move))
    return largest
