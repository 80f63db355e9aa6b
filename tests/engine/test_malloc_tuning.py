"""Free memory that the C library keeps is given back: at the start what compiling left, and later what has come together."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import pytest

from kinegraph.stream.engine import status
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.status import SPARE_BYTES, MemoryWatch
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.system.malloc_tuning import LARGE

GRAPH = "nodes: {a: {use: devices.lines.AsciiLines, port: x, columns: [v], rate_hz: 10}}"
MB = 1 << 20


FREED = """
from kinegraph.stream.system.malloc_tuning import give_back
from kinegraph.stream.system.memory_limit import taken
give_back()
before = taken()
pieces = [bytes(3000) for _ in range(20_000)]
last = pieces[::100]
full = taken()
del pieces
kept = taken()
give_back()
print((full - before) >> 20, (kept - before) >> 20, (taken() - before) >> 20)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="of GNU's C library")
def test_memory_that_was_freed_piece_by_piece_goes_back() -> None:
    """In a process of its own: one that has run tests has free pieces already."""
    output = subprocess.run([sys.executable, "-c", FREED], capture_output=True, text=True, check=True).stdout
    full, kept, left = map(int, output.split())
    assert full > 50 and kept > 40, "the C library keeps what lies between pieces in use"
    assert left < 15


LEARNT = """
import sys
from contextlib import nullcontext
from kinegraph.stream.system.memory_limit import taken
from kinegraph.stream.system.stalls import calm
bytearray(30 << 20)  # freed at once: from now on the C library takes pieces as large as that out of the heap
with calm() if sys.argv[1] == "calm" else nullcontext():
    before, small = taken(), []
    for _ in range(10):
        large = bytearray(int(sys.argv[2]))
        small.append(bytes(200_000))
        del large
    print((taken() - before) >> 20)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="of GNU's C library")
def test_a_large_piece_between_small_ones_goes_back_when_it_is_freed() -> None:
    def kept_mb(how: str) -> int:
        call = [sys.executable, "-c", LEARNT, how, str(3 * LARGE)]
        return int(subprocess.run(call, capture_output=True, text=True, check=True).stdout)

    assert kept_mb("calm") < 8 < kept_mb("as the library does")


def test_it_is_given_back_when_memory_has_grown_and_once_a_minute_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    held, now, given = 100 * MB, 0.0, []
    monkeypatch.setattr(status, "taken", lambda: held)
    monkeypatch.setattr(status.time, "monotonic", lambda: now)
    monkeypatch.setattr(status, "give_back", lambda: given.append(now))
    watch = MemoryWatch(1000.0, Pipeline(load_text(GRAPH)))
    for second in range(300):
        now, held = float(second), held + SPARE_BYTES // 100
        assert watch.exceeded() is None
    assert given[0] == 0 and 2 <= len(given) <= 4 and min(b - a for a, b in pairwise(given)) > 99


def test_no_session_ends_for_memory_that_is_merely_free(monkeypatch: pytest.MonkeyPatch) -> None:
    held = [1200 * MB]
    monkeypatch.setattr(status, "taken", lambda: held[0])
    monkeypatch.setattr(status, "give_back", lambda: held.__setitem__(0, 300 * MB))
    watch = MemoryWatch(1000.0, Pipeline(load_text(GRAPH)))
    assert watch.exceeded() is None
    held[0] = 1250 * MB
    assert watch.exceeded() is None, "also within the minute"
    held[0] = 1300 * MB
    monkeypatch.setattr(status, "give_back", lambda: None)
    assert watch.exceeded() is not None
