"""What compiled rows of operators need of the machine: memory by its address, and the clock that `time.perf_counter_ns` reads."""

from __future__ import annotations

from typing import Any

import numba
import numba.core.types
from numba.extending import intrinsic

from kinegraph.stream.chunk import NS
from kinegraph.stream.kernel import kernel

types: Any = numba.core.types
carray: Any = numba.carray  # type: ignore[attr-defined]

MONOTONIC = 1
"""Linux's name for the clock."""

clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.CPointer(types.int64)))


def _pointer(to: Any) -> Any:
    """A function for compiled code: an address as a pointer to numbers of a kind."""

    @intrinsic
    def pointer(_typing: Any, address: Any) -> Any:
        kind = types.CPointer(to)

        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(kind))

        return kind(types.int64), generate

    return pointer


floats_at = _pointer(types.float64)
longs_at = _pointer(types.int64)


@kernel
def clock(desk: int) -> int:
    """The time now (ns); `desk` is the address of two numbers for the system to write to."""
    clock_gettime(MONOTONIC, longs_at(desk))
    now = carray(longs_at(desk), (2,))
    return now[0] * NS + now[1]  # type: ignore[no-any-return]
