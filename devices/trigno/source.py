"""Delsys Trigno through its SDK server (or Trigno Control Utility) over TCP: EMG of up to 16 sensors and their auxiliary channels."""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kinegraph.devices.clocks import line_below
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.pace import DevicePace
from kinegraph.devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.transport.handshake import answer, shown
from kinegraph.devices.transport.transport import TcpTransport, Transport, unreachable
from kinegraph.devices.trigno import protocol as protocol
from kinegraph.devices.trigno.protocol import ENDING, PORTS, SENSORS, Layout, TrignoRows
from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source, outputs_by_parameters

ANSWER_S = 3.0
ASIDE_S = 1.0
"""How long an answer may take that not every server gives."""
SILENCE_S = 3.0


@dataclass(frozen=True, slots=True)
class TrignoSensor:
    """A sensor of the base station."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    sensor: int = param(least=1, most=SENSORS, help="its place in the base station, 1 to 16")
    name: str = param("", help="the channel's name; left out: emg1, emg2, ...; of a second channel emg1.2")
    channel: int = param(1, least=1, most=4, help="which of its EMG channels: a Duo has 2, a Quattro 4")

    @property
    def called(self) -> str:
        """The channel's name."""
        return self.name or f"emg{self.sensor}" + (f".{self.channel}" if self.channel > 1 else "")


@dataclass(frozen=True, slots=True)
class Trigno(Source):
    """Sensors of a Delsys Trigno, which its SDK server sends over TCP.

    emg      (sensors,) float64, uV, at `emg_hz`
    aux      (3 x sensors,) or (9 x sensors,) float64 at 148.15 Hz, with `aux`: ax ay az in g of each sensor; with the current layout also
             gx gy gz in deg/s and mx my mz as the sensor gives it
    timing   an event per read of `emg`: number of the last sample, time by it, arrival, stamp

    Samples carry no counter and no time: they are counted, and the count is mapped to session time. TCP loses nothing; what the radio lost
    the base station fills in without a word. Where the count goes astray by more than 0.1 s, an unknown number is marked as lost.
    """

    port: str = param(
        help="the server's command port, tcp://127.0.0.1:50040 on its own machine; data ports lie behind it"
    )
    sensors: tuple[TrignoSensor, ...] = param(help="which sensors, and what they are called")
    aux: bool = param(False, help="the sensors' auxiliary channels, too")
    layout: Layout = param("legacy", help="legacy: ports 50041 and 50042; current: ports 50043 and 50044")
    emg_hz: float = param(2000.0, above=0, most=5000, help="EMG samples per second, as the server sends them")
    latency_s: float = param(
        0.0,
        least=0,
        most=1,
        help="the constant delay from the electrode to the port, if you know it (Delsys states 48 ms)",
    )
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)

    @outputs_by_parameters("emg", "aux", "timing")
    def outputs(self) -> tuple[str, ...]:
        return ("emg", "aux", "timing") if self.aux else ("emg", "timing")

    @property
    def chunk_s(self) -> float:
        return protocol.FRAME_S

    @property
    def names(self) -> tuple[str, ...]:
        """Of the sensors, in the order of the graph."""
        return tuple(one.called for one in self.sensors)

    def specs(self) -> Specs:
        numbers = [one.sensor for one in self.sensors]
        places = {(one.sensor, one.channel) for one in self.sensors}
        different = len(places) == len(set(self.names)) == len(numbers)
        if not numbers or not different or not all(1 <= n <= SENSORS for n in numbers):
            raise ParameterError(
                "sensors", numbers, "1 to 16 different sensors or channels of them, with different names"
            )
        if not self.port.startswith("tcp://"):
            raise ParameterError("port", self.port, "tcp://host:port")
        meta = {"device": "Delsys Trigno"}
        specs = {
            "emg": StreamSpec((len(numbers),), rate_hz=self.emg_hz, channels=self.names, units=("uV",), meta=meta),
            "timing": timing_spec(),
        }
        if self.aux:
            ports = PORTS[self.layout]
            channels = tuple(f"{name}.{axis}" for name in self.names for axis in ports.aux_channels)
            units = ports.aux_units * len(numbers)
            specs["aux"] = StreamSpec(
                (len(channels),), rate_hz=protocol.AUX_HZ, channels=channels, units=units, meta=meta
            )
        return specs

    def missing(self) -> str:
        return unreachable(self.port)

    def prepare(self) -> None:
        line_below.prepare()

    def read(self, feed: Feed) -> None:
        with ExitStack() as links:
            control = links.enter_context(TcpTransport(self.port))
            columns = self._greet(control, feed)
            ports = PORTS[self.layout]
            emg = links.enter_context(TcpTransport(self._behind(ports.emg)))
            aux = links.enter_context(TcpTransport(self._behind(ports.aux))) if self.aux else None
            self._ask(control, feed, protocol.START)
            try:
                self._stream(emg, aux, columns, feed)
            finally:
                with suppress(DeviceError):
                    control.write(protocol.command(protocol.STOP))

    def _behind(self, step: int) -> str:
        """The data port at this offset from the command port."""
        head, _, port = self.port.rpartition(":")
        return f"{head}:{int(port) + step}"

    def _greet(self, control: Transport, feed: Feed) -> list[int]:
        """Ask who is there, and what; returns the channels' columns. Raises DeviceError if it is another server, or a sensor is missing."""
        expected = "the greeting of a Trigno server (is Trigno Control Utility or the SDK server running?)"
        banner = answer(control, feed, until=ENDING, within_s=ANSWER_S, expected=expected)
        if protocol.BANNER not in banner:
            raise DeviceError(f"expected {expected} from {self.port}; came {shown(banner)}")
        version = banner.decode("ascii", "replace").split()[-1]
        known: dict[str, str] = {}
        columns: list[int] = []
        for one, name in zip(self.sensors, self.names, strict=True):
            if self._aside(control, feed, f"SENSOR {one.sensor} PAIRED?") == "NO":
                raise DeviceError(
                    f"{self.port}: sensor {one.sensor} is not paired with the base station; pair it, or leave it out"
                )
            columns.append(self._column(one, control, feed))
            stated = self._aside(control, feed, f"SENSOR {one.sensor} CHANNEL {one.channel} RATE?")
            if stated:
                known[f"{name}_hz"] = stated
            for what in ("serial", "firmware"):
                if text := self._aside(control, feed, f"SENSOR {one.sensor} {what.upper()}?"):
                    known[f"{name}_{what}"] = text
        feed.identify("Delsys Trigno", port=self.port, server=version, **known)
        for setting in ("ENDIAN LITTLE", "TRIGGER START OFF", "TRIGGER STOP OFF"):
            self._aside(control, feed, setting)
        return columns

    def _column(self, one: TrignoSensor, control: Transport, feed: Feed) -> int:
        """Where a channel's samples stand: a Duo or Quattro moves those of all sensors behind it. Raises DeviceError."""
        count = self._aside(control, feed, f"SENSOR {one.sensor} EMGCHANNELCOUNT?")
        if count.isdigit() and one.channel > int(count):
            raise DeviceError(
                f"{self.port}: sensor {one.sensor} has {count} EMG channels, no channel {one.channel}; is another sensor meant?"
            )
        start = self._aside(control, feed, f"SENSOR {one.sensor} STARTINDEX?")
        column = (int(start) if start.isdigit() and int(start) else one.sensor) + one.channel - 2
        if column >= SENSORS:
            raise DeviceError(
                f"{self.port}: channel {one.channel} of sensor {one.sensor} would be column {column + 1} of {SENSORS}"
            )
        return column

    def _ask(self, control: Transport, feed: Feed, text: str) -> None:
        control.write(protocol.command(text))
        came = answer(control, feed, until=ENDING, within_s=ANSWER_S, expected=f"OK after {text}")
        if b"OK" not in came:
            raise DeviceError(f"{self.port} refused {text}: {came.decode('ascii', 'replace').strip()}")

    def _aside(self, control: Transport, feed: Feed, text: str) -> str:
        """The answer to what older servers do not know; "" without one, or where it is refused."""
        control.write(protocol.command(text))
        try:
            came = answer(control, feed, until=ENDING, within_s=ASIDE_S, expected=text)
        except DeviceError:
            if feed.stopped:
                raise
            return ""
        words = came.decode("ascii", "replace").strip()
        return "" if "INVALID" in words.upper() or "CANNOT" in words.upper() else words

    def _stream(self, emg: Transport, aux: Transport | None, columns: list[int], feed: Feed) -> None:
        per = len(PORTS[self.layout].aux_channels)
        streams = {"emg": TrignoPort(self, "emg", SENSORS, columns, self.emg_hz)}
        if aux:
            places = [c * per + i for c in columns for i in range(per)]
            streams["aux"] = TrignoPort(self, "aux", SENSORS * per, places, protocol.AUX_HZ)
        heard = dict.fromkeys(streams, time.monotonic())
        clock_log = ClockLog(self.port, feed, lambda: streams["emg"].pace.state)
        while not feed.stopped:
            for name, link, wait in (("emg", emg, 0.1), ("aux", aux, 0.0)):
                if link and (data := link.read(wait)) and streams[name].pass_on(data, feed):
                    heard[name] = time.monotonic()
            if silent := [name for name, at in heard.items() if time.monotonic() - at > SILENCE_S]:
                raise DeviceError(f"no samples of {' and '.join(silent)} from {self.port} for {SILENCE_S:g} s")
            clock_log.tell()


class TrignoPort:
    """One data port: its rows to samples."""

    def __init__(self, of: Trigno, name: str, channels: int, columns: list[int], rate_hz: float) -> None:
        self.pace = DevicePace(rate_hz, of.latency_s)
        setting = "emg_hz" if name == "emg" else "set the sensors' mode back"
        self._rate = RateCheck(
            f"{of.port} ({name})", rate_hz, of.rate_mismatch, setting=setting, counted=True
        )  # its server fills in what the radio lost, and TCP loses nothing
        self._name, self._rows, self._columns = name, TrignoRows(channels), columns

    def pass_on(self, data: bytes, feed: Feed) -> int:
        """Emit what a read has brought; returns how many samples that was."""
        values = self._rows.feed(data)[:, self._columns]
        if not len(values):
            return 0
        arrival = feed.now()
        counted = self.pace.take(len(values), arrival)
        if hz := self._rate.see(len(values), 0, arrival, feed):
            self.pace.follow(hz)
        if counted.astray:
            feed.problem("lost count")
        if self._name == "emg":
            values = self._in_uv(values, feed)
        stamp = counted.stamp
        feed.emit(Chunk(stamp, values, int(stamp[-1]), -1 if counted.astray else 0), self._name)
        if self._name == "emg":
            last = slice(-1, None)
            feed.emit(timing_chunk(counted.number[last], counted.device[last], arrival, stamp[last]), "timing")
        return len(values)

    def _in_uv(self, values: Samples, feed: Feed) -> Samples:
        """uV; what no electrode can give is no number."""
        wrong = ~(np.abs(values) < protocol.RANGE_V)
        if wrong.any():
            feed.problem("impossible value", int(wrong.sum()))
            values[wrong] = np.nan
        return values * 1e6
