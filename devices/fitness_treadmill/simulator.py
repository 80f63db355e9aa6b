"""A simulated treadmill with Bluetooth's fitness machine service: it runs at what was set, and answers as the service has it."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager

from kinegraph.devices.ble.simulated_radio import in_reach
from kinegraph.devices.fitness_treadmill import protocol as ftms
from kinegraph.devices.fitness_treadmill.source import FtmsTreadmill
from kinegraph.devices.transport.ble_radio import uuid

ANSWERS = {ftms.REQUEST, ftms.RESET, ftms.SPEED, ftms.INCLINE, ftms.START, ftms.STOP}
EVERY_S = 0.25


class FtmsBelt:
    """.8 to 16 km/h in steps of .1, -3 to 15 % in steps of .5."""

    name: str = "Treadmill 7"
    advertised: tuple[str, ...] = (ftms.SERVICE,)
    services: dict[str, dict[str, list[str]]] = {
        ftms.SERVICE: {
            ftms.DATA: ["notify"], ftms.FEATURES: ["read"], ftms.SPEEDS: ["read"], ftms.INCLINES: ["read"],
            ftms.CONTROL: ["write", "indicate"], ftms.STATUS: ["notify"],
        }
    }  # fmt: skip

    def __init__(self, speed_kmh: float = 0.0) -> None:
        self.speed_kmh, self.incline = speed_kmh, 0.0
        self.granted = False
        self.heard: list[bytes] = []
        self._distance = self._seconds = 0.0
        self._said = 0

    def connected(self, yes: bool) -> None:
        self.granted = self.granted and yes

    def hold(self, characteristic: str) -> bytes:
        known = {
            ftms.FEATURES: struct.pack("<II", 1 << 2 | 1 << 3, 0b11),
            ftms.SPEEDS: struct.pack("<HHH", 80, 1600, 10),
            ftms.INCLINES: struct.pack("<hhH", -30, 150, 5),
        }
        return next((held for name, held in known.items() if uuid(name) == characteristic), b"")

    def receive(self, characteristic: str, data: bytes) -> list[tuple[str, bytes]]:
        if characteristic != uuid(ftms.CONTROL) or not data:
            return []
        self.heard.append(data)
        op, status = data[0], b""
        if op not in ANSWERS:
            result = 2
        elif op == ftms.REQUEST:
            self.granted, result = True, 1
        elif not self.granted:
            result = 5
        else:
            result, status = self._obey(op, data)
        replies = [(ftms.CONTROL, bytes([0x80, op, result]))]
        return [*replies, (ftms.STATUS, status)] if status else replies

    def _obey(self, op: int, data: bytes) -> tuple[int, bytes]:
        if op == ftms.SPEED:
            (hundredths,) = struct.unpack_from("<H", data, 1)
            if not 80 <= hundredths <= 1600 or hundredths % 10:
                return 3, b""
            self.speed_kmh = hundredths / 100
            return 1, b"\x05" + data[1:3]
        if op == ftms.INCLINE:
            (tenths,) = struct.unpack_from("<h", data, 1)
            if not -30 <= tenths <= 150:
                return 3, b""
            self.incline = tenths / 10
            return 1, b"\x06" + data[1:3]
        if op == ftms.STOP:
            self.speed_kmh = 0.0
            return 1, b"\x02\x01"
        return 1, b"\x04" if op == ftms.START else b""

    def say(self, seconds: float) -> list[tuple[str, bytes]]:
        self._distance += self.speed_kmh / 3.6 * (seconds - self._seconds)
        self._seconds = seconds
        due = int(seconds / EVERY_S)
        if due <= self._said:
            return []
        self._said = due
        return [(ftms.DATA, ftms.build(self.speed_kmh, self.incline, self._distance, seconds))]


@contextmanager
def simulated(source: FtmsTreadmill) -> Iterator[FtmsTreadmill]:
    """What `--simulate` puts in its place: a belt that already moves, and is called as the source calls it."""
    belt = FtmsBelt(speed_kmh=4.5)
    belt.name = source.device or belt.name
    with in_reach(belt):
        yield source
