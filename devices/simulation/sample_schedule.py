"""Which samples a simulated device sends when its turn comes."""

from __future__ import annotations

MAX_BEHIND_S = 10.0
"""Samples of at most this much time are made at once; older ones are left out, as a device's buffer would lose them."""


def due(sent: int, seconds: float, rate_hz: float) -> tuple[int, int]:
    """The samples first..stop-1 to be sent `seconds` after sample 0, where those below `sent` have been sent."""
    stop = int(seconds * rate_hz)
    first = max(sent, stop - round(MAX_BEHIND_S * rate_hz))
    return first, max(first, stop)
