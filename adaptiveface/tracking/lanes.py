"""Rows of four numbers as one vector of the processor, for compiled functions.

Numba joins the numbers of a long loop to vectors, but not those of a short row. It can be told to (``NUMBA_SLP_VECTORIZE``),
but keeps that switched off, because programs were compiled wrongly by it. Here, the vectors are named instead. Every number is
rounded as if it were on its own, so that no result changes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, config, types
from numba.extending import intrinsic, models, register_model
from numba.np import arrayobj

# Numba has no type hints.
_arrays: Any
_pointers: Any
_settings: Any
_arrays, _pointers, _settings = arrayobj, cgutils, config
#: How many numbers a row has.
LANES = 4


class Row(types.Type):
    """Numba's type of a row of numbers of ``dtype``."""

    def __init__(self, dtype: Any) -> None:
        self.dtype = dtype
        super().__init__(f"Row({dtype})")


@register_model(Row)
class _RowModel(models.PrimitiveModel):
    """How LLVM holds a row: as a vector."""

    def __init__(self, manager: Any, row: Row) -> None:
        vector = ir.VectorType(manager.lookup(row.dtype).get_value_type(), LANES)
        super().__init__(manager, row, vector)  # type: ignore[no-untyped-call]


def _place(context: Any, builder: Any, array_type: Any, array: Any, number: Any) -> tuple[Any, int]:
    """Pointer to a row of an array, and by how many bytes it is aligned."""
    found, item = _arrays.make_array(array_type)(context, builder, array), context.get_value_type(array_type.dtype)
    first = _pointers.get_item_pointer(context, builder, array_type, found, [number, number.type(0)], wraparound=False)
    return builder.bitcast(first, ir.VectorType(item, LANES).as_pointer()), array_type.dtype.bitwidth // 8


def _row(typing_context: Any, array: Any, number: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """Load the vector."""
        pointer, align = _place(context, builder, signature.args[0], *arguments)
        return builder.load(pointer, align=align)

    return Row(array.dtype)(array, types.uintp), generate


def _put(typing_context: Any, array: Any, number: Any, value: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """Store the vector."""
        pointer, align = _place(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], pointer, align=align)
        return context.get_dummy_value()

    return types.void(array, types.uintp, value), generate


def _less(typing_context: Any, value: Any, factor: Any, other: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        """Multiply and subtract, with the factor in all four places if it is a number."""
        first, factors, second = arguments
        if not isinstance(factor, Row):
            empty, zeros = ir.Constant(first.type, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), LANES), None)
            factors = builder.shuffle_vector(builder.insert_element(empty, factors, ir.IntType(32)(0)), empty, zeros)
        return builder.fsub(first, builder.fmul(factors, second))

    return value(value, value if isinstance(factor, Row) else value.dtype, other), generate


def _plain_put(array: np.ndarray, number: int, value: np.ndarray) -> None:
    array[number] = value


_compiled = not _settings.DISABLE_JIT
#: ``row(array, number)``: the row ``array[number]`` of a contiguous array (n, 4).
row: Callable[..., Any] = intrinsic(_row) if _compiled else lambda array, number: array[number].copy()
#: ``put(array, number, value)``: ``array[number] = value`` for a row.
put: Callable[..., None] = intrinsic(_put) if _compiled else _plain_put
#: ``less(value, factor, other)``: the row ``value - factor * other``; ``factor`` is a number, or a row of one for each.
less: Callable[..., Any] = intrinsic(_less) if _compiled else lambda value, factor, other: value - factor * other
