"""Where the values of a quantity come from: what was heard, or the shape itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissue_sim.readings.fields import DISPLACEMENT, UNITS, displacement
from tool_input.table.scalar_scale import DIFFERENCE
from tool_input.table.tissue_frame import TissueFrame


def unit_of(quantity: str) -> str:
    """The SI unit of a quantity; a difference is a distance."""
    return UNITS.get(quantity, UNITS[DISPLACEMENT])


def quantity_values(
    quantity: str, frame: TissueFrame, before: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """A quantity at every node.

    Args:
        quantity: Name of the quantity.
        frame: The tissue.
        before: Values of an earlier frame: what stands in until those of this version come. Nodes
            that an edit has made take the value of the node they were copied from.

    Returns:
        In its SI unit, nan where it is not known, shape (node_rows,).
    """
    mesh = frame.mesh
    if quantity == DISPLACEMENT:
        return displacement(mesh, frame.positions)
    heard = frame.difference if quantity == DIFFERENCE else frame.scalar
    if heard is not None and (quantity == DIFFERENCE or heard.name == quantity):
        return heard.values.astype(np.float64)
    values = np.full(mesh.node_rows, np.nan)
    if before is not None and len(before) <= mesh.node_rows:
        values[: len(before)] = before
        for row in range(len(before), mesh.node_rows):
            values[row] = values[mesh.node_parents[row]]
    return values
