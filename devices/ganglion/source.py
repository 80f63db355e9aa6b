"""The OpenBCI Ganglion over Bluetooth LE: four channels, and its accelerometer."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.devices.ble.source import DEVICE_HELP, BleSource
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.packet_clock import PacketClock
from kinegraph.devices.clocks.stamps import chunks
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.ganglion import protocol as protocol
from kinegraph.devices.ganglion.protocol import RATE_HZ, UV, GanglionDecoder
from kinegraph.devices.transport.ble_link import BleLink, Notification
from kinegraph.stream.chunk import Chunk, Specs, StreamSpec
from kinegraph.stream.domain.impedance import Impedance
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

ROUNDS, MEASURED_S = 2, 40.0
"""How often each impedance is measured, of which the last counts, and how long that may take."""


@dataclass(frozen=True, slots=True)
class Ganglion(BleSource):
    """An OpenBCI Ganglion of firmware 2 or 3.

    out            (4,) float64 at 200 Hz: the channels in uV
    acceleration   (3,) float64, irregular, 10 Hz, with `acceleration`: x, y, z in g
    timing         an event per packet: its running sample number, arrival, stamp

    The board measures its electrodes' impedances itself before a session (`kinegraph emg check-electrodes`): each channel's, and the
    reference's, which stands as every channel's other pole.

    Firmware 2 sends differences: behind a lost packet everything up to the next whole one (half a second on average) is lost too, and is
    marked so.
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "acceleration", "timing")
    services: ClassVar[tuple[str, ...]] = (protocol.SERVICE,)

    device: str = param("", help=DEVICE_HELP)
    acceleration: bool = param(False, help="switch the accelerometer on")
    scan_s: float = param(10.0, above=0, help="how long to search for it")
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to its arrival, if you know it"
    )

    @property
    def chunk_s(self) -> float:
        return 2 / RATE_HZ

    def specs(self) -> Specs:
        names = tuple(f"ch{i}" for i in range(1, 5))
        return {
            "out": StreamSpec((4,), rate_hz=RATE_HZ, channels=names, units=("uV",)),
            "acceleration": StreamSpec((3,), channels=("ax", "ay", "az"), units=("g",)),
            "timing": timing_spec(),
        }

    def greet(self, link: BleLink, feed: Feed) -> GanglionReading:
        digits = [c for c in link.text(protocol.FIRMWARE) if c.isdigit()]
        link.subscribe(protocol.NOTIFY)
        if self.acceleration:
            link.write(protocol.WRITE, b"n", response=False)
        link.write(protocol.WRITE, b"b", response=False)
        return GanglionReading(self, 3 if digits and int(digits[0]) >= 3 else 2)

    def impedances(self, feed: Feed) -> Iterator[Impedance]:
        found: dict[int, float] = {}
        with BleLink(feed, self.device, self.services, self.scan_s) as link:
            link.subscribe(protocol.NOTIFY)
            link.write(protocol.WRITE, protocol.IMPEDANCE_START, response=False)
            try:
                began, heard = time.monotonic(), Counter[int]()
                while len(heard) < protocol.REFERENCE or min(heard.values()) < ROUNDS:
                    if feed.stopped or time.monotonic() - began > MEASURED_S:
                        raise DeviceError(
                            f"{link.name} reported {len(heard)} of {protocol.REFERENCE} impedances in {MEASURED_S:g} s"
                        )
                    for note in link.fetch(0.1):
                        if each := protocol.impedance_ohm(note.data):
                            found[each[0]] = each[1]
                            heard[each[0]] += 1
            finally:
                with suppress(DeviceError):
                    link.write(protocol.WRITE, protocol.IMPEDANCE_STOP, response=False)
        for number, name in enumerate(self.specs()["out"].channels, 1):
            yield Impedance(name, "+", found[number], float("nan"))
            yield Impedance(name, "-", found[protocol.REFERENCE], float("nan"))

    def rest(self, link: BleLink, feed: Feed) -> None:
        link.write(protocol.WRITE, b"s", response=False)


class GanglionReading:
    """Packets to samples."""

    def __init__(self, of: Ganglion, firmware: int) -> None:
        self._decoder = GanglionDecoder(firmware)
        self._clock = PacketClock(8, RATE_HZ, of.latency_s, turn=self._decoder.turn)
        self._motion = np.full(3, np.nan)
        self._unknown, self._wanted = 0, of.acceleration

    @property
    def clock(self) -> ClockState | None:
        return self._clock.state

    def take(self, note: Notification, feed: Feed) -> None:
        packet = self._decoder.feed(note.data)
        if self._decoder.unknown > self._unknown:
            feed.problem("packet without a reference", self._decoder.unknown - self._unknown)
            self._unknown = self._decoder.unknown
        if packet is None:
            return
        packets = self._clock.take(packet.places, note.arrival)
        if not len(packets.stamp):
            feed.problem("repeated packet")
            return
        if missing := int(packets.lost.clip(0).sum()):
            feed.problem("lost sample", missing)
        for chunk in chunks(packets.stamp, packets.lost, packet.rows[packets.kept] * UV):
            feed.emit(chunk)
        feed.emit(timing_chunk(packets.number[-1:], packets.device[-1:], note.arrival, packets.stamp[-1:]), "timing")
        if self._wanted and packet.axis is not None:
            self._motion[packet.axis] = packet.acceleration_g
            if packet.axis == 2:  # the last of the three that come one after the other, unless one was lost
                last = packets.stamp[-1:]
                feed.emit(Chunk(last, self._motion[None].copy(), int(last[0])), "acceleration")
