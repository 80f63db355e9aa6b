"""How much memory a session may take, and how much it takes now."""

from __future__ import annotations

import os
from pathlib import Path

SHARE = 0.75
"""Of the machine's memory, or of what its container may have, where a graph says nothing."""
_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def ceiling(memory_mb: float) -> int:
    """Bytes that a session may take; 0 where neither the graph nor the system says."""
    return round(memory_mb * 1e6) if memory_mb else round(SHARE * machine())


def machine() -> int:
    """Bytes of memory that there are; 0 where the system does not say."""
    try:
        whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 0
    for path in map(Path, _LIMITS):
        try:
            whole = min(whole, int(path.read_text()))
        except (OSError, ValueError):  # there is none, or it says "max"
            continue
    return whole


def taken() -> int:
    """Bytes of memory that this process holds; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError, AttributeError):
        return 0
