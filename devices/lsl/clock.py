"""Where LSL's clock on this computer stands on the session's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stream.chunk import NS

TRIES = 5


def zero_ns(lsl: Any, now: Callable[[], int]) -> int:
    """Session time (ns) at which LSL's local clock stood at 0; `now` tells session time. The quickest of a few looks counts."""
    best, zero = NS, 0
    for _ in range(TRIES):
        before, local, after = now(), lsl.local_clock(), now()
        if after - before < best:
            best, zero = after - before, (before + after) // 2 - round(local * NS)
    return zero
