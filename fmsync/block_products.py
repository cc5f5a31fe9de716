"""Sums of products of many small matrices, compiled: what solvers spend their time on.

A library takes as long to begin a product of 20 x 20 matrices as to do it. Here a tile of four rows of the result stays
in registers while the rows of the right factor pass by; entries of the left one are read at any stride, so that a
transposed factor needs no copy. Every sum is in the order of the inner index, whatever the processor.
"""

from typing import Any

import numba
import numpy as np
from numba.core import cgutils, types
from numba.core.cgutils import ir  # type: ignore[attr-defined]  # the llvmlite that Numba was built with
from numba.extending import intrinsic

_BITS, _TILE_ROWS, _TILE_VECTORS = 256, 4, 3  # twelve sums, in the sixteen vector registers of AVX2
_PLACE = types.intp
_intrinsic: Any = intrinsic  # its own type counts the context among the arguments of a call


def products(left: np.ndarray, right: np.ndarray, *, transposed: bool = False) -> np.ndarray:
    """``left @ right`` of (B, n, k) and (B, k, m); with ``transposed`` ``left`` are (B, k, n)."""
    rows = left.shape[2 if transposed else 1]
    out, every = np.zeros((len(left), rows, right.shape[2]), np.result_type(left, right)), np.arange(len(left))
    add_products(out, every, left, every, np.full(len(left), transposed), right, every)
    return out


def add_products(
    out: np.ndarray,
    to: np.ndarray,
    left: np.ndarray,
    first: np.ndarray,
    transposed: np.ndarray,
    right: np.ndarray,
    second: np.ndarray,
    weights: np.ndarray | None = None,
) -> None:
    r"""For every t in turn, add :math:`w_t A_{f_t} B_{s_t}` to number :math:`o_t` of ``out`` (C-contiguous, changed).

    A of ``left`` (., n, k), or :math:`A^\top` where ``transposed`` (T,), then (., k, n), B of ``right`` (., k, m), in
    the precision of ``out``; ``first``, ``second``, ``to`` (T,) are f, s, o; ``weights`` (T,) are ones by default.
    """
    weights = np.ones(len(to)) if weights is None else weights
    left, right, weights = (a.astype(out.dtype, copy=False) for a in (left, right, weights))
    fixed = [np.ascontiguousarray(a).view() for a in (to, left, first, transposed, right, second, weights)]
    for a in fixed:
        a.setflags(write=False)  # one compiled signature a precision, whoever owns the arrays
    _add_in_turn(out, tuple(fixed))


@numba.njit(cache=True, nogil=True)
def _add_in_turn(out: np.ndarray, fixed: tuple[np.ndarray, ...]) -> None:
    """:func:`add_products`, whose other arguments are ``fixed``: arrays of one precision, all C-contiguous."""
    to, left, first, transposed, right, second, weights = fixed
    rows, columns, inner = out.shape[1], out.shape[2], right.shape[1]
    c, a, b = out.reshape(-1), left.reshape(-1), right.reshape(-1)
    for t in range(len(to)):
        if t + 1 < len(to):
            _fetch(c, to[t + 1], rows * columns)
            _fetch(a, first[t + 1], rows * inner)
            _fetch(b, second[t + 1], inner * columns)
        steps = (1, rows) if transposed[t] else (inner, 1)
        places = to[t] * rows * columns, first[t] * rows * inner, second[t] * inner * columns
        add_product(c, a, b, places, steps, (rows, inner, columns), weights[t])


@_intrinsic  # type: ignore[untyped-decorator]
def add_product(context: Any, out: Any, left: Any, right: Any, places: Any, steps: Any, shape: Any, weight: Any) -> Any:
    """``out += weight * left @ right`` of shape = (rows, inner, columns), each from its place in a flat array.

    ``out`` and ``right`` are contiguous, neighbours in a column and a row of ``left`` are ``steps`` apart.
    """
    pair, triple = (types.UniTuple(_PLACE, count) for count in (2, 3))  # type: ignore[no-untyped-call]

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        flat = [context.make_array(kind)(context, builder, a).data for kind, a in zip(signature.args[:3], args)]
        places, steps, shape = (cgutils.unpack_tuple(builder, group) for group in args[3:6])  # type: ignore[no-untyped-call]
        _product_code(builder, (flat, places, steps, shape, args[6]))
        return context.get_dummy_value()

    return types.void(out, left, right, triple, pair, triple, out.dtype), generate


@_intrinsic  # type: ignore[untyped-decorator]
def _fetch(context: Any, array: Any, k: Any, size: Any) -> Any:
    """Have the processor read block k of a flat array while it works: a fifth faster where blocks lie far apart."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(array)(context, builder, args[0]).data
        byte, flag = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, flag, flag, flag])
        fetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")  # type: ignore[no-untyped-call]
        line, start = args[1].type(64 * 8 // array.dtype.bitwidth), builder.mul(args[1], args[2])
        with cgutils.for_range_slice(builder, start, builder.add(start, args[2]), line, line.type) as (at, _):
            builder.call(fetch, [builder.bitcast(builder.gep(data, [at]), byte), flag(0), flag(3), flag(1)])
        return context.get_dummy_value()

    return types.void(array, _PLACE, _PLACE), generate


def _product_code(builder: Any, operands: Any) -> None:
    """Tiles of three vectors of columns, of two, one, half a vector, ... for the rest; of four rows, then of one.

    Those narrower than a vector have eight rows first: a sum waits for its last addition, and four are too few to wait.
    """
    *_, (rows, _, columns), weight = operands
    index = rows.type
    lanes = _BITS // (32 if isinstance(weight.type, ir.FloatType) else 64)
    whole = builder.sub(rows, builder.srem(rows, index(_TILE_ROWS)))
    widths = [[lanes] * k for k in range(_TILE_VECTORS, 0, -1)] + [[lanes >> k] for k in range(1, lanes.bit_length())]
    column = index(0)
    for tile in widths:
        width = index(sum(tile))
        end = builder.sub(columns, builder.srem(builder.sub(columns, column), width))
        with cgutils.for_range_slice(builder, column, end, width, index) as (first, _):
            eights = builder.sub(rows, builder.srem(rows, index(2 * _TILE_ROWS))) if sum(tile) < lanes else index(0)
            groups = (2 * _TILE_ROWS, index(0), eights), (_TILE_ROWS, eights, whole), (1, whole, rows)
            for n_rows, top, bottom in groups:
                with cgutils.for_range_slice(builder, top, bottom, index(n_rows), index) as (row, _):
                    _tile_code(builder, operands, [row, first], n_rows, tile)
        column = end


def _tile_code(builder: Any, operands: Any, corner: Any, n_rows: int, lanes: list[int]) -> None:
    """The loop over the inner index, for some rows and neighbouring vectors of so many lanes."""
    flat, places, steps, (_, inner, columns), weight = operands
    index = inner.type

    def sum_of(start: Any, count: Any, step: Any) -> Any:
        return builder.add(start, builder.mul(count, step))

    def vectors(array: Any, start: Any) -> list[Any]:
        pointers = []
        for v, count in enumerate(lanes):
            place = builder.gep(array, [builder.add(start, index(sum(lanes[:v])))])
            pointers.append(builder.bitcast(place, ir.VectorType(weight.type, count).as_pointer()))
        return pointers

    def fused(factor: Any, x: Any, total: Any) -> Any:  # factor * x + total, rounded once where the processor can
        undefined, zeros = ir.Constant(x.type, ir.Undefined), ir.VectorType(ir.IntType(32), x.type.count)(None)
        first = builder.insert_element(undefined, factor, ir.IntType(32)(0))
        everywhere = builder.shuffle_vector(first, undefined, zeros)
        return builder.fadd(builder.fmul(everywhere, x, flags=("contract",)), total, flags=("contract",))

    size = 4 if isinstance(weight.type, ir.FloatType) else 8
    row_numbers = [builder.add(corner[0], index(r)) for r in range(n_rows)]
    starts = [sum_of(places[1], row, steps[0]) for row in row_numbers]
    before, loop, after = builder.block, builder.append_basic_block(), builder.append_basic_block()
    builder.branch(loop)
    builder.position_at_end(loop)
    k = builder.phi(index)
    totals = [[builder.phi(ir.VectorType(weight.type, count)) for count in lanes] for _ in starts]
    right = sum_of(builder.add(places[2], corner[1]), k, columns)
    passing, new = [builder.load(p, align=size) for p in vectors(flat[2], right)], []
    for start, row in zip(starts, totals):
        entry = builder.load(builder.gep(flat[1], [sum_of(start, k, steps[1])]))
        new.append([fused(entry, x, total) for x, total in zip(passing, row)])
    following = builder.add(k, index(1))
    builder.cbranch(builder.icmp_signed("<", following, inner), loop, after)
    k.add_incoming(index(0), before)
    k.add_incoming(following, loop)
    for row, new_row in zip(totals, new):
        for total, value in zip(row, new_row):
            total.add_incoming(ir.Constant(total.type, None), before)
            total.add_incoming(value, loop)
    builder.position_at_end(after)
    for number, new_row in zip(row_numbers, new):
        pointers = vectors(flat[0], sum_of(builder.add(places[0], corner[1]), number, columns))
        for pointer, total in zip(pointers, new_row):
            builder.store(fused(weight, total, builder.load(pointer, align=size)), pointer, align=size)
