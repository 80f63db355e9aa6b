"""Specs and chunks: what they refuse, what they tell, how they are cut, and that a spec survives its trip through JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.stream.chunk import FOREVER, NEVER, Chunk, StreamSpec, add_lost, empty, utc

EVENT = np.dtype([("onset", "<i8"), ("curve", "<f8", (100, 2)), ("side", "<U5")])
SPECS = [
    StreamSpec((3,), rate_hz=1000.0, channels=("a", "b", "c"), units=("uV", "uV", "g"), settling_s=0.5),
    StreamSpec((240, 320), np.dtype(np.uint16), 30.0, units=("mm",), meta={"site": {"left": [1, 2.5, None, True]}}),
    StreamSpec((4, 3), np.dtype(np.float32), channels=("knee", "hip", "toe", "heel"), units=("m",)),
    StreamSpec((), EVENT, units=("ns", "uV", "")),
    StreamSpec((), np.dtype(">i2")),
]


@pytest.mark.parametrize("spec", SPECS, ids=[s.describe() for s in SPECS])
def test_a_spec_survives_json(spec: StreamSpec) -> None:
    assert StreamSpec.from_json(json.loads(json.dumps(spec.to_json()))) == spec


def test_a_spec_tells_what_it_is() -> None:
    signal, frame, markers, event, _ = SPECS
    assert [s.is_signal for s in SPECS] == [True, False, False, False, False]
    assert [s.is_event for s in SPECS] == [False, False, False, True, False]
    assert event.channels == ("onset", "curve", "side")
    assert (signal.unit_of("c"), frame.unit_of("any"), event.unit_of("onset")) == ("g", "mm", "ns")
    assert (signal.period_ns, frame.period_ns, markers.period_ns) == (1_000_000, 33_333_333, 0)
    assert (frame.sample_bytes, event.sample_bytes) == (240 * 320 * 2, EVENT.itemsize)
    assert signal.describe() == "3 channels float64 at 1000 Hz in uV, g"
    assert event.describe() == "events (onset, curve, side), irregular"
    assert signal.derive(rate_hz=None).rate_hz is None


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"rate_hz": 0.0}, "rate_hz is 0.0"),
        ({"rate_hz": float("nan")}, "rate_hz is nan"),
        ({"rate_hz": -5.0}, "must be positive"),
        ({"channels": ("a", "a", "b")}, "must differ"),
        ({"channels": ("a", "b")}, "2 channel names"),
        ({"units": ("uV", "uV")}, "2 units"),
    ],
)
def test_a_spec_that_cannot_be_is_refused(wrong: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        StreamSpec((3,), **wrong)  # type: ignore[arg-type]


@st.composite
def chunks(draw: st.DrawFn) -> Chunk:
    time = np.sort(np.array(draw(st.lists(st.integers(0, 9), max_size=8)), np.int64))
    least = int(time[-1]) - 1 if len(time) else 0
    lost = draw(st.integers(-1, 3))
    return Chunk(time, np.arange(len(time), dtype=float).reshape(-1, 1), draw(st.integers(least, least + 5)), lost)


@given(chunk=chunks(), data=st.data())
def test_parts_are_the_whole(chunk: Chunk, data: st.DataObject) -> None:
    cuts = sorted(data.draw(st.lists(st.integers(0, len(chunk)), max_size=5)))
    parts = [chunk.part(a, b) for a, b in zip([0, *cuts], [*cuts, len(chunk)], strict=True)]
    assert np.concatenate([p.time for p in parts]).tolist() == chunk.time.tolist()
    assert np.concatenate([p.data for p in parts]).tolist() == chunk.data.tolist()
    if len(chunk):
        assert next(p.lost for p in parts if len(p)) == chunk.lost
        assert sum(p.lost != 0 for p in parts) == (chunk.lost != 0)
    reported = NEVER
    for part in parts:
        assert all(t > reported for t in part.time), "a part holds a sample at or before what was promised complete"
        reported = max(reported, part.until)
    assert parts[-1].until == reported == chunk.until


def test_an_empty_chunk_has_the_shape_of_its_spec() -> None:
    for spec in SPECS:
        chunk = empty(spec, 7, lost=2)
        assert (len(chunk), chunk.until, chunk.lost) == (0, 7, 2)
        assert chunk.data.shape == (0, *spec.shape)
        assert chunk.data.dtype == spec.dtype
        assert chunk.time.dtype == np.int64


@pytest.mark.parametrize(
    ("first", "then", "total"), [(0, 0, 0), (2, 3, 5), (-1, 3, -1), (2, -1, -1), (-1, -1, -1), (0, -1, -1)]
)
def test_lost_samples_add_up(first: int, then: int, total: int) -> None:
    assert add_lost(first, then) == total


def test_stamps_for_people() -> None:
    assert utc(1_700_000_000_123_456_789) == "2023-11-14T22:13:20.123456Z"
    assert utc(FOREVER) == "the end of time"
    assert utc(NEVER) == "before time"
