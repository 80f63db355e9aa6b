"""Declared frames out of a stream of bytes, cut anywhere, with anything between them; no port, no clock."""

from __future__ import annotations

import re
from collections import Counter as Tally
from collections.abc import Sequence
from dataclasses import dataclass, field

from kinegraph.devices.frames.layout import FrameLayout

SPOILT = 40
"""Frames with a wrong checksum that a feed shows."""

CONTRADICTED = 200
"""Frames that are not believed for their counter, of which the counters are kept."""


@dataclass(slots=True)
class FoundFrames:
    """What a feed brought.

    kinds     (n,) which layout each frame has, in the order in which they came
    frames    per layout, its frames one after the other
    bad       frames with a wrong checksum
    spoilt    the first of these: layout, frame
    dropped   bytes that belonged to no frame
    resyncs   how often the beginning of the next frame had to be looked for
    """

    kinds: list[int] = field(default_factory=list)
    frames: dict[int, bytearray] = field(default_factory=dict)
    bad: int = 0
    dropped: int = 0
    resyncs: int = 0
    spoilt: list[tuple[int, bytes]] = field(default_factory=list)


class FrameDecoder:
    """Feed it bytes as they come, cut anywhere; it never waits and never raises.

    A frame without a checksum is believed if it follows another directly, or if another begins directly behind it; if it has a counter,
    that must go on from the frame before, or into the one right behind.
    """

    def __init__(self, layouts: Sequence[FrameLayout]) -> None:
        self.layouts = layouts
        in_order = sorted(range(len(layouts)), key=lambda i: -len(layouts[i].sync))
        self._order = in_order
        self._frame = re.compile(b"|".join(b"(%s)" % layouts[i].pattern for i in in_order), re.DOTALL)
        self._sync = re.compile(b"|".join(b"(%s)" % re.escape(layouts[i].sync) for i in in_order))
        starts = {layout.sync[:n] for layout in layouts for n in range(1, len(layout.sync))}
        self._tails = re.compile(
            rb"(?:%s)\Z" % b"|".join(map(re.escape, sorted(starts, key=len, reverse=True))) if starts else b"(?!)"
        )
        self._longest = max(len(layout.sync) for layout in layouts)
        self._buffer = b""
        self._following = False
        self._lasts: dict[int, tuple[int, bytes]] = {}
        """The last frame and its counter, of each kind without a checksum."""
        self.contradicted: Tally[tuple[int, int]] = Tally()
        """How often a frame was not believed for its counter, by that and the one of the frame right behind; the first `CONTRADICTED`."""

    def only(self, data: bytes) -> tuple[int, bytes] | None:
        """The kind and the frame, if these bytes are one good frame and nothing else; else `feed` takes them."""
        return None

    def feed(self, data: bytes) -> FoundFrames:
        buffer = self._buffer + data
        found = FoundFrames()
        at = 0
        while True:
            start, waits = self._next_sync(buffer, at)
            if start > at and self._following:
                self._following = False
                found.resyncs += 1
            found.dropped += start - at
            at = start
            if waits:
                break
            match = self._frame.match(buffer, at)
            believed = self._believe(buffer, match, found) if match else False
            if believed is None:
                break
            if match and believed:
                kind = self._order[(match.lastindex or 1) - 1]
                found.kinds.append(kind)
                found.frames.setdefault(kind, bytearray()).extend(match.group())
                at, self._following = match.end(), True
                continue
            found.resyncs += self._following
            self._following = False
            found.dropped += 1
            at += 1
        self._buffer = buffer[at:]
        return found

    def _next_sync(self, buffer: bytes, at: int) -> tuple[int, bool]:
        """Where the next frame may begin, and whether more must come to know."""
        sync = self._sync.search(buffer, at)
        if sync is None:
            tail = self._tails.search(buffer, max(at, len(buffer) - self._longest + 1))
            return (tail.start() if tail else len(buffer)), True
        layout = self.layouts[self._order[(sync.lastindex or 1) - 1]]
        return sync.start(), len(buffer) - sync.start() < layout.size

    def _believe(self, buffer: bytes, match: re.Match[bytes], found: FoundFrames) -> bool | None:
        """Whether this is a frame; None if what follows it must come first."""
        layout = self.layouts[self._order[(match.lastindex or 1) - 1]]
        if layout.checksum.size:
            if not layout.sound(match.group()):
                found.bad += 1
                if len(found.spoilt) < SPOILT:
                    found.spoilt.append((self._order[(match.lastindex or 1) - 1], match.group()))
                return False
            return True
        return self._believe_unchecked(buffer, match)

    def _believe_unchecked(self, buffer: bytes, match: re.Match[bytes]) -> bool | None:
        """Whether a frame without a checksum is one: it has its place behind the last one and a counter that goes on, or is borne out by
        what stands right behind it."""
        kind = self._order[(match.lastindex or 1) - 1]
        layout, counter = self.layouts[kind], self.layouts[kind].counter_of(match.group())
        before, last = self._lasts.get(kind, (None, b""))
        goes_on = counter is None or before is None or layout.near(before, counter) or last == match.group()
        if not (self._following and goes_on):
            after = buffer[match.end() : match.end() + self._longest]
            if not self._sync.match(after):
                return None if len(after) < self._longest else False
            if (
                counter is not None
                and (contradiction := self._contradicted(buffer, match.end(), kind, counter)) is not False
            ):
                return None if contradiction is None else False
        if counter is not None:
            self._lasts[kind] = counter, match.group()
        return True

    def _contradicted(self, buffer: bytes, at: int, kind: int, counter: int) -> bool | None:
        """Whether the frame right behind is of the same kind and has a counter that cannot follow; None: it has not come yet."""
        behind = self._frame.match(buffer, at)
        if behind is None:
            sync = self._sync.match(buffer, at)
            same = sync is not None and self._order[(sync.lastindex or 1) - 1] == kind
            return (None if len(buffer) - at < self.layouts[kind].size else True) if same else False
        if self._order[(behind.lastindex or 1) - 1] != kind:
            return False
        later = self.layouts[kind].counter_of(behind.group())
        if later is not None and self.layouts[kind].near(counter, later):
            return False
        if later is not None and self.contradicted.total() < CONTRADICTED:
            self.contradicted[counter, later] += 1
        return True
