"""Steps of one inertial sensor: detection, accuracy of forests, and time per step, on the recordings of `KINEGRAPH_DATA`.

python -m bench.steps                 # everything; some ten minutes
python -m bench.steps --only detection
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.signal import butter

from operators.steps.commands.enrolment import enrolment
from operators.steps.commands.recordings import grouped
from operators.steps.commands.train import show_enrolment, show_trust
from operators.steps.commands.validation import SETS, Labelled, forest, trust
from operators.steps.forest import Forest
from operators.steps.step_detection import CUTOFF_HZ, ORDER, find_steps, fresh_track
from operators.steps.step_kernel import describe
from operators.steps.steps import Steps
from stream.chunk import NS, Array, Chunk, Samples, StreamSpec, Times
from stream.plain import say

TOLERANCE_S = 0.25
UNITS = ("m/s2",) * 3 + ("rad/s",) * 3
CHANNELS = ("ax", "ay", "az", "gx", "gy", "gz")


def folder() -> Path:
    return Path(os.environ["KINEGRAPH_DATA"]) / "steps"


def lower_back() -> Iterator[tuple[str, str, Times, Samples, Samples, Samples, dict[str, str]]]:
    """Person, trial, stamps by packet counter, samples, contacts in s, the walk's bounds and the turn's in s, and facts."""
    for path in sorted(folder().glob("imu_voisard_*.npz")):
        d = np.load(path)
        facts = {name: str(d[name]) for name in ("gender", "age", "height") if name in d.files}
        for key in d.files:
            if key.endswith("_lb"):
                t = key[:-3]
                stamps = d[f"{t}_lb_counter"].astype(np.int64) * (NS // 100)
                contacts = np.sort(np.concatenate([d[f"{t}_{side}_events"][:, 1] for side in ("left", "right")])) / 100
                yield path.stem[-3:], t, stamps, d[key].astype(np.float64), contacts, d[f"{t}_bounds"] / 100, facts


def foot() -> Iterator[tuple[str, str, Times, Samples, dict[str, str]]]:
    """Person, trial, stamps by packet counter, samples and facts of the right foot's sensor."""
    for path in sorted(folder().glob("imu_voisard_*.npz")):
        d = np.load(path)
        facts = {name: str(d[name]) for name in ("gender", "age", "height") if name in d.files}
        for key in (key for key in d.files if key.endswith("_rf")):
            yield (
                path.stem[-3:],
                key[:-3],
                d[f"{key}_counter"].astype(np.int64) * (NS // 100),
                d[key].astype(float),
                facts,
            )


def phones(site: str) -> Iterator[tuple[str, str, Times, Samples, dict[str, str]]]:
    """Person, trial, stamps of an even 100 Hz grid, samples while walking, and facts; sp: pocket, sw: wrist."""
    for path in sorted(folder().glob("imu_geotec_*.npz")):
        d = np.load(path)
        facts = {name: str(d[name]) for name in ("gender", "age", "height") if name in d.files}
        for key in d.files:
            if key.startswith(site) and key.endswith("_imu"):
                t = key[:-4]
                stamp, data, walking = d[f"{t}_t_ms"].astype(float), d[key].astype(np.float64), d[f"{t}_label"] == 2
                rate = (len(stamp) - 1) / (stamp[-1] - stamp[0]) * 1000
                steady = stamp[0] + np.arange(len(stamp)) * 1000 / rate
                even = np.arange(steady[0], steady[-1], 10.0)
                inside = np.interp(even, steady, walking.astype(float)) > 0.5
                resampled = np.stack([np.interp(even, steady, data[:, c]) for c in range(6)], 1)
                resampled[~inside] = np.nan
                yield path.stem[-3:], t, np.round((even - even[0]) * 1e6).astype(np.int64), resampled, facts


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


def detection() -> None:
    """F1 against delay, lower back, straight walking."""
    sos = np.ascontiguousarray(butter(ORDER, CUTOFF_HZ, fs=100.0, output="sos"))
    trials = list(lower_back())
    people = len({person for person, *_ in trials})
    say(f"steps at the lower back: {people} people, {len(trials)} walks, within 250 ms, turns left out")
    for wait_s in (0.0, 0.1, 0.15, 0.2, 0.3):
        hits = told = true = 0
        delays = list[float]()
        for _, _, stamps, data, contacts, bounds, _ in trials:
            found = np.zeros((len(data), 3), np.int64)
            count = find_steps(
                stamps, data, sos, np.zeros((1, 2)), fresh_track(), round(wait_s * NS), 300_000_000, found
            )
            peaks = found[:count, 1] / NS
            delays += list((stamps[found[:count, 0]] - found[:count, 1]) / 1e6 + 46)
            steps, contacts = straight(peaks - 0.08, bounds), straight(contacts, bounds)
            hits, told, true = hits + matched(steps, contacts), told + len(steps), true + len(contacts)
        say(
            f"wait_s {wait_s:.2f}: F1 {2 * hits / (told + true):.4f}  precision {hits / told:.3f}  recall {hits / true:.3f}  "
            f"told after the peak: median {np.median(delays):.0f} ms, p95 {np.percentile(delays, 95):.0f} ms"
        )


def straight(times: Samples, bounds: Samples) -> Samples:
    """Those within the walk, a quarter of a second more to either side, and not within the turn."""
    inside = (times >= bounds[0] - 0.25) & (times <= bounds[1] + 0.25)
    return np.asarray(times[inside & ~((times > bounds[2]) & (times < bounds[3]))])


def found_steps(site: str, stamps: Times, data: Samples, axes: str) -> Array:
    finder = Steps(site=site, axes=axes)  # type: ignore[arg-type]
    finder.open({"in": StreamSpec((6,), rate_hz=100.0, channels=CHANNELS, units=UNITS)})
    rows = finder.process("in", Chunk(stamps, data, int(stamps[-1]))).data
    return np.asarray(rows[(rows["kind"] == "walk") & np.isfinite(rows["features"]).all(axis=1)])


def dataset(site: str, target: str, axes: str) -> Labelled:
    """The steps of all people of a site, with their classes."""
    if site == "lower_back":
        walks = [(p, f"{p} {t}", found_steps(site, s, d, axes), facts) for p, t, s, d, _, _, facts in lower_back()]
    else:
        worn = foot() if site == "foot" else phones({"pocket": "sp", "wrist": "sw"}[site])
        walks = [(p, f"{p} {t}", found_steps(site, s, d, axes), facts) for p, t, s, d, facts in worn]
    walks = [walk for walk in walks if len(walk[2]) and walk[3].get(target) != "nan"]
    raw = {name: (person, person if target == "person" else facts[target]) for person, name, _, facts in walks}
    classes = grouped(raw, target)
    persons = np.concatenate([[p] * len(rows) for p, _, rows, _ in walks])
    names = np.concatenate([[name] * len(rows) for _, name, rows, _ in walks])
    features = np.concatenate([rows["features"] for _, _, rows, _ in walks])
    return Labelled(features, np.array([classes[name][1] for name in names]), persons, names)


def accuracy(sites: list[str], targets: list[str], axes: list[str], shuffles: int) -> None:
    """Random split and people left out, each set of features."""
    for site in sites:
        for target in targets:
            for axis in axes:
                given = dataset(site, target, axis)
                title = f"{target}, {site}, axes by {axis}: {len(given.labels)} steps of {len(np.unique(given.persons))} people"
                tried = [trust(given, name, 60, shuffles) for name in SETS]
                show_trust(tried, title)
                for t in tried:
                    where = f"{target}, {site.replace('_', ' ')} ({axis})" if t is tried[0] else ""
                    say(
                        f"| {where} | {t.features.replace('_', ' ')} | {t.random:.3f} | {t.subjects:.3f} | {t.majority:.3f} | "
                        f"{t.voted} of {t.people} ({t.low:.2f}-{t.high:.2f}) | {t.chance:.2f} |"
                    )


def enrolled() -> None:
    """Who is it, of those enrolled?"""
    given = dataset("lower_back", "person", "gravity")
    show_enrolment(enrolment(given, "both", 60), len(np.unique(given.persons)))


LEG_M = 10.0
"""How far these people walk to the turn, and back from it, by the recordings' protocol; nobody measured single steps."""


def lengths() -> None:
    """Lower back: what a turn, standing and straight walking are called; durations beside contacts'; distances beside the protocol's."""
    kinds = {where: dict.fromkeys(("walk", "turn", "slow", "first"), 0) for where in ("straight", "turn", "standing")}
    apart, people = list[float](), dict[str, list[float]]()
    for person, _, stamps, data, contacts, bounds, _ in lower_back():
        finder = Steps(site="lower_back")
        finder.open({"in": StreamSpec((6,), rate_hz=100.0, channels=CHANNELS, units=UNITS)})
        rows = finder.process("in", Chunk(stamps, data, int(stamps[-1]))).data
        peaks = rows["end"] / NS - 0.08
        turning = (peaks > bounds[2]) & (peaks < bounds[3])
        walking = (peaks >= bounds[0] - 0.25) & (peaks <= bounds[1] + 0.25)
        for row, turn, walk in zip(rows, turning, walking, strict=True):
            kinds["turn" if turn else "straight" if walk else "standing"][str(row["kind"])] += 1
        steady = walking & ~turning & (rows["kind"] == "walk")
        for peak, seconds in zip(peaks[steady], rows["duration_s"][steady], strict=True):
            near = int(np.argmin(np.abs(contacts - peak)))
            if near and abs(contacts[near] - peak) <= TOLERANCE_S:
                apart.append(seconds - (contacts[near] - contacts[near - 1]))
        there = (peaks >= bounds[0] - 0.25) & (peaks <= bounds[2])
        back = (peaks >= bounds[3]) & (peaks <= bounds[1] + 0.25)
        people.setdefault(person, []).extend(float(np.nansum(rows["length_m"][leg])) for leg in (there, back))
    for where, counts in kinds.items():
        told = sum(counts.values())
        say(
            f"{where}: {told} steps, " + ", ".join(f"{kind} {n} ({n / max(told, 1):.1%})" for kind, n in counts.items())
        )
    off = np.abs(np.array(apart)) * 1000
    say(
        f"duration beside the contacts', {len(off)} steps: off by {np.median(off):.0f} ms (median), {np.percentile(off, 95):.0f} ms (p95)"
    )
    every = np.concatenate([np.array(legs) for legs in people.values()])
    each = np.array([np.mean(legs) for legs in people.values()])
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


def speed() -> None:
    """Features and forest beside scikit-learn's."""
    given = dataset("lower_back", "gender", "gravity")
    trained = forest(100).fit(given.features, given.labels)
    flat = Forest.of(trained)
    window = next(iter(lower_back()))[3][500:555].copy()
    scratch, out = np.empty((6, len(window))), np.empty(50)
    rows = np.ascontiguousarray(given.features[:2000])
    ours = np.array([flat.probabilities(row) for row in rows])
    say(
        f"probabilities of {len(rows)} steps: {'the same bits' if (ours == trained.predict_proba(rows)).all() else 'DIFFERENT'}"
    )
    describe(window, 100.0, True, scratch, out)
    for name, call, times in (
        ("features", lambda: describe(window, 100.0, True, scratch, out), 5000),
        ("forest, 100 trees", lambda: flat.probabilities(rows[0]), 5000),
        ("scikit-learn's forest", lambda: trained.predict_proba(rows[:1]), 20),
    ):
        taken = list[float]()
        for _ in range(9):
            began = time.thread_time()
            for _ in range(times):
                call()
            taken.append((time.thread_time() - began) / times * 1e6)
        say(f"{name}: {np.median(taken):.1f} us a step")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.steps", description=__doc__)
    parser.add_argument("--only", nargs="+", default=["detection", "lengths", "speed", "enrolment", "accuracy"])
    parser.add_argument("--sites", nargs="+", default=["lower_back", "foot", "pocket", "wrist"])
    parser.add_argument("--targets", nargs="+", default=["gender", "age", "height"])
    parser.add_argument("--axes", nargs="+", default=["sensor", "gravity"])
    parser.add_argument("--shuffles", type=int, default=39)
    given = parser.parse_args()
    for name in given.only:
        if name == "accuracy":
            accuracy(given.sites, given.targets, given.axes, given.shuffles)
        else:
            {"detection": detection, "lengths": lengths, "speed": speed, "enrolment": enrolled}[name]()


if __name__ == "__main__":
    main()
