"""Pictures of the key moments of a session."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tissue_sim.report.session import Session


def draw(session: Session, namespace: str | None = None) -> tuple[list[tuple[bytes, str]], str]:
    """Draw the moments of a session worth a picture: before, pulled, cut open, at the end.

    A machine without a graphics driver gives none and a message, never an error.

    Args:
        session: The session; its bag is read again.
        namespace: Of the organ; None for the only one.

    Returns:
        PNG files with captions, and why there are none.
    """
    # Here, because viz_bridge depends on this package.
    from viz_bridge.moments import find_moments
    from viz_bridge.pictures import render_moments

    moments = find_moments(Path(session.bag), namespace)
    if not moments:
        return [], "No pictures: not recorded: tissue/state."
    with tempfile.TemporaryDirectory(prefix="tissue_report_") as folder:
        drawn = render_moments(moments, Path(folder))
        files = {file.stem: file.read_bytes() for file in drawn.files}
    pictures = [
        (files[moment.name], f"{moment.caption}, at {moment.sim_time:.1f} s")
        for moment in moments
        if moment.name in files
    ]
    return pictures, drawn.message
