"""Periods of sleep in a day of scored minutes, found as ActiLife's "Tudor-Locke" does (Tudor-Locke 2014)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.sleep.scorer import EPOCH, REASONED
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Specs, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Operator
from kinegraph.stream.params import param

PERIOD = np.dtype([("onset", "<i8"), ("end", "<i8"), ("minutes", "<f8"), ("moving", "<i8")])


@dataclass(slots=True)
class PeriodsState:
    """
    asleep, awake  how long the present stretch of sleep or wake is (ns), and when it began; moving: epochs with counts in it
    onset          when the open period began; NEVER if closed. inside: epochs with counts in it, up to the present stretch
    """

    asleep: int
    awake: int
    since: int
    moving: int
    onset: int
    inside: int


@dataclass(frozen=True, slots=True)
class SleepPeriods(Operator[PeriodsState]):
    """Scored epochs in (of SleepScorer; only final ones count), an event per period of sleep: onset and end, minutes, epochs with counts.

    A period begins with the first of `bedtime_min` minutes of sleep in a row, and ends before the first of `wake_min` minutes of wake in a
    row. Kept are those from `shortest_min` to `longest_min` with at least `min_moving` epochs that have counts (fewer: the device was
    not worn). Decided with the last of those minutes of wake; a period that the recording breaks off is not reported. Unknown epochs
    count as neither, and break both rows. Shown equal to ActiLife on its own example, at three settings.

    >>> given, made = tried(SleepPeriods)
    >>> len(given["in"]), made[["minutes", "moving"]][0].item()
    (600, (57.0, 4))
    """

    bedtime_min: float = param(5.0, above=0.0, help="this much sleep in a row begins a period")
    wake_min: float = param(10.0, above=0.0, help="this much wake in a row ends it")
    shortest_min: float = param(160.0, least=0.0, help="shorter periods are passed over")
    longest_min: float = param(1440.0, above=0.0, help="longer periods are passed over")
    min_moving: int = param(0, least=0, help="periods with fewer epochs that have counts are passed over")

    def open(self, specs: Specs) -> Specs:
        spec = scored(specs["in"])
        epoch_s = float(spec.meta.get("epoch_s", 0.0))
        self.set_state(PeriodsState(0, 0, NEVER, 0, NEVER, 0), decision_s={"out": 60 * self.wake_min + epoch_s})
        units = ("ns", "ns", "min", "")
        return {"out": StreamSpec((), PERIOD, units=units, settling_s=spec.settling_s, meta=spec.meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        made, stamps = [], []
        for stamp, event in zip(chunk.time.tolist(), chunk.data, strict=True):
            found = self._epoch(event) if event["final"] else None
            if found is not None:
                made.append(found)
                stamps.append(stamp)
        return Chunk(np.array(stamps, np.int64), np.array(made, PERIOD), chunk.until, -1 if chunk.lost else 0)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [Case(cls(shortest_min=5.0), {"in": some_epochs(300, 23)}, least=2)]

    def _epoch(self, event: Array) -> tuple[int, int, float, int] | None:
        """Take one final epoch; the period that it ends, if it ends one worth telling."""
        s = self.state
        state, onset, length = str(event["state"]), int(event["onset"]), int(event["end"]) - int(event["onset"])
        goes_on = (state == "sleep" and s.asleep) or (state == "wake" and s.awake)
        if not goes_on:
            s.inside += s.moving
            s.asleep = s.awake = s.moving = 0
            s.since = onset
        s.asleep += length if state == "sleep" else 0
        s.awake += length if state == "wake" else 0
        s.moving += bool(event["activity"] > 0)
        if s.onset == NEVER:
            if s.asleep >= self.bedtime_min * 60 * NS:
                s.onset, s.inside = s.since, 0
            return None
        if s.awake < self.wake_min * 60 * NS:
            return None
        minutes = (s.since - s.onset) / (60 * NS)
        found = (s.onset, s.since, minutes, s.inside)
        s.onset = NEVER
        return found if self.shortest_min <= minutes <= self.longest_min and s.inside >= self.min_moving else None


def scored(spec: StreamSpec, port: str = "in") -> StreamSpec:
    """The spec, if it is one of scored epochs."""
    if spec.dtype not in (EPOCH, REASONED):
        raise InputError(port, spec.describe(), "scored epochs, as operators.sleep.scorer.SleepScorer gives them")
    return spec


def some_epochs(n: int, seed: int, epoch_s: int = 60) -> tuple[StreamSpec, Array, Array]:
    """Made-up scores of `n` epochs, provisional and final, for trials."""
    rng = np.random.default_rng(seed)
    states = np.repeat(rng.choice(["sleep", "wake", "unknown"], n, p=[0.6, 0.37, 0.03]), rng.integers(1, 40, n))[:n]
    rows = np.zeros(2 * n, EPOCH)
    onset = 10**9 + np.arange(n) * epoch_s * NS
    rows["onset"], rows["end"] = onset.repeat(2), (onset + epoch_s * NS).repeat(2)
    rows["state"], rows["final"] = states.repeat(2), np.arange(2 * n) % 2
    moving = rng.random(n) < np.where(states == "wake", 0.8, 0.1)
    rows["activity"] = np.where(states == "unknown", np.nan, 50.0 * moving).repeat(2)
    meta = {"epoch_s": float(epoch_s), "method": "thesis"}
    return StreamSpec((), EPOCH, units=("ns", "ns", "", "", "counts", "", ""), meta=meta), onset.repeat(2), rows
