"""Heart rate belts and watches over Bluetooth LE, of any maker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.devices.ble.source import DEVICE_HELP, BleSource
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.heart_rate import protocol as protocol
from kinegraph.devices.transport.ble_link import BleLink, Notification
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed


@dataclass(frozen=True, slots=True)
class HeartRate(BleSource):
    """Anything that has Bluetooth's heart rate service: belts of Polar, Garmin, Wahoo, watches that broadcast.

    rate    (2,) float64, irregular, about once a second: heart rate (bpm) and contact (1, 0, NaN: the sensor cannot tell)
    beats   (1,) float64, irregular: the interval between two beats (s), oldest first, where the sensor tells it

    The service has no clock. The last interval of a notification is stamped with its arrival, which is up to a second after the beat; those
    before lie as far back as the intervals say, and never before an earlier one.
    """

    outputs: ClassVar[tuple[str, ...]] = ("rate", "beats")
    services: ClassVar[tuple[str, ...]] = (protocol.SERVICE,)

    device: str = param("", help=DEVICE_HELP)
    scan_s: float = param(10.0, above=0, help="how long to search for it")

    @property
    def chunk_s(self) -> float:
        return 1.0

    def specs(self) -> Specs:
        return {
            "rate": StreamSpec((2,), channels=("heart_rate", "contact"), units=("bpm", "")),
            "beats": StreamSpec((1,), channels=("interval",), units=("s",)),
        }

    def greet(self, link: BleLink, feed: Feed) -> HeartRateReading:
        link.subscribe(protocol.MEASUREMENT)
        return HeartRateReading()


class HeartRateReading:
    """Notifications to samples."""

    clock: ClockState | None = None

    def __init__(self) -> None:
        self._last = 0

    def take(self, note: Notification, feed: Feed) -> None:
        measured = protocol.parse(note.data)
        if measured is None:
            feed.problem("cut notification")
            return
        contact = np.nan if measured.contact is None else float(measured.contact)
        now = np.array([note.arrival])
        feed.emit(Chunk(now, np.array([[float(measured.bpm), contact]]), note.arrival), "rate")
        if measured.rr_s:
            back = np.cumsum(np.array((0.0, *measured.rr_s[:0:-1])))[::-1]
            beats = np.maximum(note.arrival - np.round(back * NS).astype(np.int64), self._last + 1)
            beats = np.maximum.accumulate(beats)
            self._last = int(beats[-1])
            feed.emit(Chunk(beats, np.array(measured.rr_s)[:, None], self._last), "beats")
