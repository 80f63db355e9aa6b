"""The step detector on walks with annotated contacts: F1 against delay, its constants' neighbours, what steps are called, lengths.

Recordings of `KINEGRAPH_DATA`, lower back; `python -m bench.steps --only detection neighbours lengths`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.signal import butter

from kinegraph.operators.steps.activity import STANDING, TURNING, WALKING, StepActivity
from kinegraph.operators.steps.step_detection import (
    APART_S,
    CUTOFF_HZ,
    LEAST_M_S2,
    ORDER,
    find_steps,
    fresh_track,
    rule_of,
)
from kinegraph.operators.steps.steps import LATE_NS, Steps
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec, Times
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.text.safe_text import say

TOLERANCE_S = 0.25
STANDING_S = 1.0
"""So far from every annotated contact a person stands."""
FILTER_MS = 46
LATE_S = LATE_NS["lower_back"] / NS
UNITS = ("m/s2",) * 3 + ("rad/s",) * 3
CHANNELS = ("ax", "ay", "az", "gx", "gy", "gz")
SPEC = StreamSpec((6,), rate_hz=100.0, channels=CHANNELS, units=UNITS)


def folder() -> Path:
    return Path(os.environ["KINEGRAPH_DATA"]) / "steps"


@dataclass(frozen=True, slots=True)
class Trial:
    """A walk to a turn and back: stamps by packet counter, samples (n, 6), and in s the contacts of both feet, where the walk begins and
    ends, and where the turn does."""

    person: str
    name: str
    stamps: Times
    data: Samples
    contacts: Samples
    bounds: Samples
    facts: dict[str, str]


@cache
def lower_back() -> list[Trial]:
    return list(_lower_back())


def _lower_back() -> Iterator[Trial]:
    for path in sorted(folder().glob("imu_voisard_*.npz")):
        d = np.load(path)
        facts = {name: str(d[name]) for name in ("gender", "age", "height") if name in d.files}
        for key in d.files:
            if key.endswith("_lb"):
                t = key[:-3]
                stamps = d[f"{t}_lb_counter"].astype(np.int64) * (NS // 100)
                contacts = np.sort(np.concatenate([d[f"{t}_{side}_events"][:, 1] for side in ("left", "right")])) / 100
                bounds = d[f"{t}_bounds"] / 100
                yield Trial(path.stem[-3:], t, stamps, d[key].astype(np.float64), contacts, bounds, facts)


def walking(times: Samples, trial: Trial) -> Array:
    """Which of these lie within the walk, a quarter of a second more to either side."""
    bounds = trial.bounds
    return np.asarray((times >= bounds[0] - TOLERANCE_S) & (times <= bounds[1] + TOLERANCE_S))


def turning(times: Samples, trial: Trial) -> Array:
    return np.asarray((times > trial.bounds[2]) & (times < trial.bounds[3]))


def straight(times: Samples, trial: Trial) -> Samples:
    return np.asarray(times[walking(times, trial) & ~turning(times, trial)])


def matched(found: Samples, true: Samples) -> int:
    """How many of them lie within the tolerance of one another, one to one, the nearest first."""
    pairs = sorted(
        (abs(f - t), i, j) for i, f in enumerate(found) for j, t in enumerate(true) if abs(f - t) <= TOLERANCE_S
    )
    taken_found, taken_true = set[int](), set[int]()
    for _, i, j in pairs:
        if i not in taken_found and j not in taken_true:
            taken_found.add(i)
            taken_true.add(j)
    return len(taken_found)


@dataclass(frozen=True, slots=True)
class Score:
    """Of each walk (n, 3): steps that are contacts, steps, contacts;  delays in ms from the peak, with the filter's"""

    counts: Array
    delays: Samples

    def f1(self, chosen: Array | slice = slice(None)) -> float:
        hits, reported, true = self.counts[chosen].sum(axis=0)
        return float(2 * hits / (reported + true))

    def __str__(self) -> str:
        hits, reported, true = self.counts.sum(axis=0)
        shares = f"F1 {self.f1():.4f}  precision {hits / reported:.3f}  recall {hits / true:.3f}"
        return f"{shares}  reported after the peak: median {np.median(self.delays):.0f} ms, p95 {np.percentile(self.delays, 95):.0f} ms"


def scored(rule: Array, cutoff_hz: float = CUTOFF_HZ, order: int = ORDER, late_s: float = LATE_S) -> Score:
    """The detector with these constants on every walk, turns left out."""
    sos = np.ascontiguousarray(butter(order, cutoff_hz, fs=100.0, output="sos"))
    counts, delays = list[tuple[int, int, int]](), list[Samples]()
    for trial in lower_back():
        found = np.zeros((len(trial.data), 3), np.int64)
        count = find_steps(trial.stamps, trial.data, sos, np.zeros((len(sos), 2)), fresh_track(), rule, found)
        delays.append((trial.stamps[found[:count, 0]] - found[:count, 1]) / 1e6 + FILTER_MS)
        steps, contacts = straight(found[:count, 1] / NS - late_s, trial), straight(trial.contacts, trial)
        counts.append((matched(steps, contacts), len(steps), len(contacts)))
    return Score(np.array(counts), np.concatenate(delays))


def detection() -> None:
    """F1 against delay, lower back, straight walking."""
    people = {trial.person for trial in lower_back()}
    say(f"steps at the lower back: {len(people)} people, {len(lower_back())} walks, within 250 ms, turns left out")
    for wait_s in (0.0, 0.1, 0.15, 0.2, 0.3):
        say(f"wait_s {wait_s:.2f}: {scored(rule_of(wait_s))}")


def neighbours() -> None:
    """F1 with each constant a little less and a little more, and of people left out while two of them are chosen again."""
    say("the detector's constants and their neighbours, as above, wait_s 0")
    for name, values, chosen in (
        ("cut-off, Hz", (4.0, 4.5, 5.5, 6.0), CUTOFF_HZ), ("order", (1, 3, 4), ORDER), ("late_s", (0.04, 0.06, 0.1, 0.12), LATE_S),
        ("least, m/s2", (0.5, 0.6, 0.8, 0.9), LEAST_M_S2),
        ("apart, s", (0.32, 0.34, 0.38, 0.4), APART_S),
    ):  # fmt: skip
        for value in sorted((*values, chosen)):
            say(f"{name} {value:g}{' (chosen)' if value == chosen else ''}: {_with(name, value)}")
    people = np.array([trial.person for trial in lower_back()])
    tried = {
        (least, apart): scored(rule_of(least=least, apart_s=apart))
        for least in (0.5, 0.6, 0.7, 0.8, 0.9)
        for apart in (0.32, 0.34, 0.36, 0.38, 0.4)
    }
    left, picks = np.zeros(3), list[tuple[float, float]]()
    for person in np.unique(people):
        best = max(tried, key=lambda pair: tried[pair].f1(people != person))
        picks.append(best)
        left += tried[best].counts[people == person].sum(axis=0)
    say(f"least and apart chosen on everybody else: F1 {2 * left[0] / (left[1] + left[2]):.4f} of people left out")
    say(f"  chosen: {', '.join(f'{a:g} m/s2 and {b:g} s ({picks.count((a, b))})' for a, b in sorted({*picks}))}")


def _with(name: str, value: float) -> Score:
    match name:
        case "cut-off, Hz":
            return scored(rule_of(), cutoff_hz=value)
        case "order":
            return scored(rule_of(), order=int(value))
        case "late_s":
            return scored(rule_of(), late_s=value)
        case "least, m/s2":
            return scored(rule_of(least=value))
        case _:
            return scored(rule_of(apart_s=value))


LEG_M = 10.0
"""How far these people walk to the turn, and back from it, by the recordings' protocol; single steps were not measured."""
WHERE = ("straight", "turn", "steps beyond the walk", "setting off or stopping", "standing")
KINDS = ("walk", "turn", "slow", "first")


def steps_of(trial: Trial) -> Array:
    finder = Steps(site="lower_back")
    finder.open({"in": SPEC})
    return finder.process("in", Chunk(trial.stamps, trial.data, int(trial.stamps[-1]))).data


def where(times: Samples, trial: Trial) -> Times:
    """Which of `WHERE` each of these times is. Beyond the walk people step on, to one side or back; such contacts are annotated, too."""
    far = np.abs(times[:, None] - trial.contacts).min(axis=1)
    beyond = np.where(far <= TOLERANCE_S, 2, np.where(far <= STANDING_S, 3, 4))
    return np.asarray(np.where(walking(times, trial), turning(times, trial).astype(np.int64), beyond))


def called() -> None:
    """What steps are called: straight, in the turn, and beyond the walk's bounds."""
    counts, stood_s, beyond = np.zeros((len(WHERE), len(KINDS)), np.int64), 0.0, 0
    for trial in lower_back():
        rows = steps_of(trial)
        for at, kind in zip(where(rows["end"] / NS, trial), rows["kind"], strict=True):
            counts[at, KINDS.index(str(kind))] += 1
        every = np.arange(0.0, trial.stamps[-1] / NS, 0.01)
        stood_s += float((where(every, trial) == 4).sum()) / 100
        beyond += int((~walking(trial.contacts, trial)).sum())
    for name, row in zip(WHERE, counts, strict=True):
        kinds = ", ".join(f"{kind} {n} ({n / max(row.sum(), 1):.1%})" for kind, n in zip(KINDS, row, strict=True))
        say(f"{name}: {row.sum()} steps, {kinds}")
    say(f"{beyond} contacts are annotated beyond the walks; people stand for {stood_s:.0f} s (no contact within 1 s)")


ACTIVITIES = (STANDING, WALKING, TURNING)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What people do as annotated and as reported, in s (3, 4: the last is unknown), by onset and by time of the report.

    stood   stretches of standing of 1.2 s or more: most of it reported, all
    turns   reported within the annotated turn or a second before, all, others
    after   from the annotated turn's beginning to its report, s
    """

    onsets: Samples
    live: Samples
    stood: tuple[int, int]
    turns: tuple[int, int, int]
    after: Samples


def evaluate(turn_deg: float = 45.0, still_s: float = 1.2, step_deg: float = 20.0) -> Evaluation:
    onsets, live, after = np.zeros((3, 4)), np.zeros((3, 4)), list[float]()
    stood, stretches, turned, others = 0, 0, 0, 0
    for trial in lower_back():
        stamps, changes = activity_of(trial, turn_deg, still_s, step_deg)
        every = np.arange(trial.stamps[0] / NS, trial.stamps[-1] / NS, 0.01)
        true = np.array([1, 2, -1, -1, 0])[where(every, trial)]
        rows = [np.full(len(every), 3), np.full(len(every), 3)]
        for stamp, row in zip(stamps, changes, strict=True):
            for at, since in zip(rows, (row["onset"], stamp), strict=True):
                at[every >= since / NS] = (*ACTIVITIES, "unknown").index(str(row["activity"]))
        for table, at in zip((onsets, live), rows, strict=True):
            np.add.at(table, (true[true >= 0], at[true >= 0]), 0.01)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], true == 0, [0]])))
        long = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 120]
        stood, stretches = stood + sum((rows[0][a:b] == 0).mean() > 0.5 for a, b in long), stretches + len(long)
        turn = changes["activity"] == TURNING
        within = (changes["onset"] / NS > trial.bounds[2] - 1) & (changes["onset"] / NS < trial.bounds[3])
        after += [stamps[turn & within][0] / NS - trial.bounds[2]] if (turn & within).any() else []
        turned += bool((turn & within).any())
        others += int(turn.sum()) - bool((turn & within).any())
    return Evaluation(onsets, live, (stood, stretches), (turned, len(lower_back()), others), np.array(after))


def activity_of(trial: Trial, turn_deg: float, still_s: float, step_deg: float) -> tuple[Times, Array]:
    """Stamps and changes of what a person does."""
    finder, follower = Steps(site="lower_back", turn_deg=step_deg), StepActivity(turn_deg=turn_deg, still_s=still_s)
    specs = {"steps": finder.open({"in": SPEC})["steps"], "signal": SPEC}
    steps = finder.process("in", Chunk(trial.stamps, trial.data, int(trial.stamps[-1])))
    follower.open(specs)
    made = list[Chunk]()
    merge = Merge(specs)
    for port, chunk in (("steps", steps), ("signal", Chunk(trial.stamps, trial.data, int(trial.stamps[-1])))):
        made += [follower.process(name, piece) for name, piece in merge.push(port, chunk)]
    return np.concatenate([chunk.time for chunk in made]), np.concatenate([chunk.data for chunk in made])


def activities() -> None:
    """Standing, walking and turning beside the annotations, and the constants' neighbours."""
    found = evaluate()
    for title, table in (("by onset", found.onsets), ("as reported", found.live)):
        for name, row in zip(ACTIVITIES, table, strict=True):
            shares = ", ".join(f"{text} {s:.1f} s" for text, s in zip((*ACTIVITIES, "unknown"), row, strict=True))
            say(f"{title}, {name}: {row.sum():.1f} s, reported as {shares}")
    for name, values, chosen in (
        ("turn_deg", (30.0, 60.0, 90.0), 45.0), ("still_s", (0.9, 1.0, 1.5, 2.0), 1.2), ("step_deg", (10.0, 15.0, 25.0, 30.0), 20.0),
    ):  # fmt: skip
        for value in sorted((*values, chosen)):
            t = evaluate(**{name: value})
            right = (np.diag(t.onsets) / t.onsets.sum(axis=1)).tolist()
            shares = ", ".join(f"{what} {share:.3f}" for what, share in zip(ACTIVITIES, right, strict=True))
            say(
                f"{name} {value:g}{' (chosen)' if value == chosen else ''}: right by time: {shares}; "
                f"stretches of standing {t.stood[0]} of {t.stood[1]}; turns {t.turns[0]} of {t.turns[1]}, {t.turns[2]} others, "
                f"reported after {np.median(t.after):.2f} s (p95 {np.percentile(t.after, 95):.2f} s)"
            )


def lengths() -> None:
    """What steps are called; durations beside contacts'; distances beside the protocol's."""
    called()
    apart, people = list[float](), dict[str, list[float]]()
    for trial in lower_back():
        rows = steps_of(trial)
        peaks, contacts = rows["end"] / NS, trial.contacts
        on, turn = walking(peaks, trial), turning(peaks, trial)
        steady = on & ~turn & (rows["kind"] == "walk")
        for peak, seconds in zip(peaks[steady], rows["duration_s"][steady], strict=True):
            near = int(np.argmin(np.abs(contacts - peak)))
            if near and abs(contacts[near] - peak) <= TOLERANCE_S:
                apart.append(seconds - (contacts[near] - contacts[near - 1]))
        there, back = on & (peaks <= trial.bounds[2]), on & (peaks >= trial.bounds[3])
        people.setdefault(trial.person, []).extend(float(np.nansum(rows["length_m"][leg])) for leg in (there, back))
    off = np.abs(np.array(apart)) * 1000
    median, p95 = np.percentile(off, (50, 95))
    say(f"duration beside the contacts', {len(off)} steps: off by {median:.0f} ms (median), {p95:.0f} ms (p95)")
    legs(people)


def legs(people: dict[str, list[float]]) -> None:
    """How far Weinberg's model thinks that each person walked, beside the protocol's distance."""
    every = np.concatenate([np.array(walked) for walked in people.values()])
    each = np.array([np.mean(walked) for walked in people.values()])
    usual = Steps().length_factor
    say(
        f"Weinberg's model, factor {usual}: {len(every)} times {LEG_M:g} m come out as {np.mean(every):.1f} +- {np.std(every):.1f} m; "
        f"per person {np.min(each):.1f} to {np.max(each):.1f} m, off by {np.mean(np.abs(each - LEG_M)) / LEG_M:.0%} on the mean"
    )
    for factor in (0.35, 0.36, 0.37, 0.38, 0.39, 0.46):
        wrong = np.mean(np.abs(each * factor / usual - LEG_M)) / LEG_M
        say(f"  factor {factor}: off by {wrong:.1%} on the mean")
    alone = [np.mean(np.delete(each, k)) for k in range(len(each))]
    left = np.array([abs(one * LEG_M / mean - LEG_M) for one, mean in zip(each, alone, strict=True)])
    say(f"  the factor that fits everybody else: off by {np.mean(left) / LEG_M:.1%} of people left out")
