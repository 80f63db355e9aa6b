"""Eigenvalues and eigenvectors of small symmetric matrices, the same bits on every call: Householder's reduction, then implicit QL steps.

LAPACK would do the same, through a BLAS with threads and kernels outside our control.
"""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

STEPS = 60
"""More than enough for one eigenvalue; two or three are usual."""


@kernel
def symmetric_eigen(a: Samples, n: int, values: Samples, rest: Samples, vectors: Samples) -> None:
    """Eigenvalues of the symmetric matrix `a[:n, :n]` into `values[:n]`, in no order, and its unit eigenvectors into rows of `vectors`.

    `a` is used up; `rest` (>= n,) is room. Source: Householder's reduction and implicit QL as in Golub and Van Loan, chapter 8.
    """
    for part in range(3 * n):
        eigen_part(part, a, n, values, rest, vectors)


@kernel
def eigen_part(part: int, a: Samples, n: int, values: Samples, rest: Samples, vectors: Samples) -> None:
    """One of the 3 n parts of `symmetric_eigen`, for whoever spreads it over frames: all parts in turn are the same work, bit for bit."""
    if part < n:
        reduce_row(part, a, n, values, rest)
    elif part < 2 * n:
        unfold_row(2 * n - 1 - part, a, n, vectors)
    else:
        find_value(part - 2 * n, n, values, rest, vectors)


@kernel
def reduce_row(k: int, a: Samples, n: int, values: Samples, rest: Samples) -> None:
    """Reflect `a` until row `k` has only its diagonal (`values`) and what is beside it (`rest`) left; it keeps its reflection.

    After all rows `values` and `rest` are a matrix of three diagonals.
    """
    if k >= n - 2:
        values[k], rest[k] = a[k, k], a[k, k + 1] if k == n - 2 else 0.0
        return
    size = 0.0
    for j in range(k + 1, n):
        size += a[k, j] * a[k, j]
    beside = -math.copysign(math.sqrt(size), a[k, k + 1])
    values[k], rest[k] = a[k, k], beside
    half = size - beside * a[k, k + 1]
    a[k, k] = half
    if half == 0.0:
        return
    a[k, k + 1] -= beside
    along = 0.0
    for i in range(k + 1, n):
        total = 0.0
        for j in range(k + 1, n):
            total += a[i, j] * a[k, j]
        rest[i] = total / half
        along += rest[i] * a[k, i]
    for i in range(k + 1, n):
        rest[i] -= along / (2.0 * half) * a[k, i]
    for i in range(k + 1, n):
        for j in range(k + 1, n):
            a[i, j] -= a[k, i] * rest[j] + rest[i] * a[k, j]


@kernel
def unfold_row(k: int, a: Samples, n: int, vectors: Samples) -> None:
    """Multiply in the reflection that row `k` of `a` keeps, the last row first: the product's columns become the rows of `vectors`."""
    if k == n - 1:
        for i in range(n):
            for j in range(n):
                vectors[i, j] = 1.0 if i == j else 0.0
    if k >= n - 2 or a[k, k] == 0.0:
        return
    for i in range(k + 1, n):
        total = 0.0
        for j in range(k + 1, n):
            total += vectors[i, j] * a[k, j]
        total /= a[k, k]
        for j in range(k + 1, n):
            vectors[i, j] -= total * a[k, j]


@kernel
def find_value(first: int, n: int, values: Samples, rest: Samples, vectors: Samples) -> None:
    """QL steps with Wilkinson's shift until nothing is left beside value `first`; the rows of `vectors` are turned along."""
    for _ in range(STEPS):
        last = first
        while last < n - 1:
            beside = abs(values[last]) + abs(values[last + 1])
            if abs(rest[last]) + beside == beside:
                break
            last += 1
        if last == first:
            break
        g = (values[first + 1] - values[first]) / (2.0 * rest[first])
        g = values[last] - values[first] + rest[first] / (g + math.copysign(math.hypot(g, 1.0), g))
        s, c, p = 1.0, 1.0, 0.0
        i = last - 1
        while i >= first:
            f, b = s * rest[i], c * rest[i]
            r = math.hypot(f, g)
            rest[i + 1] = r
            if r == 0.0:
                values[i + 1] -= p
                rest[last] = 0.0
                break
            s, c = f / r, g / r
            g = values[i + 1] - p
            r = (values[i] - g) * s + 2.0 * c * b
            p = s * r
            values[i + 1] = g + p
            g = c * r - b
            for j in range(n):
                above, below = vectors[i, j], vectors[i + 1, j]
                vectors[i + 1, j] = s * above + c * below
                vectors[i, j] = c * above - s * below
            i -= 1
        if i < first:
            values[first] -= p
            rest[first] = g
            rest[last] = 0.0
