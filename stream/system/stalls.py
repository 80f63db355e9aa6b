"""Python's own stalls, and the rules against them. `bench/stalls.py` measures what each is worth.

- Garbage collection: everything alive after the start is frozen (never looked at again), and the collector's first generation is made
  somewhat larger, so that a collection is rare and yet short: 50 000 objects made pauses of some milliseconds beside a thread that makes
  garbage. Chunks are freed by reference counting; nothing in the engine makes cycles per message.
- The switch interval: another thread that computes in Python gives the lock up after 0.2 ms instead of 5 ms. 0.1 ms gains little more.
- The recorder's threads are batch work to Linux: one that wakes does not interrupt the session's thread on its processor.
- Kernels keep the lock unless they take more than some 50 us (`@kernel(nogil=True)`): a short kernel that lets it go waits to get it back.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from kinegraph.stream.system.malloc_tuning import give_back, map_large_pieces

SWITCH_INTERVAL_S = 0.0002
FIRST_GENERATION = 5_000


@contextmanager
def calm() -> Iterator[None]:
    """Within: garbage collection frozen and rare, threads switched fast, large memory mapped by itself. Restores what was set before.

    Where the process has frozen its objects already, that is left as it is: a collection of all of them can take a second.
    """
    thresholds, interval, is_frozen = gc.get_threshold(), sys.getswitchinterval(), gc.get_freeze_count() > 0
    if not is_frozen:
        gc.collect()
        gc.freeze()
    map_large_pieces()
    give_back()
    gc.set_threshold(FIRST_GENERATION, *thresholds[1:])
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        gc.set_threshold(*thresholds)
        if not is_frozen:
            gc.unfreeze()


def let_others_go_on() -> None:
    """When the calling thread wakes, it waits for a processor of its own, or for the end of another thread's turn; its share of time is as
    before, for it may hold the interpreter's lock. Only if the system supports it and the user has not set it otherwise."""
    if hasattr(os, "SCHED_BATCH") and os.sched_getscheduler(0) == os.SCHED_OTHER:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
