"""OpenBCI Cyton and Daisy: 33-byte packets to counts, and commands as bytes. No port, no clock.

A packet is A0, a counter (8 bits), eight 24-bit counts (big-endian, two's complement), six auxiliary bytes, and C0..C6, which says what
those are (C0: accelerometer). There is no checksum: what stands at the right places is believed if it follows a packet directly, if
another begins directly behind it, or if its counter is the next one.

Source: docs.openbci.com, "Cyton Data Format" and "Cyton Board SDK"; BrainFlow's drivers agree (tests/peers). Impedance: the board drives
6 nA at 31.25 Hz through an electrode and 2200 ohm of its own (OpenBCI's GUI, and the ADS1299's data sheet for the frequency).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.params import param

SIZE = 33
CHANNELS = 8
PACKETS_HZ = 250.0
ACCELEROMETER = 0xC0
REFERENCE_V = 4.5
FULL_SCALE = 2**23 - 1
G_PER_COUNT = 0.002 / 16
GAINS = (1, 2, 4, 6, 8, 12, 24)
INPUTS = ("normal", "shorted", "bias_measured", "supply", "temperature", "test", "bias_positive", "bias_negative")

DRIVE_A, DRIVE_HZ, SERIES_OHM = 6e-9, 31.25, 2200.0

SOFT_RESET, START, STOP, DEFAULTS = b"v", b"b", b"s", b"d"
ONLY_BOARD, WITH_DAISY = b"c", b"C"
NEAR = 8
"""So far the counter may go from one packet to the next for them to be believed to follow each other."""
ENDING = b"$$$"
"""What every answer ends with."""

_WIDE = np.dtype(">i4")
_STILL = bytes(6)
_NAMES = "12345678QWERTYUI"
_OFF, _ON = "12345678qwertyui", "!@#$%^&*QWERTYUI"
_FRAME = rb"\xA0.{31}[\xC0-\xC6]"
_RUN = re.compile(rb"(?:" + _FRAME + rb")+", re.DOTALL)
_ONE = re.compile(_FRAME, re.DOTALL)


@dataclass(frozen=True, slots=True)
class ChannelSetting:
    """One channel's amplifier. What is not given is as the board's default: gain 24, normal input, with bias and SRB2.

    For EMG from an electrode pair on the channel's own two pins, `srb2: false` measures between them.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    channel: int = param(least=1, most=16, help="1 to 8 on the board, 9 to 16 on the Daisy")
    gain: Literal[1, 2, 4, 6, 8, 12, 24] = param(
        24, help="amplification; the range is 4.5 V divided by it, on both sides of 0"
    )
    input: Literal[
        "normal", "shorted", "bias_measured", "supply", "temperature", "test", "bias_positive", "bias_negative"
    ] = param("normal", help="what the channel measures")
    bias: bool = param(True, help="whether it takes part in the bias drive")
    srb2: bool = param(True, help="whether the common reference SRB2 is its negative side")
    srb1: bool = param(False, help="whether SRB1 is the negative side of all channels")
    power: bool = param(True, help="false: switched off, and 0 uV")

    @property
    def command(self) -> bytes:
        """What sets it: x, channel, power down, gain, input, bias, SRB2, SRB1, X."""
        numbers = (not self.power, GAINS.index(self.gain), INPUTS.index(self.input), self.bias, self.srb2, self.srb1)
        return f"x{_NAMES[self.channel - 1]}{''.join(str(int(n)) for n in numbers)}X".encode()


def switch(channel: int, on: bool) -> bytes:
    """The command that switches a channel (from 1) on or off and leaves its settings."""
    return (_ON if on else _OFF)[channel - 1].encode()


def lead_off(channel: int, positive: bool, negative: bool) -> bytes:
    """The command that drives the current for measuring impedance through a channel's (from 1) poles: z, channel, P, N, Z."""
    return f"z{_NAMES[channel - 1]}{int(positive)}{int(negative)}Z".encode()


def impedance_ohm(number: Array, uv: Samples, averaged: bool) -> float:
    """An electrode's impedance from samples (n,) in uV while the current is driven, and their running numbers (n,) at 250 Hz.

    sqrt(2) times the rms at 31.25 Hz over 6 nA, less 2200 ohm: of that frequency alone, by least squares, so that hum, drift and what
    little a muscle at rest does are left out. Samples that are the mean of two neighbours (`averaged`: a Daisy's) hold cos(pi / 8) of it.
    """
    turn = 2 * np.pi * DRIVE_HZ / PACKETS_HZ * number
    basis = np.stack([np.cos(turn), np.sin(turn), np.ones(len(number)), number - number.mean()], axis=1)
    a, b, *_ = np.linalg.lstsq(basis, uv, rcond=None)[0]
    rms_v = 1e-6 * float(np.hypot(a, b)) / np.sqrt(2) / (np.cos(np.pi * DRIVE_HZ / PACKETS_HZ) if averaged else 1.0)
    return max(0.0, float(np.sqrt(2) * rms_v / DRIVE_A - SERIES_OHM))


def uv_per_count(gain: float) -> float:
    """Microvolts per count of a channel at this gain."""
    return REFERENCE_V / gain / FULL_SCALE * 1e6


class CytonFrames:
    """The packets found; their parts are made from the bytes when they are asked for.

    dropped   how many bytes belonged to no packet
    resyncs   how often the beginning of the next packet had to be looked for
    """

    __slots__ = ("_data", "_n", "dropped", "resyncs")

    def __init__(self, data: bytes, dropped: int = 0, resyncs: int = 0) -> None:
        """`data`: whole packets, one after the other."""
        self._data, self._n, self.dropped, self.resyncs = data, len(data) // SIZE, dropped, resyncs

    def __len__(self) -> int:
        return self._n

    @property
    def counter(self) -> NDArray[np.uint8]:
        """(n,) uint8"""
        return self._table[:, 1]

    @property
    def newest(self) -> int:
        """The last packet's counter, of n > 0."""
        return self._data[1 - SIZE]

    @property
    def moved(self) -> bool:
        """Whether any packet's auxiliary bytes hold something."""
        return self._data[26 : SIZE - 1] != _STILL if self._n == 1 else bool(self.aux.any())

    @property
    def counts(self) -> Samples:
        """(n, 8) float64, whole numbers. One of 24 bits is read as the upper three of four bytes, whatever the fourth one is."""
        if not self._n:
            return np.empty((0, CHANNELS))
        wide: NDArray[np.int32] = np.ndarray((self._n, CHANNELS), _WIDE, self._data, 2, (SIZE, 3))
        return np.asarray(np.floor_divide(wide, 256.0))

    @property
    def aux(self) -> NDArray[np.uint8]:
        """(n, 6) uint8"""
        return self._table[:, 26 : SIZE - 1]

    @property
    def kind(self) -> NDArray[np.uint8]:
        """(n,) uint8: the footer"""
        return self._table[:, SIZE - 1]

    @property
    def _table(self) -> NDArray[np.uint8]:
        table: NDArray[np.uint8] = np.ndarray((self._n, SIZE), np.uint8, self._data or None)
        return table


class CytonDecoder:
    """Feed it bytes as they come, cut anywhere; it never waits and never raises."""

    def __init__(self) -> None:
        self._buffer = b""
        self._following = False
        """Whether what stands at the head of the buffer follows a packet directly."""
        self._counter, self._last = -1, b""
        """The last packet, and its counter (or the counter that would make the next packets valid)."""

    def feed(self, data: bytes) -> CytonFrames:
        if (
            self._following
            and not self._buffer
            and len(data) == SIZE
            and _ONE.fullmatch(data)
            and _near(self._counter, data[1])
        ):
            self._counter, self._last = data[1], data  # nearly every read: one packet, whole
            return CytonFrames(data)
        buffer = self._buffer + data if self._buffer else data
        pieces: list[bytes] = []
        at = dropped = resyncs = 0
        while len(buffer) - at >= SIZE:
            end = self._run(buffer, at) if self._following else at
            if end > at:
                pieces.append(buffer[at:end])
                at = end
                self._last = buffer[at - SIZE : at]
                self._counter = self._last[1]
                continue
            if self._following:
                believed = self._borne_out(buffer, at)  # the board has begun to count again, or was away
                if believed is None:
                    break
                if believed:
                    self._counter = (buffer[at + 1] - 1) % 256
                    continue
                resyncs += 1
                self._following = False
            start, found = self._seek(buffer, at)
            dropped += start - at
            at = start
            if not found:
                break
        if not self._following and len(buffer) - at < SIZE:
            start = _tail(buffer, at)
            dropped += start - at
            at = start
        self._buffer = buffer[at:]
        return CytonFrames(pieces[0] if len(pieces) == 1 else b"".join(pieces), dropped, resyncs)

    def _run(self, buffer: bytes, at: int) -> int:
        """How far packets follow each other from here on, by their places and counters; one may come twice."""
        run, counter, last = _RUN.match(buffer, at), self._counter, self._last
        for start in range(at, run.end() if run else at, SIZE):
            one = buffer[start : start + SIZE]
            if not _near(counter, one[1]) and one != last:
                return start
            counter, last = one[1], one
        return run.end() if run else at

    def _borne_out(self, buffer: bytes, at: int) -> bool | None:
        """Whether a packet begins here into which the one right behind goes on; None: that has not come yet."""
        end = at + SIZE
        if not _ONE.match(buffer, at) or buffer[end : end + 1] not in (b"", b"\xa0"):
            return False
        if len(buffer) < end + SIZE:
            return None
        return bool(_ONE.match(buffer, end)) and _near(buffer[at + 1], buffer[end + 1])

    def _seek(self, buffer: bytes, at: int) -> tuple[int, bool]:
        """Where the next packet begins, if there is one to be believed, else where to look again when more has come."""
        while one := _ONE.search(buffer, at):
            at = one.start()
            goes_on = self._counter >= 0 and (buffer[at + 1] - self._counter) % 256 == 1
            believed = goes_on or self._borne_out(buffer, at)
            if believed is None:
                return at, False
            if believed:
                self._following, self._counter = True, (buffer[at + 1] - 1) % 256
                return at, True
            at += 1
        return _tail(buffer, at), False


def _near(counter: int, later: int) -> bool:
    """Whether a packet may follow another one, by their counters: with a few lost in between."""
    return 1 <= (later - counter) % 256 <= NEAR


def _tail(buffer: bytes, at: int) -> int:
    """The first place at which a packet may have begun that has not come as a whole, or is not believed yet."""
    found = buffer.find(b"\xa0", max(at, len(buffer) - SIZE))
    return found if found >= 0 else len(buffer)


def acceleration(frames: CytonFrames) -> tuple[Array, Samples]:
    """Which packets (indices, (k,)) brought a new acceleration, and these (k, 3) in g: about each tenth, zeros stand in the others."""
    aux = frames.aux
    if not aux.any():
        return np.empty(0, np.int64), np.empty((0, 3))
    new = np.flatnonzero((frames.kind == ACCELEROMETER) & aux.any(axis=1))
    counts = np.ascontiguousarray(aux[new]).view(">i2")
    return new, counts.astype(np.float64) * G_PER_COUNT


def packet(counter: int, counts: Array, aux: bytes = bytes(6), kind: int = ACCELEROMETER) -> bytes:
    """What the board sends: counts (8,), whole numbers of at most 24 bits; for simulators and tests."""
    wide = np.asarray(counts).astype(">i4").view(np.uint8).reshape(CHANNELS, 4)
    return bytes([0xA0, counter % 256]) + wide[:, 1:].tobytes() + aux + bytes([kind])
