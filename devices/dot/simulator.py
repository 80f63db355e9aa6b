"""A simulated Movella DOT at the lower back, as its Bluetooth LE services have it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from kinegraph.devices.ble.simulated_radio import in_reach
from kinegraph.devices.dot import protocol as protocol
from kinegraph.devices.dot.protocol import DotMode
from kinegraph.devices.dot.source import MovellaDot
from kinegraph.devices.people.walking_back import Back
from kinegraph.stream.chunk import Samples

PERSON = 101
"""A walker whom the shipped model of walking manners was not trained on, as of `devices.mti.back_walker`."""


class DotSensor:
    """Channel k of packet i holds i mod 1000 + 1000 k eighths, so that what is read can be checked; its clock begins at a given time."""

    advertised: tuple[str, ...] = ()
    services: dict[str, dict[str, list[str]]] = {
        protocol.SERVICE: {
            protocol.CONTROL: ["read", "write"],
            **{c: ["notify"] for c in (protocol.LONG, protocol.MEDIUM, protocol.SHORT)},
        },
        protocol.BASE.format("1000"): {protocol.DEVICE_CONTROL: ["read", "write"]},
    }

    def __init__(self, name: str = "Movella DOT", zero_us: int = (1 << 32) - 2_000_000) -> None:
        self.name, self._zero_us = name, zero_us
        self.running: DotMode | None = None
        self._rate, self._said, self._seconds, self._began = 60, 0, 0.0, 0.0

    def connected(self, yes: bool) -> None: ...

    def hold(self, characteristic: str) -> bytes:
        return b""

    def receive(self, characteristic: str, data: bytes) -> list[tuple[str, bytes]]:
        if characteristic == protocol.DEVICE_CONTROL and data[0] & protocol.RATE_BIT:
            self._rate = int.from_bytes(data[protocol.RATE_AT : protocol.RATE_AT + 2], "little")
        elif characteristic == protocol.CONTROL and data[0] == protocol.MEASUREMENT:
            modes = {mode.number: mode for mode in protocol.MODES.values()}
            self.running = modes[data[2]] if data[1] else None
            self._began, self._said = self._seconds, 0
        return []

    def say(self, seconds: float) -> list[tuple[str, bytes]]:
        self._seconds = seconds
        if self.running is None:
            return []
        due = int((seconds - self._began) * self._rate)
        first, self._said = self._said, max(due, self._said)
        return [(self.running.characteristic, self._packet(self.running, i)) for i in range(first, self._said)]

    def _packet(self, mode: DotMode, number: int) -> bytes:
        return protocol.build(mode, self._zero_us + round(number * 1e6 / self._rate), self.values(mode, number))

    def values(self, mode: DotMode, number: int) -> Samples:
        """The channels (c,) of a packet."""
        made = (number % 1000 + 1000.0 * np.arange(len(mode.channels))) / 8
        names = [name for name, _ in mode.channels]
        if "qw" in names:
            made[names.index("qw") :][:4] = (1.0, 0.0, 0.0, 0.0)
        if mode.counts:
            made[-mode.counts :] = number % 7
        return np.asarray(made, np.float64)


class WornDot(DotSensor):
    """One at the lower back of somebody who walks, turns and stands; what is not measured there is 0."""

    _back: Back | None = None

    def values(self, mode: DotMode, number: int) -> Samples:
        made = self._worn().measure(np.array([number]))
        found = {
            **dict(zip(("ax", "ay", "az"), made["acceleration"][0], strict=True)),
            **dict(zip(("gx", "gy", "gz"), np.rad2deg(made["angular_velocity"][0]), strict=True)),
            "qw": 1.0,
        }
        return np.array([found.get(name, 0.0) for name, _ in mode.channels])

    def _worn(self) -> Back:
        if self._back is None or self._back.rate_hz != self._rate:
            self._back = Back("brisk", PERSON, float(self._rate))
        return self._back


@contextmanager
def simulated(source: MovellaDot) -> Iterator[MovellaDot]:
    """What `--simulate` puts in its place."""
    with in_reach(WornDot()):
        yield replace(source, device="Movella DOT")
