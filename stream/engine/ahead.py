"""Kernels of a graph's operators, compiled beside each other by several processes before the warm-up asks for them one by one.

Nothing is done until the warm-up meets a kernel that the cache does not hold. Then processes run the cases of the operators that lack
kernels, those with most to compile first, and so fill the cache; afterwards the warm-up finds there what it needs. What it does not find
(a process died, an operator of the user's own) it compiles itself: no result depends on where a kernel was compiled.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import Any, TypeAlias

from kinegraph.stream.compiler.cache import at_first_miss
from kinegraph.stream.compiler.fingerprint import kernels_of, size_of
from kinegraph.stream.errors import Interrupted
from kinegraph.stream.operator import Operator
from kinegraph.stream.system import names
from kinegraph.stream.system.memory_limit import machine
from kinegraph.stream.system.subprocesses import child

CompilationReport: TypeAlias = Callable[[str, bool], None]
"""Takes how far compilation is, in words, and whether it is over; from a thread of its own, several times a second."""
OperatorType: TypeAlias = type[Operator[Any]]

MODULE = "kinegraph.stream.engine.compile_process"
LOOK_S = 0.25
QUIET_S = 1.0
"""What compiles in less is not reported."""
WORTH_S = 2.0
"""Processes are started only if they save at least this many seconds: each takes one to start."""
PROCESS_MB = 500
"""Memory of a process that compiles."""
BYTE_S, KERNEL_S = 0.0006, 0.2
"""A guess of how long a kernel compiles, by the bytes of its code, for the time before one can be made from what was compiled."""


KNOWN = 0.75
"""Once less than this part of it is left, how long the rest compiles is judged by what was compiled, not by the guess."""


class Compiling:
    """The kernels that are missing when compilation begins, and how many of them are done; by whomever."""

    def __init__(self, parts: Iterable[OperatorType], report: CompilationReport) -> None:
        self._report = report
        found: dict[Any, OperatorType] = {}
        for part in (part for part in parts if names.is_ours(part.__module__)):
            for kernel in kernels_of(part):
                if not kernel._cache.is_kept:
                    found.setdefault(kernel, part)
        self._left = {kernel: _guess_s(kernel) for kernel in found}
        self._whole, self._whole_s = len(self._left), sum(self._left.values())
        self.seconds: dict[OperatorType, float] = {}
        for kernel, part in found.items():
            self.seconds[part] = self.seconds.get(part, 0.0) + self._left[kernel]
        self._began = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="compiling", daemon=True)

    def start(self) -> None:
        """From now on, report what is done."""
        if self._whole:
            self._thread.start()

    def stop(self) -> None:
        """CompilationReport the end."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def text(self) -> str:
        """The state in words: "compiling kernel 12 of 41, about 20 s left"."""
        for kernel in [kernel for kernel in self._left if kernel._cache.is_kept]:
            del self._left[kernel]
        done, left_s = self._whole - len(self._left), sum(self._left.values())
        took_s = time.monotonic() - self._began
        if left_s < KNOWN * self._whole_s:
            left_s *= took_s / (self._whole_s - left_s)
        return f"compiling kernel {min(done + 1, self._whole)} of {self._whole}, {about(left_s)} left"

    def _watch(self) -> None:
        if self._over.wait(QUIET_S):
            return
        self._report(self.text, False)
        while not self._over.wait(LOOK_S):
            self._report(self.text, False)
        took = f"{time.monotonic() - self._began:.0f} s"
        self._report(
            f"compiled {self._whole} kernel{'s' * (self._whole > 1)} in {took}; the next start finds them", True
        )


def about(seconds: float) -> str:
    """A time as it is guessed: "about 20 s", "about 3 min"."""
    if seconds >= 90:
        return f"about {seconds / 60:.0f} min"
    return f"about {max(round(seconds / 5) * 5, 5)} s" if seconds > 3 else "a few seconds"


def _guess_s(kernel: Any) -> float:
    return KERNEL_S + BYTE_S * size_of(kernel)


@contextmanager
def compiling_beside(
    parts: Iterable[OperatorType],
    stopped: Callable[[], bool] = bool,
    report: CompilationReport = lambda text, over: None,
    meanwhile: Callable[[], None] = lambda: None,
) -> Iterator[None]:
    """Within: at the first kernel that is missing, these operators' kernels are compiled by several processes, while this one calls
    `meanwhile`.

    Raises Interrupted once `stopped`.
    """
    states: list[Compiling] = []

    def begin() -> None:
        states.append(state := Compiling(parts, report))
        state.start()
        lacking = sorted(state.seconds, key=lambda part: -state.seconds[part])
        if _saves_s(list(state.seconds.values())) >= WORTH_S:
            compile_operators(lacking, stopped, meanwhile)

    try:
        with at_first_miss(begin):
            yield
    finally:
        for state in states:
            state.stop()


def _saves_s(seconds: list[float]) -> float:
    """What processes of one operator each save of the time that one process would take."""
    return sum(seconds) - max([*seconds, sum(seconds) / process_count()])


def process_count() -> int:
    """How many processes may compile beside each other: one for each processor, as far as memory reaches; one on systems but Linux."""
    if sys.platform != "linux":
        return 1
    return max(1, min(len(os.sched_getaffinity(0)), machine() // (PROCESS_MB << 20) or 1))


def compile_operators(
    parts: Sequence[OperatorType], stopped: Callable[[], bool] = bool, meanwhile: Callable[[], None] = lambda: None
) -> None:
    """Run these operators' cases in processes of their own, in this order; what a process leaves when it dies is left.

    `meanwhile` is called in this one; what fails in it fails again, and is reported, in the warm-up.
    """
    waiting: SimpleQueue[str] = SimpleQueue()
    for part in parts:
        waiting.put(f"{part.__module__}:{part.__qualname__}")
    processes = [made for _ in range(min(process_count(), len(parts))) if (made := _process())]
    threads = [threading.Thread(target=_feed, args=(process, waiting), daemon=True) for process in processes]
    try:
        for thread in threads:
            thread.start()
        with suppress(Exception):
            meanwhile()
        for thread in threads:
            while thread.is_alive():
                thread.join(LOOK_S)
                if stopped():
                    raise Interrupted
    finally:
        for process in processes:
            process.kill()
            with process:
                pass


def _process() -> subprocess.Popen[str] | None:
    """A process that compiles; None where it cannot be started."""
    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
    with suppress(OSError):
        return subprocess.Popen(child(MODULE), stdin=pipe, stdout=pipe, stderr=nowhere, text=True, bufsize=1)
    return None


def _feed(process: subprocess.Popen[str], waiting: SimpleQueue[str]) -> None:
    """Give a process one operator after the other."""
    assert process.stdin and process.stdout
    with suppress(Empty, OSError, ValueError):
        while True:
            process.stdin.write(waiting.get_nowait() + "\n")
            if not process.stdout.readline():
                return
