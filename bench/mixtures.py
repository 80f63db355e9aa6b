"""EMG mixtures: false alarms of drift in steady walking, and how soon a change is reported. What a refit takes: `bench.gait`.

    python -m bench.mixtures                     # everything; some ten minutes
    python -m bench.mixtures --only drift

Cycles are made up from the bursts of the simulated treadmill walk, each point with 28 % of noise as an envelope at 20 Hz has it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from kinegraph.devices.people.treadmill.signal import BURSTS
from kinegraph.operators.cycles.cycle import CLOSED, MAXIMUM, POINTS
from kinegraph.operators.emg.mixtures.drift import MixtureDrift
from kinegraph.operators.emg.mixtures.events import MIXTURE
from kinegraph.operators.emg.mixtures.operator import PeakMixtures
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec
from kinegraph.stream.text.safe_text import say

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

    def __init__(self, **settings: int) -> None:
        meta = PeakMixtures()
        channels = ("M",)
        spec = StreamSpec((POINTS, 1), channels=channels, units=("uV",), channel_axis=1)
        self.specs = {
            "maxima": StreamSpec((), MAXIMUM, units=("",)), "closed": StreamSpec((), CLOSED, units=("",)), "cycles": spec,
        }  # fmt: skip
        self.specs["mixture"] = meta.open(self.specs)["mixture"]
        self.drift, self.number = replace(MixtureDrift(), **settings), 0  # type: ignore[arg-type]
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


def watched(hours: float, seed: int, muscle: str, **settings: int) -> tuple[int, list[float]]:
    """False alarms in so many hours, and after how many cycles each change at minute 5 is reported; infinite: not within 57."""
    rng = np.random.default_rng([seed, *muscle.encode()])
    watch, before = DriftWatch(**settings), 5 * 57
    first = walked(rng, before, muscle)
    found = sum(state == "on" for _, state in watch.walk(first))
    for _ in range(round(hours * 60 - 5)):
        found += sum(state == "on" for _, state in watch.walk(walked(rng, 57, muscle)))
    delays = list[float]()
    for _, change in CHANGES:
        again = DriftWatch(**settings)
        for _ in again.walk(first):
            pass
        now = [n - before for n, state in again.walk(change(walked(rng, 57, muscle))) if state == "on"]
        delays.append(now[0] if now else np.inf)
    return found, delays


def alarms(hours: float, seeds: list[int], muscles: list[str], **settings: int) -> None:
    """False alarms in steady walking, and how soon three changes at minute 5 are reported."""
    for muscle in muscles:
        runs = [watched(hours, seed, muscle, **settings) for seed in seeds]
        late = list[str]()
        for k, (name, _) in enumerate(CHANGES):
            cycles = sorted(reported[k] for _, reported in runs)
            late.append(f"{name}: {np.median(cycles):g} ({', '.join(f'{c:g}' for c in cycles)})")
        say(
            f"{muscle}: false alarms {[found for found, _ in runs]} by seed; reported after (cycles), median (each): {'; '.join(late)}"
        )


NEIGHBOURS: tuple[tuple[str, tuple[int, ...]], ...] = (
    ("first", (30, 45, 90)), ("cycles", (2, 4, 6)), ("windows", (2, 4)), ("pairs", (50, 200)),
)  # fmt: skip


def neighbours(hours: float, seeds: list[int], muscles: list[str]) -> None:
    """The same with each of the operator's parameters a little less and a little more."""
    for name, values in (("as it is", (0,)), *NEIGHBOURS):
        for value in values:
            say(f"{name} {value or ''}")
            alarms(hours, seeds, muscles, **({name: value} if value else {}))


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


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.mixtures", description=__doc__)
    parser.add_argument(
        "--only", nargs="+", default=["drift", "references"], choices=["drift", "references", "neighbours"]
    )
    parser.add_argument("--hours", type=float, default=20.0)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--muscles", nargs="+", default=list(BURSTS))
    given = parser.parse_args()
    if "drift" in given.only:
        say(
            f"drift: {given.hours:g} h of steady walking a muscle and seed; then changes at minute 5, reported within 57 cycles"
        )
        alarms(given.hours, given.seeds, given.muscles)
    if "neighbours" in given.only:
        neighbours(given.hours, given.seeds, given.muscles)
    if "references" in given.only:
        references(given.hours, given.muscles)


if __name__ == "__main__":
    main()
