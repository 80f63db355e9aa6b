"""Several inputs, one order: whatever the interleaving and the cutting, the same samples in the same order, and no untrue `until`."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.stream.chunk import FOREVER, NEVER, Chunk, StreamSpec, empty
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.operator import ANY, Input

SPEC = StreamSpec((1,))
Row = tuple[str, int, float, int]
"""Port, stamp, value, lost."""


@st.composite
def streams(draw: st.DrawFn) -> dict[str, list[tuple[int, int]]]:
    """Per port: (stamp, lost) of every sample, with many ties within and between ports."""
    sample = st.tuples(st.integers(0, 12), st.sampled_from([0, 0, 0, 2, -1]))
    return {
        port: sorted(draw(st.lists(sample, max_size=12)), key=lambda s: s[0])
        for port in draw(st.sampled_from(["ab", "abc"]))
    }


@st.composite
def deliveries(draw: st.DrawFn, samples: dict[str, list[tuple[int, int]]]) -> list[tuple[str, Chunk]]:
    """The streams cut anywhere, with empty chunks, each `until` anywhere it may be, and the ports in any turn."""
    waiting = {port: list(_cut(draw, rows)) for port, rows in samples.items()}
    order = []
    while waiting := {port: chunks for port, chunks in waiting.items() if chunks}:
        port = draw(st.sampled_from(sorted(waiting)))
        order.append((port, waiting[port].pop(0)))
    return order


def _cut(draw: st.DrawFn, rows: list[tuple[int, int]]) -> list[Chunk]:
    """A `lost` begins a chunk, as chunks have it only before their first sample."""
    begins = {i for i, (_, lost) in enumerate(rows) if lost}
    cuts = sorted([*begins, *draw(st.lists(st.integers(0, len(rows)), max_size=6))])
    chunks, entries = [], NEVER
    for start, stop in zip([0, *cuts], [*cuts, len(rows)], strict=True):
        time = np.array([t for t, _ in rows[start:stop]], np.int64)
        highest = rows[stop][0] - 1 if stop < len(rows) else 15
        entries = max(entries, draw(st.integers(min(time[-1] if len(time) else -1, highest), highest)))
        lost = rows[start][1] if stop > start else 0
        chunks.append(Chunk(time, np.arange(start, stop, dtype=float).reshape(-1, 1), entries, lost))
    return [*chunks, empty(SPEC, FOREVER)]


def rows_of(pieces: list[tuple[str, Chunk]]) -> list[Row]:
    return [
        (port, int(t), float(v), piece.lost if i == 0 else 0)
        for port, piece in pieces
        for i, (t, v) in enumerate(zip(piece.time, piece.data[:, 0], strict=True))
    ]


def in_order(samples: dict[str, list[tuple[int, int]]]) -> list[Row]:
    """What must come out: sorted by time, then port, then place in the stream."""
    rows = [(t, p, i, lost) for p, port in enumerate(samples) for i, (t, lost) in enumerate(samples[port])]
    ports = list(samples)
    return [(ports[p], t, float(i), lost) for t, p, i, lost in sorted(rows)]


@given(data=st.data())
def test_any_interleaving_and_cutting_gives_one_order(data: st.DataObject) -> None:
    samples = data.draw(streams())
    merge = Merge(dict.fromkeys(samples, SPEC))
    pieces = [piece for port, chunk in data.draw(deliveries(samples)) for piece in merge.push(port, chunk)]
    assert rows_of(pieces) == in_order(samples)
    assert merge.held == 0


@given(data=st.data())
def test_out_of_turn_each_port_keeps_its_own_order(data: st.DataObject) -> None:
    samples = data.draw(streams())
    merge = Merge(dict.fromkeys(samples, SPEC), {ANY: Input(in_turn=False)})
    order = data.draw(deliveries(samples))
    rows = rows_of([piece for port, chunk in order for piece in merge.push(port, chunk)])
    for port in samples:
        assert [r for r in rows if r[0] == port] == [r for r in in_order(samples) if r[0] == port]


def test_out_of_turn_a_chunk_stays_whole() -> None:
    """Two streams of one rate: in turn every sample would be a piece of its own."""
    merge = Merge({"a": SPEC, "b": SPEC}, {ANY: Input(in_turn=False)})
    time = np.arange(10)
    merge.push("a", Chunk(time, np.zeros((10, 1)), 9))
    pieces = [(port, len(piece), piece.until) for port, piece in merge.push("b", Chunk(time, np.zeros((10, 1)), 9))]
    assert pieces == [("a", 10, -1), ("b", 10, 9), ("a", 0, 9)]


@given(data=st.data(), in_turn=st.booleans())
def test_until_is_true_of_all_ports_and_never_falls(data: st.DataObject, in_turn: bool) -> None:
    samples = data.draw(streams())
    merge = Merge(dict.fromkeys(samples, SPEC), {ANY: Input(in_turn=in_turn)})
    facts = dict.fromkeys(samples, NEVER)
    for port, chunk in data.draw(deliveries(samples)):
        for name, piece in merge.push(port, chunk):
            assert all(t > max(facts.values()) for t in piece.time), (
                "a sample came at or before what had been promised complete"
            )
            assert piece.until >= facts[name]
            facts[name] = piece.until
    assert set(facts.values()) == {FOREVER}


@given(data=st.data())
def test_nothing_is_held_that_is_certain(data: st.DataObject) -> None:
    samples = data.draw(streams())
    merge = Merge(dict.fromkeys(samples, SPEC))
    until, out = dict.fromkeys(samples, NEVER), 0
    seen: list[int] = []
    for port, chunk in data.draw(deliveries(samples)):
        until[port] = max(until[port], chunk.until)
        seen += chunk.time.tolist()
        out += len(rows_of(merge.push(port, chunk)))
        assert out == sum(t <= min(until.values()) for t in seen)


@given(data=st.data())
def test_a_restored_merge_goes_on_as_if_nothing_had_happened(data: st.DataObject) -> None:
    samples = data.draw(streams())
    order = data.draw(deliveries(samples))
    merge = other = Merge(dict.fromkeys(samples, SPEC))
    at = data.draw(st.integers(0, len(order)))
    for k, (port, chunk) in enumerate(order):
        if k == at:
            other = Merge(dict.fromkeys(samples, SPEC))
            other.restore({name: array.copy() for name, array in merge.snapshot().items()})
            assert other.held == merge.held
        one, two = merge.push(port, chunk), other.push(port, chunk) if k >= at else []
        if k >= at:
            assert rows_of(one) == rows_of(two)
            assert [(p, c.until) for p, c in one] == [(p, c.until) for p, c in two]


def test_a_gap_told_by_an_empty_chunk_reaches_the_next_sample() -> None:
    merge = Merge({"a": SPEC, "b": SPEC})
    merge.push("a", empty(SPEC, 5, lost=3))
    merge.push("a", Chunk(np.array([7]), np.zeros((1, 1)), 7, lost=1))
    restored = Merge({"a": SPEC, "b": SPEC})
    restored.restore(merge.snapshot())
    for each in (merge, restored):
        assert rows_of(each.push("b", empty(SPEC, 9))) == [("a", 7, 0.0, 4)]


def test_a_port_that_does_not_exist_is_refused() -> None:
    with pytest.raises(KeyError):
        Merge({"a": SPEC, "b": SPEC}).push("c", empty(SPEC, 0))


def test_time_without_samples_passes_on_triggers_alone_until_the_end() -> None:
    """A call for every port would be one for all that is behind the operator, too."""
    merge = Merge({"a": SPEC, "b": SPEC, "c": SPEC}, {"b": Input(trigger=True), ANY: Input()})
    for until, ports in ((5, ["b"]), (9, ["b"]), (FOREVER, ["a", "c", "b"])):
        pieces = [piece for port in "abc" for piece in merge.push(port, empty(SPEC, until))]
        assert [(port, len(piece), piece.until) for port, piece in pieces] == [(port, 0, until) for port in ports]
    sampled = Merge({"a": SPEC, "b": SPEC}, {"b": Input(trigger=True), ANY: Input()})
    sampled.push("a", empty(SPEC, 7))
    pieces = sampled.push("b", Chunk(np.array([7]), np.zeros((1, 1)), 7))
    assert [(port, len(piece), piece.until) for port, piece in pieces] == [("b", 1, 7)]
