"""Many Xbus messages of one layout at once: how many of them are whole and right, and the numbers in them.

Compiled, not of numpy's parts: a sensor is read a hundred times a second, each time after the processor did something else, and then a
dozen small numpy calls take ten times as long as in a row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

Bytes = NDArray[np.uint8]

FRACTION_20, FRACTION_32 = 2.0**20, 2.0**32


@kernel
def sound(raw: Bytes, at: int, size: int, most: int, fixed: Times, values: Bytes) -> int:
    """How many messages of `size` bytes follow each other in `raw` from `at`, `most` at most, up to the first that is not right.

    A valid one has bytes after the first that add up to 0 mod 256, and `values` (k,) at `fixed` (k,).
    """
    n = min((len(raw) - at) // size, most)
    for message in range(n):
        begin = at + message * size
        total = 0
        for i in range(begin + 1, begin + size):
            total += raw[i]
        if total & 0xFF:
            return message
        for k in range(len(fixed)):
            if raw[begin + fixed[k]] != values[k]:
                return message
    return n


@kernel
def integers(table: Bytes, at: int, size: int, out: Times) -> None:
    """The whole number of `size` bytes from byte `at` on, big-endian, of every message (n, bytes): `out` (n,)."""
    for i in range(len(out)):
        value = 0
        for k in range(at, at + size):
            value = value << 8 | table[i, k]
        out[i] = value


@kernel
def reals(table: Bytes, places: NDArray[np.int64], out: Samples) -> None:
    """Quantities of every message (n, bytes) side by side in `out` (n, components).

    places (k, 3): a quantity's first byte, its components, its format (0: 32 bits, 1: 12.20, 2: 16.32, 3: 64 bits).
    """
    word, double = np.zeros(1, np.uint32), np.zeros(1, np.uint64)
    single, real = word.view(np.float32), double.view(np.float64)
    for i in range(len(out)):
        column = 0
        for q in range(len(places)):
            at, form = places[q, 0], places[q, 2]
            for _ in range(places[q, 1]):
                size = 4 if form < 2 else 6 if form == 2 else 8
                bits = np.uint64(0)
                for k in range(at, at + size):
                    bits = bits << np.uint64(8) | np.uint64(table[i, k])
                at += size
                if form == 0:
                    word[0] = bits
                    out[i, column] = single[0]
                elif form == 1:
                    out[i, column] = np.int32(bits) / FRACTION_20
                elif form == 2:  # 32 bits of fraction, then 16 signed bits of whole numbers
                    whole = np.int64(np.int16(bits & np.uint64(0xFFFF)))
                    out[i, column] = whole + np.float64(bits >> np.uint64(16)) / FRACTION_32
                else:
                    double[0] = bits
                    out[i, column] = real[0]
                column += 1


def prepare() -> None:
    """Compile them, or take them from the cache."""
    raw = np.frombuffer(bytes(8), np.uint8)
    table = raw.reshape(1, 8)
    sound(raw, 0, 8, 1, np.zeros(1, np.int64), np.zeros(1, np.uint8))
    integers(table, 0, 2, np.empty(1, np.int64))
    reals(table, np.array([[0, 1, 0]]), np.empty((1, 1)))
