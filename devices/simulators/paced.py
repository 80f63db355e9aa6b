"""The frames of a simulated source, each when it is due."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

from stream.chunk import NS
from stream.source import Feed


def paced(feed: Feed, rate_hz: float, duration_s: float, realtime: bool) -> Iterator[tuple[int, int]]:
    """(frame, stamp) in time, until the feed stops."""
    begun, last = feed.now(), round(duration_s * rate_hz)
    for frame in range(last) if last else count():
        stamp = begun + round(frame * NS / rate_hz)
        if realtime and feed.wait(max(0, stamp - feed.now()) / NS):
            return
        if feed.stopped:
            return
        yield frame, stamp
