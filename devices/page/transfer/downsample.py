"""Signals thinned out to what a screen can show: per bucket of time the least and the greatest value, and gaps as gaps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Array, Times


class Curve(NamedTuple):
    """What is drawn of a signal.

    time   (n,) int64        ns; where a bucket begins, or each sample's stamp
    low    (n, c) float32    the least value; a row of NaN is a gap
    high   (n, c) float32    the greatest value; None where each sample is there itself
    """

    time: Times
    low: NDArray[np.float32]
    high: NDArray[np.float32] | None


def as_rows(data: Array) -> Array:
    """Samples (n, *shape) as (n, width), also for n = 0."""
    return data.reshape(len(data), int(np.prod(data.shape[1:])))


def breaks(time: Times, lost: int, before: int | None, period_ns: int) -> NDArray[np.bool_]:
    """Before which samples of a chunk the line is interrupted: something is `lost`, or a regular stream's stamps leave a hole.

    before      the stamp of the sample before the chunk, or None
    period_ns   0: an irregular stream, where no gap can be seen
    """
    found = np.zeros(len(time), np.bool_)
    if not len(time):
        return found
    if period_ns:
        found[1:] = np.diff(time) > 2 * period_ns
        found[0] = before is not None and time[0] - before > 2 * period_ns
    found[0] |= lost != 0
    return found


def thinned(time: Times, data: Array, broken: NDArray[np.bool_], width_ns: int) -> Curve:
    """Samples `data` (n, c) in buckets of `width_ns` on a grid that does not depend on where the samples were cut; 0: as they are.

    A value that is not finite is left out of its bucket; a bucket without any, and what lies before a `broken` sample, is a gap.
    """
    rows = np.where(np.isfinite(data), data, np.nan).astype(np.float32)
    if not width_ns:
        time, rows = _with_gaps(time, np.flatnonzero(broken), rows)
        return Curve(time, rows, None)
    if not len(time):
        return Curve(time, rows, rows)
    bucket = time // width_ns
    starts = np.flatnonzero(np.diff(bucket, prepend=bucket[0] - 1))
    begin, low, high = bucket[starts] * width_ns, np.fmin.reduceat(rows, starts), np.fmax.reduceat(rows, starts)
    at = np.unique(np.searchsorted(starts, np.flatnonzero(broken), side="right") - 1)
    gaps, low = _with_gaps(begin, at, low)
    return Curve(gaps, low, _with_gaps(begin, at, high)[1])


def _with_gaps(time: Times, at: NDArray[np.intp], rows: NDArray[np.float32]) -> tuple[Times, NDArray[np.float32]]:
    """A row of NaN before each row that is named in `at`, with its stamp."""
    return (np.insert(time, at, time[at]), np.insert(rows, at, np.nan, axis=0)) if len(at) else (time, rows)
