"""One cycle's and one step's work beside numpy's and scikit-learn's, in one run: mixtures refitted, divergences, step features, forests.

    python -m bench.gait            # a minute; --write puts the table into docs/lab/performance.md
    python -m bench.gait --quick    # to see that it works, not for figures

Processor time of one thread; contenders take turns. What takes less than 0.1 ms is timed ten at a time. Needs scikit-learn.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import cycle

import numpy as np

from bench.mixtures import maxima, walked
from bench.report import Goal, Section, marks, publish, short, whole
from kinegraph.devices.people.treadmill.signal import BURSTS
from kinegraph.devices.people.walking_back import MANNERS, Back
from kinegraph.operators.emg.mixtures.distance import cauchy_schwarz
from kinegraph.operators.emg.mixtures.operator import PeakMixtures
from kinegraph.operators.emg.mixtures.peak_window import PeakWindow
from kinegraph.operators.emg.mixtures.refit import Fitting, Refit
from kinegraph.operators.steps.commands.validation import forest
from kinegraph.operators.steps.forest import Forest
from kinegraph.operators.steps.step_kernel import BINS, COUNT, FASTEST_HZ, WEINBERG, describe
from kinegraph.operators.steps.steps import Steps
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec
from kinegraph.stream.operator import grid

CYCLES, TREES, RATE_HZ = 20, 100, 100.0
Call = Callable[[], object]
Mixture = tuple[Samples, Samples, Samples]


@dataclass(frozen=True, slots=True)
class Contender:
    """A call, how often it is made in one go of the clock, and its times in us."""

    name: str
    call: Call
    at_once: int
    times: list[float]

    @staticmethod
    def of(name: str, call: Call) -> Contender:
        call()
        began = time.thread_time()
        call()
        return Contender(name, call, 10 if time.thread_time() - began < 1e-4 else 1, [])

    def take(self, seconds: float) -> None:
        end = time.thread_time() + seconds
        while time.thread_time() < end:
            began = time.thread_time_ns()
            for _ in range(self.at_once):
                self.call()
            self.times.append((time.thread_time_ns() - began) / 1e3 / self.at_once)

    @property
    def median(self) -> float:
        return float(np.median(self.times))

    @property
    def p99(self) -> float:
        return float(np.percentile(self.times, 99))


def compared(task: str, ours: Call, theirs: Call, by: str) -> tuple[str, Contender, Contender, str]:
    return task, Contender.of("ours", ours), Contender.of(by, theirs), by


class Cycles:
    """The peaks of 20 cycles of a muscle, and how its mixture is refitted."""

    def __init__(self, muscle: str) -> None:
        self.window = PeakWindow.empty(CYCLES, 1)
        for k, curve in enumerate(walked(np.random.default_rng(1), CYCLES, muscle)):
            self.window.note_peaks(maxima(k, curve))
            self.window.accept(k, curve[:, None])
        self.slots, self.group = self.window.latest(CYCLES), np.zeros(1, np.int64)
        self.refit = Refit.empty(CYCLES, 1)

    def fit(self, how: Fitting) -> Mixture:
        self.refit.begin(self.window, self.slots, self.group, how)
        self.refit.finish(how)
        return self.refit.mixture()

    def learnt(self, how: Fitting) -> Call:
        """scikit-learn's EM on the same peaks, from the same start."""
        from sklearn.mixture import GaussianMixture

        self.refit.begin(self.window, self.slots, self.group, how)
        points, start = self.refit.points[: self.refit.count].copy(), [part.copy() for part in self.refit.mixture()]
        precisions = np.linalg.inv(start[2][:, [0, 1, 1, 2]].reshape(-1, 2, 2))
        plain = GaussianMixture(
            len(start[0]), tol=how.tolerance, max_iter=how.most_sweeps, reg_covar=1e-3, weights_init=start[0],
            means_init=start[1], precisions_init=precisions,
        )  # fmt: skip
        return lambda: plain.fit(points)


def plain_distance(a: tuple[Samples, ...], b: tuple[Samples, ...]) -> float:
    """Cauchy-Schwarz divergence in numpy, without turns."""

    def both(p: tuple[Samples, ...], q: tuple[Samples, ...]) -> float:
        c = p[2][:, None, [0, 1, 1, 2]].reshape(len(p[0]), 1, 2, 2) + q[2][None, :, [0, 1, 1, 2]].reshape(
            1, len(q[0]), 2, 2
        )
        d = p[1][:, None] - q[1][None]
        far = np.einsum("ija,ijab,ijb->ij", d, np.linalg.inv(c), d)
        density = np.exp(-0.5 * far) / (2 * np.pi * np.sqrt(np.linalg.det(c)))
        return float(p[0] @ density @ q[0])

    return float(0.5 * np.log(both(a, a) * both(b, b)) - np.log(both(a, b)))


def mixtures() -> list[tuple[str, Contender, Contender, str]]:
    """A refit of each muscle, and a divergence."""
    rows, circular, plain = (
        list[tuple[str, Contender, Contender, str]](),
        PeakMixtures().fitting(),
        PeakMixtures(circular=False).fitting(),
    )
    for muscle in BURSTS:
        cycles = Cycles(muscle)
        task = f"refit, {muscle}: {cycles.window.tops.sum()} peaks, {len(cycles.fit(circular)[0])} modes"
        rows.append(compared(task, partial(cycles.fit, circular), cycles.learnt(plain), "scikit-learn, without turns"))
    weight, mean, covariance = (part.copy() for part in cycles.fit(circular))
    mine, other = (weight, mean, covariance), (weight, mean + 1.0, covariance)
    task = f"divergence, {len(mine[0])} and {len(other[0])} modes"
    distance = partial(cauchy_schwarz, *mine, *other, 1)
    return [*rows, compared(task, distance, partial(plain_distance, mine, other), "numpy, without turns")]


def walkers(people: int) -> tuple[Samples, Array, Samples]:
    """Features and manners of simulated people's steps, and the samples of one step."""
    spec = StreamSpec(
        (6,), rate_hz=RATE_HZ, channels=("ax", "ay", "az", "gx", "gy", "gz"), units=("m/s2",) * 3 + ("rad/s",) * 3
    )
    features, manners = list[Samples](), list[str]()
    for person in range(people):
        manner = list(MANNERS)[person % 2]
        measured = Back(manner, person).measure(np.arange(3000))
        data = np.concatenate([measured["acceleration"], measured["angular_velocity"]], 1)
        finder = Steps()
        finder.open({"in": spec})
        rows = finder.process("in", Chunk(grid(RATE_HZ, 3000), data, 30 * NS)).data
        features.append(rows["features"][rows["kind"] == "walk"])
        manners += [manner] * len(features[-1])
    return np.concatenate(features), np.array(manners), np.ascontiguousarray(data[500:555])


def plain_features(window: Samples, rate_hz: float) -> Samples:
    """The 50 features of a step (n, 6) by axes of gravity, in numpy."""
    up = window[:, :3].mean(0)
    up /= np.linalg.norm(up)
    channels = list[Samples]()
    for three in (window[:, :3], window[:, 3:]):
        along, norm = three @ up, np.linalg.norm(three, axis=1)
        channels += [along, np.sqrt(np.maximum(norm**2 - along**2, 0)), norm]
    rows, n = np.array(channels), len(window)
    counts = [np.histogram(row, BINS)[0] for row in rows]
    shares = [count[count > 0] / n for count in counts]
    kept = np.fft.rfftfreq(n, 1 / rate_hz)[1:] <= FASTEST_HZ
    lines = 2 * np.abs(np.fft.rfft(rows, axis=1))[:, 1:][:, kept] / n
    square = (rows**2).sum(1)
    made = [rows.mean(1), rows.std(1), rows.min(1), rows.max(1), np.sqrt(square / n)]
    made += [np.array([-(share * np.log(share)).sum() for share in shares]), square / rate_hz, lines.max(1)]
    return np.concatenate([[WEINBERG * np.ptp(rows[0]) ** 0.25, n / rate_hz], np.array(made).T.ravel()])


def steps() -> list[tuple[str, Contender, Contender, str]]:
    features, manners, window = walkers(24)
    labels = manners.copy()
    labels[np.random.default_rng(1).random(len(labels)) < 0.2] = next(
        iter(MANNERS)
    )  # people are less plain: trees of a real size
    trained = forest(TREES).fit(features, labels)
    flat, ours, theirs = Forest.of(trained), *(cycle(np.ascontiguousarray(features[:64])) for _ in range(2))
    scratch, out = np.empty((6, len(window))), np.empty(COUNT)
    return [
        compared(
            f"50 features of a step of {len(window)} samples",
            partial(describe, window, RATE_HZ, True, scratch, out), partial(plain_features, window, RATE_HZ), "numpy",
        ),
        compared(
            f"forest, {TREES} trees, {len(flat.feature)} nodes",
            lambda: flat.probabilities(next(ours)), lambda: trained.predict_proba(next(theirs)[None]), "scikit-learn",
        ),
    ]  # fmt: skip


def section(seconds: float, rounds: int) -> Section:
    """All contenders in turn, `seconds` each a round."""
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with threadpool_limits(1):
        rows = [*mixtures(), *steps()]
        for _ in range(rounds):
            for _, ours, theirs, _ in rows:
                ours.take(seconds)
                theirs.take(seconds)
    lines = [
        [task, short(ours.median), short(ours.p99), by, short(theirs.median), short(theirs.p99), short(theirs.median / ours.median)]
        for task, ours, theirs, by in rows
    ]  # fmt: skip
    refits = [ours for task, ours, _, _ in rows if task.startswith("refit")]
    both = rows[-2][1].median + rows[-1][1].median
    goals = [
        Goal("refit of a mixture, median of the slowest muscle", max(r.median for r in refits) / 1e3, 1.0, "ms"),
        Goal("refit of a mixture, p99 of the slowest muscle", max(r.p99 for r in refits) / 1e3, 3.0, "ms"),
        Goal("features and forest of a step", both, 25.0, "us"),
    ]
    head = ["a cycle's or a step's work", "ours, us", "p99", "beside", "us", "p99", "times"]
    note = (
        f"Processor time of one thread, medians and 99th percentiles; {platform.machine()}, Python {platform.python_version()}; "
        f"load average at the end {os.getloadavg()[0]:.1f}."
    )
    return Section("Mixtures and steps", head, lines, [note], goals)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.gait", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="tiny sizes: to see that it works, not for figures")
    parser.add_argument("--write", action="store_true", help="write goals and table into docs/lab/performance.md")
    given = parser.parse_args()
    made = [section(0.01, 1) if given.quick else section(0.15, 9)]
    about = "Measured by `python -m bench.gait`."
    print(whole(made, about))
    if given.write:
        publish(made, about, "lab/performance.md", *marks("bench.gait"))


if __name__ == "__main__":
    main()
