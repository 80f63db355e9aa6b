"""Finds the checksum (kind, range, byte order) that fits received frames if the declared one is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Literal

from kinegraph.devices.frames.checksums import CHECKSUMS
from kinegraph.devices.frames.layout import FrameLayout

LEAST = 5
"""This many different frames must have come; fewer may fit by chance."""
SHARE = 0.7
"""This share of the candidates must fit; the others may be sync bytes within a frame, or broken."""
MAX = 40
"""Candidates that are looked at."""


def fitting(candidates: Sequence[bytes], layout: FrameLayout) -> str:
    """What to declare instead, for frames as long as `layout` has them; "" if nothing of the same size fits."""
    frames = list(dict.fromkeys(candidates))[-MAX:]
    size = layout.checksum.size
    if len(frames) < LEAST or not size:
        return ""
    orders: tuple[Literal["little", "big"], ...] = ("little", "big") if size > 1 else (layout.frame.endian,)
    kinds = [kind for kind, checksum in CHECKSUMS.items() if checksum.size == size]
    for start, kind, endian in product(range(layout.body_end), kinds, orders):
        rows = [int.from_bytes(f[layout.body_end : layout.body_end + size], endian) for f in frames]
        fits = sum(CHECKSUMS[kind].of(f[start : layout.body_end]) == s for f, s in zip(frames, rows, strict=True))
        if fits >= max(LEAST, SHARE * len(frames)):
            order = f" in {endian}-endian order" if size > 1 else ""
            return f"checksum: {kind} with checksum_from: {start}{order} fits {fits} of {len(frames)} frames that came"
    return ""
