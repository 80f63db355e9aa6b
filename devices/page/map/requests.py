"""What a client of the map asks for, validated."""

from __future__ import annotations

from typing import TypeAlias

import msgspec

MAX_FRAMES = 256
MAX_POINTS = 2000


class WantedFrames(msgspec.Struct, tag="frames", tag_field="do", forbid_unknown_fields=True):
    """These poses, with their places. `ask` comes back with them."""

    numbers: list[int]
    ask: int = 0


class WantedCurve(msgspec.Struct, tag="curve", tag_field="do", forbid_unknown_fields=True):
    """A sequence's markers over time, thinned out to at most `points` points."""

    sequence: int
    points: int


class WantedNear(msgspec.Struct, tag="near", tag_field="do", forbid_unknown_fields=True):
    """What is nearest to a pose (first = last) or a stretch; `markers` are the numbers of those that count; empty: all."""

    first: int
    last: int
    count: int = 20
    band_s: float = 0.5
    markers: list[int] = []


Wanted: TypeAlias = WantedFrames | WantedCurve | WantedNear
_wanted = msgspec.json.Decoder(Wanted)


def wanted(message: str | bytes) -> Wanted:
    """What a client asks for. Raises ValueError (msgspec's) for anything else; numbers are checked by whom they belong to."""
    found: Wanted = _wanted.decode(message)
    match found:
        case WantedFrames(numbers) if len(numbers) > MAX_FRAMES:
            raise ValueError("a client asks for too many poses")
        case WantedCurve(_, points) if not 2 <= points <= MAX_POINTS:
            raise ValueError("a client asks for too many points")
        case WantedNear(_, _, count, band_s, markers) if not (
            0 < count <= 200 and 0 <= band_s <= 1e6 and all(0 <= m < 64 for m in markers)
        ):
            raise ValueError("a client asks for too much")
    return found
