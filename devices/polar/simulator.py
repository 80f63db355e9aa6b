"""A simulated Polar H10: heart rate, electrocardiogram and acceleration as its Bluetooth LE interface has them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from kinegraph.devices.ble.simulated_radio import in_reach
from kinegraph.devices.heart_rate import protocol as heart_rate
from kinegraph.devices.heart_rate.protocol import HeartRateMeasurement
from kinegraph.devices.heart_rate.source import HeartRate
from kinegraph.devices.polar import protocol as polar_pmd
from kinegraph.devices.polar.protocol import ACC, ECG
from kinegraph.devices.polar.source import ECG_HZ, Polar
from kinegraph.devices.transport.ble_radio import uuid
from kinegraph.stream.chunk import NS, Array

BEAT_S = 0.85
UNSET_NS = 599_616_000 * NS
"""Where the clock of a belt begins that was never set: 2019-01-01."""
ECG_FRAME, ACC_FRAME = 73, 36


class PolarBelt:
    """Worn by someone at rest: 70 beats a minute. `ecg` and `acceleration` give sample i of a measurement."""

    name: str = "Polar H10 12345678"
    advertised: tuple[str, ...] = (heart_rate.SERVICE,)
    services: dict[str, dict[str, list[str]]] = {
        heart_rate.SERVICE: {heart_rate.MEASUREMENT: ["notify"]},
        polar_pmd.SERVICE: {polar_pmd.CONTROL: ["read", "write", "indicate"], polar_pmd.DATA: ["notify"]},
        "180a": {"2a29": ["read"], "2a26": ["read"]},
        "180f": {"2a19": ["read"]},
    }

    def __init__(self, *, compressed: bool = False, refuses: int = 0) -> None:
        """`refuses`: the status with which every start is answered; 0: success."""
        self._compressed, self._refuses = compressed, refuses
        self.running: dict[int, float] = {}
        """By measurement, its rate."""
        self._began: dict[int, float] = {}
        self._said: dict[int, int] = {}
        self._beats = 0
        self._seconds = 0.0
        self.ahead_ns = 0
        self.host = False

    def connected(self, yes: bool) -> None:
        self.host = yes

    def hold(self, characteristic: str) -> bytes:
        known = {
            polar_pmd.CONTROL: b"\x0f\x05" + bytes(15),
            uuid("2a29"): b"Polar",
            uuid("2a26"): b"3.1.1",
            uuid("2a19"): b"\x5a",
        }
        return known.get(characteristic, b"")

    def receive(self, characteristic: str, data: bytes) -> list[tuple[str, bytes]]:
        if characteristic != polar_pmd.CONTROL or len(data) < 2:
            return []
        op, kind = data[0], data[1]
        return [(polar_pmd.CONTROL, bytes([0xF0, op, kind]) + self._obey(op, kind, data[2:]))]

    def _obey(self, op: int, kind: int, rest: bytes) -> bytes:
        if kind not in (ECG, ACC):
            return b"\x03"
        if op == polar_pmd.SETTINGS:
            rates = (130,) if kind == ECG else (25, 50, 100, 200)
            return b"\0\0" + bytes([0, len(rates)]) + b"".join(struct.pack("<H", r) for r in rates) + b"\x01\x01\x0e\0"
        if op == polar_pmd.STOP:
            return b"\0\0" if self.running.pop(kind, None) else b"\x06\0"
        if self._refuses:
            return bytes([self._refuses, 0])
        if kind in self.running:
            return b"\x06\0"
        self.running[kind] = polar_pmd.settings(rest)[0][0]
        self._began[kind], self._said[kind] = self._seconds, 0
        return b"\0\0" + (b"\x05\x01" + struct.pack("<f", 1.0) if self._compressed and kind == ACC else b"")

    def say(self, seconds: float) -> list[tuple[str, bytes]]:
        self._seconds = seconds
        sent: list[tuple[str, bytes]] = []
        for kind, rate in self.running.items():
            size = ECG_FRAME if kind == ECG else ACC_FRAME
            due = int((seconds - self._began[kind]) * rate) // size
            sent += [(polar_pmd.DATA, self._frame(kind, rate, i, size)) for i in range(self._said[kind], due)]
            self._said[kind] = max(due, self._said[kind])
        beats = int(seconds / BEAT_S)
        if beats > self._beats:
            measured = HeartRateMeasurement(round(60 / BEAT_S), None, None, (BEAT_S,) * min(beats - self._beats, 4))
            sent.append((heart_rate.MEASUREMENT, heart_rate.build(measured)))
            self._beats = beats
        return sent

    def _frame(self, kind: int, rate: float, number: int, size: int) -> bytes:
        index = np.arange(number * size, (number + 1) * size)
        last = UNSET_NS + self.ahead_ns + round((self._began[kind] + (index[-1] + 1) / rate) * NS)
        if kind == ECG:
            body = b"\0" + b"".join(int(v).to_bytes(3, "little", signed=True) for v in self.ecg(index))
        elif self._compressed:
            body = b"\x81" + polar_pmd.packed(self.acceleration(index), 10)
        else:
            body = b"\x01" + self.acceleration(index).astype("<i2").tobytes()
        return bytes([kind]) + struct.pack("<Q", last) + body

    def ecg(self, index: Array) -> Array:
        """uV at samples (n,): a peak of 1 mV every beat; their last three digits are the sample's number."""
        phase = (index / ECG_HZ % BEAT_S) - BEAT_S / 2
        return np.asarray(np.round(np.exp(-((phase / 0.02) ** 2)) * 10) * 1000 + index % 1000, np.int64)

    def acceleration(self, index: Array) -> Array:
        """mg at samples (n,): (n, 3); x is the sample's number modulo 200."""
        return np.stack([index % 200, np.full(len(index), -20), 990 + index % 7], axis=1).astype(np.int64)


@contextmanager
def simulated(source: Polar | HeartRate) -> Iterator[Polar | HeartRate]:
    """What `--simulate` puts in its place."""
    belt = PolarBelt()
    with in_reach(belt):
        yield replace(source, device=belt.name)
