"""How much memory a session may take, and how much it takes now."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import resource
except ImportError:  # not a POSIX system
    resource = None  # type: ignore[assignment]

SHARE = 0.75
"""Of the machine's memory, or of what its container may have, where a graph says nothing."""
BEYOND = 0.25
"""How much further than its ceiling a session may reach in one call before the system refuses it; the ceiling itself is looked at once a
second, between two chunks."""
MIN_BEYOND = 1 << 30
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
        except (OSError, ValueError):  # there is no limit, or it says "max"
            continue
    return whole


def taken() -> int:
    """Bytes of memory that this process holds; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError, AttributeError):
        return 0


@contextmanager
def refused_beyond(ceiling_bytes: int) -> Iterator[None]:
    """Within: a call that asks for far more memory than `ceiling_bytes` at once gets a MemoryError, not the machine's last page.

    Linux only; elsewhere, with no ceiling (0), or with a limit that somebody else has set, nothing is changed.
    """
    if not ceiling_bytes:
        yield
        return
    with limited(max(ceiling_bytes - taken(), 0) + max(round(ceiling_bytes * BEYOND), MIN_BEYOND)):
        yield


@contextmanager
def limited(room: int) -> Iterator[None]:
    """Within: this process gets `room` more bytes of memory to write to, and no more; on Linux, unless a limit was set already."""
    if resource is None or not sys.platform.startswith("linux"):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if soft != resource.RLIM_INFINITY:
        yield
        return
    resource.setrlimit(resource.RLIMIT_DATA, (writable() + room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def writable() -> int:
    """Bytes of writable memory that this process has asked for, used or not; 0 where the system does not say."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmData:")), 0)
