"""References that were computed before, kept on disk.

A reference of exact finite elements takes seconds to minutes and is wanted again in every fit and
every comparison. What is kept is named after all that decides it: the organ, its material, the
interaction, the subject, and the code of the models.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import astuple, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.compare.interaction import Interaction
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.subject import Subject
from tissue_sim.compare.trajectory import Trajectory, TrajectoryError, simulate

FORMAT = 1
"""Version of the files and of their names."""

LARGEST = 2_000_000_000
"""Bytes that are kept; what was used longest ago goes first."""

CODE = ("elastic", "kernels", "geometry", "compare/trajectory.py", "compare/spring_constants.py")
"""Sources that decide what a model does: what other code computed is not used."""

Say = Callable[[str], None]


def cached(
    subject: Subject,
    organ: Organ,
    interaction: Interaction,
    folder: Path | None = None,
    on_frame: Callable[[int], None] | None = None,
    say: Say | None = None,
    largest: int = LARGEST,
) -> Trajectory:
    """How a subject moves, computed now or before.

    Times of its steps are those of the run that computed it. A subject whose effort is a time a
    frame is always computed, because another run moves otherwise, and so is an organ with stitches
    or patches. A file that cannot be used is computed anew, and one that cannot be written is not
    kept; both are said.

    Args:
        subject: The model, its parameters and its effort.
        organ: The organ.
        interaction: What is held.
        folder: Folder of the cache; None: `user_folder`.
        on_frame: Told the number of each frame that is done, if it is computed.
        say: Told what a person should know; None: written to standard error.
        largest: Bytes that are kept in the folder.

    Raises:
        ValueError: As `simulate`.
    """
    sewn = len(organ.mesh.sutures) or len(organ.mesh.patches)
    if sewn or not subject.effort.reproducible:
        return simulate(subject, organ, interaction, on_frame)
    say = say or _to_standard_error
    folder = folder or user_folder()
    path = folder / f"{digest(subject, organ, interaction)}.npz"
    found = _found(path, organ, interaction, say)
    if found is None:
        found = simulate(subject, organ, interaction, on_frame)
        _keep(found, path, largest, say)
    return replace(found, label=subject.name)


def user_folder() -> Path:
    """Where a user's references are kept."""
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(caches) / "tissue_sim" / "references"


def digest(subject: Subject, organ: Organ, interaction: Interaction) -> str:
    """What tells a reference from any other one; the label of the subject does not count."""
    told = hashlib.sha256(code_digest().encode())
    words = (
        FORMAT, organ.digest, organ.material, organ.mesh.region_names, subject.model,
        sorted(subject.values.items()), subject.effort, interaction.rate_hz,
    )  # fmt: skip
    told.update(repr(words).encode())
    for array in (*_parts(organ), interaction.nodes, interaction.held, interaction.displacement):
        told.update(f"{array.dtype.str}{array.shape}".encode())
        told.update(np.ascontiguousarray(array).tobytes())
    return told.hexdigest()[:32]


def _parts(organ: Organ) -> Iterator[NDArray[np.generic]]:
    """What a mesh has beside rest positions, elements and fixed nodes."""
    mesh = organ.mesh
    yield mesh.regions[: mesh.element_rows]
    yield mesh.fibres[: mesh.element_rows]
    yield mesh.element_alive[: mesh.element_rows]
    if mesh.sheet is not None:
        sheet = mesh.sheet
        yield from (sheet.triangles, sheet.thickness, sheet.springs, sheet.categories)
        yield sheet.volumes
        yield np.array(astuple(sheet.stiffness))


@cache
def code_digest() -> str:
    """Digest of the sources that decide what a model does."""
    package = Path(__file__).resolve().parents[1]
    told = hashlib.sha256()
    for name in CODE:
        place = package / name
        for path in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            told.update(path.relative_to(package).as_posix().encode())
            told.update(path.read_bytes())
    return told.hexdigest()[:16]


def _found(path: Path, organ: Organ, interaction: Interaction, say: Say) -> Trajectory | None:
    wanted = (interaction.frames, organ.mesh.node_rows, 3)
    try:
        found = Trajectory.load(path)
        if found.displacement.shape != wanted or found.organ != organ.digest:
            raise TrajectoryError(f"{path} has shape {found.displacement.shape}, not {wanted}")
        os.utime(path)
    except FileNotFoundError:
        return None
    except (TrajectoryError, OSError) as error:
        say(f"a kept reference cannot be used and is computed anew: {error}")
        return None
    return found


def _keep(trajectory: Trajectory, path: Path, largest: int, say: Say) -> None:
    # Under a name of its own, because other processes may keep the same one.
    own = path.with_name(f"{path.stem}.{os.getpid()}.npz.new")
    try:
        trajectory.save(own)
        own.replace(path)
        _remove_oldest(path.parent, path, largest)
    except OSError as error:
        say(f"the reference could not be kept: {error}")


def _remove_oldest(folder: Path, newest: Path, largest: int) -> None:
    """Remove what was used longest ago until the rest is small enough, but never the newest."""
    kept = []
    for path in folder.glob("*.npz"):
        try:
            kept.append((path.stat(), path))
        except FileNotFoundError:
            continue
    kept.sort(key=lambda entry: entry[0].st_mtime_ns)
    size = sum(status.st_size for status, _ in kept)
    for status, path in kept:
        if size <= largest:
            return
        if path != newest:
            path.unlink(missing_ok=True)
            size -= status.st_size


def _to_standard_error(text: str) -> None:
    print(text, file=sys.stderr)
