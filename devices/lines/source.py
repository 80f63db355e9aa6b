"""Lines of numbers over a serial port or TCP: an Arduino with MyoWare sensors, or anything that prints comma-separated values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import structlog

from kinegraph.devices.clocks.counter_check import CounterCheck
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from kinegraph.devices.clocks.stamps import Stamps, chunks, report_losses, report_problems
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.lines.protocol import LineDecoder
from kinegraph.devices.transport.handshake import shown
from kinegraph.devices.transport.serial_source import SerialSource
from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.chunk import NS, Array, Samples, Specs, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

NS_PER = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": NS}
HEADER_S = 5.0
FIRST_LINE_S = 5.0

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class AsciiLines(SerialSource):
    """Numbers in lines of text, one sample a line.

    out      (channels,) float64: every column that is neither the device's time nor its counter, times `scale`, plus `offset`, in `units`
    timing   an event per line: counter, device time, arrival, stamp

    Stamps follow the column named by `time` if there is one, else `counter` (with `rate_hz`), else the lines' arrival, spread evenly at
    `rate_hz` over what comes in one read. Missing lines are known from the counter, or, with `rate_hz`, from steps of the device's time.
    Lines with another number of columns, or with something that is no number, are rejected and counted ("bad line").
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "timing")

    port: str = param(help="/dev/serial/by-id/NAME, COM3 or tcp://host:port; `kinegraph devices` lists serial ports")
    columns: tuple[str, ...] = param(help="names of the columns in a line; with `header`, the wanted ones in any order")
    baud: int = param(115200, least=50, help="bits per second of the serial port")
    delimiter: str = param(",", help="between two numbers; a blank stands for any number of blanks")
    header: bool = param(False, help="the device prints a line with its columns' names, which gives their order")
    units: tuple[str, ...] = param(
        ("",), unit=True, help="unit of every channel, or one for all, after scale and offset"
    )
    scale: tuple[float, ...] = param(
        (1.0,), help="factor for every channel, or one for all, e.g. 5000 / 1023 mV per count"
    )
    offset: tuple[float, ...] = param((0.0,), help="added to every channel after scale, or one for all")
    time: str = param("", help="the column that holds the device's time")
    time_unit: Literal["ns", "us", "ms", "s"] = param("us", help="unit of that column")
    time_bits: int = param(
        32, least=0, most=64, help="after how many bits the time starts again (micros() and millis(): 32); 0: never"
    )
    counter: str = param("", help="the column that counts lines")
    counter_bits: int = param(16, least=1, most=32, help="after how many bits the counter starts again")
    counter_wraps: int = param(
        0, least=0, help="after how many lines it starts again, where that is no power of two (0: by `counter_bits`)"
    )
    rate_hz: float | None = param(None, above=0, help="lines per second; left out: irregular")
    start: str = param("", help='sent when the port has been opened, e.g. "b\\n"')
    stop: str = param("", help="sent before it is closed")
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to the port, if you know it"
    )
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)

    @property
    def chunk_s(self) -> float:
        return 1 / self.rate_hz if self.rate_hz else 0.0

    @property
    def channels(self) -> tuple[str, ...]:
        """The columns that are data."""
        return tuple(name for name in self.columns if name not in (self.time, self.counter))

    def specs(self) -> Specs:
        self._check()
        spec = StreamSpec((len(self.channels),), rate_hz=self.rate_hz, channels=self.channels, units=self.units)
        return {"out": spec, "timing": timing_spec()}

    def _check(self) -> None:
        n = len(self.channels)
        if not n or len(set(self.columns)) != len(self.columns):
            raise ParameterError("columns", list(self.columns), "different names, at least one of which is data")
        for name in ("time", "counter"):
            column = getattr(self, name)
            if column and column not in self.columns:
                raise ParameterError(name, column, f"one of the columns: {', '.join(self.columns)}")
        for name in ("units", "scale", "offset"):
            if len(getattr(self, name)) not in (1, n):
                raise ParameterError(
                    name, list(getattr(self, name)), f"one, or {n}: one for each of {', '.join(self.channels)}"
                )
        if self.counter and not self.rate_hz:
            raise ParameterError(
                "rate_hz", self.rate_hz, "given with `counter`: it tells how often the counter has started again"
            )
        if not self.delimiter or self.delimiter in "\r\n.+-#" or self.delimiter.isalnum():
            raise ParameterError("delimiter", self.delimiter, "what stands between numbers, as ',' ';' ' ' or a tab")

    def greet(self, link: Transport, feed: Feed) -> LinesReading:
        if self.start:
            link.write(self.start.encode())
        return LinesReading(self)

    def rest(self, link: Transport, feed: Feed) -> None:
        if self.stop:
            link.write(self.stop.encode())


class LinesReading:
    """Rows to samples."""

    def __init__(self, of: AsciiLines) -> None:
        columns = of.columns
        self._of, self._decoder, self._seen = of, LineDecoder(columns, of.delimiter, of.header), False
        self._row: Samples | None = None
        self._time = columns.index(of.time) if of.time else None
        self._counter = columns.index(of.counter) if of.counter else None
        self._data = [columns.index(name) for name in of.channels]
        self._ns = NS_PER[of.time_unit]
        self._scale, self._offset = np.array(of.scale), np.array(of.offset)
        self._turn = of.counter_wraps or 1 << of.counter_bits
        self._counting = CounterCheck(of.port, self._turn, "counter_wraps") if of.counter else None
        wraps = (1 << of.time_bits) * self._ns if of.time_bits else 0
        self._stamps = Stamps(
            of.rate_hz,
            counter_bits=of.counter_bits if of.counter else 0,
            counter_turn=of.counter_wraps,
            has_time=bool(of.time),
            wraps_ns=wraps,
            latency_s=of.latency_s,
        )
        self._rate = RateCheck(
            of.port,
            of.rate_hz,
            of.rate_mismatch,
            unit=of.time_unit if of.time else "",
            counted=bool(of.counter),
            wraps_ns=wraps,
        )

    @property
    def clock(self) -> ClockState | None:
        return self._stamps.state

    def wrong(self, silent_s: float, came: bytes) -> str:
        """Once there has been a good line, silence is for the engine to judge."""
        of, names = self._of, self._of.delimiter.join(self._of.columns)
        if self._seen:
            return ""
        if not self._decoder.names and silent_s > HEADER_S:
            return (
                f"no header from {of.port} within {HEADER_S:g} s: expected a line that names {names}; came {shown(came)}"
                " (an Arduino prints it when it is reset; or leave `header` out)"
            )
        if self._decoder.names and came and silent_s > FIRST_LINE_S + (of.chunk_s and 2 * of.chunk_s):
            return (
                f"no good line from {of.port} within {silent_s:.0f} s: expected {len(of.columns)} numbers, {names};"
                f" came {shown(came)}" + (f" (is baud {of.baud} right?)" if "://" not in of.port else "")
            )
        return ""

    def take(self, data: bytes, feed: Feed) -> int:
        lines = self._decoder.feed(data)
        if lines.rejected:
            feed.problem("bad line", lines.rejected)
            log.debug("bad line", port=self._of.port, line=lines.example.decode("ascii", "replace"))
        if len(lines.rows):
            self._seen = True
            self._emit(lines.rows, feed)
        return len(lines.rows)

    def _emit(self, rows: Samples, feed: Feed) -> None:
        rows = self._sound(rows, feed)
        if not len(rows):
            return
        arrival = feed.now()
        device = None if self._time is None else np.round(rows[:, self._time] * self._ns).astype(np.int64)
        counter = None if self._counter is None else rows[:, self._counter].astype(np.int64) % self._turn
        packets = self._stamps.take(len(rows), arrival, device, counter, self._again(rows))
        if self._counting and counter is not None:
            self._counting.see(counter, arrival, feed)
        missing = report_losses(packets, feed, "lost line", "device restarted")
        report_problems(feed, repeated_line_or_wrong_time=len(rows) - len(packets.stamp))
        if hz := self._rate.see(len(packets.stamp), missing * (counter is not None), arrival, feed, device):
            self._stamps.follow(hz)
        if not len(packets.stamp):
            return
        data = rows[packets.kept][:, self._data] * self._scale + self._offset
        for chunk in chunks(packets.stamp, packets.lost, data):
            feed.emit(chunk)
        feed.emit(timing_chunk(packets.number, packets.device, arrival, packets.stamp), "timing")

    def _again(self, rows: Samples) -> Array:
        """(n,) Whether each row is the one before it."""
        before = np.concatenate([rows[:1] + np.nan if self._row is None else self._row, rows])[:-1]
        self._row = rows[-1:].copy()
        return np.asarray((before == rows).all(axis=1))

    def _sound(self, rows: Samples, feed: Feed) -> Samples:
        """The rows with a numeric time and counter."""
        keys = [c for c in (self._time, self._counter) if c is not None]
        good = (np.abs(rows[:, keys]) < 2**62 / self._ns).all(axis=1) if keys else np.ones(len(rows), bool)
        if not good.all():
            feed.problem("bad line", int((~good).sum()))
        return rows[good]
