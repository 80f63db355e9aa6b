"""A simulated OpenBCI Ganglion of firmware 2 or 3, as its Bluetooth LE service has it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from kinegraph.devices.ble.simulated_radio import in_reach
from kinegraph.devices.ganglion import protocol as protocol
from kinegraph.devices.ganglion.source import Ganglion
from kinegraph.devices.transport.ble_radio import uuid
from kinegraph.stream.chunk import Array


class GanglionBoard:
    """`counts` gives sample i of all channels; `ohm`: of the four electrodes and the reference."""

    advertised: tuple[str, ...] = (protocol.SERVICE,)
    services: dict[str, dict[str, list[str]]] = {
        protocol.SERVICE: {protocol.NOTIFY: ["notify"], protocol.WRITE: ["write-without-response"]},
        "180a": {protocol.FIRMWARE: ["read"]},
    }

    def __init__(self, firmware: int = 2, ohm: tuple[int, ...] = (9000, 12000, 7000, 15000, 10000)) -> None:
        self.name, self._firmware = "Ganglion-1234", firmware
        self.running = self._motion = False
        self._said, self._seconds, self._began = 0, 0.0, 0.0
        self.ohm, self.measuring = ohm, False

    def connected(self, yes: bool) -> None: ...

    def hold(self, characteristic: str) -> bytes:
        return f"{self._firmware}.0.1".encode() if characteristic == uuid(protocol.FIRMWARE) else b""

    def receive(self, characteristic: str, data: bytes) -> list[tuple[str, bytes]]:
        if data == b"b":
            self.running, self._began, self._said = True, self._seconds, 0
        elif data == b"s":
            self.running = False
        elif data in (protocol.IMPEDANCE_START, protocol.IMPEDANCE_STOP):
            self.measuring, self._began, self._said = data == protocol.IMPEDANCE_START, self._seconds, 0
        elif data == b"n":
            self._motion = True
        return []

    def say(self, seconds: float) -> list[tuple[str, bytes]]:
        self._seconds = seconds
        if self.measuring:
            first, self._said = self._said, int((seconds - self._began) / 0.1)
            return [(protocol.NOTIFY, self._impedance(i % protocol.REFERENCE)) for i in range(first, self._said)]
        if not self.running:
            return []
        due = int((seconds - self._began) * protocol.RATE_HZ / 2)
        first, self._said = self._said, max(due, self._said)
        return [(protocol.NOTIFY, self.packet(i)) for i in range(first, self._said)]

    def _impedance(self, which: int) -> bytes:
        return bytes([protocol.IMPEDANCE_FIRST + which]) + f"{self.ohm[which]}Z\n".encode()

    def counts(self, index: Array) -> Array:
        """Samples (n, 4) in counts; what is sent of them differs by less than two (firmware 2) or 128 (3): the lowest bit is the sign."""
        slow = np.stack([np.sin(index * (k + 1) / 30) for k in range(4)], axis=1)
        return np.asarray(np.round(slow * 1000) * 64 + 2**20, np.int64)

    def packet(self, number: int) -> bytes:
        """The packet of this number, from the start on."""
        last = (number * 3 % 100) if self._motion else 0
        if self._firmware >= 3:
            place = number % 100
            rows = self.counts(np.arange(2 * number, 2 * number + 2)) >> 6
            return bytes([place]) + protocol.packed(rows & ~1, 18) + bytes([last])
        turn, place = divmod(number, 101)
        if place == 0:
            whole = self.counts(np.array([201 * turn]))[0]
            return bytes([0]) + b"".join(int(v).to_bytes(3, "big", signed=True) for v in whole).ljust(19, b"\0")
        rows = self.counts(np.arange(201 * turn, 201 * turn + 2 * place + 1))
        sent, steps = rows[0], []
        for row in rows[1:]:
            step = sent - row
            steps.append(np.where(step < 0, step | 1, step & ~1))
            sent = sent - steps[-1]
        return bytes([100 + place]) + protocol.packed(np.array(steps[-2:]), 19)


@contextmanager
def simulated(source: Ganglion) -> Iterator[Ganglion]:
    """What `--simulate` puts in its place."""
    board = GanglionBoard()
    with in_reach(board):
        yield replace(source, device=board.name)
