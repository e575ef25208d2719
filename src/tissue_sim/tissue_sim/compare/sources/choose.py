"""The interaction that a person means with one text: a motion, a script, a file or a recording."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from tissue_sim.compare.difference import check_alike
from tissue_sim.compare.interaction import Interaction, InteractionError
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.sources.markers import measured_markers, recorded_markers
from tissue_sim.compare.sources.motions import MOTIONS, motion
from tissue_sim.compare.sources.recorded import Recording
from tissue_sim.compare.sources.recording import read_recording
from tissue_sim.compare.sources.script import interaction_of_script
from tissue_sim.compare.trajectory import Trajectory, only_held

SAME = 1e-6
"""Places are the same that are nearer than this share of the organ's size: single precision."""

ALLOWED = (
    f"allowed: a motion ({', '.join(MOTIONS)}; with an amplitude as NAME:MILLIMETRES), a procedure "
    "(.yaml), an interaction or markers (.npz), a bag (its folder, or .mcap)"
)


def interaction_from(
    text: str,
    organ: Organ | None = None,
    rate_hz: float = 30.0,
    namespace: str | None = None,
    epoch: int | None = None,
) -> Recording:
    """The interaction that a text means.

    Args:
        text: A motion's name, NAME:AMPLITUDE in millimetres, or a file: an interaction (.npz),
            markers (.npz), a procedure (.yaml), or a bag.
        organ: The organ; None: the bag's.
        rate_hz: Frames per second [1/s] of what is not an interaction already.
        namespace: Of a bag: that of the organ, if there are several.
        epoch: Of a bag: which, counted from 1, if there are several.

    Raises:
        ValueError: It means nothing, or what it means cannot be used; the message says why.
        OSError: A file cannot be read.
    """
    path, suffix = Path(text), Path(text).suffix.lower()
    is_motion = text.partition(":")[0] in MOTIONS
    if not is_motion and (path.is_dir() or suffix == ".mcap"):
        return read_recording(path, namespace, rate_hz, epoch, organ)
    if organ is None:
        raise InteractionError(f"interaction {text!r} says of no organ: name one")
    if suffix in (".yaml", ".yml"):
        return interaction_of_script(path, organ, rate_hz)
    if suffix == ".npz":
        return _of_archive(path, organ, rate_hz)
    return Recording(organ, _motion(text, organ, rate_hz))


def reference_from(path: Path, organ: Organ, interaction: Interaction) -> Trajectory:
    """Positions to compare with: a trajectory that was kept, or markers.

    Raises:
        ValueError: The file (.npz) holds neither, or does not go with the interaction.
        OSError: It cannot be read.
    """
    if "displacement" in _keys(path):
        return _of_interaction(Trajectory.load(path), path, organ, interaction)
    return measured_markers(path, organ, interaction)


def _of_interaction(
    kept: Trajectory, path: Path, organ: Organ, interaction: Interaction
) -> Trajectory:
    """A kept trajectory, if what is held in it is where the interaction holds it."""
    check_alike(organ, only_held(organ, interaction), kept)
    if not len(kept.steps):
        return kept  # It was measured: tissue is never quite where a tool is.
    apart = kept.displacement[:, interaction.nodes] - interaction.displacement
    farthest = float(np.linalg.norm(apart[interaction.held], axis=1).max())
    if farthest > SAME * max(interaction.amplitude, organ.size):
        raise InteractionError(
            f"{path} was made under another interaction than {interaction.name}: what that holds "
            f"is up to {1e3 * farthest:.3g} mm elsewhere in it"
        )
    return kept


def _of_archive(path: Path, organ: Organ, rate_hz: float) -> Recording:
    if "positions" in _keys(path):
        return recorded_markers(path, organ, rate_hz)
    return Recording(organ, Interaction.load(path).checked(organ))


def _keys(path: Path) -> list[str]:
    try:
        with np.load(path, allow_pickle=False) as file:
            return list(file.files)
    except (zipfile.BadZipFile, EOFError, ValueError, TypeError) as error:
        raise InteractionError(f"{path} is no NumPy archive (.npz): {error}") from error


def _motion(text: str, organ: Organ, rate_hz: float) -> Interaction:
    name, colon, amplitude = text.partition(":")
    if name not in MOTIONS:
        raise InteractionError(f"there is no interaction {text!r}; {ALLOWED}")
    if not colon:
        return motion(name, organ, rate_hz=rate_hz)
    try:
        return motion(name, organ, 1e-3 * float(amplitude), rate_hz)
    except ValueError as error:
        if isinstance(error, InteractionError):
            raise
        raise InteractionError(
            f"amplitude {amplitude!r} of {name} is no number of millimetres"
        ) from error
