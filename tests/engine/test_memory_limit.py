"""How much memory a session may take: where the graph says nothing, in a container, and in one call that asks for more."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from kinegraph.stream.system import memory_limit as memory

GB = 10**9
GIB = 1024**3


def test_without_a_word_in_the_graph_it_is_three_quarters_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "machine", lambda: 8 * GB)
    assert memory.ceiling(0) == 6 * GB
    assert memory.ceiling(500) == 500 * 10**6


def test_a_container_has_what_its_limit_leaves(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    first, second, absent = tmp_path / "first", tmp_path / "second", tmp_path / "absent"
    monkeypatch.setattr(memory, "_LIMITS", (str(absent), str(first), str(second)))
    for one, other, wanted in (("max", "12345", 12345), ("7000", "8000", 7000), ("max", str(10 * whole), whole)):
        first.write_text(one + "\n")
        second.write_text(other + "\n")
        assert memory.machine() == wanted


def test_what_is_taken_is_what_the_system_says() -> None:
    reported = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS:"))
    assert memory.taken() == pytest.approx(int(reported.split()[1]) * 1024, rel=0.1)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of this kind are Linux's")
@pytest.mark.parametrize(
    ("ceiling_bytes", "beyond"), [(8 * GIB, 2 * GIB), (4 * GIB, GIB), (1 * GIB, GIB), (100 * GIB, 25 * GIB)]
)
def test_one_call_may_reach_a_quarter_further_but_a_gibibyte_at_least(
    ceiling_bytes: int, beyond: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    import resource

    monkeypatch.setattr(memory, "taken", lambda: GIB // 2)
    before = resource.getrlimit(resource.RLIMIT_DATA)
    if before[0] != resource.RLIM_INFINITY:
        pytest.skip("somebody else has set a limit")
    with memory.refused_beyond(ceiling_bytes):
        room = resource.getrlimit(resource.RLIMIT_DATA)[0] - memory.writable()
        assert room == pytest.approx(ceiling_bytes - GIB // 2 + beyond, abs=50 << 20)
        with memory.refused_beyond(ceiling_bytes):
            assert resource.getrlimit(resource.RLIMIT_DATA)[0] - memory.writable() == pytest.approx(room, abs=50 << 20)
    with memory.refused_beyond(0):
        assert resource.getrlimit(resource.RLIMIT_DATA) == before
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
