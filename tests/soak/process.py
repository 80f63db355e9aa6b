"""`kinegraph` with a disk that can be filled and a wall clock that can be set.

    python -m tests.soak.process SWITCHES ARGUMENTS...

SWITCHES is a folder. While it holds a file `full`, no write to a recording or a table succeeds; a file `clock` holds the seconds by
which the wall clock is ahead (below 0: behind), and a file `asleep` those that the machine was suspended: the wall clock and the clock of
boot went on, the monotonic one did not.
"""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

NS = 1_000_000_000


def fill_disk(full: Path) -> None:
    """From now on writes fail while `full` exists, as on a disk without room; sockets and terminals are spared."""

    def guarded(write: Callable[..., int]) -> Callable[..., int]:
        def take(file: int, *given: Any) -> int:
            if full.exists() and Path(f"/proc/self/fd/{file}").is_file():
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return write(file, *given)

        return take

    os.write, os.writev, os.pwrite = guarded(os.write), guarded(os.writev), guarded(os.pwrite)


def set_clock(switch: Path, asleep: Path) -> None:
    """From now on the wall clock is ahead by what `switch` holds, and the machine was suspended for as long as `asleep` says."""
    wall_ns, gettime_ns = time.time_ns, time.clock_gettime_ns

    def ahead_s() -> float:
        try:
            return float(switch.read_text())
        except (OSError, ValueError):
            return 0.0

    def slept_ns() -> int:
        return NS * int(asleep.read_text()) if asleep.exists() else 0

    def clock_ns(clock: int) -> int:
        return gettime_ns(clock) + (slept_ns() if clock == time.CLOCK_BOOTTIME else 0)

    time.time_ns = lambda: wall_ns() + round(ahead_s() * NS) + slept_ns()
    time.time = lambda: time.time_ns() / NS
    time.clock_gettime_ns = clock_ns


def main() -> None:
    switches = Path(sys.argv.pop(1))
    fill_disk(switches / "full")
    set_clock(switches / "clock", switches / "asleep")
    sys.argv[0] = "kinegraph"
    from kinegraph.stream.cli.main import main as kinegraph

    kinegraph()


if __name__ == "__main__":
    main()
