"""Pictures of a session, rendered without a display from its bag."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viz_bridge.moments import Moment, find_moments
from viz_bridge.picture_scene import arrays_of, camera_of

SECONDS_PER_PICTURE = 60.0
NO_DRIVER = (
    "no pictures: no graphics driver renders without a display here "
    "(Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri)"
)
# Mesa's software renderer through EGL, then VTK's own choice of window.
_ENVIRONMENTS: tuple[dict[str, str], ...] = (
    {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"},
    {"VTK_DEFAULT_OPENGL_WINDOW": "vtkOSOpenGLRenderWindow"},
)


@dataclass(frozen=True)
class Pictures:
    """What became of the pictures.

    Attributes:
        files: Pictures written.
        message: Why there are none; empty where there are.
    """

    files: tuple[Path, ...]
    message: str = ""


def render(
    bag: Path,
    folder: Path,
    namespace: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> Pictures:
    """Render the moments of a bag worth a picture: before, pulled, cut_open, released.

    A machine without a graphics driver gives no pictures and a message, never an error.

    Args:
        bag: Directory or file.
        folder: Where the PNG files go.
        namespace: Of the organ; None for the only one.
        progress: Called with the number of messages read so far.

    Raises:
        ValueError: The bag cannot be read, or holds no organ.
        OSError: The folder cannot be written.
    """
    moments = find_moments(bag, namespace, progress)
    if not moments:
        return Pictures((), f"no pictures: {bag} holds no state of the organ")
    return render_moments(moments, folder)


def render_moments(moments: list[Moment], folder: Path) -> Pictures:
    """Render moments, each into a file of its name; see `render`."""
    camera = camera_of(moments)
    return render_files({moment.name: arrays_of(moment, camera) for moment in moments}, folder)


def render_files(pictures: dict[str, dict[str, NDArray]], folder: Path) -> Pictures:
    """Render pictures, given as the arrays that `picture_process` draws, by name of the file."""
    folder.mkdir(parents=True, exist_ok=True)
    reason = ""
    with tempfile.TemporaryDirectory(prefix="tissue_pictures_") as scratch:
        pairs: list[str] = []
        for name, arrays in pictures.items():
            saved = Path(scratch) / f"{name}.npz"
            np.savez(saved, **arrays)  # type: ignore[arg-type]
            pairs += [str(saved), str(Path(scratch) / f"{name}.png")]
        for extra in _ENVIRONMENTS:
            reason = _run(pairs, extra)
            written = [Path(name) for name in pairs[1::2] if Path(name).is_file()]
            if len(written) == len(pictures):
                break
        files = []
        for picture in written:
            target = folder / picture.name
            target.write_bytes(picture.read_bytes())
            files.append(target)
    if files:
        return Pictures(tuple(files))
    return Pictures((), f"{NO_DRIVER}; {reason}" if reason else NO_DRIVER)


def _run(pairs: list[str], extra: dict[str, str]) -> str:
    """Draw in a process of its own; returns what went wrong."""
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"} | extra
    command = [sys.executable, "-m", "viz_bridge.picture_process", *pairs]
    try:
        done = subprocess.run(
            command,
            env=environment,
            capture_output=True,
            text=True,
            timeout=SECONDS_PER_PICTURE * len(pairs) / 2,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "drawing took too long"
    if done.returncode == 0:
        return ""
    lines = [line.strip() for line in (done.stderr + done.stdout).splitlines() if line.strip()]
    return lines[-1][:200] if lines else f"the renderer ended with code {done.returncode}"


def draw_session(bag: Path, folder: Path) -> list[str]:
    """Render the pictures of a session and say in lines what became of them; never fails."""
    try:
        pictures = render(bag, folder)
    except (ValueError, OSError) as error:
        return [f"no pictures: {error}"]
    if not pictures.files:
        return [pictures.message]
    return [str(picture) for picture in pictures.files]
