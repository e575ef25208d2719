"""What is held in every frame, and where: the recorded interaction that models are compared under.

The thesis copies the held nodes from the reference to the target (section 6): which nodes a grab
takes must not depend on the model that is judged.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.organ import Organ

FORMAT = 1
"""Version of the files that `Interaction.save` writes."""


class InteractionError(ValueError):
    """An interaction makes no sense, or is not one of this organ."""


@dataclass(frozen=True)
class Interaction:
    """Held nodes and their displacements, frame by frame.

    Attributes:
        name: Name for people.
        rate_hz: Frames per second [1/s].
        nodes: Rows that are held at any time, sorted, int32, shape (h,).
        held: Which of them are held in each frame, shape (frames, h).
        displacement: Where they are then, from rest [m], float64, shape (frames, h, 3); zero where
            they are not held.
        organ: Digest of the organ it was made on.
    """

    name: str
    rate_hz: float
    nodes: NDArray[np.int32]
    held: NDArray[np.bool_]
    displacement: NDArray[np.float64]
    organ: str

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.held)

    @property
    def seconds(self) -> float:
        """Length [s]."""
        return self.frames / self.rate_hz

    @property
    def amplitude(self) -> float:
        """Farthest displacement of a held node [m]."""
        return float(np.linalg.norm(self.displacement, axis=-1).max(initial=0.0))

    def held_rows(self, frame: int) -> NDArray[np.int32]:
        """Rows held in a frame, counted from 0."""
        return self.nodes[self.held[frame]]

    def scaled(self, factor: float, name: str = "") -> Interaction:
        """The same with all displacements multiplied."""
        return replace(self, name=name or self.name, displacement=factor * self.displacement)

    def checked(self, organ: Organ) -> Interaction:
        """This interaction, if it can be played on an organ.

        Raises:
            InteractionError: It was made on another organ, holds fixed or unknown nodes, or is
                empty; the message says what is there.
        """
        if self.organ != organ.digest:
            raise InteractionError(
                f"interaction {self.name} was recorded on another topology (organ {self.organ}) "
                f"than {organ.name} (organ {organ.digest}, {organ.mesh.node_rows} nodes): "
                "record it on this one"
            )
        if not 1.0 <= self.rate_hz <= 1000.0:
            raise InteractionError(
                f"interaction {self.name} has {self.rate_hz:g} frames a second; allowed: 1 to 1000"
            )
        if not self.frames or not self.held.any():
            raise InteractionError(
                f"interaction {self.name} has {self.frames} frames and holds nothing in any of them"
            )
        if not np.isfinite(self.displacement).all():
            raise InteractionError(f"interaction {self.name} has places that are not finite")
        if organ.mesh.fixed[self.nodes].any():
            raise InteractionError(f"interaction {self.name} holds nodes that are fixed")
        return self

    def save(self, path: Path) -> None:
        """Write it as a NumPy archive (.npz)."""
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            path, format=FORMAT, name=self.name, rate_hz=self.rate_hz, nodes=self.nodes,
            held=self.held, displacement=self.displacement, organ=self.organ,
        )  # fmt: skip

    @classmethod
    def load(cls, path: Path) -> Interaction:
        """Read what `save` wrote.

        Raises:
            InteractionError: The file is not one of these; the message says what it holds.
            OSError: It cannot be read.
        """
        wanted = ("format", "name", "rate_hz", "nodes", "held", "displacement", "organ")
        try:
            with np.load(path, allow_pickle=False) as file:
                missing = [key for key in wanted if key not in file]
                if missing:
                    raise InteractionError(
                        f"{path} is no interaction: it has no {', '.join(missing)}; "
                        f"it holds {', '.join(file.files) or 'nothing'}"
                    )
                if int(file["format"]) != FORMAT:
                    raise InteractionError(
                        f"{path} has format {int(file['format'])}; this version reads {FORMAT}"
                    )
                return cls(
                    str(file["name"]), float(file["rate_hz"]), file["nodes"].astype(np.int32),
                    file["held"].astype(np.bool_), file["displacement"].astype(np.float64),
                    str(file["organ"]),
                )  # fmt: skip
        except (zipfile.BadZipFile, zlib.error, EOFError) as error:
            raise InteractionError(f"{path} is no interaction: {error}") from error
        except ValueError as error:
            if isinstance(error, InteractionError):
                raise
            raise InteractionError(f"{path} is no interaction: {error}") from error


def held_along(
    organ: Organ,
    name: str,
    rate_hz: float,
    nodes: NDArray[np.integer],
    offsets: NDArray[np.float64],
    held: NDArray[np.bool_] | None = None,
) -> Interaction:
    """Nodes that move together, without turning.

    Args:
        organ: The organ.
        name: Name for people.
        rate_hz: Frames per second [1/s].
        nodes: Rows that are held.
        offsets: Displacement of all of them in each frame [m], shape (frames, 3).
        held: Frames in which they are held, shape (frames,); None: all.
    """
    rows = np.unique(np.asarray(nodes, dtype=np.int32))
    frames = len(offsets)
    which = np.ones(frames, dtype=np.bool_) if held is None else held
    displacement = np.where(which[:, None, None], offsets[:, None, :], 0.0)
    return Interaction(
        name, rate_hz, rows, np.repeat(which[:, None], len(rows), axis=1),
        np.repeat(displacement, len(rows), axis=1).astype(np.float64), organ.digest,
    )  # fmt: skip
