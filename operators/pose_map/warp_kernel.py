"""Subsequence warping: where in a stretch of motion another one is found, at any pace from half to twice its own (thesis, 5.3.4)."""

from __future__ import annotations

import math

from stream.chunk import Array, Samples, Times
from stream.kernel import kernel


@kernel
def warp(query: Array, there: Array, weights: Samples, cost: Samples, start: Times, out: Samples) -> None:
    """Find `query` (l, w) in `there` (n, w): out = [first, last, distance], the best first and last frame of `there`.

    Steps are (1, 1), (1, 2) and (2, 1), so the match is half to twice as long as the query. The distance is the root of the mean, over the
    query's frames, of the weighted squared distances along the path; infinite where none fits or all that would hold a NaN.

    cost (3, n), start (3, n)   room: of the three newest frames of the query, the least sum so far and where its path begins
    """
    length, n = query.shape[0], there.shape[0]
    for i in range(length):
        now, one, two = i % 3, (i - 1) % 3, (i - 2) % 3
        for j in range(n):
            apart = 0.0
            for c in range(query.shape[1]):
                off = query[i, c] - there[j, c]
                apart += weights[c] * off * off
            if not apart < math.inf:
                cost[now, j] = math.inf
                start[now, j] = -1
                continue
            if i == 0:
                cost[now, j], start[now, j] = apart, j
                continue
            best, begin = math.inf, -1
            if j >= 1 and cost[one, j - 1] < best:
                best, begin = cost[one, j - 1], start[one, j - 1]
            if j >= 2 and cost[one, j - 2] < best:
                best, begin = cost[one, j - 2], start[one, j - 2]
            if i >= 2 and j >= 1 and cost[two, j - 1] + apart < best:
                best, begin = cost[two, j - 1] + apart, start[two, j - 1]
            cost[now, j], start[now, j] = best + apart, begin
    out[0], out[1], out[2] = -1.0, -1.0, math.inf
    row = (length - 1) % 3
    for j in range(n):
        if cost[row, j] < out[2]:
            out[0], out[1], out[2] = start[row, j], j, cost[row, j]
    out[2] = math.sqrt(out[2] / length)


@kernel
def far_apart(starts: Times, least: int, out: Times) -> int:
    """Take from `starts` (n,), in their order, each that is at least `least` from all taken before it, into `out`; returns how many fit."""
    count = 0
    for start in starts:
        near = False
        for k in range(count):
            near = near or abs(start - out[k]) < least
        if not near:
            out[count] = start
            count += 1
            if count == out.shape[0]:
                break
    return count
