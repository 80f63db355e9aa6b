"""A stream in memory, joined from its chunks: what is missing before each sample, and nothing that was not."""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.data.arrays import series
from kinegraph.stream.data.series import Series

SPEC = StreamSpec((2,), rate_hz=10.0)


def joined(*chunks: tuple[int, int]) -> Series:
    """Of chunks given as (how many samples, how many were lost before them)."""
    made, at = [], 0
    for samples, lost in chunks:
        at += max(lost, 0)
        time = (at + np.arange(samples)) * 100_000_000
        made.append(Chunk(time, np.stack([time, -time], axis=1) / 1e9, at * 100_000_000, lost))
        at += samples
    return Series.of_chunks("x", SPEC, made)


def test_what_was_lost_stands_at_the_first_sample_after_it() -> None:
    series = joined((2, 0), (3, 4), (1, 0), (2, -1))
    assert series.lost is not None and series.lost.tolist() == [0, 0, 4, 0, 0, 0, -1, 0]
    assert series.time.tolist() == [k * 100_000_000 for k in (0, 1, 6, 7, 8, 9, 10, 11)]
    assert np.array_equal(series.data[:, 0] * 1e9, series.time) and np.array_equal(
        series.data[:, 1], -series.data[:, 0]
    )


def test_losses_of_chunks_without_samples_are_added_to_the_next() -> None:
    series = joined((1, 0), (0, 2), (0, 0), (1, 3), (1, 0))
    assert series.lost is not None and series.lost.tolist() == [0, 5, 0]
    unknown = joined((1, 0), (0, -1), (1, 3))
    assert unknown.lost is not None and unknown.lost.tolist() == [0, -1]


def test_where_nothing_was_lost_nothing_is_said_of_it() -> None:
    for one in (joined((3, 0), (0, 0), (2, 0)), joined((0, 0)), joined()):
        assert one.lost is None and len(one) == len(one.data)
    assert joined().data.shape == (0, 2)


def test_numbers_in_a_row_are_one_channel_and_events_in_a_row_are_events() -> None:
    events = np.zeros(5, [("onset", "<i8"), ("end", "<i8")])
    assert series(np.zeros(5), rate_hz=10.0).data.shape == (5, 1)
    assert series(events, time=np.arange(5) * NS).data.shape == (5,)
