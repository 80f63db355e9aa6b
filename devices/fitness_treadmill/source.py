"""Treadmills over Bluetooth LE (fitness machine service): what the belt does, as a stream; and, if asked, set from a graph."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import structlog

from kinegraph.devices.ble.source import DEVICE_HELP, BleReading, BleSource
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.fitness_treadmill import protocol as ftms
from kinegraph.devices.fitness_treadmill.targets import Targets, targets_of
from kinegraph.devices.transport.ble_link import BleLink, Notification
from kinegraph.stream.chunk import Chunk, Specs, StreamSpec
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

CHANNELS = (
    ("speed", "m/s"),
    ("incline", "%"),
    ("distance", "m"),
    ("heart_rate", "bpm"),
    ("force", "N"),
    ("power", "W"),
)
KMH = 3.6
ANSWER_S = 3.0

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class FtmsTreadmill(BleSource):
    """A treadmill that has Bluetooth's fitness machine service (FTMS).

    out      (6,) float64, irregular, about once a second: speed of the belt (m/s), incline (%), distance (m), heart rate (bpm), force (N),
             power (W); NaN: this treadmill does not say it

    Stamps are arrivals: the service has no clock. With `control: true` the outlet `devices.fitness_treadmill.control.TreadmillControl` of
    the
    same graph, with the same `device`, sets speed and incline, within the treadmill's own limits and `max_kmh`; otherwise nothing is ever
    written. At the session's end the belt is stopped, but only if this session has set it.
    """

    services: ClassVar[tuple[str, ...]] = (ftms.SERVICE,)

    device: str = param("", help=DEVICE_HELP)
    control: bool = param(False, help="let an outlet of this graph set speed and incline")
    max_kmh: float = param(12.0, above=0, most=40, help="no faster speed is ever set")
    scan_s: float = param(10.0, above=0, help="how long to search for it")

    @property
    def chunk_s(self) -> float:
        return 1.0

    def specs(self) -> Specs:
        names, units = zip(*CHANNELS, strict=True)
        return {"out": StreamSpec((len(names),), channels=names, units=units)}

    def greet(self, link: BleLink, feed: Feed) -> TreadmillReading:
        control = TreadmillControls(link, self.max_kmh, targets_of(self.device)) if self.control else None
        reading = TreadmillReading(link.name, control)
        link.subscribe(ftms.DATA)
        if link.offers(ftms.STATUS):
            link.subscribe(ftms.STATUS)
        if control:
            control.ask()
        return reading

    def serve(self, reading: BleReading, feed: Feed) -> None:
        if isinstance(reading, TreadmillReading) and reading.control:
            reading.control.serve(feed)

    def rest(self, link: BleLink, feed: Feed) -> None:
        if self.control and targets_of(self.device).forget():
            link.write(ftms.CONTROL, bytes([ftms.STOP, 1]))


class TreadmillControls:
    """What is set: only what was asked for since the last look, within the limits, and only after control was granted."""

    def __init__(self, link: BleLink, max_kmh: float, targets: Targets) -> None:
        self._link, self._targets = link, targets
        features = link.ask(ftms.FEATURES)
        self._able = dict(zip((ftms.SPEED, ftms.INCLINE), ftms.can_be_set(features), strict=True))
        self._limits: dict[int, tuple[float, float, float]] = {}
        for op, where, signed, factor in (
            (ftms.SPEED, ftms.SPEEDS, False, 0.01),
            (ftms.INCLINE, ftms.INCLINES, True, 0.1),
        ):
            if self._able[op]:
                try:
                    low, high, step = ftms.limits(link.ask(where), signed=signed, factor=factor)
                except struct.error:
                    raise DeviceError(f"{link.name} does not report its limits; its speed is not set") from None
                self._limits[op] = (low, min(high, max_kmh) if op == ftms.SPEED else high, step)

    def ask(self) -> None:
        """Take control; raises DeviceError."""
        self._link.subscribe(ftms.CONTROL)
        self._command(bytes([ftms.REQUEST]))

    def serve(self, feed: Feed) -> None:
        """Set what the graph has asked for."""
        for op, value in self._targets.take():
            if op == ftms.STOP:
                self._command(bytes([ftms.STOP, 1]))
                continue
            if op not in self._limits:
                feed.problem("setting that the treadmill does not have")
                continue
            low, high, step = self._limits[op]
            wanted = min(max(value, low), high)
            if wanted != value:
                feed.problem("setting beyond the limits")
            steps = round((wanted - low) / step) if step else 0
            self._command(ftms.target(op, low + steps * step if step else wanted))

    def _command(self, data: bytes) -> None:
        self._link.write(ftms.CONTROL, data)
        answer = self._link.answer(ftms.CONTROL, bytes([0x80, data[0]]), ANSWER_S)
        if answer[2:3] != b"\x01":
            why = ftms.RESULT.get(answer[2] if len(answer) > 2 else 0, "an answer that is cut off")
            raise DeviceError(f"{self._link.name} refuses {data.hex(' ')}: {why}")


class TreadmillReading:
    """Notifications to samples; a message split in two is joined."""

    clock: ClockState | None = None

    def __init__(self, name: str, control: TreadmillControls | None) -> None:
        self._name, self.control = name, control
        self._parts: dict[str, float] = {}
        self._status: dict[int, Callable[[], str]] = {
            ftms.SAFETY_KEY: lambda: "its safety key was pulled",
            ftms.CONTROL_LOST: lambda: "it has taken control back",
        }

    def take(self, note: Notification, feed: Feed) -> None:
        if note.characteristic.startswith("00002ada") and note.data[:1]:
            if reported := self._status.get(note.data[0]):
                log.warning("treadmill", name=self._name, status=reported())
                feed.problem("safety key" if note.data[0] == ftms.SAFETY_KEY else "control lost")
            return
        if not note.characteristic.startswith("00002acd"):
            return
        parsed = ftms.parse(note.data)
        if parsed is None:
            feed.problem("cut notification")
            return
        self._parts |= parsed.values
        if parsed.more:
            return
        parts, self._parts = self._parts, {}
        row = [parts.get(name, np.nan) for name, _ in CHANNELS]
        row[0] /= KMH
        feed.emit(Chunk(np.array([note.arrival]), np.array([row]), note.arrival))
