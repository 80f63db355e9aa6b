"""A declared frame's layout, worked out: bytes to numbers and back; no port, no clock."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from itertools import accumulate
from typing import Literal

import numpy as np

from kinegraph.devices.frames.checksums import CHECKSUMS
from kinegraph.devices.frames.declared import NS_PER, Field, Frame, hex_bytes
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.errors import ParameterError

STRUCT = {
    "u": {8: "B", 16: "H", 32: "I", 64: "Q"},
    "i": {8: "b", 16: "h", 32: "i", 64: "q"},
    "f": {16: "e", 32: "f", 64: "d"},
}
"""How `struct` names a number of a kind and a number of bits."""
NEAR = 8
"""So far a counter may go from one frame to the next for them to be believed to follow each other."""


class FrameLayout:
    """A frame's layout, worked out: where each field stands. Raises ParameterError for what cannot be.

    Fields of a number of bits that is not a multiple of 8 are packed: from the highest bit of a byte on where the order is big-endian,
    from the lowest where it is little-endian. `alone`: whether each transfer or packet is a frame, which then needs no sync.
    """

    def __init__(self, frame: Frame, at: str = "frames", *, alone: bool = False) -> None:
        self.frame, self.fields = frame, frame.laid_out
        self.sync, self.footer = hex_bytes(frame.sync, f"{at}.sync"), hex_bytes(frame.footer, f"{at}.footer")
        if not self.sync and not alone:
            raise ParameterError(f"{at}.sync", frame.sync, "at least one byte in hex")
        if not frame.fields:
            raise ParameterError(f"{at}.fields", [], "at least one field")
        self.checksum = CHECKSUMS[frame.checksum]
        self._starts = list(accumulate((f.bits for f in self.fields), initial=8 * len(self.sync)))
        """At which bit each field begins, and the last one ends."""
        self._counter = next((i for i, f in enumerate(self.fields) if f.role == "counter"), None)
        self._check(at)
        self.body_end = end = self._starts[-1] // 8
        self.size = end + self.checksum.size + len(self.footer)
        if frame.checksum != "none" and frame.checksum_from >= end:
            raise ParameterError(f"{at}.checksum_from", frame.checksum_from, f"below {end}, where the checksum stands")
        self._dtype = np.dtype(
            {
                "names": [f"f{i}" for i in range(len(self.fields))],
                "formats": [self._format(i) for i in range(len(self.fields))],
                "offsets": [start // 8 for start in self._starts[:-1]],
                "itemsize": self.size,
            }
        )
        self._chosen = [i for i, f in enumerate(self.fields) if f.is_channel]
        self.channels, self.counted = frame.channels, self._counter is not None
        self._scale = np.array([f.scale for f in frame.channels])
        self._offset = np.array([f.offset for f in frame.channels])
        self._plain = self._struct() if frame.samples == 1 else None
        self._factors = [(f.scale, f.offset) for f in frame.channels]
        self._counter_at = None if self._counter is None else self._place(self._counter)

    def _struct(self) -> struct.Struct | None:
        """Reads the channels of one frame; None where one of them is packed, or they differ in their order of bytes."""
        orders = {self._endian(self.fields[i]) for i in self._chosen}
        form, at = "<" if orders == {"little"} else ">", 0
        for i in self._chosen:
            f, start = self.fields[i], self._starts[i]
            if len(orders) > 1 or self._format(i)[0] == "V":
                return None
            form += f"{start // 8 - at}x{STRUCT[f.type[0]][f.bits]}"
            at = self._starts[i + 1] // 8
        return struct.Struct(form)

    def _check(self, at: str) -> None:
        """Raise ParameterError for numbers that are packed so that they cannot be read."""
        if over := self._starts[-1] % 8:
            bits = self._starts[-1] - 8 * len(self.sync)
            raise ParameterError(
                f"{at}.fields", f"{bits} bits", f"whole bytes; add a field of {8 - over} bits without a name"
            )
        for f, start in zip(self.fields, self._starts, strict=False):
            if f.type[0] == "f" and start % 8:
                raise ParameterError(f"{at}.fields", f.type, "at the beginning of a byte")
        if self.frame.samples == 1:
            return
        if not self.frame.rate_hz:
            raise ParameterError(f"{at}.rate_hz", None, "given, where a frame holds several samples")
        for role in ("counter", "time"):
            if sum(f.role == role for f in self.fields) > len(self.frame.with_role(role)):
                raise ParameterError(f"{at}.fields", role, "before or behind the samples, not among their fields")

    @property
    def pattern(self) -> bytes:
        """Matches a frame with any content."""
        rest = self.size - len(self.sync) - len(self.footer)
        return re.escape(self.sync) + b".{%d}" % rest + re.escape(self.footer)

    def sound(self, frame: bytes) -> bool:
        """Whether the checksum is right."""
        if not self.checksum.size:
            return True
        checksum = int.from_bytes(frame[self.body_end : self.body_end + self.checksum.size], self.frame.endian)
        return checksum == self.checksum.of(frame[self.frame.checksum_from : self.body_end])

    def table(self, frames: bytes) -> Array:
        """Frames, one after the other, as a structured array (n,)."""
        return np.frombuffer(frames, self._dtype)

    def values(self, table: Array) -> Samples:
        """The channels (n * samples, c) in their units."""
        raw: Samples = np.empty((len(table), len(self._chosen)))
        for column, i in enumerate(self._chosen):
            raw[:, column] = self._numbers(table, i)
        k, c = self.frame.samples, len(self.channels)
        if k > 1 and self._chosen:
            raw = raw.reshape(-1, c, k).transpose(0, 2, 1) if self.frame.by_channel else raw
            raw = np.ascontiguousarray(raw).reshape(-1, c)
        raw *= self._scale
        raw += self._offset
        return raw

    def row(self, frame: bytes) -> Samples:
        """What `values` gives for one frame (1, c) of one sample."""
        if self._plain is None:
            return self.values(self.table(frame))
        row = []
        for number, (scale, offset) in zip(self._plain.unpack_from(frame), self._factors, strict=True):
            row.append(number * scale + offset)
        return np.array([row])

    def counter_of(self, frame: bytes) -> int | None:
        """The counter of one frame."""
        if self._counter_at is None:
            return None
        start, stop, order, shift, mask = self._counter_at
        return int.from_bytes(frame[start:stop], order) >> shift & mask

    def _place(self, i: int) -> tuple[int, int, Literal["little", "big"], int, int]:
        """A whole number's first byte, the one behind its last, their order, how far it is shifted in them, and its mask."""
        start, stop = self._starts[i] // 8, -(-self._starts[i + 1] // 8)
        return start, stop, self._endian(self.fields[i]), self._shift(i), (1 << self.fields[i].bits) - 1

    def near(self, counter: int, later: int) -> bool:
        """Whether a frame may follow another one, by their counters: with a few lost in between."""
        return self._counter is not None and 1 <= (later - counter) % self.fields[self._counter].turn <= NEAR

    def counters(self, table: Array) -> Times | None:
        """The counter of every frame, or None."""
        return None if self._counter is None else self._numbers(table, self._counter).astype(np.int64)

    def times_ns(self, table: Array) -> Times | None:
        """The device's time of every frame; None if it does not say."""
        total: Times | None = None
        for i, f in enumerate(self.fields):
            if f.role == "time":
                numbers = self._numbers(table, i)
                ns = (
                    numbers.astype(np.float64) * NS_PER[f.unit] * f.scale
                    if f.type[0] == "f"
                    else numbers.astype(np.int64) * (NS_PER[f.unit] if f.scale == 1.0 else NS_PER[f.unit] * f.scale)
                )
                total = np.round(ns).astype(np.int64) + (0 if total is None else total)
        return total

    def build(self, numbers: Mapping[int, float]) -> bytes:
        """A frame with these raw numbers, by the field's place in `fields`; 0 in the others. For simulators and tests."""
        body = bytearray(self.sync) + bytes(self.body_end - len(self.sync))
        for i, f in enumerate(self.fields):
            start, stop = self._starts[i] // 8, -(-self._starts[i + 1] // 8)
            if f.type[0] == "f":
                body[start:stop] = np.array([numbers.get(i, 0)], self._format(i)).tobytes()
                continue
            order = self._endian(f)
            shifted = (int(numbers.get(i, 0)) % (1 << f.bits)) << self._shift(i)
            body[start:stop] = (int.from_bytes(body[start:stop], order) | shifted).to_bytes(stop - start, order)
        total = self.checksum.of(bytes(body[self.frame.checksum_from :]))
        return bytes(body) + total.to_bytes(self.checksum.size, self.frame.endian) + self.footer

    def _shift(self, i: int) -> int:
        """How many bits stand below a field in its bytes, read as one number."""
        start, stop = self._starts[i], self._starts[i + 1]
        return start % 8 if self._endian(self.fields[i]) == "little" else -stop % 8

    def _numbers(self, table: Array, i: int) -> Array:
        """One field of every frame, as it stands there."""
        f, column = self.fields[i], np.asarray(table[f"f{i}"])
        if column.dtype.kind != "V":
            return column
        parts = np.frombuffer(column.tobytes(), np.uint8).reshape(len(table), -1).astype(np.int64)
        if self._endian(f) == "big":
            parts = parts[:, ::-1]
        number = (parts << (8 * np.arange(parts.shape[1]))).sum(axis=1) >> self._shift(i) & ((1 << f.bits) - 1)
        return np.asarray(number - (number >> (f.bits - 1) << f.bits) if f.type[0] == "i" else number)

    def _endian(self, f: Field) -> Literal["little", "big"]:
        return f.endian or self.frame.endian

    def _format(self, i: int) -> str:
        f, start, stop = self.fields[i], self._starts[i], self._starts[i + 1]
        if start % 8 or f.bits not in (8, 16, 32, 64):
            return f"V{-(-stop // 8) - start // 8}"
        return f"{'<' if self._endian(f) == 'little' else '>'}{f.type[0]}{f.bits // 8}"
