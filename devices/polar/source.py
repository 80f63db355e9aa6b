"""The Polar H10 over Bluetooth LE: electrocardiogram and acceleration, on the belt's own clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.devices.ble.source import DEVICE_HELP, BleSource
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.packet_clock import Packets
from kinegraph.devices.clocks.stamps import Stamps, chunks
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.heart_rate import protocol as heart_rate
from kinegraph.devices.heart_rate.source import HeartRateReading
from kinegraph.devices.polar import protocol as polar_pmd
from kinegraph.devices.polar.protocol import ACC, ECG, PmdDecoder, PmdFrame
from kinegraph.devices.transport.ble_link import BleLink, Notification
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, outputs_by_parameters

ECG_HZ = 130.0
ANSWER_S = 5.0
FOLLOWS = 0.5
"""A frame with a time off by less than this many frames follows the one before: its samples are spread evenly between the two."""


@dataclass(frozen=True, slots=True)
class Polar(BleSource):
    """A Polar H10 (or another Polar sensor that offers the same measurements), worn.

    ecg            (1,) float64 at 130 Hz: electrocardiogram in uV
    acceleration   (3,) float64 at `acceleration_hz`: x, y, z in g
    rate, beats    with `heart`: as of `devices.heart_rate.HeartRate`
    timing         an event per frame: the belt's time (of its last sample), arrival, stamp

    A frame brings the belt's time of its last sample; the samples before lie evenly behind the frame before. Missing frames are known from
    that time. Measuring is stopped at the end, whatever happens: a belt that is not stopped stays on until its battery is empty.
    """

    services = (heart_rate.SERVICE,)

    device: str = param("Polar H10", help=DEVICE_HELP)
    ecg: bool = param(True, help="read the electrocardiogram")
    acceleration_hz: Literal[0, 25, 50, 100, 200] = param(0, help="samples of acceleration per second; 0: off")
    range_g: Literal[2, 4, 8] = param(8, help="full scale of the acceleration")
    heart: bool = param(True, help="read heart rate and intervals between beats too")
    scan_s: float = param(10.0, above=0, help="how long to search for it")
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to its arrival, if you know it"
    )

    @outputs_by_parameters("ecg", "timing")
    def outputs(self) -> tuple[str, ...]:
        wanted = (
            self.ecg and "ecg",
            self.acceleration_hz and "acceleration",
            self.heart and "rate",
            self.heart and "beats",
        )
        return (*(str(name) for name in wanted if name), "timing")

    @property
    def chunk_s(self) -> float:
        return 73 / ECG_HZ

    def specs(self) -> Specs:
        specs: Specs = {"timing": timing_spec()}
        if self.ecg:
            specs["ecg"] = StreamSpec((1,), rate_hz=ECG_HZ, channels=("ecg",), units=("uV",))
        if self.acceleration_hz:
            rate = float(self.acceleration_hz)
            specs["acceleration"] = StreamSpec((3,), rate_hz=rate, channels=("ax", "ay", "az"), units=("g",))
        if self.heart:
            specs["rate"] = StreamSpec((2,), channels=("heart_rate", "contact"), units=("bpm", ""))
            specs["beats"] = StreamSpec((1,), channels=("interval",), units=("s",))
        return specs

    @property
    def kinds(self) -> tuple[int, ...]:
        return (*((ECG,) if self.ecg else ()), *((ACC,) if self.acceleration_hz else ()))

    def greet(self, link: BleLink, feed: Feed) -> PolarReading:
        decoder = PmdDecoder()
        if self.kinds:
            offered = link.ask(polar_pmd.CONTROL)
            for kind in self.kinds:
                if len(offered) < 2 or not offered[1] >> kind & 1:
                    raise DeviceError(f"{link.name} does not measure {'ecg' if kind == ECG else 'acceleration'}")
            link.subscribe(polar_pmd.CONTROL)
            link.subscribe(polar_pmd.DATA)
        for kind in self.kinds:
            if kind == ECG:
                command = polar_pmd.start(ECG, rate=130, resolution=14)
            else:
                command = polar_pmd.start(ACC, rate=self.acceleration_hz, resolution=16, range=self.range_g)
            self._start(link, kind, command, decoder)
        if self.heart:
            link.subscribe(heart_rate.MEASUREMENT)
        return PolarReading(self, decoder, link.name)

    def _start(self, link: BleLink, kind: int, command: bytes, decoder: PmdDecoder) -> None:
        """Begin a measurement; one that another program left running is stopped first. Raises DeviceError."""
        for _ in range(2):
            link.write(polar_pmd.CONTROL, command)
            answer = link.answer(polar_pmd.CONTROL, bytes([0xF0, polar_pmd.START, kind]), ANSWER_S)
            status = answer[3] if len(answer) > 3 else 4
            if status != 6:
                break
            self._stop(link, kind)
            link.answer(polar_pmd.CONTROL, bytes([0xF0, polar_pmd.STOP, kind]), ANSWER_S)
        if status:
            raise DeviceError(f"{link.name} refuses to measure: {polar_pmd.STATUS.get(status, f'error {status}')}")
        try:
            decoder.started(answer)
        except ValueError as error:
            raise DeviceError(f"{link.name} answers {answer.hex(' ')}: {error}") from None

    @staticmethod
    def _stop(link: BleLink, kind: int) -> None:
        link.write(polar_pmd.CONTROL, bytes([polar_pmd.STOP, kind]))

    def rest(self, link: BleLink, feed: Feed) -> None:
        for kind in self.kinds:
            self._stop(link, kind)


class PolarReading:
    """Notifications to samples."""

    def __init__(self, of: Polar, decoder: PmdDecoder, name: str) -> None:
        self._decoder, self._name = decoder, name
        self._heart = HeartRateReading()
        self._streams = {
            kind: PmdStream(ECG_HZ if kind == ECG else of.acceleration_hz, of.latency_s) for kind in of.kinds
        }
        self._outputs = {ECG: "ecg", ACC: "acceleration"}
        self._told = 0

    @property
    def clock(self) -> ClockState | None:
        return next((stream.stamps.state for stream in self._streams.values()), None)

    def take(self, note: Notification, feed: Feed) -> None:
        if note.characteristic == polar_pmd.DATA:
            self._measured(note, feed)
        elif note.characteristic == polar_pmd.CONTROL:
            if note.data[:1] == b"\x01":
                raise DeviceError(f"{self._name} stopped measuring of its own accord")
        else:
            self._heart.take(note, feed)

    def _measured(self, note: Notification, feed: Feed) -> None:
        frame = self._decoder.frame(note.data)
        if frame is None or frame.kind not in self._streams:
            feed.problem("cut frame" if frame is None else "frame that was not asked for")
            return
        stream = self._streams[frame.kind]
        stamp = stream.go_on(frame, note.arrival)
        if stamp is not None:
            feed.emit(Chunk(stamp, frame.data, int(stamp[-1])), self._outputs[frame.kind])
            self._report_timing(stream, frame, note.arrival, stamp, feed)
            return
        packets = stream.take(frame, note.arrival)
        missing = int(packets.lost.clip(0).sum())
        if missing:
            feed.problem("lost sample", missing)
        if (packets.lost < 0).any():
            feed.problem("device restarted")
        if not len(packets.stamp):
            return
        for chunk in chunks(packets.stamp, packets.lost, frame.data[packets.kept]):
            feed.emit(chunk, self._outputs[frame.kind])
        self._report_timing(stream, frame, note.arrival, packets.stamp, feed)

    def _report_timing(self, stream: PmdStream, frame: PmdFrame, arrival: int, stamp: Times, feed: Feed) -> None:
        self._told = max(self._told, int(stamp[-1]))
        feed.emit(timing_chunk(stream.frames, frame.last_ns, arrival, np.array([self._told])), "timing")


class PmdStream:
    """One measurement's frames to stamped samples."""

    def __init__(self, rate_hz: float, latency_s: float) -> None:
        self._period = NS / rate_hz
        self.stamps = Stamps(rate_hz, has_time=True, latency_s=latency_s)
        self._last: int | None = None
        self.frames = 0

    def go_on(self, frame: PmdFrame, arrival: int) -> Times | None:
        """Stamps (n,) of a frame that follows the one before it, as nearly all do; None of others, which `take` takes."""
        n, last = len(frame.data), self._last
        if last is None or not n or abs(frame.last_ns - last - n * self._period) >= FOLLOWS * n * self._period:
            return None
        made = self.stamps.go_on(frame.last_ns, n, arrival)
        if made is None:
            return None
        self._last, self.frames = frame.last_ns, self.frames + 1
        return made[1]

    def take(self, frame: PmdFrame, arrival: int) -> Packets:
        self.frames += 1
        return self.stamps.take(len(frame.data), arrival, self._times(frame.last_ns, len(frame.data)))

    def _times(self, last_ns: int, n: int) -> Times:
        """The device's time of each of n samples."""
        before, self._last = self._last, last_ns
        step = self._period
        if before is not None and abs(last_ns - before - n * self._period) < FOLLOWS * n * self._period:
            step = (last_ns - before) / n
        return np.asarray(last_ns - np.round(step * np.arange(n - 1, -1, -1)).astype(np.int64))
