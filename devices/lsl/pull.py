"""Reading an open LSL stream: samples to chunks, until stopped or the stream is lost."""

from __future__ import annotations

import time

import numpy as np
import structlog

from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.timing import timing_chunk
from kinegraph.devices.lsl.clock import SenderClock, zero_ns
from kinegraph.devices.lsl.connection import Connection
from kinegraph.devices.lsl.find import is_there
from kinegraph.devices.lsl.stamps import LslStamps, Mapped
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec
from kinegraph.stream.domain.finding import REPORT, Finding
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed

CORRECT_S = 1.0
"""How often the clocks' offset is asked for; LSL measures it every five seconds."""
MEASURE_S = 5.0
"""How long the first measurement may take."""
THERE_S = 2.0
"""How long a silent outlet may take to answer."""
TIMING_S = 0.1
"""How long events of `timing` are gathered."""
WAITED_S = 0.005
"""A read that took longer has waited for its sample; one that was quicker had it at hand."""
LATE_NS = 5 * NS
"""No network takes so long, for so long."""
UNORDERED_S = 0.1
"""A stamp may run back so far by how a sender happens to take its samples."""
QUICKEST_S = 0.05
"""LSL does not find an outlet again within less."""

log = structlog.get_logger(__name__)


class Pull:
    """One opening of an inlet."""

    def __init__(
        self,
        connection: Connection,
        spec: StreamSpec,
        feed: Feed,
        gap_s: float,
        latency_s: float,
        lost_after_s: float,
    ) -> None:
        self._connection, self._spec, self._feed, self._lost_after = connection, spec, feed, lost_after_s
        zero = zero_ns(connection.lsl, feed.now)
        self._stamps = LslStamps(spec.rate_hz, zero, gap_s, latency_s)
        self._clock = SenderClock(zero / NS)
        self._told_clock = ClockLog(connection.described.name, feed, self._clock.state)
        self._count = 0
        self._found: set[str] = set()
        self._late_since = 0
        self._timing: list[tuple[int, int, int, int]] = []
        self._timing_lost = 0
        self._told = self._asked = time.monotonic()

    def run(self) -> None:
        """Emit what comes. Returns when stopped; raises DeviceError when the stream is lost."""
        connection, feed = self._connection, self._feed
        connection.correction()
        feed.ready()
        heard, reconnected, known = time.monotonic(), False, False
        while not feed.stopped:
            data, stamps = connection.pull()
            now = time.monotonic()
            if now - heard > QUICKEST_S:
                reconnected = connection.has_reconnected() or reconnected
            if len(stamps):
                if reconnected:
                    feed.problem("reconnected")
                    log.warning("LSL stream is back", name=connection.described.name, host=connection.described.host)
                if reconnected or not known:
                    first, known = not known, self._learn_clock(float(stamps[-1]))
                    if first and self._stamps.begin(float(stamps[-1]), feed.now()):
                        data, stamps = self._begin_elsewhere(data, stamps)
                self._emit(data, stamps, reconnected)
                time.sleep(0)  # lets go of the interpreter, for which the graph's thread is waiting
                heard, reconnected = now, False
            elif now - heard > self._lost_after:
                self._silent(now - heard)
                heard = now
            self._look_after(now)

    def _learn_clock(self, stamp: float) -> bool:
        """Wait until it is known how the sender's clock stands, by which a sample has this stamp; returns whether it is."""
        deadline = time.monotonic() + MEASURE_S
        while (correction := self._connection.correction()) is None:
            if self._connection.has_our_clock(stamp):
                correction = 0.0
                break
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"how the clock of {self._connection.described.host!r} stands could not be measured within {MEASURE_S:g} s;"
                    " does a firewall keep back UDP?"
                )
            if self._feed.wait(0.01):
                return False
        self._correct(correction, at_once=True)
        return True

    def _begin_elsewhere(self, data: Array, stamps: Samples) -> tuple[Array, Samples]:
        """Stamps are of another clock from the start. Only a sample that was waited for tells by how much: the newest, which this gives."""
        while not self._feed.stopped:
            asked = time.monotonic()
            newer, its_stamps = self._connection.pull()
            if len(its_stamps):
                data, stamps = newer, its_stamps
            if time.monotonic() - asked > WAITED_S:
                break
        moved_s = self._stamps.begin(float(stamps[-1]), self._feed.now())
        self._shifted(moved_s, self._feed.now())
        return data, stamps

    def _correct(self, correction: float, *, at_once: bool = False) -> None:
        self._stamps.correct(correction, at_once=at_once)
        self._clock.see(correction, self._connection.uncertainty(), time.monotonic())

    def _emit(self, data: Array, stamps: Samples, reconnected: bool) -> None:
        """Hand over what a read brought; last of all, so that the graph's thread need not wait for what we still do."""
        arrival = self._feed.now()
        mapped = self._stamps.map(stamps, arrival, after_pause=reconnected)
        times, gaps = mapped.time, mapped.gaps
        samples = self._events(mapped, data) if self._spec.is_event else _numbers(data)
        self._count += len(times)
        self._timing.append((self._count - 1, _ns(stamps.item(-1)), arrival, times.item(-1)))
        if gaps or mapped.backwards or mapped.impossible:
            self._count_problems(mapped)
        if arrival - times.item(-1) < LATE_NS:
            self._late_since = arrival
        elif arrival - (self._late_since or arrival) > LATE_NS:
            seen = f"stamps {(arrival - times.item(-1)) / NS:.1f} s before their arrival"
            self._find("epoch", "stamps of LSL's clock", seen, "beside other streams they are late", times.item(0))
        self._late_since = self._late_since or arrival
        if not gaps:
            self._feed.emit(Chunk(times, samples, times.item(-1)))
            return
        start = lost = 0
        for at, missing in [*gaps, (len(times), 0)]:
            if at > start:
                self._feed.emit(Chunk(times[start:at], samples[start:at], int(times[at - 1]), lost))
            start, lost = at, missing

    def _count_problems(self, mapped: Mapped) -> None:
        if mapped.gaps:
            self._timing_lost = -1
        for _, missing in mapped.gaps:
            self._feed.problem("gap" if missing < 0 else "lost sample", max(missing, 1))
        if mapped.backwards:
            self._feed.problem("stamp ran backwards", mapped.backwards)
        if mapped.impossible:
            self._feed.problem("impossible stamp", mapped.impossible)
        if mapped.shifted_s:
            self._shifted(mapped.shifted_s, int(mapped.time[-1]))
        if mapped.back_s > UNORDERED_S:
            seen = f"a sample stamped {mapped.back_s:.3f} s before an earlier one"
            self._find(
                "order",
                "samples in the order of time",
                seen,
                "it is moved to the stamp of that one",
                int(mapped.time[-1]),
            )
        if mapped.impossible:
            seen = "stamps that are an hour old, of the future, or no numbers"
            self._find("epoch", "stamps of LSL's clock", seen, "their arrival is taken", int(mapped.time[-1]))

    def _shifted(self, by_s: float, since_ns: int) -> None:
        self._feed.problem("stamps of another clock")
        seen, consequence = (
            f"stamps that are {-by_s:.3f} s off",
            "they are moved to their arrival, and keep their pace from there",
        )
        self._find("epoch", "stamps of LSL's clock", seen, consequence, since_ns)

    def _find(self, kind: str, claimed: str, seen: str, consequence: str, since_ns: int) -> None:
        """Report a claim that does not hold, once of a kind."""
        if kind not in self._found:
            self._found.add(kind)
            remedy = "stamp samples with LSL's local_clock(), in their order"
            made = Finding(kind, self._connection.described.name, claimed, seen, consequence, remedy, since_ns)
            self._feed.tell(REPORT, **made.facts())

    def _events(self, mapped: Mapped, texts: Array) -> Array:
        """Markers (n, channels), texts or whole numbers, as events; what is too long is cut, and counted."""
        dtype = self._spec.dtype
        assert dtype.names
        events = np.empty(len(texts), dtype)
        events["onset"] = mapped.time
        for i, field in enumerate(dtype.names[1:]):
            decoded = [
                text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text) for text in texts[:, i]
            ]
            width = dtype[field].itemsize // 4
            if cut := sum(len(text) > width for text in decoded):
                self._feed.problem("marker cut short", cut)
            events[field] = decoded
        return events

    def _silent(self, seconds: float) -> None:
        """Nothing has come for long. Of a regular stream that means that it is lost; of markers, if the outlet does not answer."""
        if self._spec.rate_hz is None and is_there(
            self._connection.lsl, self._connection.wanted, THERE_S, self._feed.wait
        ):
            return
        if not self._feed.stopped:
            raise DeviceError(
                f"{self._connection.wanted} has delivered nothing for {seconds:.1f} s; searching for it again"
            )

    def _look_after(self, now: float) -> None:
        """What is due now and then: the timing, the sender's clock."""
        if self._timing and now - self._told > TIMING_S:
            rows = np.array(self._timing, np.int64)
            self._feed.emit(timing_chunk(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3], self._timing_lost), "timing")
            self._timing, self._timing_lost, self._told = [], 0, now
        if now - self._asked > CORRECT_S:
            self._asked = now
            correction = self._connection.correction()
            if correction is not None:
                self._correct(correction)
        self._told_clock.tell()


def _numbers(data: Array) -> Samples:
    """As float64; bits of a float32 that some processors signal for are NaN like others."""
    with np.errstate(invalid="ignore"):
        return data.astype(np.float64)


def _ns(seconds: float) -> int:
    """Nanoseconds, if they can be written in 64 bits; else -1."""
    return round(float(seconds) * NS) if abs(seconds) < 2**62 / NS else -1
