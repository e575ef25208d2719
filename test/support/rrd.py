"""What an .rrd file holds, read back."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader


def columns(path: Path) -> dict[str, dict[str, list[Any]]]:
    """Component columns by entity and name, one value for each time; `sim_time` in [ns]."""
    found: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    chunks = [
        (chunk.entity_path.replace("\\", ""), chunk.to_record_batch())
        for chunk in RrdReader(path).stream().to_chunks()
    ]
    # The writer's thread may put what came at once into the file in any order.
    for entity, batch in sorted(chunks, key=lambda chunk: _first_frame(chunk[1])):
        for name in batch.schema.names:
            if name not in ("clock", "log_time"):
                values = batch.column(name)
                # Nanoseconds that are no whole microseconds are no timedelta.
                plain = values.cast("int64") if name == "sim_time" else values
                found[entity][name] += plain.to_pylist()
    return found


def _first_frame(batch: Any) -> int:
    """The frame a chunk begins with; -1 for what is timeless."""
    if "frame" not in batch.schema.names or not batch.num_rows:
        return -1
    first = batch.column("frame")[0].as_py()
    return -1 if first is None else int(first)


def rgb(packed: list[int]) -> np.ndarray:
    """Red, green, blue of colours as they are stored, shape (n, 3)."""
    numbers = np.array(packed, dtype=np.uint32)
    return np.stack([numbers >> 24, numbers >> 16 & 255, numbers >> 8 & 255], axis=1)
