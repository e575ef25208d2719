"""Rigid motions as poses: x y z [m] and a unit quaternion x y z w, shape (7,), float64."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
IDENTITY.flags.writeable = False

FARTHEST = 1e4
"""A tool farther away than this [m] is a mistake; float32 would not resolve a millimetre there."""

NORM_TOLERANCE = 1e-2
"""How far from 1 a quaternion's norm may be; senders that work in float32 are well inside."""


class PoseError(ValueError):
    """A pose that cannot be used."""


def checked_pose(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose with its quaternion normalised.

    Args:
        values: x y z [m] and quaternion x y z w, shape (7,).

    Raises:
        PoseError: A number is not finite, the place is absurd or the quaternion is not of unit
            length.
    """
    pose = np.array(values, dtype=np.float64)
    if not np.isfinite(pose).all():
        raise PoseError(f"the pose is not finite: {pose.tolist()}")
    if np.abs(pose[:3]).max() > FARTHEST:
        raise PoseError(f"the position {pose[:3].tolist()} m is farther away than {FARTHEST:g} m")
    norm = float(np.linalg.norm(pose[3:]))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise PoseError(
            f"the orientation {pose[3:].tolist()} (x y z w) has length {norm:.6g}; "
            f"allowed: 1 within {NORM_TOLERANCE:g}"
        )
    pose[3:] /= norm
    return pose


def multiply(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternion product p q (first q, then p), x y z w, shape (4,)."""
    px, py, pz, pw = p.tolist()
    qx, qy, qz, qw = q.tolist()
    return np.array(
        [
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
            pw * qw - px * qx - py * qy - pz * qz,
        ]
    )


def conjugate(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of a unit quaternion, shape (4,)."""
    return q * np.array([-1.0, -1.0, -1.0, 1.0])


def matrix(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrix of a unit quaternion, shape (3, 3)."""
    x, y, z, w = q.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def from_matrix(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternion of a rotation matrix, shape (4,).

    The largest component is computed first (Shepperd's method).
    """
    m = rotation
    trace = float(np.trace(m))
    squares = np.array([2 * m[0, 0] - trace, 2 * m[1, 1] - trace, 2 * m[2, 2] - trace, trace]) + 1
    largest = int(np.argmax(squares))
    if largest == 3:
        q = [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], squares[3]]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = [0.0, 0.0, 0.0, m[k, j] - m[j, k]]
        q[i], q[j], q[k] = squares[i], m[j, i] + m[i, j], m[k, i] + m[i, k]
    quaternion = np.array(q, dtype=np.float64)
    return quaternion / np.linalg.norm(quaternion)


def rotation_vector(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Axis times angle [rad] of a unit quaternion, by the shorter way round, shape (3,)."""
    sine = math.sqrt(q[:3].dot(q[:3]))
    if sine < 1e-12:
        vector: NDArray[np.float64] = 2.0 * q[:3] * (1.0 if q[3] >= 0.0 else -1.0)
        return vector
    cosine = float(q[3])
    angle = 2.0 * (math.atan2(sine, cosine) if cosine >= 0.0 else -math.atan2(sine, -cosine))
    return q[:3] * (angle / sine)


def motion(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """From one pose to another: way [m] and rotation vector [rad], in outer axes, shape (6,)."""
    turn = rotation_vector(multiply(end[3:], conjugate(start[3:])))
    return np.concatenate([end[:3] - start[:3], turn])


def compose(outer: NDArray[np.float64], inner: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose that first applies `inner`, then `outer`, shape (7,)."""
    position = matrix(outer[3:]) @ inner[:3] + outer[:3]
    return np.concatenate([position, multiply(outer[3:], inner[3:])])


def inverse(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose that undoes `pose`, shape (7,)."""
    turned_back = conjugate(pose[3:])
    return np.concatenate([-(matrix(turned_back) @ pose[:3]), turned_back])


def to_world(pose: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points given in the pose's own axes, in the axes the pose is given in, shape (n, 3)."""
    return points @ matrix(pose[3:]).T + pose[:3]


def to_local(pose: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points in the pose's own axes, shape (n, 3); undoes `to_world`."""
    return (points - pose[:3]) @ matrix(pose[3:])
