"""Streams joined on time, against a plain reference that sees them whole."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from kinegraph.operators.timing.align import Align
from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import ANY, Input, grid

MS = 1_000_000


def value_at(t, time, column, method, furthest):
    """One stream's value at `t`, and whether there is one."""
    before, after = np.flatnonzero(time <= t), np.flatnonzero(time > t)
    left = before[-1] if len(before) and t - time[before[-1]] <= furthest else None
    right = after[0] if len(after) and time[after[0]] - t <= furthest else None
    if left is not None and time[left] == t:
        return column[left]
    if method == "hold":
        return None if left is None else column[left]
    if method == "nearest":
        near = [k for k in (left, right) if k is not None]
        return column[min(near, key=lambda k: abs(int(time[k]) - t))] if near else None
    if left is None or right is None:
        return None
    share = (t - int(time[left])) / (int(time[right]) - int(time[left]))
    return column[left] + share * (column[right] - column[left])


def joined(operator, streams, specs):
    """Rows that must come out: (stamps, rows)."""
    first = next(iter(streams))
    if operator.rate_hz:
        start = min(int(time[0]) for time, _ in streams.values())
        end = max(int(time[-1]) for time, _ in streams.values()) + 10**9
        targets = [
            start + round(k * 1e9 / operator.rate_hz) for k in range(round((end - start) / 1e9 * operator.rate_hz))
        ]
    else:
        targets = streams[first][0].tolist()
    stamps, rows = [], []
    for i, t in enumerate(targets):
        row, near = [], False
        for port, (time, data) in streams.items():
            furthest = round((operator.max_distance_s or 1.5 / specs[port].rate_hz) * 1e9)
            for column in data.T:
                found = (
                    column[i]
                    if port == first and not operator.rate_hz
                    else value_at(t, time, column, operator.method, furthest)
                )
                near |= found is not None
                row.append(np.nan if found is None else found)
        if near or not operator.rate_hz:
            stamps.append(t)
            rows.append(row)
    return np.array(stamps), np.array(rows)


def run(operator, streams, specs, seed=None, lost=None, *, in_turn=False):
    """(output's spec, stamps, rows, {row: lost}), with the streams cut and interleaved at random, merged as the engine does it."""
    operator = operator.unopened()
    made = operator.open(specs)["out"]
    merge = Merge(specs, {ANY: Input(in_turn=in_turn)}) if len(specs) > 1 else None
    rng = np.random.default_rng(seed)
    waiting = {port: pieces(rng, port, *stream, lost or {}) for port, stream in streams.items()}
    emitted = []
    while any(waiting.values()):
        port = rng.choice([name for name, chunks in waiting.items() if chunks])
        chunk = waiting[port].pop(0)
        for name, piece in merge.push(port, chunk) if merge else [(port, chunk)]:
            emitted.append(operator.process(name, piece))
    emitted.append(operator.close())
    stamps, rows, marks, promised, owed = [], [], {}, None, 0
    for given in emitted:
        for chunk in [given] if isinstance(given, Chunk) else [piece for _, piece in given or ()]:
            assert promised is None or not len(chunk.time) or chunk.time[0] > promised
            owed += chunk.lost
            if len(chunk.time) and owed:
                marks[sum(map(len, stamps))], owed = owed, 0
            promised = chunk.until if promised is None else max(promised, chunk.until)
            stamps.append(chunk.time)
            rows.append(chunk.data)
    return made, np.concatenate(stamps), np.concatenate(rows), marks


def pieces(rng, port, time, data, lost):
    cuts = {*rng.integers(0, len(time), 25).tolist(), *(k for name, k in lost if name == port)}
    places = sorted({0, len(time), *cuts})
    made = []
    for a, b in pairwise(places):
        until = FOREVER if b == len(time) else int(time[b]) - 1
        made.append(Chunk(time[a:b], data[a:b], until, lost.get((port, a), 0)))
    return made


def three(seed):
    """A regular stream, a slower one, and an irregular one with equal stamps, a pause and bad samples."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.integers(1000, 3000, 80)) * MS
    times = times[(times < 1800 * MS) | (times > 2200 * MS)]
    times[10] = times[11]
    plate = rng.normal(size=(len(times), 1))
    plate[20] = np.nan
    streams = {
        "emg": (grid(100.0, 200), rng.normal(size=(200, 2))),
        "foot.accel": (grid(37.0, 70) + 3 * MS, rng.normal(size=(70, 3))),
        "plate": (times, plate),
    }
    specs = {
        "emg": StreamSpec(
            (2,), rate_hz=100.0, channels=("x", "b"), units=("uV",), settling_s=0.2, meta={"side": "left"}
        ),
        "foot.accel": StreamSpec((3,), rate_hz=37.0, channels=("x", "y", "z"), units=("g",)),
        "plate": StreamSpec((1,), units=("N",), settling_s=0.1),
    }
    return streams, specs


@pytest.mark.parametrize("rate_hz", [None, 64.0])
@pytest.mark.parametrize("method", ["linear", "hold", "nearest"])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("in_turn", [False, True])
def test_rows_are_those_of_a_plain_reference(rate_hz, method, seed, in_turn):
    streams, specs = three(seed)
    operator = Align(rate_hz=rate_hz, method=method, max_distance_s=0.03)
    made, stamps, rows, _ = run(operator, streams, specs, seed, in_turn=in_turn)
    expected_stamps, expected = joined(operator, streams, specs)
    assert np.array_equal(stamps, expected_stamps)
    assert np.array_equal(rows, expected, equal_nan=True)
    assert rows.shape[1:] == made.shape == (6,)
    assert np.isnan(rows).any() and np.isfinite(rows).all(axis=1).any()


def test_the_joined_spec_names_every_channel():
    _, specs = three(0)
    made = Align(max_distance_s=0.1).open(specs)["out"]
    assert made.channels == ("emg.x", "b", "foot.accel.x", "y", "z", "plate.0")
    assert made.units == ("uV", "uV", "g", "g", "g", "N")
    assert made.rate_hz == 100.0 and made.settling_s == 0.2 and made.meta == {"side": "left"}
    assert Align(max_distance_s=0.1, rate_hz=60.0).open(specs)["out"].rate_hz == 60.0


def test_by_default_samples_count_for_one_and_a_half_periods():
    streams, specs = three(0)
    streams, specs = ({name: one[name] for name in ("emg", "foot.accel")} for one in (streams, specs))
    operator = Align()
    _, stamps, rows, _ = run(operator, streams, specs, 1)
    expected_stamps, expected = joined(operator, streams, specs)
    assert np.array_equal(stamps, expected_stamps) and np.array_equal(rows, expected, equal_nan=True)
    operator.open(specs)
    assert operator.delay_s == pytest.approx(1.5 / 37.0)
    holding = Align(method="hold")
    holding.open(specs)
    assert holding.delay_s == 0.0


def test_gaps_of_the_first_stream_are_passed_on_and_those_of_others_show_as_nan():
    streams, specs = three(0)
    streams, specs = ({name: one[name] for name in ("emg", "foot.accel")} for one in (streams, specs))
    time, data = streams["emg"]
    keep = np.r_[0:50, 60:200]
    streams["emg"] = time[keep], data[keep]
    time, data = streams["foot.accel"]
    keep = np.r_[0:40, 50:70]
    streams["foot.accel"] = time[keep], data[keep]
    _, stamps, rows, marks = run(Align(), streams, specs, 2, lost={("emg", 50): 10, ("foot.accel", 40): -1})
    assert marks == {50: 10}
    hidden = (stamps > time[40]) & (stamps < time[49])
    assert np.isnan(rows[hidden, 2:]).any() and np.isfinite(rows[hidden, :2]).all()


def test_a_grid_passes_over_a_time_without_samples_and_counts_its_rows():
    specs = {"a": StreamSpec((1,), rate_hz=100.0), "b": StreamSpec((1,), rate_hz=100.0)}
    time = np.r_[grid(100.0, 50), grid(100.0, 50) + 3600 * 10**9]
    data = np.arange(100.0)[:, None]
    _, stamps, rows, marks = run(Align(rate_hz=50.0), {"a": (time, data), "b": (time, -data)}, specs)
    assert np.array_equal(stamps, np.r_[time[:50:2], time[50::2]])
    assert np.array_equal(rows[:, 0], -rows[:, 1])
    assert marks == {25: 3600 * 50 - 25}


def test_a_silent_stream_holds_nothing_up():
    specs = {"a": StreamSpec((1,), rate_hz=100.0), "b": StreamSpec((1,), rate_hz=100.0)}
    operator = Align(max_distance_s=0.05)
    operator.open(specs)
    time = grid(100.0, 10)
    for i in range(10):
        chunk = operator.process("a", Chunk(time[i : i + 1], np.ones((1, 1)), int(time[i])))
    assert chunk.until == time[5] - 1 and chunk.time.tolist() == [time[4]] and np.isnan(chunk.data[0, 1])


def test_one_stream_alone_passes():
    specs = {"a": StreamSpec((2,), rate_hz=100.0, channels=("u", "v"))}
    data = np.random.default_rng(0).normal(size=(80, 2))
    made, stamps, rows, _ = run(Align(), {"a": (grid(100.0, 80), data)}, specs)
    assert made.channels == ("u", "v") and np.array_equal(rows, data) and np.array_equal(stamps, grid(100.0, 80))


def test_what_cannot_be_joined_is_refused():
    with pytest.raises(InputError, match=r"input 'b' is 4 x 3 .*; it must be a signal of channels"):
        Align().open({"a": StreamSpec((1,), rate_hz=9.0), "b": StreamSpec((4, 3), rate_hz=9.0)})
    with pytest.raises(ParameterError, match=r"max_distance_s is empty; it must be given, as input 'b' is irregular"):
        Align().open({"a": StreamSpec((1,), rate_hz=9.0), "b": StreamSpec((1,))})
