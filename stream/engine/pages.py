"""Memory in large pages, so that after a rest less has to be looked up again.

What a chunk needs lies in some hundred pages of 4 KB, all over the process. After a few milliseconds of rest a processor has forgotten
where they are, and looking a page up costs more than most of what is done with it, above all in a virtual machine. Gathered into pages of
2 MB, they are few. `bench/stalls.py` measures what that is worth; the answer to every sample stays the same to the bit.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

COLLAPSE = 25
"""MADV_COLLAPSE (Linux 6.1): copy a range into one large page, now."""
SETTINGS = Path("/sys/kernel/mm/transparent_hugepage")
MAPS = Path("/proc/self/maps")


def gather() -> int:
    """Gather this process's memory into large pages, as far as it is in use; returns how many could be. Some tens of milliseconds, once.

    Where the system has no such pages (before Linux 6.1, other systems) or its owner has switched them off, nothing happens.
    """
    if not sys.platform.startswith("linux"):
        return 0
    with suppress(OSError, ValueError, AttributeError):
        if "[never]" in (SETTINGS / "enabled").read_text():
            return 0
        size = int((SETTINGS / "hpage_pmd_size").read_text())
        advise = ctypes.CDLL(None).madvise
        advise.argtypes = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
        return sum(
            advise(at, size, COLLAPSE) == 0
            for start, end in _own_memory()
            for at in range(-(-start // size) * size, end - size + 1, size)
        )
    return 0


def _own_memory() -> Iterator[tuple[int, int]]:
    """Where (address, end) this process keeps what it has made: neither files nor what it shares, nor threads' stacks."""
    for line in MAPS.read_text().splitlines():
        where, rights, _, _, _, *name = line.split(maxsplit=5)
        if rights == "rw-p" and (not name or name[0] == "[heap]"):
            start, end = (int(part, 16) for part in where.split("-"))
            yield start, end
