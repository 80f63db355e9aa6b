"""Subsequence warping: where in a stretch of motion another one is found, at any pace from half to twice its own (thesis, 5.3.4)."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.pose_map import MISSING
from kinegraph.stream.kernel import kernel


@kernel
def warp_all(
    poses: Array, columns: Times, unit: float, stride: int, begins: Times, ends: Times, query: Samples, weights: Samples,
    there: Samples, cost: Samples, start: Times, out: Samples,
) -> None:  # fmt: skip
    """Find `query` (l, w) in each region `begins[r]` to `ends[r] - 1` of an index, every `stride`-th frame: `out` (r, 3) as of `warp`.

    poses, columns, unit  as in MotionIndex: the numbers that count, in steps of `unit`
    there (w, n), cost (4, n), start (3, n)   room for the longest region
    """
    for r in range(begins.shape[0]):
        n = min((ends[r] - begins[r] + stride - 1) // stride, there.shape[1])
        for j in range(n):
            frame = begins[r] + j * stride
            for c in range(columns.shape[0]):
                found = poses[frame, columns[c]]
                there[c, j] = math.nan if found == MISSING else found * unit
        warp(query, there, n, weights, cost, start, out[r])


@kernel
def warp(query: Samples, there: Samples, n: int, weights: Samples, cost: Samples, start: Times, out: Samples) -> None:
    """Find `query` (l, w) in the first `n` columns of `there` (w, n): out = [first, last, distance], the best first and last column.

    Steps are (1, 1), (1, 2) and (2, 1), so the match is half to twice as long as the query. The distance is the root of the mean, over the
    query's frames, of the weighted squared distances along the path; infinite where no path fits or all contain a NaN.

    cost (4, n), start (3, n)   room: of the three newest frames of the query the least sum so far, and where its path begins; the last
                                row of `cost` holds the squared distances of one frame
    """
    length, apart = query.shape[0], cost[3]
    for i in range(length):
        now, one, two = i % 3, (i - 1) % 3, (i - 2) % 3
        distances_to(query[i], there, n, weights, apart)
        for j in range(n):
            if not apart[j] < math.inf:
                cost[now, j] = math.inf
                start[now, j] = -1
                continue
            if i == 0:
                cost[now, j], start[now, j] = apart[j], j
                continue
            best, begin = math.inf, -1
            if j >= 1 and cost[one, j - 1] < best:
                best, begin = cost[one, j - 1], start[one, j - 1]
            if j >= 2 and cost[one, j - 2] < best:
                best, begin = cost[one, j - 2], start[one, j - 2]
            if i >= 2 and j >= 1 and cost[two, j - 1] + apart[j] < best:
                best, begin = cost[two, j - 1] + apart[j], start[two, j - 1]
            cost[now, j], start[now, j] = best + apart[j], begin
    out[0], out[1], out[2] = -1.0, -1.0, math.inf
    row = (length - 1) % 3
    for j in range(n):
        if cost[row, j] < out[2]:
            out[0], out[1], out[2] = start[row, j], j, cost[row, j]
    out[2] = math.sqrt(out[2] / length)


@kernel
def distances_to(x: Samples, there: Samples, n: int, weights: Samples, apart: Samples) -> None:
    """Weighted squared distances of `x` (w,) to each column of `there` (w, n), summed feature by feature, all columns side by side."""
    apart[:n] = 0.0
    for c in range(x.shape[0]):
        at, weight, row = x[c], weights[c], there[c]
        for j in range(n):
            off = at - row[j]
            apart[j] += weight * off * off


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
