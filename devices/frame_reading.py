"""Declared frames to samples: stamps and losses of several kinds of frame on one device's clock."""

from __future__ import annotations

from collections import Counter as Tally
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from devices.clocks.counter_check import ENOUGH, MOSTLY, CounterCheck
from devices.clocks.device_clock import ClockState, DeviceClock
from devices.clocks.device_time import DeviceTime
from devices.clocks.packet_clock import Packets, Stamped
from devices.clocks.rate_check import Policy, RateCheck
from devices.clocks.stamps import REPEATED, Losses, Stamps, chunks, tell_problems
from devices.clocks.timing import TIMING, chunks_of_one
from devices.protocols.checksum_fit import fitting
from devices.protocols.declared import Frame
from devices.protocols.frame_decoder import SPOILT, FoundFrames, FrameDecoder
from devices.protocols.frame_layout import FrameLayout
from devices.transport.handshake import shown
from stream.chunk import NS, Array, Chunk, Times
from stream.errors import DeviceError, RunError
from stream.source import Feed

FIRST_FRAME_S = 5.0
JUDGED, CHANCE = 300, 0.02
"""How many frames tell whether checksums are right, and the share that chance makes right: of one byte 1 in 256."""


class Declared(Protocol):
    """A source whose frames are declared, as its reading sees it."""

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
        self._port, self._hint = of.port, of.hint
        self._decoder, self._layouts = decoder, decoder.layouts
        self._seen = False
        self._good = self._bad = 0
        """Frames with a right and a wrong checksum, until there are `JUDGED`."""
        self._spoilt: deque[tuple[int, bytes]] = deque(maxlen=SPOILT)
        self._clock = DeviceClock(of.latency_s)
        self._time = DeviceTime(self._clock, of.wraps_ns)
        self._now: int | None = None
        """The device's time by the last frame that brought one."""
        self._timed = any(f.with_role("time") for f in of.frames)
        counters = [c[0] if (c := f.with_role("counter")) else None for f in of.frames]
        bits = [c.bits if c else 0 for c in counters]
        turns = [c.wraps if c else 0 for c in counters]
        self._losses = [Losses(f.rate_hz, b, t) for f, b, t in zip(of.frames, bits, turns, strict=True)]
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
        return self._clock.state if self._timed else None

    def wrong(self, silent_s: float, came: bytes) -> str:
        """Once there has been a frame, silence is for the engine to judge."""
        if self._seen or not came or silent_s <= FIRST_FRAME_S:
            return ""
        if text := self._counters():
            return f"no frame from {self._port} within {FIRST_FRAME_S:g} s, as none is believed: {text}"
        syncs = " or ".join(layout.sync.hex(" ") or f"{layout.size} bytes" for layout in self._layouts)
        check = " and a right checksum" if all(layout.checksum.size for layout in self._layouts) else ""
        return (
            f"no frame from {self._port} within {FIRST_FRAME_S:g} s: expected {syncs}{check}; came {shown(came)}"
            + _fits(self._spoilt, self._layouts)
            + self._hint
        )

    def _counters(self) -> str:
        """What speaks against frames that have their places but no checksum, if it is their counter; "": nothing."""
        steps = Tally(
            (after - before, before if after == before else -1)
            for before, after in self._decoder.contradicted.elements()
        )
        if steps.total() < ENOUGH:
            return ""
        (step, at), times = steps.most_common(1)[0]
        what = "is it the field of the counter? Else leave the counter out"
        if times < MOSTLY * steps.total():
            return f"the counter of one frame does not lead to that of the next: {what}"
        way = f"goes up by {step} a frame" if step > 0 else "counts down" if step else f"stands still at {at}"
        return f"their counter {way}: {what}"

    def take(self, data: bytes, feed: Feed) -> int:
        if only := self._decoder.only(data):
            self._seen = True
            self._emit_one(*only, feed)
            if self._good + self._bad < JUDGED:
                self._judge(1, 0, feed)
            return 1
        found = self._decoder.feed(data)
        if found.kinds:
            self._seen = True
            if len(found.kinds) == 1:
                self._emit_one(found.kinds[0], bytes(found.frames[found.kinds[0]]), feed)
            else:
                self._emit_all(found, feed)
        if self._good + self._bad < JUDGED:
            self._spoilt.extend(found.spoilt)
            self._judge(len(found.kinds), found.bad, feed)
        if found.bad or found.dropped or found.resyncs:
            tell_problems(feed, bad_checksum=found.bad, bytes_that_are_no_frame=found.dropped, resync=found.resyncs)
        return len(found.kinds)

    def _judge(self, good: int, bad: int, feed: Feed) -> None:
        """A device nearly all of whose first frames have a wrong checksum is another one: those that seem right are so by chance.

        Raises RunError, DeviceError.
        """
        self._good, self._bad = self._good + good, self._bad + bad
        if self._good + self._bad < JUDGED or self._good > CHANCE * self._bad:
            return
        text = (
            f"{self._port} is not as declared: of {self._good + self._bad} frames {self._good} have a right checksum, which is chance"
            + _fits(self._spoilt, self._layouts)
            + self._hint
        )
        raise DeviceError(text) if feed.again else RunError(text)

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
            made = self._one_by_time(kind, own, counter, arrival, feed)
        else:
            made = self._stamps[kind].one(arrival, None, counter)
        missing = max(made.lost, 0) if made else 0
        if counter is not None and (counting := self._counting[kind]):
            counting.see(np.array([counter]), arrival, feed)
        came = 0 if made is None else 1
        if hz := self._rates[kind].see(came, missing if layout.counted else 0, arrival, feed, own):
            self._stamps[kind].follow(hz)
            self._losses[kind].follow(hz)
        if made is None or missing:
            tell_problems(feed, repeated_frame_or_wrong_time=1 - came, lost_frame=missing)
        if made is None:
            return
        record, event = chunks_of_one(made, arrival, layout.row(frame), self._last)
        self._last = event.until
        if layout.channels:
            feed.emit(record, layout.frame.name)
        feed.emit(event, "timing")

    def _one_by_time(
        self, kind: int, own: Times | None, counter: int | None, arrival: int, feed: Feed
    ) -> Stamped | None:
        """What `_by_time` gives for one frame; None where it is left out."""
        restarted = False
        if own is not None:
            self._now = self._time.read(int(own[0]), arrival)
            restarted = self._time.restarted
            if restarted:
                self._clock.restart(self._time.jump_ns)
                feed.problem("device restarted")
        if self._now is None:
            return None
        lost = self._losses[kind].before(self._now, counter, arrival, restarted)
        if lost <= REPEATED:
            return None
        device = self._now + (0 if own is None else self._losses[kind].within_ns)
        self._clock.see(device, arrival)
        lost = lost or -int(self._clock.take_gap())
        return Stamped(self._losses[kind].number, lost, device, self._clock.stamp(device))

    def _emit_all(self, found: FoundFrames, feed: Feed) -> None:
        arrival = feed.now()
        tables = {kind: self._layouts[kind].table(bytes(frames)) for kind, frames in found.frames.items()}
        if self._timed:
            packets = self._by_time(np.array(found.kinds), tables, arrival, feed)
        else:
            packets = {
                kind: self._stamps[kind].take(len(table), arrival, None, self._layouts[kind].counters(table))
                for kind, table in tables.items()
            }
        for kind, table in tables.items():
            missing = packets[kind].missing
            self._check_rate(kind, table, packets[kind], missing, arrival, feed)
            self._emit(kind, table, packets[kind], missing, feed)
        self._tell_timing(packets, arrival, feed)

    def _check_rate(self, kind: int, table: Array, packets: Packets, missing: int, arrival: int, feed: Feed) -> None:
        layout = self._layouts[kind]
        if (counting := self._counting[kind]) and (counters := layout.counters(table)) is not None:
            counting.see(counters, arrival, feed)
        lost = missing if layout.counted else 0
        hz = self._rates[kind].see(len(packets.stamp), lost, arrival, feed, layout.times_ns(table))
        if hz:
            self._stamps[kind].follow(hz)
            self._losses[kind].follow(hz)

    def _by_time(self, kinds: Array, tables: dict[int, Array], arrival: int, feed: Feed) -> dict[int, Packets]:
        """Frames in the order in which they came get the device's time, all through one mapping."""
        raw = {kind: self._layouts[kind].times_ns(table) for kind, table in tables.items()}
        counters = {kind: self._layouts[kind].counters(table) for kind, table in tables.items()}
        seen = dict.fromkeys(tables, 0)
        device, lost, number, stamp = np.full((4, len(kinds)), -1, np.int64)
        mapped = 0
        kept = np.zeros(len(kinds), bool)
        for i, kind in enumerate(kinds.tolist()):
            place, seen[kind] = seen[kind], seen[kind] + 1
            own, restarted = raw[kind], False
            if own is not None:
                self._now = self._time.read(int(own[place]), arrival)
                restarted = self._time.restarted
                if restarted:
                    self._clock.map(device[mapped:i], kept[mapped:i], arrival, stamp[mapped:i])
                    self._clock.restart(self._time.jump_ns)
                    mapped = i
                    feed.problem("device restarted")
            if self._now is None:
                continue
            count = counters[kind]
            lost[i] = self._losses[kind].before(
                self._now, None if count is None else int(count[place]), arrival, restarted
            )
            within = 0 if own is None else self._losses[kind].within_ns
            device[i], number[i], kept[i] = self._now + within, self._losses[kind].number, lost[i] > REPEATED
        self._clock.map(device[mapped:], kept[mapped:], arrival, stamp[mapped:])
        if self._clock.take_gap():
            for kind in tables:
                first = np.flatnonzero((kinds == kind) & kept)[:1]
                lost[first] = np.where(lost[first] == 0, -1, lost[first])
        packets = {}
        for kind in tables:
            here = kinds == kind
            good = here & kept
            packets[kind] = Packets(kept[here], number[good], lost[good], device[good], stamp[good])
        return packets

    def _emit(self, kind: int, table: Array, packets: Packets, missing: int, feed: Feed) -> None:
        left_out = len(table) - len(packets.stamp)
        if left_out or missing:
            tell_problems(feed, repeated_frame_or_wrong_time=left_out, lost_frame=missing)
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

    def _tell_timing(self, packets: dict[int, Packets], arrival: int, feed: Feed) -> None:
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


def _fits(spoilt: Iterable[tuple[int, bytes]], layouts: Sequence[FrameLayout]) -> str:
    """For the error's end: which checksums would fit the frames that came."""
    by_kind: dict[int, list[bytes]] = {}
    for kind, frame in spoilt:
        by_kind.setdefault(kind, []).append(frame)
    told = [f"frames[{kind}]: {text}" for kind, frames in by_kind.items() if (text := fitting(frames, layouts[kind]))]
    return f"; {', '.join(told)}" if told else ""
