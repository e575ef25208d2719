"""A patch of held nodes moves as a rigid body between its tool's spring and the tissue."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

FASTMATH = {"contract", "nnan", "ninf", "nsz", "arcp"}


class PatchNumbers(NamedTuple):
    """What pulls at a patch.

    Attributes:
        stiffness, angular_stiffness: Of the spring to the tool [N/m], [N m/rad].
        damping, angular_damping: Of the motion since the anchor, over its time [N/m], [N m/rad].
        force_limit, torque_limit: Of the spring [N], [N m].
    """

    stiffness: float
    angular_stiffness: float
    damping: float
    angular_damping: float
    force_limit: float
    torque_limit: float


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, inline="never")
def turn_between(
    start: NDArray[np.float64], end: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Rotation vector from one pose to another, in the axes of the first [rad], shape (3,)."""
    ax, ay, az, aw = -start[3], -start[4], -start[5], start[6]
    bx, by, bz, bw = end[3], end[4], end[5], end[6]
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    w = aw * bw - ax * bx - ay * by - az * bz
    sine = math.sqrt(x * x + y * y + z * z)
    sign = 1.0 if w >= 0.0 else -1.0
    factor = 2.0 * sign
    if sine > 1e-12:
        factor = 2.0 * sign * math.atan2(sine, sign * w) / sine
    out[0], out[1], out[2] = factor * x, factor * y, factor * z


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, inline="never")
def fill_rotation(pose: NDArray[np.float64], R: NDArray[np.float64]) -> None:
    """Rotation matrix of a pose, shape (3, 3)."""
    x, y, z, w = pose[3], pose[4], pose[5], pose[6]
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, inline="never")
def turn_pose(pose: NDArray[np.float64], turn: NDArray[np.float64]) -> None:
    """Turn a pose by a rotation vector in its own axes, shape (3,). Modifies `pose` in place."""
    angle = math.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    factor = math.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    x, y, z, w = factor * turn[0], factor * turn[1], factor * turn[2], math.cos(0.5 * angle)
    px, py, pz, pw = pose[3], pose[4], pose[5], pose[6]
    qx = pw * x + px * w + py * z - pz * y
    qy = pw * y - px * z + py * w + pz * x
    qz = pw * z + px * y - py * x + pz * w
    qw = pw * w - px * x - py * y - pz * z
    inverse = 1.0 / math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    pose[3], pose[4], pose[5], pose[6] = qx * inverse, qy * inverse, qz * inverse, qw * inverse


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, inline="never")
def solve_positive(A: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    """Solve A x = b by Cholesky's method; A positive definite. Modifies `A`, and `b` to x."""
    n = len(b)
    for j in range(n):
        for i in range(j, n):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = math.sqrt(s) if i == j else s / A[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]
        b[i] /= A[i, i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def local_wrench(
    rows: NDArray[np.int32],
    forces: NDArray[np.float64],
    rest: NDArray[np.float64],
    displacement: NDArray[np.floating],
    pose: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Sum of forces [N] and torques about the pose's origin [N m], in its axes, shape (6,)."""
    f, t = np.zeros(3), np.zeros(3)
    for i in range(len(rows)):
        row = rows[i]
        x = rest[row, 0] + displacement[row, 0] - pose[0]
        y = rest[row, 1] + displacement[row, 1] - pose[1]
        z = rest[row, 2] + displacement[row, 2] - pose[2]
        fx, fy, fz = forces[i, 0], forces[i, 1], forces[i, 2]
        f[0] += fx
        f[1] += fy
        f[2] += fz
        t[0] += y * fz - z * fy
        t[1] += z * fx - x * fz
        t[2] += x * fy - y * fx
    R = np.empty((3, 3))
    fill_rotation(pose, R)
    for k in range(3):
        out[k] = R[0, k] * f[0] + R[1, k] * f[1] + R[2, k] * f[2]
        out[3 + k] = R[0, k] * t[0] + R[1, k] * t[1] + R[2, k] * t[2]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def place_patch(
    rows: NDArray[np.int32],
    local: NDArray[np.float64],
    rest: NDArray[np.float64],
    pose: NDArray[np.float64],
    displacement: NDArray[np.floating],
) -> None:
    """Put nodes where a pose has them. Modifies `displacement` in place."""
    R = np.empty((3, 3))
    fill_rotation(pose, R)
    for i in range(len(rows)):
        row = rows[i]
        a, b, c = local[i, 0], local[i, 1], local[i, 2]
        for k in range(3):
            place = R[k, 0] * a + R[k, 1] * b + R[k, 2] * c + pose[k]
            displacement[row, k] = place - rest[row, k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def move_patch(
    numbers: PatchNumbers,
    wrench: NDArray[np.float64],
    tissue: NDArray[np.float64],
    tool: NDArray[np.float64],
    anchor: NDArray[np.float64],
    size: float,
    pose: NDArray[np.float64],
    q: NDArray[np.float64],
) -> float:
    """One Newton step of a patch. Modifies `pose` and `q` in place.

    With q the patch's pose, t the tool's, a the anchor, f the tissue's force and S its stiffness:

        (K + B + S) dq = K (t - q) - B (q - a) + f,

    in the patch's axes. Beyond the spring's limit K is the limit over the stretch.

    Args:
        numbers: What pulls at it.
        wrench: Force and torque of the tissue, in the patch's axes, shape (6,).
        tissue: Stiffness of the tissue, positive semidefinite [N/m, N/rad, N m/rad], shape (6, 6).
        tool: Pose of the tool, shape (7,).
        anchor: Pose at the beginning of the time step, shape (7,).
        size: Radius of the patch [m].
        pose: Of the patch, shape (7,).
        q: Written: the motion, in the patch's axes before it, shape (6,).

    Returns:
        How far it has moved, turns times `size` [m].
    """
    R, turn, back = np.empty((3, 3)), np.empty(3), np.empty(3)
    fill_rotation(pose, R)
    turn_between(pose, tool, turn)
    turn_between(pose, anchor, back)
    dx, dy, dz = tool[0] - pose[0], tool[1] - pose[1], tool[2] - pose[2]
    ax, ay, az = anchor[0] - pose[0], anchor[1] - pose[1], anchor[2] - pose[2]
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    angle = math.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    stiffness, angular = numbers.stiffness, numbers.angular_stiffness
    if stiffness * distance > numbers.force_limit:
        stiffness = numbers.force_limit / distance
    if angular * angle > numbers.torque_limit:
        angular = numbers.torque_limit / angle
    A = tissue.copy()
    for k in range(3):
        away = R[0, k] * dx + R[1, k] * dy + R[2, k] * dz
        behind = R[0, k] * ax + R[1, k] * ay + R[2, k] * az
        q[k] = wrench[k] + stiffness * away + numbers.damping * behind
        q[3 + k] = wrench[3 + k] + angular * turn[k] + numbers.angular_damping * back[k]
        A[k, k] += stiffness + numbers.damping
        A[3 + k, 3 + k] += angular + numbers.angular_damping
    solve_positive(A, q)
    for k in range(3):
        pose[k] += R[k, 0] * q[0] + R[k, 1] * q[1] + R[k, 2] * q[2]
    turn_pose(pose, q[3:])
    squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
    turned = q[3] * q[3] + q[4] * q[4] + q[5] * q[5]
    return math.sqrt(squared + size * size * turned)
