"""EMG mixtures: false alarms of drift in steady walking, how soon a change is reported, and the time of a refit and of a distance.

    python -m bench.mixtures                     # everything; some ten minutes
    python -m bench.mixtures --only speed

Cycles are made up from the bursts of the simulated treadmill walk, each point with 28 % of noise as an envelope at 20 Hz has it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from devices.simulators.treadmill.signal import BURSTS
from operators.emg.mixture_distance import cauchy_schwarz
from operators.emg.mixture_drift import MixtureDrift
from operators.emg.mixture_events import MIXTURE
from operators.emg.mixtures import PeakMixtures
from operators.emg.peak_window import PeakWindow
from operators.emg.refit import Refit
from operators.gait.cycle import CLOSED, MAXIMUM, POINTS
from stream.chunk import NS, Array, Chunk, Samples, StreamSpec
from stream.plain import say

PER_HOUR = 57 * 60
NOISE, BASELINE_UV = 0.28, 2.0
KERNEL = np.exp(-0.5 * (np.arange(-3, 4) / 1.3) ** 2)
CHANGES: tuple[tuple[str, Callable[[Samples], Samples]], ...] = (
    ("6 % of the cycle later", lambda curves: np.roll(curves, 6, axis=1)),
    ("0.6 times as high", lambda curves: 0.6 * curves),
    ("1.5 times as high", lambda curves: 1.5 * curves),
)


def walked(rng: np.random.Generator, count: int, muscle: str) -> Samples:
    """So many curves (count, 100) of a muscle in steady walking, uV."""
    place = np.arange(POINTS)
    power = np.full(POINTS, BASELINE_UV**2)
    for centre, width, size in BURSTS[muscle]:
        power += (size * np.exp(-0.5 * (((place - centre + 50) % 100 - 50) / width) ** 2)) ** 2
    white = rng.standard_normal((count, POINTS + len(KERNEL) - 1))
    kernel = KERNEL / np.sqrt((KERNEL**2).sum())
    noise = np.stack([np.convolve(row, kernel, "valid") for row in white])
    return np.asarray(np.abs(np.sqrt(power) * (1 + NOISE * noise)))


def maxima(number: int, curve: Samples) -> Array:
    """The local maxima of a curve (100,) around the cycle."""
    at = np.flatnonzero((curve > np.roll(curve, 1)) & (curve > np.roll(curve, -1)))
    rows = np.zeros(len(at), MAXIMUM)
    rows["number"], rows["position_pct"], rows["height"] = number, at, curve[at]
    return rows


class DriftWatch:
    """A MixtureDrift of one muscle, given cycle after cycle."""

    def __init__(self) -> None:
        meta = PeakMixtures()
        channels = ("M",)
        spec = StreamSpec((POINTS, 1), channels=channels, units=("uV",), channel_axis=1)
        self.specs = {
            "maxima": StreamSpec((), MAXIMUM, units=("",)), "closed": StreamSpec((), CLOSED, units=("",)), "cycles": spec,
        }  # fmt: skip
        self.specs["mixture"] = meta.open(self.specs)["mixture"]
        self.drift, self.number = MixtureDrift(), 0
        self.drift.open(self.specs)

    def walk(self, curves: Samples) -> Iterator[tuple[int, str]]:
        """Cycles; gives the number of a cycle and the state of every alarm."""
        for curve in curves:
            self.number += 1
            n, stamp = self.number, self.number * NS
            closed, mixture = np.zeros(1, CLOSED), np.zeros(1, MIXTURE)
            for rows in (closed, mixture):
                rows["number"], rows["onset"], rows["end"] = n, stamp - NS, stamp
            peaks = maxima(n, curve)
            for port, data in (
                ("maxima", peaks),
                ("closed", closed),
                ("cycles", curve[None, :, None]),
                ("mixture", mixture),
            ):
                made = self.drift.process(port, Chunk(np.full(len(data), stamp), data, stamp))
                for name, chunk in made:
                    for row in chunk.data if name == "change" else ():
                        yield n, str(row["state"])


def alarms(hours: float, seeds: list[int], muscles: list[str]) -> None:
    """False alarms in steady walking, and how soon three changes at minute 5 are told."""
    say(f"drift: {hours:g} h of steady walking a muscle and seed; then changes at minute 5, told within 57 cycles")
    for muscle in muscles:
        false, told = list[int](), [list[float]() for _ in CHANGES]
        for seed in seeds:
            rng = np.random.default_rng([seed, *muscle.encode()])
            watch, before = DriftWatch(), 5 * 57
            first = walked(rng, before, muscle)
            early = [state for _, state in watch.walk(first)]
            found = sum(state == "on" for state in early)
            for _ in range(round(hours * 60 - 5)):
                found += sum(state == "on" for _, state in watch.walk(walked(rng, 57, muscle)))
            false.append(found)
            for k, (_, change) in enumerate(CHANGES):
                again = DriftWatch()
                for _ in again.walk(first):
                    pass
                now = [n - before for n, state in again.walk(change(walked(rng, 57, muscle))) if state == "on"]
                told[k].append(now[0] if now else np.inf)
        late = "; ".join(
            f"{name}: {np.median(cycles):g} ({', '.join(f'{c:g}' for c in sorted(cycles))})"
            for (name, _), cycles in zip(CHANGES, told, strict=True)
        )
        say(f"{muscle}: false alarms {false} by seed; told after so many cycles, median (each): {late}")


def references(hours: float, muscles: list[str]) -> None:
    """The same steady walking as sessions of half an hour, each with a reference of its own: false alarms."""
    say(f"drift: {hours:g} h of steady walking a muscle, in sessions of half an hour")
    for muscle in muscles:
        rng, found = np.random.default_rng([1, 7, *muscle.encode()]), list[int]()
        for _ in range(round(2 * hours)):
            watch = DriftWatch()
            minutes = (watch.walk(walked(rng, 57, muscle)) for _ in range(30))
            found.append(sum(state == "on" for minute in minutes for _, state in minute))
        say(f"{muscle}: {sum(found)} false alarms in {len(found)} sessions, at most {max(found)} in one")


def percentiles(call: Callable[[], object], times: int) -> str:
    taken = np.empty(times)
    for k in range(times):
        began = time.thread_time()
        call()
        taken[k] = (time.thread_time() - began) * 1e3
    return f"{np.median(taken):.3f} ms, p99 {np.quantile(taken, 0.99):.3f} ms"


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

    return 0.5 * np.log(both(a, a) * both(b, b)) - np.log(both(a, b))


def speed(times: int) -> None:
    """A refit over 20 cycles and a distance, beside scikit-learn's and numpy's from the same start, one after another."""
    from sklearn.mixture import GaussianMixture
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
    mixer = PeakMixtures(circular=False)
    how, rng = mixer.fitting(), np.random.default_rng(1)
    say("a refit of the peaks of 20 cycles, and a divergence of two mixtures: time of the processor, median and p99")
    for muscle in ("TA", "BF", "SO", "GM"):
        window = PeakWindow.none(20, 1)
        for k, curve in enumerate(walked(rng, 20, muscle)):
            window.note_peaks(maxima(k, curve))
            window.accept(k, curve[:, None])
        slots, group = window.latest(20), np.zeros(1, np.int64)
        refit, circular = Refit.none(20, 1), PeakMixtures().fitting()

        def ours(how=circular, refit=refit, window=window, slots=slots, group=group):  # type: ignore[no-untyped-def]
            refit.begin(window, slots, group, how)
            refit.finish(how)

        ours(how)
        points, start = refit.points[: refit.count].copy(), [part.copy() for part in refit.mixture()]
        precisions = np.linalg.inv(start[2][:, [0, 1, 1, 2]].reshape(-1, 2, 2))

        def theirs(points=points, start=start, precisions=precisions):  # type: ignore[no-untyped-def]
            GaussianMixture(
                len(start[0]), tol=how.tolerance, max_iter=how.most_sweeps, reg_covar=1e-3, weights_init=start[0],
                means_init=start[1], precisions_init=precisions,
            ).fit(points)  # fmt: skip

        ours()
        mine = tuple(part.copy() for part in refit.mixture())
        other = (mine[0], mine[1] + 1.0, mine[2])
        say(f"{muscle}, {len(points)} peaks, {len(mine[0])} modes")
        for name, call, share in (
            ("refit, circular", ours, 1), ("refit, plain", lambda: ours(how), 1), ("scikit-learn's EM, plain", theirs, 20),
            ("divergence, circular", partial(cauchy_schwarz, *mine, *other, 1), 1),
            ("divergence in numpy, plain", partial(plain_distance, mine, other), 10),
        ):  # fmt: skip
            say(f"  {name}: {percentiles(call, times // share)}")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.mixtures", description=__doc__)
    parser.add_argument(
        "--only", nargs="+", default=["speed", "drift", "references"], choices=["speed", "drift", "references"]
    )
    parser.add_argument("--hours", type=float, default=20.0)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--muscles", nargs="+", default=list(BURSTS))
    given = parser.parse_args()
    if "speed" in given.only:
        speed(1000)
    if "drift" in given.only:
        alarms(given.hours, given.seeds, given.muscles)
    if "references" in given.only:
        references(given.hours, given.muscles)


if __name__ == "__main__":
    main()
