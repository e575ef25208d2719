"""How many parts joined things make, counted by scipy and not by what edits count with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components


def count_parts(first: NDArray[np.int64], second: NDArray[np.int64], number: int) -> int:
    """Parts that so many things make when pairs of them are joined."""
    graph = csr_matrix((np.ones(len(first), dtype=np.int8), (first, second)), (number, number))
    return int(connected_components(graph, directed=False)[0])
