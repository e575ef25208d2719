"""Positions of markers on tissue, as a camera or a tracker measures them.

The file is a NumPy archive (.npz):

- `positions`: of the markers in every frame [m], shape (frames, m, 3), in the organ's frame; at
  rest in the first one
- `rate_hz`: frames per second [1/s]
- `held`: which markers a tool moves, shape (frames, m); optional: with it the file says what was
  done as well
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tissue_sim.compare.interaction import Interaction, InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.sources.held_frames import frames_at
from tissue_sim.compare.sources.recorded import Recording
from tissue_sim.compare.trajectory import Trajectory


@dataclass(frozen=True)
class Markers:
    """What a file of markers holds.

    Attributes:
        name: Name for people.
        rate_hz: Frames per second [1/s].
        positions: Of the markers [m], shape (frames, m, 3).
        held: Which of them a tool moves, shape (frames, m); None: nobody says.
    """

    name: str
    rate_hz: float
    positions: NDArray[np.float64]
    held: NDArray[np.bool_] | None = None

    @classmethod
    def load(cls, path: Path) -> Markers:
        """Read a file.

        Raises:
            InteractionError: It is no file of markers; the message says what it holds.
            OSError: It cannot be read.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                missing = [key for key in ("positions", "rate_hz") if key not in file]
                if missing:
                    raise InteractionError(
                        f"{path} holds no markers: it has no {', '.join(missing)}; "
                        f"it holds {', '.join(file.files) or 'nothing'}"
                    )
                held = file["held"].astype(np.bool_) if "held" in file else None
                return cls(
                    path.stem, float(file["rate_hz"]), file["positions"].astype(np.float64), held
                ).checked()
        except (zipfile.BadZipFile, zlib.error, EOFError, TypeError) as error:
            raise InteractionError(f"{path} holds no markers: {error}") from error

    def checked(self) -> Markers:
        """These markers, if they can be used.

        Raises:
            InteractionError: A shape, the rate or a position is not allowed.
        """
        shape = self.positions.shape
        if len(shape) != 3 or shape[2] != 3 or shape[0] < 2 or not shape[1]:
            raise InteractionError(
                f"{self.name}: positions have shape {shape}; allowed: (frames, markers, 3) with at "
                "least 2 frames and 1 marker"
            )
        if self.held is not None and self.held.shape != shape[:2]:
            raise InteractionError(
                f"{self.name}: held has shape {self.held.shape}; allowed: {shape[:2]}"
            )
        if not 1.0 <= self.rate_hz <= 1e5:
            raise InteractionError(
                f"{self.name}: rate_hz = {self.rate_hz:g} is not allowed; allowed: 1 to 100000"
            )
        lost = ~np.isfinite(self.positions).all(axis=2)
        if lost.any():
            frame, marker = np.argwhere(lost)[0]
            raise InteractionError(
                f"{self.name}: {int(lost.sum())} positions are not finite, the first is that of "
                f"marker {marker} in frame {frame}; fill gaps before"
            )
        return self

    def rows(self, organ: Organ, tolerance: float | None = None) -> NDArray[np.int32]:
        """The node next to each marker at rest, shape (m,).

        Args:
            organ: The organ.
            tolerance: Farthest that a marker may be from it [m]; None: the median distance between
                a node and the next one.

        Raises:
            InteractionError: A marker is farther from every node, or two are at the same one.
        """
        alive = np.flatnonzero(organ.mesh.node_alive[: organ.mesh.node_rows])
        tree = cKDTree(organ.rest[alive])
        if tolerance is None:
            spacing = np.asarray(tree.query(organ.rest[alive], k=2)[0])[:, 1]
            tolerance = float(np.median(spacing))
        away, nearest = (np.asarray(found) for found in tree.query(self.positions[0]))
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            raise InteractionError(
                f"{self.name}: marker {worst} is {1e3 * away[worst]:.3g} mm from the next node of "
                f"{organ.name} in the first frame; allowed: {1e3 * tolerance:.3g} mm. Positions "
                "are in metres in the organ's frame, the first frame at rest"
            )
        rows = alive[nearest]
        unique, counts = np.unique(rows, return_counts=True)
        if (counts > 1).any():
            same = np.flatnonzero(rows == unique[np.argmax(counts)])[:2].tolist()
            raise InteractionError(
                f"{self.name}: markers {same[0]} and {same[1]} are at the same node of "
                f"{organ.name}; leave one out, or use a finer mesh"
            )
        return rows.astype(np.int32)

    def displacement(self, rate_hz: float) -> NDArray[np.float64]:
        """From the first frame [m], shape (frames, m, 3), from the frame after it on."""
        chosen = frames_at(rate_hz, self.rate_hz, len(self.positions))[1:]
        moved: NDArray[np.float64] = self.positions[chosen] - self.positions[0]
        return moved


def measured_markers(
    path: Path, organ: Organ, interaction: Interaction, tolerance: float | None = None
) -> Trajectory:
    """How markers moved while an interaction was made.

    Args:
        path: File of markers that begins when the interaction begins.
        organ: The organ.
        interaction: The interaction.
        tolerance: As in `Markers.rows` [m].

    Raises:
        InteractionError: The file is no such file, or ends before the interaction does.
    """
    markers = Markers.load(path)
    moved = markers.displacement(interaction.rate_hz)
    if len(moved) < interaction.frames:
        raise InteractionError(
            f"{path} ends after {len(moved) / interaction.rate_hz:g} s; interaction "
            f"{interaction.name} takes {interaction.seconds:g} s"
        )
    return _trajectory(markers, organ, moved[: interaction.frames], interaction.rate_hz, tolerance)


def recorded_markers(
    path: Path, organ: Organ, rate_hz: float = 30.0, tolerance: float | None = None
) -> Recording:
    """The interaction and the measurement of a file of markers that says which are held.

    Raises:
        InteractionError: The file is no such file.
    """
    markers = Markers.load(path)
    if markers.held is None:
        raise InteractionError(
            f"{path} says nothing of what is held: it has no held (frames, markers); give it as "
            "the reference of another interaction, or add it"
        )
    rate_hz = min(rate_hz, markers.rate_hz)
    moved = markers.displacement(rate_hz)
    held = markers.held[frames_at(rate_hz, markers.rate_hz, len(markers.positions))[1:]]
    rows = markers.rows(organ, tolerance)
    used = np.flatnonzero(held.any(axis=0) & ~organ.mesh.fixed[rows])
    used = used[np.argsort(rows[used])]
    which = held[:, used]
    interaction = Interaction(
        markers.name, rate_hz, rows[used], which,
        np.where(which[..., None], moved[:, used], 0.0), organ.digest,
    )  # fmt: skip
    measured = _trajectory(markers, organ, moved, rate_hz, tolerance)
    return Recording(organ, interaction.checked(organ), measured, (), "")


def _trajectory(
    markers: Markers,
    organ: Organ,
    moved: NDArray[np.float64],
    rate_hz: float,
    tolerance: float | None,
) -> Trajectory:
    rows = markers.rows(organ, tolerance)
    displacement = np.zeros((len(moved), organ.mesh.node_rows, 3), dtype=np.float32)
    displacement[:, rows] = moved
    none = np.empty(0)
    return Trajectory(
        f"{len(rows)} markers of {markers.name}", rate_hz, displacement, none.astype(np.int64),
        none, len(moved), organ.digest, np.sort(rows),
    )  # fmt: skip
