"""Vectors with four lanes, one for each of four problems that are solved at once.

Arrays of lanes have the lane last, as in shape (node_capacity, 3, 4), and are contiguous; `c` is a
component.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from tissue_sim.kernels.vectors import Vector, place_of, splatted

LANES = 4
"""Lanes: one SSE register of single precision numbers."""


def _lanes_place(context: Any, builder: Any, array: Any, args: Any) -> tuple[Any, int]:
    """Pointer to the four numbers a[i, c], and the alignment of a single one."""
    value = context.make_array(array)(context, builder, args[0])
    row = builder.mul(args[1], cgutils.unpack_tuple(builder, value.shape)[1])
    first = builder.mul(builder.add(row, args[2]), ir.IntType(64)(LANES))
    return place_of(builder, value.data, first, LANES)


@intrinsic
def load_lanes(typing: Any, array: Any, i: Any, c: Any) -> Any:
    """The numbers a[i, c] of an array of shape (n, components, 4)."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer, size = _lanes_place(context, builder, array, args)
        return builder.load(pointer, align=size)

    return Vector(array.dtype, LANES)(array, types.int64, types.int64), generate


@intrinsic
def store_lanes(typing: Any, array: Any, i: Any, c: Any, vector: Any) -> Any:
    """Write the numbers a[i, c] of an array of shape (n, components, 4)."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer, size = _lanes_place(context, builder, array, args)
        builder.store(args[3], pointer, align=size)
        return context.get_dummy_value()

    return types.void(array, types.int64, types.int64, vector), generate


@intrinsic
def in_lanes(typing: Any, value: Any) -> Any:
    """A number in each of the four lanes."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return splatted(builder, args[0], LANES)

    return Vector(value, LANES)(value), generate


@intrinsic
def wide(typing: Any, vector: Any) -> Any:
    """The same numbers in double precision."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if vector.base == types.float64:
            return args[0]
        return builder.fpext(args[0], ir.VectorType(ir.DoubleType(), vector.lanes))

    return Vector(types.float64, vector.lanes)(vector), generate
