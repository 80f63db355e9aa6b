"""Shimmer3 with LogAndStream firmware: packets to counts, commands and their answers as bytes. No port, no clock.

A packet is 00, the device's time in ticks of 1/32768 s (24 bits, little-endian, over after 512 s), and the channels in the order that the
inquiry tells. There is no checksum and no counter: only its time shows that a packet begins where it seems to, which is a whole
number of periods after the last one's. Acknowledgements (FF) and answers (8A ...) may stand between packets.

Source: "LogAndStream for Shimmer3 Firmware User Manual"; the package `pyshimmer` agrees (tests/peers).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kinegraph.stream.chunk import Samples, Times

TICKS_HZ = 32768
TICKS = 1 << 24
ACK, DATA, IN_STREAM = 0xFF, 0x00, 0x8A
INQUIRY, RATE, SENSORS, WIDE_RANGE, START, STOP = 0x01, 0x05, 0x08, 0x09, 0x07, 0x20
CALIBRATION, FIRMWARE, HARDWARE, EXG, BOARD, BATTERY, NAME = 0x2C, 0x2E, 0x3F, 0x61, 0x66, 0x95, 0x7B
WIDE_RATE, GYRO_RANGE, GYRO_RATE = 0x40, 0x49, 0x4C
INQUIRED, CALIBRATED, VERSION, MADE, BOARDED, NAMED, STATUS, CHARGED = 0x02, 0x2D, 0x2F, 0x25, 0x65, 0x7A, 0x71, 0x94
LOG_AND_STREAM = 3
SHIMMER3 = 3
MODELS = {2: "Shimmer2R", 3: "Shimmer3", 10: "Shimmer3R"}
"""By the number of the hardware; only a Shimmer3 lays its packets out like this."""
ANSWERS = {STATUS: 3, CHARGED: 5}
"""Length of what comes between packets, by its second byte."""

AGREE = 3
"""This many packets in a row must fit each other where nothing is known of where they begin."""
STRAY = 3
"""At most this many periods lie between two packets that make each other likely."""
LONGEST = 10 * TICKS_HZ
"""A packet after a longer silence than 10 s starts again."""


@dataclass(frozen=True, slots=True)
class ShimmerChannel:
    """A channel as it is sent: the number that the inquiry gives it stands in `CHANNELS`."""

    name: str
    size: int
    big: bool = False
    signed: bool = True


CHANNELS: dict[int, ShimmerChannel] = {
    0x00: ShimmerChannel("ax", 2), 0x01: ShimmerChannel("ay", 2), 0x02: ShimmerChannel("az", 2),
    0x04: ShimmerChannel("wx", 2), 0x05: ShimmerChannel("wy", 2), 0x06: ShimmerChannel("wz", 2),
    0x0A: ShimmerChannel("gx", 2, big=True), 0x0B: ShimmerChannel("gy", 2, big=True), 0x0C: ShimmerChannel("gz", 2, big=True),
    0x1D: ShimmerChannel("status1", 1, signed=False), 0x1E: ShimmerChannel("exg1", 3, big=True), 0x1F: ShimmerChannel("exg2", 3, big=True),
    0x20: ShimmerChannel("status2", 1, signed=False), 0x21: ShimmerChannel("exg3", 3, big=True), 0x22: ShimmerChannel("exg4", 3, big=True),
}  # fmt: skip
SENSOR_BITS = {"acceleration": 0x80, "wide_acceleration": 0x1000, "angular_velocity": 0x40, "exg1": 0x10, "exg2": 0x08}


@dataclass(frozen=True, slots=True)
class Inquiry:
    """What the device is set to: ticks between two packets, ranges, channels in the order in which they are sent."""

    divider: int
    wide_range: int
    gyro_range: int
    channels: tuple[int, ...]


def inquiry(data: bytes) -> Inquiry:
    """The answer to INQUIRY behind its code."""
    config = int.from_bytes(data[2:6], "little")
    return Inquiry(int.from_bytes(data[:2], "little"), config >> 2 & 3, config >> 16 & 3, tuple(data[8 : 8 + data[6]]))


def divider(rate_hz: float) -> int:
    """Ticks between two packets."""
    return max(1, round(TICKS_HZ / rate_hz))


def battery_v(data: bytes) -> float:
    """Volt by the two bytes of the battery's answer: 12 bits of 3 V behind a divider."""
    return int.from_bytes(data[:2], "little") / 4095 * 3.0 * 1.988


def answer_in(data: bytes, code: int, size: int) -> bytes | None:
    """The answer with this code and `size` bytes behind it, among acknowledgements and news; None: it has not come whole.

    `size` 0: the first byte after the code says how many follow; -1: an inquiry: the seventh byte says so. For a command that is only
    acknowledged `code` is ACK.
    """
    at = 0
    while at < len(data):
        news = _between(data, at)
        if data[at] == ACK and code == ACK:
            return b""
        if code == CHARGED and news == ANSWERS[CHARGED] and data[at + 1] == CHARGED:
            return data[at + 2 : at + news]
        if data[at] == code:
            body = data[at + 1 :]
            wanted = size or (1 + body[0] if body else 1)
            if size < 0:
                wanted = 8 + body[6] if len(body) > 6 else 8
            return body[:wanted] if len(body) >= wanted else None
        if news < 0:
            return None
        at += max(1, news)
    return None


def _between(data: bytes, at: int) -> int:
    """Length of the acknowledgement or answer that starts here; 0: something else; -1: it may be incomplete."""
    if data[at] == ACK:
        return 1
    if data[at] != IN_STREAM:
        return 0
    if at + 1 >= len(data):
        return -1
    size = ANSWERS.get(data[at + 1], 0)
    return -1 if at + size > len(data) else size


@dataclass(slots=True)
class ShimmerPackets:
    """The packets found.

    ticks      (n,) int64, the device's time
    table      (n, size) uint8, each packet's bytes
    dropped    bytes that belonged to no packet
    resyncs    how often the beginning of the next packet had to be looked for
    repeated   packets that were there already
    battery    the device's battery reports, as they came
    """

    ticks: Times
    table: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
    dropped: int = 0
    resyncs: int = 0
    repeated: int = 0
    battery: list[bytes] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.ticks)


class ShimmerDecoder:
    """Feed it bytes as they come, cut anywhere; it never waits and never raises."""

    def __init__(self, channels: tuple[int, ...], divider: int) -> None:
        self.size = 4 + sum(CHANNELS[c].size for c in channels)
        self._divider, self._slack = divider, max(2, divider // 8)
        self._buffer = b""
        self._last: int | None = None
        self._packet = b""
        self._astray = False

    def feed(self, data: bytes) -> ShimmerPackets:
        buffer, at, size = self._buffer + data, 0, self.size
        found = bytearray()
        packets = ShimmerPackets(np.empty(0, np.int64), np.empty((0, size), np.uint8))
        while at < len(buffer):
            if between := _between(buffer, at):
                if between < 0:
                    break
                if between == ANSWERS[CHARGED]:
                    packets.battery.append(buffer[at + 2 : at + between])
                at += between
                continue
            good = self._good(buffer, at)
            if good is None:
                break
            if not good:
                packets.dropped += 1
                self._astray = self._last is not None
                at += 1
                continue
            packet = buffer[at : at + size]
            if packet == self._packet:
                packets.repeated += 1
            else:
                found += packet
            packets.resyncs += self._astray
            self._packet, self._last, self._astray = packet, _ticks(packet, 0), False
            at += size
        self._buffer = buffer[at:]
        packets.table = np.frombuffer(bytes(found), np.uint8).reshape(-1, size)
        packets.ticks = _integers(packets.table, 1, ShimmerChannel("", 3, signed=False))
        return packets

    def _good(self, buffer: bytes, at: int) -> bool | None:
        """Whether a packet begins here; None: more must have come to say."""
        if buffer[at] != DATA:
            return False
        if len(buffer) - at < 4:
            return None
        if self._last is None:
            return self._agree(buffer, at, AGREE)
        step = (_ticks(buffer, at) - self._last) % TICKS
        if not self._astray and self._follows(step, 1):
            return True if len(buffer) - at >= self.size else None
        if step == 0 and self._packet.startswith(buffer[at : at + self.size]):
            return True if len(buffer) - at >= self.size else None
        return self._agree(buffer, at, 2 if self._follows(step, LONGEST // self._divider) else AGREE)

    def _agree(self, buffer: bytes, at: int, packets: int) -> bool | None:
        """Whether there are this many `packets` in a row here."""
        before: int | None = None
        for _ in range(packets):
            while at < len(buffer) and (between := _between(buffer, at)):
                if between < 0:
                    return None
                at += between
            if at < len(buffer) and buffer[at] != DATA:
                return False
            if len(buffer) - at < 4:
                return None
            ticks = _ticks(buffer, at)
            if before is not None and not self._follows((ticks - before) % TICKS, STRAY):
                return False
            before, at = ticks, at + self.size
            if at > len(buffer):
                return None
        return True

    def _follows(self, step: int, most: int) -> bool:
        """Whether a time this much later is that of one of the next `most` packets."""
        periods = round(step / self._divider)
        return 1 <= periods <= most and abs(step - periods * self._divider) <= self._slack


def _ticks(data: bytes, at: int) -> int:
    return int.from_bytes(data[at + 1 : at + 4], "little")


def _integers(table: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], at: int, channel: ShimmerChannel) -> Times:
    """One channel of every packet: (n,) int64."""
    digits = table[:, at : at + channel.size].astype(np.int64)
    weights = 1 << 8 * np.arange(channel.size)
    values: Times = digits @ (weights[::-1] if channel.big else weights)
    return values - ((values >> 8 * channel.size - 1) << 8 * channel.size) if channel.signed else values


def columns(packets: ShimmerPackets, channels: tuple[int, ...], wanted: list[str]) -> Samples:
    """Counts (n, len(wanted)) of the named channels."""
    places, at = {}, 4
    for number in channels:
        places[CHANNELS[number].name] = (at, CHANNELS[number])
        at += CHANNELS[number].size
    out = np.empty((len(packets), len(wanted)))
    for i, name in enumerate(wanted):
        out[:, i] = _integers(packets.table, *places[name])
    return out


def packet(ticks: int, channels: tuple[int, ...], counts: list[int]) -> bytes:
    """What the device sends; for simulators and tests."""
    body = b"".join(
        (int(n) % (1 << 8 * CHANNELS[c].size)).to_bytes(CHANNELS[c].size, "big" if CHANNELS[c].big else "little")
        for c, n in zip(channels, counts, strict=True)
    )
    return bytes([DATA]) + (ticks % TICKS).to_bytes(3, "little") + body
