"""How far two trajectories are apart.

The thesis' figure is the mean over nodes of |x_target - x_reference|, averaged over the frames
(THESIS.md, section 6); beside it stand the largest distances, where they are, and what happens to
the volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.organ import Organ
from tissue_sim.compare.trajectory import Trajectory, TrajectoryError
from tissue_sim.geometry.quality import total_volume
from tissue_sim.kernels import distances


@dataclass(frozen=True)
class Difference:
    """A target's distance from a reference.

    Attributes:
        frame_mean: Mean over the nodes in each frame [m], shape (frames,).
        frame_p95: 95th percentile of the nodes in each frame [m], shape (frames,).
        frame_largest: Largest of a node in each frame [m], shape (frames,).
        node_mean: Mean over the frames of each node [m], shape (node_rows,); nan where the
            reference knows nothing.
        node_largest: Largest in a frame of each node [m], shape (node_rows,); nan likewise.
        volume_error: Volume of the target over that of the reference, less 1, in each frame, shape
            (frames,); nan for tissue without tetrahedra, or a reference that knows some nodes only.
    """

    frame_mean: NDArray[np.float64]
    frame_p95: NDArray[np.float64]
    frame_largest: NDArray[np.float64]
    node_mean: NDArray[np.float64]
    node_largest: NDArray[np.float64]
    volume_error: NDArray[np.float64]

    @property
    def mean(self) -> float:
        """Mean over nodes and frames [m]: the thesis' difference."""
        return float(self.frame_mean.mean())

    @property
    def p95(self) -> float:
        """95th percentile of the nodes, averaged over the frames [m]."""
        return float(self.frame_p95.mean())

    @property
    def largest(self) -> float:
        """Largest of a node in any frame [m]."""
        return float(self.frame_largest.max())

    @property
    def largest_volume_error(self) -> float:
        """Largest share of the volume that is missing or too much in a frame; nan: has none."""
        return float(np.abs(self.volume_error).max())


def mean_distance(
    target: Trajectory, reference: Trajectory, rows: NDArray[np.intp] | None = None
) -> float:
    """Mean over nodes and frames of |x_target - x_reference| [m]: `Difference.mean` alone.

    Raises:
        TrajectoryError: They are not of as many frames and nodes.
    """
    ours, theirs = target.displacement, reference.displacement
    if ours.shape != theirs.shape:
        raise TrajectoryError(
            f"{target.label} has {ours.shape[0]} frames of {ours.shape[1]} nodes, "
            f"{reference.label} has {theirs.shape[0]} of {theirs.shape[1]}; they must be the same"
        )
    where = np.arange(ours.shape[1]) if rows is None else rows
    return float(distances.mean_distance(ours, theirs, where))


def known_rows(organ: Organ, reference: Trajectory) -> NDArray[np.intp]:
    """Rows that a distance from a reference is taken over: living nodes that it knows."""
    known = organ.mesh.node_alive[: organ.mesh.node_rows].copy()
    if reference.rows is not None:
        measured = np.zeros_like(known)
        measured[reference.rows] = True
        known &= measured
    return np.flatnonzero(known)


def difference(organ: Organ, target: Trajectory, reference: Trajectory) -> Difference:
    """How far a target is from a reference.

    Raises:
        TrajectoryError: They are not of this organ, or not of the same frames.
    """
    check_alike(organ, target, reference)
    rows = known_rows(organ, reference)
    frames, count = target.frames, organ.mesh.node_rows
    per_frame = np.empty((3, frames))
    total, largest = np.zeros(len(rows)), np.zeros(len(rows))
    volume = np.full(frames, np.nan)
    volumes = organ.mesh.sheet is None and reference.rows is None
    for frame in range(frames):
        apart = np.linalg.norm(
            target.displacement[frame, rows].astype(np.float64)
            - reference.displacement[frame, rows], axis=1,
        )  # fmt: skip
        per_frame[:, frame] = apart.mean(), np.percentile(apart, 95), apart.max()
        total += apart
        np.maximum(largest, apart, out=largest)
        if volumes:
            ours, theirs = (_volume(organ, t.displacement[frame]) for t in (target, reference))
            volume[frame] = ours / theirs - 1.0
    node_mean, node_largest = np.full(count, np.nan), np.full(count, np.nan)
    node_mean[rows], node_largest[rows] = total / frames, largest
    mean, p95, farthest = per_frame
    return Difference(mean, p95, farthest, node_mean, node_largest, volume)


def check_alike(organ: Organ, target: Trajectory, reference: Trajectory) -> None:
    """Refuse trajectories that cannot be compared.

    Raises:
        TrajectoryError: They are not of this organ, or not of the same frames.
    """
    for trajectory in (target, reference):
        if trajectory.organ != organ.digest:
            raise TrajectoryError(
                f"{trajectory.label} has another topology (organ {trajectory.organ}, "
                f"{trajectory.displacement.shape[1]} nodes) than {organ.name} "
                f"(organ {organ.digest}, {organ.mesh.node_rows} nodes)"
            )
    ours, theirs = ((t.frames, t.rate_hz) for t in (target, reference))
    if ours != theirs:
        raise TrajectoryError(
            f"{target.label} has {ours[0]} frames at {ours[1]:g} Hz, {reference.label} has "
            f"{theirs[0]} at {theirs[1]:g} Hz; they must be the same"
        )


def _volume(organ: Organ, displacement: NDArray[np.float32]) -> float:
    mesh, rows = organ.mesh, organ.mesh.element_rows
    return float(
        total_volume(organ.rest, displacement, mesh.tets[:rows], mesh.element_alive[:rows])
    )
