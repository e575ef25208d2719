"""Which tool holds a node."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tissue_sim.readings.reach import ToolReach

NOBODY = ""


class Holders:
    """Remembers by which tool nodes are held.

    `tissue/held_nodes` names no tools, but a tool takes hold of what it reaches: of the tools that
    hold tissue it is the one closest to the node when that is first seen held.
    """

    def __init__(self) -> None:
        self._tools: dict[int, str] = {}

    def clear(self) -> None:
        """Forget all."""
        self._tools.clear()

    def take(
        self, nodes: NDArray[np.integer], places: NDArray[np.floating], tools: Sequence[ToolReach]
    ) -> dict[str, NDArray[np.intp]]:
        """Take the nodes that are held now.

        Args:
            nodes: Their ids, shape (n,).
            places: Where they are [m], shape (n, 3).
            tools: The tools.

        Returns:
            For each tool which of them it holds, as places in `nodes`; NOBODY's are those that no
            tool is known to hold.
        """
        named = nodes.tolist()
        self._tools = {node: self._tools[node] for node in named if node in self._tools}
        fresh = [k for k, node in enumerate(named) if node not in self._tools]
        holding = [tool for tool in tools if tool.holds]
        if fresh and holding:
            away = [tool.distances(places[fresh].astype(np.float64)) for tool in holding]
            for k, nearest in zip(fresh, np.argmin(away, axis=0).tolist(), strict=True):
                self._tools[named[k]] = holding[nearest].tool
        holders = np.array([self._tools.get(node, NOBODY) for node in named], dtype=np.str_)
        return {str(tool): np.flatnonzero(holders == tool) for tool in np.unique(holders)}
