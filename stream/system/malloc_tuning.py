"""Memory that was freed and is still the process's, as the C library keeps it for later. Of GNU's; with another one nothing is done.

Left alone, it learns from each large piece that is freed to take the next ones out of the heap, up to 32 MB, between small ones that stay.
So an avatar's session of 100 MB grew by 5 to 20 MB within two hours of its data.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache

M_MMAP_THRESHOLD, LARGE = -3, 4 << 20
"""Its name for the size (bytes) from which a piece is mapped by itself, and goes back to the system once freed; larger than a frame."""
M_TRIM_THRESHOLD, HELD = -1, 24 << 20
"""Its name for the free bytes at the heap's end that stay until the next look; with fewer, each message would ask for pages again."""
KEPT = 128 << 10
"""Bytes at the heap's end that stay, so that the next messages find some."""


@cache
def _library() -> ctypes.CDLL | None:
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "malloc_trim") and hasattr(library, "mallopt") else None


def map_large_pieces() -> None:
    """From now on large pieces of memory are mapped by themselves, whatever was freed before."""
    if library := _library():
        library.mallopt(M_MMAP_THRESHOLD, LARGE)
        library.mallopt(M_TRIM_THRESHOLD, HELD)


def give_back() -> None:
    """Give free memory back to the system, page by page, wherever it lies. Takes one to three milliseconds."""
    if library := _library():
        library.malloc_trim(ctypes.c_size_t(KEPT))
