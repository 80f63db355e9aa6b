"""`python -m bench.neighbours`: one frame in, its 32 nearest out, beside brute force, scipy's cKDTree and hnswlib; a table in Markdown.

Every contender gets the same frames. Times are of one insertion and one query together, microseconds a frame, called from Python one frame
at a time as a live graph would, in the thread's own time, less that of a step that does nothing (reading the clock takes some .5 us):
median and 99th percentile. `--quick` leaves out the largest window; `--write`
puts goals and table into docs/lab/neighbours.md.
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite.binding import get_host_cpu_features

from bench.report import Goal, Section, marks, publish, short, whole
from kinegraph.operators.neighbours import Index
from kinegraph.operators.neighbours.follow import follow
from kinegraph.stream.chunk import Array
from kinegraph.stream.kernel import kernel

K, BAND = 32, 30


@kernel
def row_major(window: Array, q: Array, at: int, filled: int, frames: Array, distances: Array) -> None:
    """Brute force as one would write it: every row's distance, and the nearest kept in order."""
    size = window.shape[0]
    found = 0
    for slot in range(min(size, filled)):
        if (at - slot) % size <= BAND:
            continue
        total = np.float32(0.0)
        for i in range(q.shape[0]):
            off = window[slot, i] - q[i]
            total += off * off
        if found < K or total < distances[found - 1]:
            j = min(found, K - 1)
            while j > 0 and distances[j - 1] > total:
                distances[j] = distances[j - 1]
                frames[j] = frames[j - 1]
                j -= 1
            distances[j] = total
            frames[j] = slot
            found = min(found + 1, K)


class Ours:
    """The index, by the kernel that the operator calls."""

    name = "kinegraph"

    def __init__(self, first: Array) -> None:
        self.index = Index(first.shape[1], len(first), K)
        self.index.follow(first, K, band=BAND)
        self.frames, self.distances = np.empty((1, K), np.int64), np.empty((1, K), np.float32)

    def step(self, x: Array) -> None:
        s = self.index.state
        follow(s.floats, s.books, x[None], BAND, np.nan, self.frames, self.distances)

    def insert(self, x: Array) -> None:
        self.index.insert(x)


class Brute:
    """All rows, each time."""

    name = "brute force (numba, row-major)"

    def __init__(self, first: Array) -> None:
        self.window = first.astype(np.float32)
        self.at, self.filled = len(first) - 1, len(first)
        self.frames, self.distances = np.empty(K, np.int64), np.empty(K, np.float32)

    def step(self, x: Array) -> None:
        self.at = (self.at + 1) % len(self.window)
        self.window[self.at] = x
        row_major(self.window, self.window[self.at], self.at, self.filled, self.frames, self.distances)


class Rebuilt:
    """A tree of the whole window, each time."""

    name = "cKDTree rebuilt"

    def __init__(self, first: Array) -> None:
        self.window, self.at = first.copy(), len(first) - 1

    def step(self, x: Array) -> None:
        from scipy.spatial import cKDTree

        self.at = (self.at + 1) % len(self.window)
        self.window[self.at] = x
        cKDTree(self.window).query(x, K + BAND + 1)


class Tail:
    """A tree rebuilt every 16th of the window; what came since is searched by numpy."""

    name = "cKDTree every N/16 + tail"

    def __init__(self, first: Array) -> None:
        self.frames = list(first)
        self.size, self.every = len(first), len(first) // 16
        self.build()

    def build(self) -> None:
        from scipy.spatial import cKDTree

        self.frames = self.frames[-self.size :]
        self.tree, self.tail = cKDTree(np.array(self.frames)), np.empty((self.every, len(self.frames[0])))
        self.filled = 0

    def step(self, x: Array) -> None:
        self.frames.append(x)
        self.tail[self.filled] = x
        self.filled += 1
        near, _ = self.tree.query(x, K + BAND + 1)
        off = self.tail[: self.filled] - x
        np.sort(np.concatenate([near, np.sqrt((off * off).sum(1))]))[:K]
        if self.filled == self.every:
            self.build()


class Hnsw:
    """Approximate: a navigable graph; the newest frame replaces the oldest."""

    name = "hnswlib (approximate)"

    def __init__(self, first: Array) -> None:
        import hnswlib

        self.graph: Any = hnswlib.Index("l2", first.shape[1])
        self.graph.init_index(len(first) + 1, ef_construction=100, M=16, allow_replace_deleted=True)
        self.graph.set_num_threads(1)
        self.graph.set_ef(64)
        self.graph.add_items(first, np.arange(len(first)))
        self.next, self.size = len(first), len(first)

    def step(self, x: Array) -> None:
        self.graph.mark_deleted(self.next - self.size)
        self.graph.add_items(x[None], np.array([self.next]), replace_deleted=True)
        self.next += 1
        self.graph.knn_query(x[None], K)


def motion(n: int, width: int, seed: int = 0) -> Array:
    """Six cyclic actions of three harmonics in random turn, with drifting speed and centre: an intrinsic dimension of about 5."""
    rng = np.random.default_rng(seed)
    actions = [(rng.normal(size=(6, width)), 0.5 * rng.normal(size=width), rng.uniform(0.6, 1.6)) for _ in range(6)]
    harmonic = np.array([1.0, 2.0, 3.0])
    x, at, phase = np.empty((n, width)), 0, 0.0
    while at < n:
        size = min(n - at, int(rng.uniform(300, 900)))
        curve, centre, speed = actions[rng.integers(6)]
        turn = phase + 2 * np.pi / 60 * np.cumsum(speed * (1 + 0.005 * np.cumsum(rng.normal(size=size))))
        waves = np.concatenate([np.sin(np.outer(turn, harmonic)), np.cos(np.outer(turn, harmonic))], 1)
        x[at : at + size] = centre + waves / np.tile(harmonic, 2) @ curve
        at, phase = at + size, turn[-1]
    drift = 0.01 * np.cumsum(rng.normal(size=(n, 4)), 0)
    drift -= np.linspace(0, 1, n)[:, None] * drift[-1]
    return x + 0.3 * drift @ rng.normal(size=(4, width)) + 0.02 * rng.normal(size=x.shape)


def uniform(n: int, width: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).random((n, width))


EMPTY = 1000
"""Steps that do nothing, to know what the clock takes."""
COLD = 3
"""A frame that was interrupted, and those after it until the caches are warm again: so many are disturbed."""


@dataclass(slots=True)
class Figure:
    """Microseconds: median, 99th percentile, the longest; and the 99th percentile of frames that nothing disturbed."""

    median: float
    p99: float
    longest: float
    calm: float

    @staticmethod
    def of(step: Callable[[Array], None], frames: Array, budget_s: float) -> Figure:
        """As many of `frames` as the budget lasts for; a few before do not count. What an empty step takes is taken off."""
        empty, _ = timed(lambda x: None, frames[:EMPTY], budget_s)
        took, switches = timed(step, frames, budget_s)
        first = min(5, len(took) // 3)
        us = (took[first:] - np.median(empty)) / 1e3
        disturbed = np.convolve(switches, np.ones(COLD))[first : len(took)] > 0
        calm = us[~disturbed] if not disturbed.all() else us
        return Figure(
            float(np.median(us)), float(np.percentile(us, 99)), float(us.max()), float(np.percentile(calm, 99))
        )

    def __str__(self) -> str:
        return f"{short(self.median)} / {short(self.p99)}"


def timed(step: Callable[[Array], None], frames: Array, budget_s: float) -> tuple[Array, list[int]]:
    """The thread's time of each step, ns; and how often each was interrupted."""
    took, switches = [], []
    end = time.perf_counter() + budget_s
    for x in frames:
        before = interruptions()
        began = time.thread_time_ns()
        step(x)
        took.append(time.thread_time_ns() - began)
        switches.append(interruptions() - before)
        if time.perf_counter() > end and len(took) > 8:
            break
    return np.array(took), switches


def interruptions() -> int:
    """How often this thread has been taken off its core for other work; 0 where the system does not say."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw if hasattr(resource, "RUSAGE_THREAD") else 0


def contenders() -> tuple[list[type[Any]], list[str]]:
    """Who takes part, and who does not."""
    found: list[type[Any]] = [Ours, Brute, Rebuilt, Tail]
    try:
        import hnswlib  # noqa: F401
    except ImportError:
        return found, ["hnswlib is not installed, and left out."]
    return [*found, Hnsw], []


ROWS = [
    *((motion, n, width) for n in (1000, 10_000, 100_000) for width in (6, 24, 60)),
    *((uniform, 10_000, width) for width in (6, 24, 60)),
]
PROMISED = {(1000, 6): 3, (10_000, 6): 10, (100_000, 6): 25, (100_000, 24): 70}
"""Times brute force with AVX-512, by window and from so many features on; half of it on narrower machines."""


def measure(budget_s: float, *, quick: bool) -> Section:
    """The table; a contender that would take minutes to set up is left out of that row."""
    parts, notes = contenders()
    head = [
        "stream, N, D",
        *(p.name for p in parts),
        "times brute force",
        "p99 / median",
        "undisturbed",
        "longest insertion / median",
    ]
    lines, made = [], []
    for stream, n, width in ROWS:
        if quick and n > 10_000:
            continue
        figures, insertion = row(stream, n, width, parts, budget_s)
        ours = figures[Ours.name]
        made.append((stream, n, width, figures))
        ratios = [figures[Brute.name].median / ours.median, ours.p99 / ours.median, ours.calm / ours.median]
        cells = [str(figures.get(p.name, "")) for p in parts] + [short(v) for v in (*ratios, insertion / ours.median)]
        lines.append([f"{stream.__name__}, {n}, {width}", *cells])
    notes.append(
        f"Microseconds in the thread's own time less that of an empty step, median / p99; {platform.machine()}, "
        f"Python {platform.python_version()}; load average at the end {os.getloadavg()[0]:.1f}. Undisturbed: p99 / median without the "
        f"frames in which the system took the core away for other work, and the {COLD - 1} after each, with cold caches."
    )
    return Section("An insertion and a query for the 32 nearest", head, lines, notes, goals(made))


def goals(made: list[tuple[Any, int, int, dict[str, Figure]]]) -> list[Goal]:
    """What was promised, kept by the worst row each."""
    share = 1.0 if get_host_cpu_features().get("avx512f") else 0.5
    found = []
    steady = {(n, width): f for stream, n, width, f in made if stream is motion}
    for (n, least), promised in PROMISED.items():
        ratios = [
            f[Brute.name].median / f[Ours.name].median for (m, width), f in steady.items() if m == n and width >= least
        ]
        if (n, least) == (100_000, 6):
            ratios = ratios[:1]
        if ratios:
            name = f"{n} frames, {'from ' if len(ratios) > 1 else ''}{least} features: brute force against ours"
            found.append(Goal(name, min(ratios), promised * share, "times", least=True))
    noise = [f[Ours.name].median / f[Brute.name].median for stream, _, _, f in made if stream is uniform]
    found.append(Goal("noise: ours against brute force", max(noise), 1.7, "times"))
    for what, field in (("p99 against the median", "p99"), ("p99 against the median, undisturbed", "calm")):
        worst = max(getattr(f[Ours.name], field) / f[Ours.name].median for f in steady.values())
        found.append(Goal(what, worst, 4.0, "times"))
    return found


def row(
    stream: Callable[[int, int], Array], n: int, width: int, parts: list[type[Any]], budget_s: float
) -> tuple[dict[str, Figure], float]:
    """Everybody's figures, and our longest insertion."""
    x = stream(n + 6000, width)
    figures: dict[str, Figure] = {}
    longest = 0.0
    for part in parts:
        if part is Hnsw and n > 10_000:
            continue
        contender = part(x[:n])
        figures[part.name] = Figure.of(contender.step, x[n : n + 4000], budget_s)
        if part is Ours:
            longest = Figure.of(contender.insert, x[n + 4000 :], budget_s).longest
    return figures, longest


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.neighbours", description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="windows of 1000 and 10 000 frames, and little time for each"
    )
    parser.add_argument("--write", action="store_true", help="write goals and table into docs/lab/neighbours.md")
    given = parser.parse_args()
    section = measure(0.5 if given.quick else 4.0, quick=given.quick)
    name = "bench.neighbours"
    print(whole([section], f"By `python -m {name}`."))
    if given.write:
        publish([section], f"By `python -m {name}`.", "lab/neighbours.md", *marks(name))


if __name__ == "__main__":
    main()
