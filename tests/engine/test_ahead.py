"""No session waits longer than for the compiler: kernels are kept one by one, compiled side by side, and counted."""

from __future__ import annotations

import json
import os
import platform
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest
from numba import types
from numba.core.registry import cpu_target

from kinegraph.devices.page.hub import Hub
from kinegraph.operators.emg.quality import SignalQuality
from kinegraph.operators.filters.iir import Lowpass
from kinegraph.operators.filters.one_euro import OneEuro
from kinegraph.stream.compiler import cache
from kinegraph.stream.compiler.fingerprint import kernels_of
from kinegraph.stream.engine import ahead, warmup
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Operator
from kinegraph.stream.text.progress import FirstAndLast
from tests.support.command_line import Command, kinegraph

__all__ = ["kinegraph"]

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache."""
    monkeypatch.setenv("KINEGRAPH_CACHE", str(tmp_path / "cache"))
    cache.cache_folder.cache_clear()
    yield tmp_path / "cache" / "kernels"
    cache.cache_folder.cache_clear()


def doubled() -> Any:
    """A kernel that is not compiled yet."""

    @kernel
    def double(x: float) -> float:
        return 2.0 * x

    return double


def test_every_kernel_is_kept_as_soon_as_it_is_compiled(empty: Path) -> None:
    made = doubled()
    assert not made._cache.is_kept and cache.kept_count() == 0
    assert made(1.5) == 3.0
    assert made._cache.is_kept and cache.kept_count() == 1
    assert made(2) == 4
    assert cache.kept_count() == 2, "for other types of arguments it is other code, in a file of its own"
    again = doubled()
    assert again(1.5) == 3.0 and sum(again.stats.cache_hits.values()) == 1


def test_a_file_that_is_cut_off_or_damaged_is_compiled_again(empty: Path) -> None:
    doubled()(1.5)
    (file,) = empty.glob(f"*/*{cache.SUFFIX}")
    whole = file.read_bytes()
    for content in (b"", whole[: len(whole) // 2], whole[:-1] + b"?"):
        file.write_bytes(content)
        made = doubled()
        assert made(1.5) == 3.0 and not made.stats.cache_hits
        again = doubled()
        assert again(1.5) == 3.0 and again.stats.cache_hits


def shipped(kept: Path, to: Path) -> None:
    """Move what was compiled here to where a platform wheel holds it, as if it were for a level."""
    (file,) = kept.glob(f"*/*{cache.SUFFIX}")
    triple, _, _ = cpu_target.target_context.codegen().magic_tuple()
    name = cache._file((types.float64,), (triple, "x86-64-v2", ""))
    place = to / "x86-64-v2" / file.parent.name
    place.mkdir(parents=True)
    file.rename(place / name)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="levels are those of x86-64")
def test_what_the_package_holds_is_used_and_the_cache_is_left_alone(
    empty: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    doubled()(1.5)
    monkeypatch.setattr(cache, "SHIPPED", tmp_path / "compiled")
    shipped(empty, tmp_path / "compiled" / cache.MADE_BY)
    cache.levels.cache_clear()
    try:
        made = doubled()
        assert cache.levels() == ("x86-64-v2",) and made._cache.is_kept
        assert made(1.5) == 3.0 and made.stats.cache_hits and cache.kept_count() == 0

        @kernel
        def double(x: float) -> float:
            return 3.0 * x  # edited

        assert double(1.5) == 4.5 and cache.kept_count() == 1
    finally:
        cache.levels.cache_clear()


@pytest.mark.parametrize("which", ("another numba", "an older processor", "a processor that was asked for"))
@pytest.mark.skipif(platform.machine() != "x86_64", reason="levels are those of x86-64")
def test_what_the_package_holds_for_others_is_not_used(
    which: str, empty: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    doubled()(1.5)
    monkeypatch.setattr(cache, "SHIPPED", tmp_path / "compiled")
    shipped(empty, tmp_path / "compiled" / ("numba-0.1" if which == "another numba" else cache.MADE_BY))
    if which == "an older processor":
        monkeypatch.setattr(cache, "LEVELS", {"x86-64-v2": frozenset(("a feature of tomorrow",))})
    if which == "a processor that was asked for":
        monkeypatch.setattr(numba.config, "CPU_NAME", "generic")
    cache.levels.cache_clear()
    try:
        made = doubled()
        assert not made._cache.is_kept
        assert made(1.5) == 3.0 and not made.stats.cache_hits
    finally:
        cache.levels.cache_clear()


def test_a_cache_that_cannot_be_written_is_read(empty: Path) -> None:
    doubled()(1.5)
    folders = [*empty.glob("*"), empty]
    for folder in folders:
        folder.chmod(0o500)
    try:
        cache.cache_folder.cache_clear()
        made = doubled()
        assert made(1.5) == 3.0 and sum(made.stats.cache_hits.values()) == 1
    finally:
        for folder in folders:
            folder.chmod(0o700)


def test_before_the_first_kernel_is_compiled_others_may_compile_it(empty: Path) -> None:
    called: list[int] = []

    def elsewhere() -> None:
        called.append(1)
        doubled()(1.5)

    with cache.at_first_miss(elsewhere):
        made = doubled()
        assert made(1.5) == 3.0 and sum(made.stats.cache_hits.values()) == 1
        assert made(2) == 4 and called == [1], "once only"
    doubled()(np.float32(1.0))
    assert called == [1], "not afterwards"


@pytest.mark.parametrize("part", [SignalQuality, Lowpass, OneEuro])
def test_the_kernels_that_are_counted_are_those_that_the_warm_up_compiles(part: type[Operator[Any]]) -> None:
    warmup.run_cases(part)
    counted = kernels_of(part)
    assert counted and all(made._cache.is_kept for made in counted)  # type: ignore[attr-defined]


class Ends(Lowpass):
    """Its case ends the process that runs it."""

    @classmethod
    def cases(cls) -> Sequence[Case]:
        os._exit(9)


class Notes(Lowpass):
    """Its case leaves a file."""

    @classmethod
    def cases(cls) -> Sequence[Case]:
        (cache.cache_folder() / "noted").touch()
        return []


@pytest.mark.skipif(ahead.sys.platform != "linux", reason="elsewhere one process compiles")
def test_a_process_that_dies_leaves_its_work_to_the_others(empty: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{ROOT / 'tests' / 'support'}")
    monkeypatch.setattr(ahead, "process_count", lambda: 2)
    ahead.compile_operators([Ends, Notes])
    assert (empty / "noted").exists()


def test_a_process_that_cannot_be_started_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "child", lambda module: ["/there/is/no/such/program"])
    ahead.compile_operators([Lowpass])


def test_this_process_compiles_too_and_may_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[bool] = []

    def meanwhile() -> None:
        called.append(True)
        raise ValueError("reported by the warm-up")

    monkeypatch.setattr(ahead, "_process", lambda: None)
    ahead.compile_operators([Lowpass], meanwhile=meanwhile)
    assert called


def counted(monkeypatch: pytest.MonkeyPatch, sizes: Sequence[int]) -> list[SimpleNamespace]:
    """Kernels of these sizes, none of them compiled."""
    made = [SimpleNamespace(_cache=SimpleNamespace(is_kept=False), size=size) for size in sizes]
    kept = [*map(_Hashable, made)]
    monkeypatch.setattr(ahead, "kernels_of", lambda part: kept)
    monkeypatch.setattr(ahead, "size_of", lambda kernel: kernel.size)
    return made


class _Hashable:
    def __init__(self, inner: SimpleNamespace) -> None:
        self._cache, self.size = inner._cache, inner.size


def test_progress_counts_kernels_and_guesses_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    made = counted(monkeypatch, [10_000, 30_000, 60_000])
    now = [100.0]
    monkeypatch.setattr(ahead.time, "monotonic", lambda: now[0])
    state = ahead.Compiling([Lowpass], lambda text, over: None)
    assert state.text == "compiling kernel 1 of 3, about 60 s left"
    made[1]._cache.is_kept = True
    now[0] = 130.0
    assert state.text == "compiling kernel 2 of 3, about 70 s left", "30 s for 30 % of the work"
    made[2]._cache.is_kept = True
    now[0] = 193.0
    assert state.text == "compiling kernel 3 of 3, about 10 s left"
    assert [*map(ahead.about, (0.5, 12.0, 61.0, 200.0))] == ["a few seconds", "about 10 s", "about 60 s", "about 3 min"]


def test_processes_are_started_only_where_they_save_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "process_count", lambda: 2)
    assert ahead._saves_s([10.0, 8.0, 4.0]) == 11.0
    assert ahead._saves_s([30.0, 0.5]) == 0.5 and ahead._saves_s([]) == 0.0
    monkeypatch.setattr(ahead, "process_count", lambda: 1)
    assert ahead._saves_s([10.0, 8.0, 4.0]) == 0.0


def test_short_compilations_are_not_reported_and_long_ones_begin_and_end(monkeypatch: pytest.MonkeyPatch) -> None:
    counted(monkeypatch, [10])
    reported: list[tuple[str, bool]] = []
    state = ahead.Compiling([Lowpass], lambda text, over: reported.append((text, over)))
    state.start()
    state.stop()
    assert reported == []
    monkeypatch.setattr(ahead, "QUIET_S", 0.0)
    begun = threading.Event()
    state = ahead.Compiling([Lowpass], lambda text, over: (reported.append((text, over)), begun.set())[0])
    state.start()
    assert begun.wait(30)
    state.stop()
    assert reported[0] == ("compiling kernel 1 of 1, a few seconds left", False)
    assert reported[-1][1] and reported[-1][0].startswith("compiled 1 kernel")


def test_without_a_terminal_the_first_and_the_last_report_are_printed() -> None:
    lines: list[str] = []
    report: Callable[[str, bool], None] = FirstAndLast(lines.append)
    for k in range(5):
        report(f"kernel {k + 1} of 5", False)
    report("compiled 5 kernels in 3 s", True)
    assert lines == ["kernel 1 of 5", "compiled 5 kernels in 3 s"]


def test_the_page_learns_how_far_it_is() -> None:
    hub = Hub(lambda asked: None)
    hub.receive({"t": "state", "table": {}, "dropped": 0, "starting": "compiling kernel 2 of 9"}, memoryview(b""))
    assert hub.starting == "compiling kernel 2 of 9"
    hub.receive({"t": "state", "table": {"board": {}}, "dropped": 0, "edges": {}}, memoryview(b""))
    assert hub.starting == ""


def test_dev_compile_compiles_what_a_session_would(kinegraph: Command, empty: Path, tmp_path: Path) -> None:
    graph = tmp_path / "rect.yaml"
    graph.write_text(
        "nodes:\n  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 1}\n"
        "  rect: {use: operators.filters.rectify.Rectify, from: board.emg}\n"
    )
    code, out, _ = kinegraph("dev", "compile", graph, "--json")
    reported = json.loads(out)
    assert code == 0 and reported["compiled"] == reported["kept"] == cache.kept_count()
    assert json.loads(kinegraph("dev", "compile", graph, "--json")[1])["compiled"] == 0
    code, _, _ = kinegraph("run", graph, "--view", "none")
    assert code == 0 and cache.kept_count() == reported["kept"]
    assert "compiled 0 kernels" in kinegraph("dev", "compile", graph)[1]
