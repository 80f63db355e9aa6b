"""Threshold events against a plain reading of their rules."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from kinegraph.operators.filters.threshold import Threshold
from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import grid

SPEC = StreamSpec((1,), rate_hz=1000.0, channels=("force",), units=("N",))
MS = 1_000_000


def events(operator, values, *, cuts=(), lost=None, time=None):
    """({output: events as tuples in ms from the first sample}, {output: stamps in ms}, {output: lost})."""
    data = np.asarray(values, dtype=float)[:, None]
    time = grid(1000.0, len(data)) if time is None else time
    operator = operator.unopened()
    operator.open({"in": SPEC})
    found, stamps, marks = {"onset": [], "interval": []}, {"onset": [], "interval": []}, {"onset": [], "interval": []}
    places = sorted({0, len(data), *cuts, *(lost or {})})
    for start, stop in pairwise(places):
        until = FOREVER if stop == len(data) else int(time[stop]) - 1
        chunk = Chunk(time[start:stop], data[start:stop], until, (lost or {}).get(start, 0))
        for name, made in operator.process("in", chunk):
            stamps[name] += [(t - time[0]) // MS for t in made.time.tolist()]
            marks[name].append(made.lost)
            for event in made.data.tolist():
                found[name].append(((event[0] - time[0]) // MS, *((v - time[0]) // MS for v in event[1:2]), *event[2:]))
    return found, stamps, marks


SQUARE = [0, 0, 30, 40, 30, 10, 0, 0, 25, 0, 0, 50, 50, 50]


@pytest.mark.parametrize("cuts", [(), (3, 5, 6), range(14)])
def test_intervals_begin_at_the_level_and_end_behind_the_release(cuts):
    found, stamps, _ = events(Threshold(level=20.0), SQUARE, cuts=cuts)
    assert found == {"onset": [(2,), (8,), (11,)], "interval": [(2, 5, 40.0), (8, 9, 25.0)]}
    assert stamps == {"onset": [2, 8, 11], "interval": [5, 9]}
    found, _, _ = events(Threshold(level=20.0, release=5.0), SQUARE, cuts=cuts)
    assert found["interval"] == [(2, 6, 40.0), (8, 9, 25.0)]


def test_short_intervals_are_passed_over_and_long_ones_decided_late():
    found, stamps, _ = events(Threshold(level=20.0, min_duration_s=0.002), SQUARE)
    assert found == {"onset": [(2,), (11,)], "interval": [(2, 5, 40.0)]}
    assert stamps["onset"] == [4, 13]


def test_after_an_interval_a_new_crossing_must_wait():
    found, _, _ = events(Threshold(level=20.0, refractory_s=0.004), SQUARE)
    assert found["onset"] == [(2,), (11,)]
    long = [0, 30, 0, *[30] * 20, 0, 30]
    found, _, _ = events(Threshold(level=20.0, refractory_s=0.005), long)
    assert found["onset"] == [(1,), (24,)]


def test_below_is_the_mirror_of_above():
    mirrored, _, _ = events(Threshold(level=-20.0, release=-5.0, direction="below"), [-v for v in SQUARE])
    found, _, _ = events(Threshold(level=20.0, release=5.0), SQUARE)
    assert mirrored["onset"] == found["onset"]
    assert mirrored["interval"] == [(a, b, -peak) for a, b, peak in found["interval"]]


def test_an_interval_whose_beginning_was_not_seen_is_not_reported():
    found, _, _ = events(Threshold(level=20.0), [30, 30, 0, 30, 0])
    assert found == {"onset": [(3,)], "interval": [(3, 4, 30.0)]}


def test_a_long_gap_ends_an_interval_unreported():
    time = grid(1000.0, 200)
    values = np.array([0, 30, 30, 30, 0, 30, 0])
    short = np.r_[time[:3], time[50:54]]
    found, _, marks = events(Threshold(level=20.0), values, time=short, lost={3: 47})
    assert found["interval"] == [(1, 51, 30.0), (52, 53, 30.0)] and marks["interval"] == [0, -1]
    found, _, _ = events(Threshold(level=20.0, reset_gap_s=0.01), values, time=short, lost={3: 47})
    assert found["interval"] == [(52, 53, 30.0)]


def test_bad_samples_change_nothing():
    found, _, _ = events(Threshold(level=20.0), [0, 30, np.nan, -np.inf, np.inf, 30, 0])
    assert found == {"onset": [(1,)], "interval": [(1, 6, 30.0)]}


def test_what_cannot_be_is_refused():
    with pytest.raises(ParameterError, match=r"release is 30\.0; it must be at most level, which is 20"):
        Threshold(level=20.0, release=30.0).open({"in": SPEC})
    with pytest.raises(ParameterError, match=r"channel is empty; it must be one of 'left', 'right'"):
        Threshold(level=20.0).open({"in": StreamSpec((2,), channels=("left", "right"))})
