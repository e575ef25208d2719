"""Makes a rerun recording out of a bag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from viz_bridge.bag_reader import read_organ
from viz_bridge.recording import Recording, file_stream


def to_rrd(
    bag: Path,
    target: Path,
    namespace: str | None = None,
    max_hz: float = 0.0,
    progress: Callable[[int], None] | None = None,
) -> int:
    """Draw a bag into a .rrd file.

    Args:
        bag: Directory or file.
        target: The file; replaced where it is there.
        namespace: Of the organ; None for the only one.
        max_hz: States drawn a second at most; 0 for all.
        progress: Called with the number of messages read so far.

    Returns:
        Number of states drawn.

    Raises:
        ValueError: The bag cannot be read, or holds no organ.
        OSError: The target cannot be written.
    """
    messages = read_organ(bag, namespace)
    target.parent.mkdir(parents=True, exist_ok=True)
    recording = Recording(file_stream(str(target)), max_hz)
    try:
        for count, (topic, item) in enumerate(messages, start=1):
            if recording.takes(topic):
                recording.take(topic, item.message, item.log_time)
            if progress is not None:
                progress(count)
    finally:
        recording.close()
    return recording.states
