"""Large pages: what is in memory stays what it is; where there are none, nothing happens."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from stream.engine import pages

ROLLUP = Path("/proc/self/smaps_rollup")


def large_kb() -> int:
    found = re.search(r"AnonHugePages:\s+(\d+)", ROLLUP.read_text())
    assert found
    return int(found[1])


def test_memory_is_gathered_and_holds_the_same() -> None:
    kept = np.random.default_rng(0).normal(size=1_000_000)
    before = kept.copy()
    gathered = pages.gather()
    if not gathered:
        pytest.skip("this system gathers no memory into large pages (Linux 6.1 does, unless switched off)")
    assert large_kb() >= 2048 * min(gathered, 4)
    np.testing.assert_array_equal(kept, before)


@pytest.mark.parametrize("setting", ["always madvise [never]\n", None])
def test_where_there_are_none_nothing_happens(
    setting: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "SETTINGS", tmp_path)
    if setting:
        (tmp_path / "enabled").write_text(setting)
    assert pages.gather() == 0


def test_threads_stacks_and_files_are_left_alone() -> None:
    files = {line.split()[0] for line in pages.MAPS.read_text().splitlines() if "/" in line or "[stack]" in line}
    for start, end in pages._own_memory():
        assert f"{start:x}-{end:x}" not in files
