"""Sixteen numbers side by side, as one value inside kernels.

LLVM splits such a value into whatever registers the processor has (one of AVX-512, two of AVX2, four of SSE or NEON), so that the same code
runs on every processor that numba supports. No operation is contracted or reordered: every lane holds the bits that a plain float32 loop
would give.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

from kinegraph.operators.neighbours.layout import LANES

_f32: Any = ir.FloatType()
_i64: Any = ir.IntType(64)
_vector: Any = ir.VectorType(_f32, LANES)
_counts: Any = ir.VectorType(_i64, LANES)


class Lanes(types.Type):
    """Numba's type of sixteen numbers: float32, or int64 that count."""

    def __init__(self, name: str, vector: Any) -> None:
        cast(Any, super()).__init__(name=name)
        self.vector = vector


lanes_type: Any = cast(Any, Lanes)("Lanes16", _vector)
counts_type: Any = cast(Any, Lanes)("Counts16", _counts)


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        cast(Any, super()).__init__(dmm, fe_type, fe_type.vector)


def primitive(define: Callable[..., Any]) -> Any:
    """Something that kernels can call, made of LLVM instructions; `define` gives its type and what writes them."""
    return intrinsic(define)


def _place(builder: Any, numbers: Any, at: Any, vector: Any = _vector) -> Any:
    """Pointer to sixteen numbers."""
    return builder.bitcast(builder.gep(numbers, [at]), vector.as_pointer())


def _splat(builder: Any, scalar: Any, vector: Any = _vector) -> Any:
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(
        one, ir.Constant(vector, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    )


array_of: Any = cast(Any, numba).carray
"""As many of bare numbers as an array again, from their beginning on."""


@primitive
def load(typing: Any, numbers: Any, at: Any) -> Any:
    """Sixteen of bare float32 numbers, from place `at` on."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_place(builder, args[0], args[1]), align=4)

    return lanes_type(numbers, types.int64), make


@primitive
def store(typing: Any, numbers: Any, at: Any, value: Any) -> Any:
    """Put sixteen among bare float32 numbers, from place `at` on."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(args[2], _place(builder, args[0], args[1]), align=4)
        return context.get_dummy_value()

    return types.void(numbers, types.int64, lanes_type), make


@primitive
def add_square(typing: Any, total: Any, x: Any, q: Any) -> Any:
    """`total` + (x - q)^2 in every lane; q is one number."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        off = builder.fsub(args[1], _splat(builder, args[2]))
        return builder.fadd(args[0], builder.fmul(off, off))

    return lanes_type(lanes_type, lanes_type, types.float32), make


@primitive
def add_weighted(typing: Any, total: Any, x: Any, q: Any, w: Any) -> Any:
    """`total` + (w (x - q)) (x - q) in every lane; q and w are one number each."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        off = builder.fsub(args[1], _splat(builder, args[2]))
        return builder.fadd(args[0], builder.fmul(builder.fmul(_splat(builder, args[3]), off), off))

    return lanes_type(lanes_type, lanes_type, types.float32, types.float32), make


def _larger(builder: Any, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


@primitive
def outside(typing: Any, low: Any, high: Any, q: Any) -> Any:
    """How far the number q lies outside of `low` .. `high`, in every lane; 0 inside."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        at = _splat(builder, args[2])
        off = _larger(builder, builder.fsub(args[0], at), builder.fsub(at, args[1]))
        return _larger(builder, off, ir.Constant(_vector, [0.0] * LANES))

    return lanes_type(lanes_type, lanes_type, types.float32), make


@primitive
def at_most(typing: Any, total: Any, limit: Any) -> Any:
    """The lanes that hold at most `limit` (one number), as the bits of a whole number."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        within = builder.fcmp_ordered("<=", args[0], _splat(builder, args[1]))
        return builder.zext(builder.bitcast(within, ir.IntType(LANES)), _i64)

    return types.int64(lanes_type, types.float32), make


@primitive
def lowest(typing: Any, bits: Any) -> Any:
    """The place of the lowest bit that is set, of a number that is not 0."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        count = cast(Any, cgutils).get_or_insert_function(
            builder.module, ir.FunctionType(_i64, [_i64, ir.IntType(1)]), "llvm.cttz.i64"
        )
        return builder.call(count, [args[0], ir.Constant(ir.IntType(1), 1)])

    return types.int64(types.int64), make


@primitive
def bits_of(typing: Any, value: Any) -> Any:
    """The bits of a float32 as a whole number: of two numbers that are not negative, the larger has the larger."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.zext(builder.bitcast(args[0], ir.IntType(32)), _i64)

    return types.int64(types.float32), make


@primitive
def number_of(typing: Any, bits: Any) -> Any:
    """The float32 that has these bits."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(builder.trunc(args[0], ir.IntType(32)), _f32)

    return types.float32(types.int64), make


@primitive
def none_counted(typing: Any) -> Any:
    """Sixteen counts of 0."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return ir.Constant(_counts, [0] * LANES)

    return counts_type(), make


@primitive
def count_above(typing: Any, counts: Any, numbers: Any, at: Any, number: Any) -> Any:
    """One more in every lane in which, of sixteen of bare int64 numbers from place `at` on, there stands one above `number`."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        counts, numbers, at, number = args
        sixteen = builder.load(_place(builder, numbers, at, _counts), align=8)
        above = builder.icmp_signed(">", sixteen, _splat(builder, number, _counts))
        return builder.add(counts, builder.zext(above, _counts))

    return counts_type(counts_type, numbers, types.int64, types.int64), make


@primitive
def store_counts(typing: Any, numbers: Any, at: Any, counts: Any) -> Any:
    """Put sixteen counts among bare int64 numbers, from place `at` on."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(args[2], _place(builder, args[0], args[1], _counts), align=8)
        return context.get_dummy_value()

    return types.void(numbers, types.int64, counts_type), make
