"""Movella (Xsens) DOT over Bluetooth LE: orientation, acceleration, angular velocity, on the sensor's own clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from kinegraph.devices.ble.source import DEVICE_HELP, BleSource
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.clocks.stamps import Stamps, chunks
from kinegraph.devices.clocks.timing import timing_chunk, timing_spec
from kinegraph.devices.dot import protocol as protocol
from kinegraph.devices.transport.ble_link import BleLink, Notification
from kinegraph.stream.chunk import Specs, StreamSpec
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed


@dataclass(frozen=True, slots=True)
class MovellaDot(BleSource):
    """One DOT sensor; several are several nodes, each with its `device`.

    out      the channels of `mode` at `rate_hz`: qw..qz, roll pitch yaw (deg), free_x.. (m/s2, earth's frame, without gravity),
             ax.. (m/s2), gx.. (deg/s), mx.. (in units of the earth's field)
    timing   an event per packet: the sensor's time, arrival, stamp

    Stamps follow the sensor's time, and what is missing is known from it: packets have no counter. Measuring is ended at the end.
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "timing")

    device: str = param("Movella DOT", help=DEVICE_HELP + "; older sensors are called Xsens DOT")
    mode: protocol.Mode = param("inertial", help="what is measured")
    rate_hz: Literal[1, 4, 10, 12, 15, 20, 30, 60, 120] = param(60, help="packets per second")
    scan_s: float = param(10.0, above=0, help="how long to search for it")
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the measurement to its arrival, if you know it"
    )

    @property
    def chunk_s(self) -> float:
        return 1 / self.rate_hz

    def specs(self) -> Specs:
        names, units = zip(*protocol.MODES[self.mode].channels, strict=True)
        spec = StreamSpec((len(names),), rate_hz=float(self.rate_hz), channels=names, units=units)
        return {"out": spec, "timing": timing_spec()}

    def greet(self, link: BleLink, feed: Feed) -> DotReading:
        mode = protocol.MODES[self.mode]
        link.subscribe(mode.characteristic)
        link.write(protocol.DEVICE_CONTROL, protocol.rate_command(self.rate_hz))
        link.write(protocol.CONTROL, protocol.command(mode, protocol.BEGIN))
        return DotReading(self)

    def rest(self, link: BleLink, feed: Feed) -> None:
        link.write(protocol.CONTROL, protocol.command(protocol.MODES[self.mode], protocol.END))


class DotReading:
    """Packets to samples."""

    def __init__(self, of: MovellaDot) -> None:
        self._mode = protocol.MODES[of.mode]
        self._stamps = Stamps(float(of.rate_hz), has_time=True, wraps_ns=protocol.WRAPS_NS, latency_s=of.latency_s)

    @property
    def clock(self) -> ClockState | None:
        return self._stamps.state

    def take(self, note: Notification, feed: Feed) -> None:
        parsed = protocol.parse(self._mode, note.data)
        if parsed is None:
            feed.problem("cut packet")
            return
        packets = self._stamps.take(1, note.arrival, np.array([parsed[0] * 1000]))
        if not len(packets.stamp):
            feed.problem("repeated packet or wrong time")
            return
        lost = int(packets.lost[0])
        if lost:
            feed.problem("lost packet" if lost > 0 else "device restarted", max(lost, 1))
        for chunk in chunks(packets.stamp, packets.lost, parsed[1][None]):
            feed.emit(chunk)
        feed.emit(timing_chunk(-1, packets.device, note.arrival, packets.stamp), "timing")
