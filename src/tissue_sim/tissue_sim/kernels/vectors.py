"""Vectors of numbers as values in kernels: what a compiler does not find by itself.

A loop that fetches from anywhere is left scalar, and so are the roots and divisions in it. Kernels
whose eight next springs or nodes do not touch each other say so by working on vectors, one lane
for each. `+ - * /`, `<`, `>` and negation work lane by lane, also with a scalar of the lanes' own
type. Vectors have eight lanes, or four (`kernels.lanes`); an operation takes operands of one
length. Products are fused with sums and not-a-numbers are not expected; nothing else is changed, so
that results do not depend on how a processor estimates inverses.

Vectors live in registers only: between kernels inlined into each other.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 8
"""Lanes of a vector unless it says otherwise: one AVX register of single precision numbers."""

ROW = 4
"""Columns of arrays whose rows are fetched and put whole: one SSE register."""

POINT = 3
"""Columns of arrays of points."""

_FLAGS = ("contract", "nnan", "ninf", "nsz")
_I32, _I64 = ir.IntType(32), ir.IntType(64)


class Vector(types.Type):
    """The type of a vector, for the compiler."""

    def __init__(self, base: types.Type, lanes: int = LANES) -> None:
        self.base, self.lanes = base, lanes
        super().__init__(name=f"Vector({base}, {lanes})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, vector: Vector) -> None:
        logical = vector.base == types.boolean
        base = ir.IntType(1) if logical else manager[vector.base].get_value_type()
        super().__init__(manager, vector, ir.VectorType(base, vector.lanes))


def _shuffled(builder: Any, a: Any, b: Any, mask: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_I32, len(mask)), mask))


def splatted(builder: Any, value: Any, lanes: int) -> Any:
    """A vector with a number in every lane."""
    vector = ir.Constant(ir.VectorType(value.type, lanes), ir.Undefined)
    vector = builder.insert_element(vector, value, _I32(0))
    return _shuffled(builder, vector, vector, [0] * lanes)


def _lanes_of(kinds: Any) -> int:
    """Lanes of the vectors among some operands; scalars alone fill a vector of `LANES`."""
    return next((kind.lanes for kind in kinds if isinstance(kind, Vector)), LANES)


def _widened(builder: Any, kinds: Any, values: Any) -> list[Any]:
    """Operands, the scalars among them in every lane."""
    lanes = _lanes_of(kinds)
    return [
        value if isinstance(kind, Vector) else splatted(builder, value, lanes)
        for kind, value in zip(kinds, values, strict=True)
    ]


def _typed(function: Any, result: types.Type | None) -> None:
    """Tell the compiler of what type an operator's result is."""

    @infer_global(function)
    class _Typing(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            bases = {kind.base if isinstance(kind, Vector) else kind for kind in args}
            lanes = {kind.lanes for kind in args if isinstance(kind, Vector)}
            if len(lanes) != 1 or len(bases) != 1:
                return None
            return signature(Vector(result or bases.pop(), lanes.pop()), *args)


def _binary(function: Any, instruction: str, result: types.Type | None = None) -> None:
    """Teach the compiler an operator of two operands."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        values = _widened(builder, sig.args, args)
        if result is not None:
            return builder.fcmp_ordered(instruction, *values, flags=_FLAGS)
        return getattr(builder, instruction)(*values, flags=_FLAGS)

    _typed(function, result)
    lower_builtin(function, Vector, Vector)(lower)
    lower_builtin(function, Vector, types.Number)(lower)
    lower_builtin(function, types.Number, Vector)(lower)


for _function, _instruction in (
    (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"),
    (operator.truediv, "fdiv"), (operator.iadd, "fadd"), (operator.isub, "fsub"),
    (operator.imul, "fmul"),
):  # fmt: skip
    _binary(_function, _instruction)
_binary(operator.lt, "<", types.boolean)
_binary(operator.gt, ">", types.boolean)
_typed(operator.neg, None)


@lower_builtin(operator.neg, Vector)
def _negative(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0], flags=_FLAGS)


def _data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return context.make_array(kind)(context, builder, value).data


def place_of(builder: Any, data: Any, at: Any, count: int) -> tuple[Any, int]:
    """Pointer to `count` numbers as one value, and the alignment of a single one."""
    base = data.type.pointee
    pointer = builder.bitcast(builder.gep(data, [at]), ir.VectorType(base, count).as_pointer())
    return pointer, base.get_abi_size(cpu_target.target_context.target_data)


@intrinsic
def load(typing: Any, array: Any, at: Any) -> Any:
    """Eight consecutive numbers of a one-dimensional array from place `at` on."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer, size = place_of(builder, _data(context, builder, array, args[0]), args[1], LANES)
        return builder.load(pointer, align=size)

    return Vector(array.dtype)(array, at), generate


@intrinsic
def store(typing: Any, array: Any, at: Any, vector: Any) -> Any:
    """Write the consecutive numbers of a one-dimensional array from place `at` on."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = _data(context, builder, array, args[0])
        pointer, size = place_of(builder, data, args[1], vector.lanes)
        builder.store(args[2], pointer, align=size)
        return context.get_dummy_value()

    return types.void(array, at, vector), generate


@intrinsic
def splat(typing: Any, value: Any) -> Any:
    """A number in every lane."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return splatted(builder, args[0], LANES)

    return Vector(value)(value), generate


_LOW, _HIGH = [0, 8, 1, 9, 4, 12, 5, 13], [2, 10, 3, 11, 6, 14, 7, 15]


def _interleaved(builder: Any, four: list[Any]) -> list[Any]:
    """Transpose the 4x4 blocks of four vectors; rows k and k + 4 share vector k."""
    a, b = (_shuffled(builder, four[0], four[2], mask) for mask in (_LOW, _HIGH))
    c, d = (_shuffled(builder, four[1], four[3], mask) for mask in (_LOW, _HIGH))
    return [_shuffled(builder, *pair, mask) for pair in ((a, c), (b, d)) for mask in (_LOW, _HIGH)]


def _row_places(
    builder: Any, data: Any, indices: Any, at: Any, columns: int = ROW
) -> list[tuple[Any, int]]:
    """Where the rows are whose numbers stand at eight places of `indices`."""
    places = []
    for lane in range(LANES):
        index = builder.load(builder.gep(indices, [builder.add(at, at.type(lane))]))
        first = builder.mul(builder.zext(index, _I64), _I64(columns))
        places.append(place_of(builder, data, first, columns))
    return places


@intrinsic
def fetch_rows(typing: Any, array: Any, indices: Any, at: Any) -> Any:
    """Rows indices[at:at + 8] of an array of shape (n, 4): a vector for each column."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = _data(context, builder, array, args[0])
        numbers = _data(context, builder, indices, args[1])
        places = _row_places(builder, data, numbers, args[2])
        rows = [builder.load(pointer, align=size) for pointer, size in places]
        wide = [_shuffled(builder, rows[k], rows[k + ROW], list(range(LANES))) for k in range(ROW)]
        return context.make_tuple(builder, sig.return_type, _interleaved(builder, wide))

    return types.UniTuple(Vector(array.dtype), ROW)(array, indices, at), generate


@intrinsic
def fetch_points(typing: Any, array: Any, indices: Any, at: Any) -> Any:
    """Rows indices[at:at + 8] of an array of shape (n, 3): a vector for each column."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = _data(context, builder, array, args[0])
        numbers = _data(context, builder, indices, args[1])
        places = _row_places(builder, data, numbers, args[2], POINT)
        points = [builder.load(pointer, align=size) for pointer, size in places]
        mask = [0, 1, 2, 2, 3, 4, 5, 5]
        wide = [_shuffled(builder, points[k], points[k + ROW], mask) for k in range(ROW)]
        columns = _interleaved(builder, wide)[:POINT]
        return context.make_tuple(builder, sig.return_type, columns)

    return types.UniTuple(Vector(array.dtype), POINT)(array, indices, at), generate


@intrinsic
def put_rows(typing: Any, array: Any, indices: Any, at: Any, columns: Any) -> Any:
    """Write rows indices[at:at + 8] of an array of shape (n, 4) from a vector for each column."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = _data(context, builder, array, args[0])
        numbers = _data(context, builder, indices, args[1])
        wide = _interleaved(builder, cgutils.unpack_tuple(builder, args[3], ROW))
        for lane, (pointer, size) in enumerate(_row_places(builder, data, numbers, args[2])):
            half = [lane // ROW * ROW + k for k in range(ROW)]
            row = _shuffled(builder, wide[lane % ROW], wide[lane % ROW], half)
            builder.store(row, pointer, align=size)
        return context.get_dummy_value()

    return types.void(array, indices, at, columns), generate


@intrinsic
def prefetch(typing: Any, array: Any, at: Any) -> Any:
    """Ask for the cache line of a place of a one-dimensional array, which need not exist."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        place = builder.gep(_data(context, builder, array, args[0]), [args[1]])
        place = builder.bitcast(place, ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [place.type, _I32, _I32, _I32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [place, _I32(0), _I32(3), _I32(1)])
        return context.get_dummy_value()

    return types.void(array, at), generate


@intrinsic
def root(typing: Any, x: Any) -> Any:
    """Square roots."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = args[0].type
        suffix = "f64" if kind.element == ir.DoubleType() else "f32"
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(kind, [kind]), f"llvm.sqrt.v{kind.count}{suffix}"
        )
        return builder.call(function, args, fastmath=_FLAGS)

    return x(x), generate


@intrinsic
def select(typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    """Lanes of `yes` where the mask holds, of `no` elsewhere; either may be a scalar."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(*_widened(builder, sig.args, args))

    base = yes.base if isinstance(yes, Vector) else yes
    return Vector(base, mask.lanes)(mask, yes, no), generate


@intrinsic
def first_lanes(typing: Any, vector: Any, count: Any) -> Any:
    """The lanes before `count`, zero in the others whatever they were."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind, lanes = args[0].type, vector.lanes
        numbers = ir.Constant(ir.VectorType(_I64, lanes), list(range(lanes)))
        inside = builder.icmp_signed("<", numbers, splatted(builder, args[1], lanes))
        return builder.select(inside, args[0], ir.Constant(kind, [0.0] * lanes))

    return vector(vector, types.int64), generate


@intrinsic
def bits(typing: Any, mask: Any) -> Any:
    """A mask as a number: bit k is lane k."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(mask.lanes)), _I64)

    return types.int64(mask), generate


@intrinsic
def total(typing: Any, vector: Any) -> Any:
    """Sum of the lanes, by halves: of eight (0 + 4) + (2 + 6) + ((1 + 5) + (3 + 7))."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value, half = args[0], vector.lanes // 2
        while half:
            other = _shuffled(builder, value, value, list(range(half, 2 * half)))
            value = _shuffled(builder, value, value, list(range(half)))
            value = builder.fadd(value, other, flags=_FLAGS)
            half //= 2
        return builder.extract_element(value, _I32(0))

    return vector.base(vector), generate
