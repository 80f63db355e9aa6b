"""Eigenvalues and eigenvectors of small symmetric matrices, the same bits on every call: Householder's reduction, then implicit QL steps.

LAPACK would do the same, through a BLAS whose threads and kernels are not ours to choose.
"""

from __future__ import annotations

import math

from stream.chunk import Samples
from stream.kernel import kernel

STEPS = 60
"""More than enough for one eigenvalue; two or three are usual."""


@kernel
def symmetric_eigen(a: Samples, n: int, values: Samples, rest: Samples, vectors: Samples) -> None:
    """Eigenvalues of the symmetric matrix `a[:n, :n]` into `values[:n]`, in no order, and its unit eigenvectors into rows of `vectors`.

    `a` is used up; `rest` (>= n,) is room. Source: Householder's reduction and implicit QL as in Golub and Van Loan, chapter 8.
    """
    reduce_to_three_diagonals(a, n, values, rest)
    unfold(a, n, vectors)
    turn_to_one_diagonal(n, values, rest, vectors)


@kernel
def reduce_to_three_diagonals(a: Samples, n: int, values: Samples, rest: Samples) -> None:
    """Reflect `a` until only `values` (its diagonal) and `rest` (beside it) are left; row k keeps its reflection right of the diagonal."""
    for k in range(n - 2):
        size = 0.0
        for j in range(k + 1, n):
            size += a[k, j] * a[k, j]
        beside = -math.copysign(math.sqrt(size), a[k, k + 1])
        values[k], rest[k] = a[k, k], beside
        half = size - beside * a[k, k + 1]
        a[k, k] = half
        if half == 0.0:
            continue
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
    if n > 1:
        values[n - 2], rest[n - 2] = a[n - 2, n - 2], a[n - 2, n - 1]
    values[n - 1], rest[n - 1] = a[n - 1, n - 1], 0.0


@kernel
def unfold(a: Samples, n: int, vectors: Samples) -> None:
    """The product of all reflections that `a` keeps: its columns become the rows of `vectors`."""
    for i in range(n):
        for j in range(n):
            vectors[i, j] = 1.0 if i == j else 0.0
    for k in range(n - 3, -1, -1):
        half = a[k, k]
        if half == 0.0:
            continue
        for i in range(k + 1, n):
            total = 0.0
            for j in range(k + 1, n):
                total += vectors[i, j] * a[k, j]
            total /= half
            for j in range(k + 1, n):
                vectors[i, j] -= total * a[k, j]


@kernel
def turn_to_one_diagonal(n: int, values: Samples, rest: Samples, vectors: Samples) -> None:
    """QL steps with Wilkinson's shift until nothing is left in `rest`; the rows of `vectors` are turned along."""
    for first in range(n):
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
