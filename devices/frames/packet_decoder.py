"""Declared frames where what carries them marks their ends: transfers, datagrams, SLIP and COBS packets; no port, no clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Literal

from kinegraph.devices.frames.decoder import SPOILT, FoundFrames, FrameDecoder
from kinegraph.devices.frames.layout import FrameLayout

Framing = Literal["none", "slip", "cobs", "packet"]
LONGEST = 65536
"""What has no end within this many bytes is no packet."""


class PacketDecoder(FrameDecoder):
    """Packets to frames: each is a frame as a whole, or nothing. What is behind a frame's last byte is passed over.

    Of several kinds, the one with the longest sync that fits is taken, and of these the one with the packet's length.
    """

    def __init__(self, layouts: Sequence[FrameLayout]) -> None:
        self.layouts = layouts
        self.contradicted = Counter()  # a packet's ends are known: its counter need not speak for it
        self._order = sorted(range(len(layouts)), key=lambda i: (-len(layouts[i].sync), -layouts[i].size))

    def feed(self, data: bytes) -> FoundFrames:
        """`data`: one packet; b"": nothing came."""
        found = FoundFrames()
        if data:
            self.take(data, found)
        return found

    def only(self, data: bytes) -> tuple[int, bytes] | None:
        if len(self.layouts) > 1 or not data or not self._fits(layout := self.layouts[0], data):
            return None
        frame = data[: layout.size]
        return (0, frame) if layout.sound(frame) else None

    def take(self, packet: bytes, found: FoundFrames) -> None:
        """Sort one packet."""
        fitting = [kind for kind in self._order if self._fits(self.layouts[kind], packet)]
        exact = [kind for kind in fitting if self.layouts[kind].size == len(packet)]
        if not fitting:
            found.dropped += len(packet)
            return
        first = self.layouts[fitting[0]]
        kind = next((k for k in exact if len(self.layouts[k].sync) == len(first.sync)), fitting[0])
        frame = packet[: self.layouts[kind].size]
        if self.layouts[kind].sound(frame):
            found.kinds.append(kind)
            found.frames.setdefault(kind, bytearray()).extend(frame)
        else:
            found.bad += 1
            if len(found.spoilt) < SPOILT:
                found.spoilt.append((kind, frame))

    @staticmethod
    def _fits(layout: FrameLayout, packet: bytes) -> bool:
        frame = packet[: layout.size]
        return len(frame) == layout.size and frame.startswith(layout.sync) and frame.endswith(layout.footer)


class EscapedDecoder(PacketDecoder):
    """A stream of bytes in which packets are escaped, so that one byte alone marks their ends: SLIP (RFC 1055) or COBS (Cheshire 1999).

    The first piece is passed over, for it may have begun before the port was opened, unless it is a frame.
    """

    def __init__(self, layouts: Sequence[FrameLayout], framing: Framing) -> None:
        super().__init__(layouts)
        self._end, self._unescape = {"slip": (b"\xc0", unslip), "cobs": (b"\x00", uncobs)}[framing]
        self._rest, self._first = b"", True

    def only(self, data: bytes) -> None:
        return None

    def feed(self, data: bytes) -> FoundFrames:
        """`data`: bytes, cut anywhere."""
        found = FoundFrames()
        *pieces, self._rest = (self._rest + data).split(self._end)
        for piece in filter(None, pieces):
            packet = self._unescape(piece)
            if packet is not None:
                before = len(found.kinds)
                self.take(packet, found)
                lost = len(found.kinds) == before
            else:
                lost, found.dropped = True, found.dropped + len(piece)
            found.resyncs += lost and not self._first
            self._first = False
        if len(self._rest) > LONGEST:
            found.dropped, self._rest = found.dropped + len(self._rest), b""
        return found


def unslip(piece: bytes) -> bytes | None:
    """The content of a SLIP packet; None for invalid escapes."""
    parts = piece.split(b"\xdb")
    made = bytearray(parts[0])
    for part in parts[1:]:
        if part[:1] not in (b"\xdc", b"\xdd"):
            return None
        made += (b"\xc0" if part[0] == 0xDC else b"\xdb") + part[1:]
    return bytes(made)


def slip(packet: bytes) -> bytes:
    """A packet as SLIP sends it, with an end on both sides; for simulators and tests."""
    return b"\xc0" + packet.replace(b"\xdb", b"\xdb\xdd").replace(b"\xc0", b"\xdb\xdc") + b"\xc0"


def uncobs(piece: bytes) -> bytes | None:
    """What a COBS packet holds; None where its lengths do not add up."""
    made, at = bytearray(), 0
    while at < len(piece):
        code = piece[at]
        if at + code > len(piece):
            return None
        made += piece[at + 1 : at + code]
        at += code
        if code < 0xFF and at < len(piece):
            made.append(0)
    return bytes(made)


def cobs(packet: bytes) -> bytes:
    """A packet as COBS sends it, with its end; for simulators and tests."""
    made, runs = bytearray(), packet.split(b"\0")
    for i, run in enumerate(runs):
        whole = len(run) // 254
        for k in range(whole):
            made += b"\xff" + run[254 * k : 254 * k + 254]
        rest = run[254 * whole :]
        if rest or not whole or i < len(runs) - 1:
            made += bytes([len(rest) + 1]) + rest
    return bytes(made) + b"\0"


def escaped(packet: bytes, framing: Framing) -> bytes:
    """A frame as it is sent."""
    if framing in ("none", "packet"):
        return packet
    return slip(packet) if framing == "slip" else cobs(packet)
