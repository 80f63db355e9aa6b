"""Declared frames to samples: stamps and losses of several kinds of frame on one device's clock."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from kinegraph.devices.clocks.counter_check import CounterCheck
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.packet_clock import Packets
from kinegraph.devices.clocks.rate_check import Policy, RateCheck
from kinegraph.devices.clocks.stamps import Losses, Stamps, chunks, report_problems
from kinegraph.devices.clocks.timing import TIMING, chunks_of_one
from kinegraph.devices.frames.declaration_check import DeclarationCheck
from kinegraph.devices.frames.declared import Frame
from kinegraph.devices.frames.decoder import FoundFrames, FrameDecoder
from kinegraph.devices.frames.times import FrameTimes
from kinegraph.stream.chunk import NS, Array, Chunk, Times
from kinegraph.stream.source import Feed


class Declared(Protocol):
    """A source with declared frames, as its reading sees it."""

    @property
    def port(self) -> str: ...

    @property
    def frames(self) -> tuple[Frame, ...]: ...

    @property
    def wraps_ns(self) -> int:
        """At which value the device's time starts again; 0: never."""

    @property
    def latency_s(self) -> float: ...

    @property
    def rate_mismatch(self) -> Policy: ...

    @property
    def hint(self) -> str:
        """What else may be the reason when no frame comes."""


class FrameReading:
    """Frames to samples."""

    def __init__(self, of: Declared, decoder: FrameDecoder) -> None:
        self._decoder, self._layouts = decoder, decoder.layouts
        self._seen = False
        self._check = DeclarationCheck(of.port, of.hint, decoder)
        self._timed = any(f.with_role("time") for f in of.frames)
        counters = [c[0] if (c := f.with_role("counter")) else None for f in of.frames]
        bits = [c.bits if c else 0 for c in counters]
        turns = [c.wraps if c else 0 for c in counters]
        losses = [Losses(f.rate_hz, b, t) for f, b, t in zip(of.frames, bits, turns, strict=True)]
        self._times = FrameTimes(losses, of.latency_s, of.wraps_ns)
        self._stamps = [
            Stamps(f.rate_hz, counter_bits=b, counter_turn=t, latency_s=of.latency_s)
            for f, b, t in zip(of.frames, bits, turns, strict=True)
        ]
        self._counting = [
            CounterCheck(of.port, c.turn, f"frames[{i}]: the counter's `wraps`") if c else None
            for i, c in enumerate(counters)
        ]
        self._rates = [
            RateCheck(
                of.port,
                f.rate_hz,
                of.rate_mismatch,
                setting=f"frames[{i}].rate_hz",
                counted=bool(b),
                wraps_ns=of.wraps_ns,
            )
            for i, (f, b) in enumerate(zip(of.frames, bits, strict=True))
        ]
        self._last = 0
        self._lasts: dict[int, int] = {}
        """Each kind's last stamp, of frames that hold several samples."""

    @property
    def clock(self) -> ClockState | None:
        return self._times.clock if self._timed else None

    def wrong(self, silent_s: float, came: bytes) -> str:
        """Once there has been a frame, silence is for the engine to judge."""
        return "" if self._seen else self._check.wrong(silent_s, came)

    def take(self, data: bytes, feed: Feed) -> int:
        if only := self._decoder.only(data):
            self._seen = True
            self._emit_one(*only, feed)
            if self._check.open:
                self._check.judge(1, 0, (), feed)
            return 1
        found = self._decoder.feed(data)
        if found.kinds:
            self._seen = True
            if len(found.kinds) == 1:
                self._emit_one(found.kinds[0], bytes(found.frames[found.kinds[0]]), feed)
            else:
                self._emit_all(found, feed)
        if self._check.open:
            self._check.judge(len(found.kinds), found.bad, found.spoilt, feed)
        if found.bad or found.dropped or found.resyncs:
            report_problems(feed, bad_checksum=found.bad, bytes_that_are_no_frame=found.dropped, resync=found.resyncs)
        return len(found.kinds)

    def _emit_one(self, kind: int, frame: bytes, feed: Feed) -> None:
        """What `_emit_all` does of one frame, as most reads of a slow device bring it, with as few arrays as can be."""
        layout = self._layouts[kind]
        if layout.frame.samples > 1:
            self._emit_all(FoundFrames(kinds=[kind], frames={kind: bytearray(frame)}), feed)
            return
        arrival, own = feed.now(), None
        counter = layout.counter_of(frame)
        if self._timed:
            own = layout.times_ns(layout.table(frame))
            made = self._times.one(kind, own, counter, arrival, feed)
        else:
            made = self._stamps[kind].one(arrival, None, counter)
        missing = max(made.lost, 0) if made else 0
        if counter is not None and (counting := self._counting[kind]):
            counting.see(np.array([counter]), arrival, feed)
        came = 0 if made is None else 1
        if hz := self._rates[kind].see(came, missing if layout.counted else 0, arrival, feed, own):
            self._stamps[kind].follow(hz)
            self._times.follow(kind, hz)
        if made is None or missing:
            report_problems(feed, repeated_frame_or_wrong_time=1 - came, lost_frame=missing)
        if made is None:
            return
        record, event = chunks_of_one(made, arrival, layout.row(frame), self._last)
        self._last = event.until
        if layout.channels:
            feed.emit(record, layout.frame.name)
        feed.emit(event, "timing")

    def _emit_all(self, found: FoundFrames, feed: Feed) -> None:
        arrival = feed.now()
        tables = {kind: self._layouts[kind].table(bytes(frames)) for kind, frames in found.frames.items()}
        if self._timed:
            raw = {kind: self._layouts[kind].times_ns(table) for kind, table in tables.items()}
            counters = {kind: self._layouts[kind].counters(table) for kind, table in tables.items()}
            packets = self._times.take(np.array(found.kinds), raw, counters, arrival, feed)
        else:
            packets = {
                kind: self._stamps[kind].take(len(table), arrival, None, self._layouts[kind].counters(table))
                for kind, table in tables.items()
            }
        for kind, table in tables.items():
            missing = packets[kind].missing
            self._check_rate(kind, table, packets[kind], missing, arrival, feed)
            self._emit(kind, table, packets[kind], missing, feed)
        self._report_timing(packets, arrival, feed)

    def _check_rate(self, kind: int, table: Array, packets: Packets, missing: int, arrival: int, feed: Feed) -> None:
        layout = self._layouts[kind]
        if (counting := self._counting[kind]) and (counters := layout.counters(table)) is not None:
            counting.see(counters, arrival, feed)
        lost = missing if layout.counted else 0
        hz = self._rates[kind].see(len(packets.stamp), lost, arrival, feed, layout.times_ns(table))
        if hz:
            self._stamps[kind].follow(hz)
            self._times.follow(kind, hz)

    def _emit(self, kind: int, table: Array, packets: Packets, missing: int, feed: Feed) -> None:
        left_out = len(table) - len(packets.stamp)
        if left_out or missing:
            report_problems(feed, repeated_frame_or_wrong_time=left_out, lost_frame=missing)
        frame = self._layouts[kind].frame
        if self._layouts[kind].channels and len(packets.stamp):
            data = self._layouts[kind].values(table[packets.kept] if left_out else table)
            stamp, lost = self._spread(kind, packets) if frame.samples > 1 else (packets.stamp, packets.lost)
            for chunk in chunks(stamp, lost, data):
                feed.emit(chunk, frame.name)

    def _spread(self, kind: int, packets: Packets) -> tuple[Times, Times]:
        """Stamps and losses of every sample in frames that hold several: a frame's stamp is its last one's, the others lie evenly between
        it and the frame before; behind a gap, by the declared rate."""
        frame, last = self._layouts[kind].frame, self._lasts.get(kind)
        n, period = frame.samples, NS / (frame.sample_hz or 1.0)
        self._lasts[kind] = int(packets.stamp[-1])
        first = packets.stamp[0] - round(n * period) if last is None else last
        before = np.concatenate([[first], packets.stamp[:-1]])
        step = np.where(packets.lost == 0, (packets.stamp - before) / n, period)
        stamp = packets.stamp[:, None] - np.round(step[:, None] * np.arange(n - 1, -1, -1)).astype(np.int64)
        lost = np.zeros(stamp.shape, np.int64)
        lost[:, 0] = np.where(packets.lost > 0, packets.lost * n, packets.lost)
        return np.maximum(stamp, before[:, None]).ravel(), lost.ravel()

    def _report_timing(self, packets: dict[int, Packets], arrival: int, feed: Feed) -> None:
        """All kinds of frame in one stream, in the order of their stamps."""
        events = np.empty(sum(len(p.stamp) for p in packets.values()), TIMING)
        if not len(events):
            return
        for name, column in (("counter", "number"), ("device", "device"), ("stamp", "stamp")):
            events[name] = np.concatenate([getattr(p, column) for p in packets.values()])
        events["arrival"] = arrival
        events = events[np.argsort(events["stamp"], kind="stable")]
        times: Times = np.maximum(events["stamp"], self._last)
        self._last = int(times[-1])
        feed.emit(Chunk(times, events, self._last), "timing")
