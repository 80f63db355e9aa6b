"""Motion that comes back, but in no cycle, may be several actions: it is divided where a somewhat smaller radius divides it."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.segmentation.kernels.layout import Memory
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.kernel import kernel

SMALLER = 0.8
"""The radius may be this share of what it is, so that an activity without a cycle falls into two."""


@kernel
def gaps(s: Memory, first: int, stop: int, radius: float) -> Times:
    """Where frames first..stop-1 (the newest 3 `max_lag` at the most) fall into several: the first frames of all parts but the first."""
    first = max(first, stop - 3 * s.max_lag, s.next_frame - 3 * s.max_lag - s.firm)
    if first >= stop:
        return np.empty(0, np.int64)
    found, stops, m, n = np.empty(stop - first + 2, np.int64), np.empty(stop - first + 2, np.int64), 0, 1
    stops[0] = stop
    while n:
        cut = gap(s, first, stops[n - 1], radius)
        if cut >= 0:
            stops[n] = cut
            n += 1
            continue
        n -= 1
        first = stops[n]
        if n:
            found[m] = first
            m += 1
    return found[:m]


@kernel
def gap(s: Memory, first: int, stop: int, radius: float) -> int:
    """Where frames first..stop-1 fall into two if only nearer ones are neighbours, each with enough that have one; -1: nowhere.

    The widest gap at which they do so, if several: in the middle of the frames across which the nearest neighbours are the same.
    """
    least, most = first + s.mass, stop - s.mass
    if most < least:
        return -1
    across = nearest_across(s, first, stop)
    while True:
        widest, at, until = SMALLER * radius, -1, -1
        c = least
        while c <= most:
            e = c
            while e < most and across[e + 1 - first] == across[c - first]:
                e += 1
            if across[c - first] > widest:
                widest, at, until = across[c - first], c, e
            c = e + 1
        if at < 0:
            return -1
        cut, near = (at + until) // 2, min(widest, radius)
        if has_mass(s, first, cut, near) and has_mass(s, cut, stop, near):
            return int(cut)
        across[at - first : until + 1 - first] = 0.0


@kernel
def nearest_across(s: Memory, first: int, stop: int) -> Samples:
    """By frame, from `first` on: the least distance of a frame before it to one from it on, within `max_lag` and outside of the band."""
    across = np.full(stop - first, math.inf)
    for i in range(first, stop):
        if not known(s, i):
            continue
        least = math.inf
        for c in range(min(stop - 1, i + s.max_lag), i, -1):
            if c - i >= s.band and known(s, c):
                least = min(least, s.rows[c % s.rows.shape[0], c - i])
            across[c - first] = min(across[c - first], least)
    return across


@kernel
def known(s: Memory, i: int) -> bool:
    """Whether frame `i` is known."""
    return bool(s.near[i % s.near.shape[0]] != 2)


@kernel
def has_mass(s: Memory, first: int, stop: int, near: float) -> bool:
    """Whether, of the frames first..stop-1, as many as open an activity have a neighbour among them nearer than `near`."""
    found = 0
    for i in range(first, stop):
        if not known(s, i):
            continue
        for k in range(s.band, s.max_lag + 1):
            before = i - k >= first and known(s, i - k) and s.rows[i % s.rows.shape[0], k] < near
            if before or (i + k < stop and known(s, i + k) and s.rows[(i + k) % s.rows.shape[0], k] < near):
                found += 1
                break
        if found >= s.mass:
            return True
    return False
