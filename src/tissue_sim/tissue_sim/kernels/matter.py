"""What elements are made of, as kernels read it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Matter(NamedTuple):
    """Materials by kind, and each element's kind and fibres.

    Attributes:
        kind: Row of `table` of each element, shape (element_capacity,).
        table: lambda, mu and fibre stiffness [Pa] of each kind, shape (kinds, 3).
        fibres: Unit vector along each element's fibres at rest, or zero, float32, shape
            (element_capacity, 3).
    """

    kind: NDArray[np.uint8]
    table: NDArray[np.float64]
    fibres: NDArray[np.float32]
