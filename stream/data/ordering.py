"""Order statistics for kernels: numpy's sort and median each take a second to compile, these a tenth of one."""

from __future__ import annotations

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel


@kernel
def select(values: Samples, count: int, place: int) -> float:
    """The value at `place` were the first `count` values in order (Hoare's method). Moves it there: no smaller one is behind it, no greater
    one before it.

    >>> select(np.array([5.0, 1.0, 4.0, 2.0]), 4, 1)
    2.0
    """
    low, high = 0, count - 1
    while low < high:
        pivot, i, j = values[place], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < place:
            low = i
        if place < i:
            high = j
    return float(values[place])


@kernel
def median(values: Samples, count: int) -> float:
    """Of the first `count` > 0 values, which change places; as numpy's to the bit.

    >>> median(np.array([5.0, 1.0, 4.0, 2.0]), 4)
    3.0
    """
    half = count // 2
    upper = select(values, count, half)
    if count % 2:
        return upper
    lower: float = values[0]
    for i in range(1, half):
        lower = max(lower, values[i])
    return (lower + upper) / 2.0
