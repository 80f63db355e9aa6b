"""The work that everyone is given: the five-operator chain's numbers, its steps, what feeds them, and the sink that counts.

Sixteen channels at 2000 Hz -> rectify -> Butterworth low-pass (order 4, 20 Hz) -> every 20th sample (100 Hz) -> moving mean of 25 -> sink.
Peers run this file in environments of their own; beside numpy, scipy and numba it needs only our kernels, so that "the same kernels"
means the same machine code.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from itertools import cycle, islice
from time import perf_counter_ns
from typing import Any, TypeAlias

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from kinegraph.operators.filters.decimate import thin_out
from kinegraph.operators.filters.iir import late_sections, sections
from kinegraph.operators.filters.moving import moving_mean
from kinegraph.operators.filters.rectify import magnitudes
from kinegraph.stream.chunk import Samples, Times

CHANNELS = 16
RATE_HZ = 2000
CUTOFF_HZ = 20.0
ORDER = 4
EVERY = 20
WINDOW = 25
POOL = 64
"""So many different chunks are handed out again and again where only the time counts."""

Step: TypeAlias = Callable[[Samples], Samples]
Stamped: TypeAlias = tuple[Times, Samples]
"""Samples and when each of them was, in ns: what kinegraph's chunks carry."""


def samples(n: int, seed: int = 7) -> Samples:
    """EMG-like noise (n, channels)."""
    return np.random.default_rng(seed).normal(scale=50.0, size=(n, CHANNELS))


def sos() -> Samples:
    """The low-pass as second-order sections (2, 6)."""
    return np.ascontiguousarray(butter(ORDER, CUTOFF_HZ, fs=RATE_HZ, output="sos"))


def kernel_steps() -> list[Step]:
    """The chain's four steps on kinegraph's own kernels, each with a memory of its own."""
    coefficients = sos()
    z = np.zeros((len(coefficients), 2, CHANNELS))
    ring, sums, places = np.zeros((WINDOW, CHANNELS)), np.zeros((4, CHANNELS)), np.zeros((2, CHANNELS), np.int64)
    stamps = np.zeros(1000, np.int64)
    skip = 0

    def rectify(x: Samples) -> Samples:
        out = np.empty(x.shape)
        magnitudes(x, out)
        return out

    def lowpass(x: Samples) -> Samples:
        out = np.empty(x.shape)
        sections(x, coefficients, z, out)
        return out

    def thin(x: Samples) -> Samples:
        nonlocal skip
        rows = (len(x) - skip + EVERY - 1) // EVERY
        out = np.empty((rows, CHANNELS))
        if rows:
            thin_out(x, skip, EVERY, stamps, out, stamps)
        skip = (skip - len(x)) % EVERY
        return out

    def mean(x: Samples) -> Samples:
        out = np.empty(x.shape)
        moving_mean(x, ring, sums, places, stamps[: len(x)], 0, out, stamps[: len(x)])
        return out

    return [rectify, lowpass, thin, mean]


def stamped_steps() -> list[Callable[[Stamped], Stamped]]:
    """The chain's four steps on kinegraph's own kernels, every sample with its stamp, earlier by the filters' delays: all of what we do."""
    coefficients = sos()
    z = np.zeros((len(coefficients), 2, CHANNELS))
    ring, sums, places = np.zeros((WINDOW, CHANNELS)), np.zeros((4, CHANNELS)), np.zeros((2, CHANNELS), np.int64)
    lowpass_ns, mean_ns = 20_800_000, 120_000_000
    skip = 0

    def rectify(s: Stamped) -> Stamped:
        time, x = s
        out = np.empty(x.shape)
        magnitudes(x, out)
        return time, out

    def lowpass(s: Stamped) -> Stamped:
        time, x = s
        out, stamps = np.empty(x.shape), np.empty(len(x), np.int64)
        late_sections(x, coefficients, z, out, time, lowpass_ns, stamps)
        return stamps, out

    def thin(s: Stamped) -> Stamped:
        nonlocal skip
        time, x = s
        rows = (len(x) - skip + EVERY - 1) // EVERY
        out, stamps = np.empty((rows, CHANNELS)), np.empty(rows, np.int64)
        if rows:
            thin_out(x, skip, EVERY, time, out, stamps)
        skip = (skip - len(x)) % EVERY
        return stamps, out

    def mean(s: Stamped) -> Stamped:
        time, x = s
        out, stamps = np.empty(x.shape), np.empty(len(x), np.int64)
        moving_mean(x, ring, sums, places, time, mean_ns, out, stamps)
        return stamps, out

    return [rectify, lowpass, thin, mean]


def scipy_steps() -> list[Step]:
    """The chain's four steps as someone writes them with numpy and scipy alone."""
    coefficients = sos()
    zi = np.zeros((len(coefficients), 2, CHANNELS))
    taps = np.full(WINDOW, 1 / WINDOW)
    tail = np.zeros((WINDOW - 1, CHANNELS))
    phase = 0

    def lowpass(x: Samples) -> Samples:
        nonlocal zi
        y, zi = sosfilt(coefficients, x, axis=0, zi=zi)
        return y

    def thin(x: Samples) -> Samples:
        nonlocal phase
        y = x[-phase % EVERY :: EVERY]
        phase = (phase + len(x)) % EVERY
        return y

    def mean(x: Samples) -> Samples:
        nonlocal tail
        y, tail = lfilter(taps, 1.0, x, axis=0, zi=tail)
        return y

    return [np.abs, lowpass, thin, mean]


class Feed:
    """What is handed out, chunk after chunk; with `paced`, each not before its last sample is due.

    due    when each chunk's last sample was due (ns, perf_counter)
    made   when each chunk was handed out
    """

    def __init__(self, arrays: list[Samples], count: int, *, paced: bool) -> None:
        self.arrays, self.count, self.paced = arrays, count, paced
        self.chunk = len(arrays[0])
        self.period_ns = self.chunk * 10**9 // RATE_HZ
        self.due: list[int] = []
        self.made: list[int] = []
        self.began = 0
        self.cpu_s = 0.0
        self.wall_s = 0.0

    def begin(self) -> None:
        """The first chunk is about to be handed out."""
        self.began = perf_counter_ns()
        self._cpu = time.process_time()

    def end(self) -> None:
        """The last chunk has been handed out: what it cost so far."""
        self.cpu_s = time.process_time() - self._cpu
        self.wall_s = (perf_counter_ns() - self.began) / 1e9

    def rest_s(self, i: int) -> float:
        """How long until chunk `i` is due."""
        return (self.began + (i + 1) * self.period_ns - perf_counter_ns()) / 1e9

    def hand(self, i: int) -> None:
        """Chunk `i` is handed out now."""
        self.due.append(self.began + (i + 1) * self.period_ns)
        self.made.append(perf_counter_ns())

    def __iter__(self) -> Iterator[Samples]:
        self.begin()
        if self.paced:
            for i, x in enumerate(cycled(self)):
                if (rest := self.rest_s(i)) > 0:
                    time.sleep(rest)
                self.hand(i)
                yield x
        else:
            yield from cycled(self)
        self.end()


def cycled(feed: Feed) -> Iterator[Samples]:
    """The feed's chunks without its pace."""
    return islice(cycle(feed.arrays), feed.count)


def stamps(feed: Feed) -> list[Times]:
    """The stamps of every chunk of a feed, as a recording gives them."""
    times = 10**18 + np.arange(feed.count * feed.chunk) * (10**9 // RATE_HZ)
    return [times[i * feed.chunk : i * feed.chunk + len(x)] for i, x in enumerate(cycled(feed))]


class Sink:
    """The end of the chain: notes when how many rows came; keeps them if they are to be hashed."""

    def __init__(self, keep: bool) -> None:
        self.calls: list[tuple[int, int]] = []
        self.kept: list[Samples] | None = [] if keep else None

    def __call__(self, x: Samples) -> None:
        if n := len(x):
            self.calls.append((perf_counter_ns(), n))
            if self.kept is not None:
                self.kept.append(np.array(x))

    @property
    def rows(self) -> int:
        return sum(n for _, n in self.calls)

    def digest(self) -> str:
        """A hash of all rows that does not depend on how they were cut."""
        return hashlib.blake2b(b"".join(x.tobytes() for x in self.kept or ()), digest_size=16).hexdigest()


def outcome(feed: Feed, sink: Sink, every: int = EVERY, phase: int = 0) -> dict[str, Any]:
    """What is reported of one run.

    `every` input samples lead to one row, which is complete with sample `phase` of each `every`; rows that a peer leaves out are taken
    to be missing at the beginning.
    """
    last = sink.calls[-1][0] if sink.calls else feed.began
    report: dict[str, Any] = {"seconds": (last - feed.began) / 1e9, "rows": sink.rows, "cpu": 0.0}
    if sink.kept is not None:
        report["hash"] = sink.digest()
    if feed.paced:
        expected = (len(feed.due) * feed.chunk - phase - 1) // every + 1
        row = expected - sink.rows
        waited, travelled = [], []
        for at, n in sink.calls:
            row += n
            i = ((row - 1) * every + phase) // feed.chunk
            waited.append(at - feed.due[i])
            travelled.append(at - feed.made[i])
        report |= {"cpu": feed.cpu_s / feed.wall_s, "due_ns": waited, "made_ns": travelled}
    return report
