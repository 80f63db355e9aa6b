"""`python -m bench.generalise`: how the segmentation does on every set at hand, set by set; Markdown.

So that a rule that was made for one set shows its price on the others. Real: annotated motion capture, sixty Kinect recordings of gestures
(twelve of them, `seen`, were looked at for years), actions done once (UTKinect). Simulated: `tests/support/everyday_made.py`.
Beside the counts those of an offline peak counter. `--left-out`: `radius_share` chosen on each set, and chosen on all others.
`--only SET,SET`; `--write` puts the tables into docs/lab/segmentation-figures.md.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from bench.motion import RATE, Series, features, in_picture, kinect, poses, regular, segment
from bench.report import Section, marks, publish, whole
from kinegraph.devices.people.exerciser import JOINTS
from kinegraph.devices.reports.training import TrainingReport
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.evaluation.found import Found
from kinegraph.operators.segmentation.evaluation.scores import score
from kinegraph.operators.segmentation.evaluation.truth import Truth, read_truth
from kinegraph.operators.segmentation.names.recent_frames import widest
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec
from tests.support.everyday_made import (
    ANGLES,
    EXERCISES,
    LARGE,
    LARGE_LEFT_OUT,
    LEFT_OUT,
    SMALL,
    SMALL_LEFT_OUT,
    Done,
    Person,
    a_session,
)

SEEN = (
    "P1_1_2_p21", "P1_1_3_p19", "P1_1_5_p21", "P1_1_6_p19", "P1_1_9_p19", "P2_1_8_p07", "P2_2_12_p05", "P2_2_4_p09",
    "P3_1_1_p23", "P3_2_10_p17", "P3_2_11_p29", "P3_2_7_p17",
)  # fmt: skip
"""MSRC-12 recordings on which parameters and rules were chosen before the others were at hand."""


SEEN_BY_ANGLES = (
    "arm raises",
    "squats",
    "front raises",
    "punches",
    "knee raises",
    "jumping jacks",
    "toe touches",
    "kicks",
    "windmill",
    "quarter squats",
)
"""Exercises of which arms' and thighs' angles say something."""


@dataclass(slots=True)
class Item:
    """One recording: its set, stacked features, and what was done. counts: spans (s) with how many repetitions; minutes without any."""

    kind: str
    name: str
    features: Series
    truth: Truth | None = None
    counts: list[tuple[float, float, int]] = field(default_factory=list)
    idle_min: float = 0.0
    done: list[Done] = field(default_factory=list)


def real(folder: Path) -> Iterator[Item]:
    for kind, name, pose, truth in poses(folder):
        yield Item(kind, name, pose.through(Stack()), truth)
    for path in sorted(folder.glob("msrc12/*.npz")):
        kind = "MSRC-12, seen" if path.stem in SEEN else "MSRC-12, new"
        keys = read_truth(path).keys
        yield Item(kind, path.stem, kinect(path).through(Stack()), counts=[(-np.inf, np.inf, len(keys))])
    for path in sorted(folder.glob("utkinect/*.npz")):
        with np.load(path) as found:
            joints, names = found["joints_m"].astype(np.float64), tuple(str(n) for n in found["joint_names"])
            stamps = ((found["frame"] - found["frame"][0]) / 30.0 * NS).astype(np.int64)
            label, acts = found["label"], [str(n) for n in found["label_names"]]
        keep = np.append(True, np.diff(stamps) > 0)
        made = Series(StreamSpec(joints.shape[1:], channels=names, units=("m",)), stamps[keep], joints[keep])
        done = Truth(*spans_of(label[keep], stamps[keep], acts))
        yield Item("UTKinect", path.stem, features(made), done)


def spans_of(label: Samples, stamps: Samples, names: list[str]) -> tuple[Samples, Samples, list[str], Samples, Samples]:
    edges = [0, *(np.flatnonzero(np.diff(label)) + 1), len(label)]
    found = [(a, b) for a, b in pairwise(edges) if label[a] >= 0]
    start, end = (np.array([stamps[min(k, len(stamps) - 1)] / NS for k in ks]) for ks in zip(*found, strict=True))
    return start, end, [names[label[a]] for a, _ in found], np.full(len(found), np.nan), np.empty(0)


def seen_by_camera(person: Person, noise_mm: float, lost: float = 0.0, missing: str = "") -> Series:
    joints = person.joints(noise_mm)
    rng = np.random.default_rng((person.seed, 9))
    stamps = np.round((np.arange(len(joints)) / RATE + rng.uniform(-0.003, 0.003, len(joints)) + 0.02) * NS)
    joints[rng.random(joints.shape[:2]) < lost] = np.nan
    if missing:
        joints[:, JOINTS.index(missing)] = np.nan
    return features(
        Series(StreamSpec((len(JOINTS), 3), channels=JOINTS, units=("m",)), stamps.astype(np.int64), joints)
    )


def angles_of(person: Person) -> Series:
    """The thigh's and upper arm's angles to the front (4 channels, degrees), as CMU-86 has them, with its unsteadiness."""
    a, rng = person.angles(), np.random.default_rng((person.seed, 8))
    chosen = [ANGLES.index(name) for name in ("flex_l", "flex_r", "hip_l", "hip_r")]
    made = np.rad2deg(a[:, chosen]) + 0.35 * np.rad2deg(
        a[:, [ANGLES.index("abduct_l"), ANGLES.index("abduct_r"), 0, 0]]
    )
    return regular(made + rng.normal(0.0, 0.3, made.shape)).through(Stack())


def truth_of(done: list[Done]) -> Truth:
    start, end = np.array([d.start for d in done]), np.array([d.end for d in done])
    counts = np.array([float(d.count) if d.kind == "exercise" else np.nan for d in done])
    return Truth(start, end, [d.label for d in done], counts, np.empty(0))


def near(d: Done, count: int | None = None) -> tuple[float, float, int]:
    return (d.start - MARGIN_S, d.end + MARGIN_S, d.count if count is None else count)


def each_set(done: list[Done]) -> list[tuple[float, float, int]]:
    """The spans of exercises, each a little wider; where two adjoin, they meet in the middle: no repetition is of both."""
    sets = [d for d in done if d.kind == "exercise"]
    ends = [-np.inf, *(d.end for d in sets)]
    starts = [*(d.start for d in sets[1:]), np.inf]
    return [
        (max(d.start - MARGIN_S, (before + d.start) / 2), min(d.end + MARGIN_S, (d.end + after) / 2), d.count)
        for d, before, after in zip(sets, ends, starts, strict=False)
    ]


MARGIN_S = 0.7


def simulated(quick: bool = False) -> Iterator[Item]:
    few = 1 if quick else 3
    for seed in range(4 if quick else 20):
        person = a_session(seed, SEEN_BY_ANGLES)
        yield Item("sim, 4 angles", str(seed), angles_of(person), truth_of(person.done))
    for seed in range(100, 102 if quick else 112):
        person = a_session(seed)
        yield Item("sim, bodies", str(seed), seen_by_camera(person, 3.0), truth_of(person.done), each_set(person.done))
    for suffix, first, exercises, large, small in KINDS:
        yield from one_exercise(suffix, first, exercises, few)
        yield from small_after_large(suffix, first, large, small, few)
        yield from half_repetitions(suffix, first, exercises, min(few, 2))
    for draw in range(2 * few):
        yield everyday(draw)
        yield everyday(draw, left_out=True)
        if draw < few:
            yield walking(draw)
    for seed in range(4000, 4010 if quick else 4060):
        yield video(seed)


def one_exercise(suffix: str, first: int, exercises: Iterable[str], draws: int) -> Iterator[Item]:
    """One set of each exercise, whole and with lost joints, and clips of it; people are numbered from `first` on."""
    for k, name in enumerate(exercises):
        for draw in range(draws):
            rng = np.random.default_rng((first // 10000, k, draw, 50) if first >= 10000 else (k, draw, 50))
            person = Person(first + 1000 + 10 * k + draw)
            person.stand(rng.uniform(1, 6))
            person.exercise(name, int(rng.integers(6, 13)), pauses=(0.0, 0.0, 2.0)[draw], drift=rng.uniform(-0.1, 0.25))
            person.stand(rng.uniform(2, 5))
            counts = [near(d) for d in person.done if d.kind == "exercise"]
            for noise in (1.0, 6.0):
                yield Item(
                    "sim, sets" + suffix, f"{name} {draw} {noise:g} mm", seen_by_camera(person, noise), counts=counts
                )
            lost = [("a fifth of values", 0.2, ""), ("wrist_r", 0.0, "wrist_r"), ("ankle_l", 0.0, "ankle_l")][draw]
            made = seen_by_camera(person, 3.0, lost[1], lost[2])
            yield Item("sim, lost joints" + suffix, f"{name}: {lost[0]}", made, counts=counts)
            person = Person(first + 1500 + 10 * k + draw)
            person.hold(rng.uniform(0.0, 1.0))
            person.exercise(name, int(rng.integers(3, 7)), drift=rng.uniform(-0.1, 0.2))
            person.hold(rng.uniform(0.3, 1.0))
            counts = [(-np.inf, np.inf, person.done[-1].count)]
            if person.time < 20:
                yield Item("sim, short clips" + suffix, f"{name} {draw}", seen_by_camera(person, 4.0), counts=counts)


def small_after_large(
    suffix: str, first: int, larges: Iterable[str], smalls: tuple[str, ...], draws: int
) -> Iterator[Item]:
    for k, large in enumerate(larges):
        for j, small in enumerate(smalls):
            for draw in range(draws):
                person = Person(first + 2000 + 100 * k + 10 * j + draw)
                person.stand(3.0)
                person.exercise(large, 9)
                person.stand((5.0, 30.0, 12.0)[draw])
                person.exercise(small, 9)
                person.stand(4.0)
                counts = [near(d) for d in person.done if d.label == small]
                made = seen_by_camera(person, 2.0)
                yield Item("sim, small after large" + suffix, f"{large}, {small} {draw}", made, counts=counts)


def half_repetitions(suffix: str, first: int, exercises: Iterable[str], draws: int) -> Iterator[Item]:
    for k, name in enumerate(exercises):
        for draw in range(draws):
            person = Person(first + 3000 + 10 * k + draw)
            person.stand(3.0)
            person.exercise(name, 10, partial=((3, 7), (4, 5, 8))[draw])
            person.stand(3.0)
            counts = [near(d, 8 - draw) for d in person.done if d.kind == "exercise"]
            yield Item("sim, half repetitions" + suffix, f"{name} {draw}", seen_by_camera(person, 3.0), counts=counts)


KINDS = (("", 0, EXERCISES, LARGE, SMALL), (", left out", 10000, LEFT_OUT, LARGE_LEFT_OUT, SMALL_LEFT_OUT))
"""What follows a set's name, its people, its exercises; rules were chosen with the first ones only."""


def everyday(draw: int, *, left_out: bool = False) -> Item:
    """Two minutes of what somebody does who waits for somebody: one thing after the other, with pauses; no exercise, and no walking."""
    person = Person(5000 + 10000 * left_out + 10 * draw)
    acts: list[Callable[[], None]] = [
        person.drink, person.stretch, person.scratch, person.tie_shoes,
        lambda: person.talk(person.rng.uniform(8, 25)), lambda: person.stand(person.rng.uniform(5, 25)),
    ]  # fmt: skip
    if left_out:
        acts = [person.telephone, person.tidy, person.jacket, lambda: person.stand(person.rng.uniform(5, 25))]
    while person.time < 120.0:
        for k in person.rng.permutation(len(acts)):
            acts[k]()
            person.hold(person.rng.uniform(0.2, 3.0))
    return Item(
        "sim, everyday, left out" if left_out else "sim, everyday",
        str(draw),
        seen_by_camera(person, (1.0, 3.0, 6.0)[draw % 3]),
        idle_min=person.time / 60,
        done=person.done,
    )


def walking(draw: int) -> Item:
    person = Person(5500 + 10 * draw)
    while person.time < 90.0:
        person.walk(person.rng.uniform(5, 12))
        person.stand(person.rng.uniform(1.0, 8.0))
    return Item("sim, walking about", str(draw), seen_by_camera(person, 3.0), idle_min=person.time / 60)


def video(seed: int) -> Item:
    """A clip from the net: a few to many repetitions, other motion before or behind, joints as an estimator finds them in pictures."""
    person, rng = Person(seed), np.random.default_rng((seed, 6))
    name = str(rng.choice(list(EXERCISES)))
    before = [
        lambda: None,
        lambda: person.hold(rng.uniform(0.5, 3)),
        lambda: person.talk(rng.uniform(2, 6)),
        lambda: person.walk(3.0),
    ]
    before[int(rng.integers(4))]()
    person.exercise(
        name,
        int(rng.choice([2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25])),
        pauses=rng.choice([0.0, 0.0, 0.0, 0.6, 2.0]),
        drift=rng.uniform(-0.2, 0.5),
    )
    [lambda: None, lambda: person.hold(rng.uniform(0.5, 3)), lambda: person.stretch()][int(rng.integers(3))]()
    joints = person.joints(rng.uniform(5.0, 12.0))
    view = rng.uniform(-0.9, 0.9)
    c, s = np.cos(view), np.sin(view)
    middle = joints[:, :1].mean(0)
    x = c * (joints[:, :, 0] - middle[..., 0]) + s * (joints[:, :, 2] - middle[..., 2])
    depth = -s * (joints[:, :, 0] - middle[..., 0]) + c * (joints[:, :, 2] - middle[..., 2])
    joints[:, :, 0], joints[:, :, 2] = x, 0.6 * depth + rng.normal(0.0, 0.03, depth.shape)
    spikes = rng.random(joints.shape[:2]) < 0.003
    joints[spikes] += rng.normal(0.0, 0.15, (int(spikes.sum()), 3))
    stamps = np.round(np.arange(len(joints)) / RATE * NS).astype(np.int64)
    made = in_picture(Series(StreamSpec((len(JOINTS), 3), channels=JOINTS, units=("m",)), stamps, joints))
    return Item(
        "sim, videos",
        f"{name} {seed}",
        made,
        counts=[(-np.inf, np.inf, next(d.count for d in person.done if d.kind == "exercise"))],
    )


def are_full(series: Series, spans: Samples) -> Array:
    """Which repetitions of a set (n,) go at least half as far as its median, as a training report counts them."""
    parts = [series.part(start, end) for start, end in spans]
    ranges = np.array([widest(part)[0] for part in parts])
    made: Array = ranges >= TrainingReport().full_share * np.median(ranges) if len(ranges) else np.zeros(0, bool)
    return made


def in_sets(found: Found, middles: Samples) -> int:
    """How many repetitions with these middles (s) a training report has, as their activity has enough of them."""
    counts = [int(((middles >= start) & (middles < end)).sum()) for start, end in found.activities]
    return sum(count for count in counts if count >= TrainingReport().min_repetitions)


def items(folder: Path, only: tuple[str, ...] = (), *, quick: bool = False) -> Iterable[Item]:
    for made in (real(folder), simulated(quick)):
        for item in made:
            if not only or any(part in item.kind for part in only):
                yield item


def peaks(series: Series) -> Samples:
    """When the first principal component of a whole recording (n, features) is at a peak, s: what twenty lines offline count."""
    x = np.where(np.isfinite(series.data), series.data, np.nanmean(series.data, 0, where=np.isfinite(series.data)))
    x = x[:, np.isfinite(x).all(0)]
    x = x - x.mean(0)
    way = x @ np.linalg.eigh(x.T @ x)[1][:, -1]
    smooth = gaussian_filter1d(way, 0.15 * RATE)
    low, high = np.percentile(smooth, (5, 95))
    at, _ = find_peaks(smooth, prominence=0.4 * (high - low), distance=round(0.4 * RATE))
    other, _ = find_peaks(-smooth, prominence=0.4 * (high - low), distance=round(0.4 * RATE))
    made: Samples = series.stamps[at if len(at) <= len(other) else other] / NS
    return made


SHARES = (0.425, 0.45, 0.475, 0.5, 0.525)
MAIN = dict.fromkeys(("f1", "within 1"))


def left_out(tallies: dict[float, Tally]) -> Section:
    """Each set's main figure with the share chosen on it, and with that chosen on all others: highest mean of their main figures."""
    figures = {
        share: {
            kind: float(np.mean(f[next(n for n in MAIN if n in f)]))
            for kind, f in tally.figures.items()
            if MAIN.keys() & f.keys()
        }
        for share, tally in tallies.items()
    }
    rows, gaps = [], []
    for kind in next(iter(figures.values())):
        others = {share: np.mean([v for k, v in f.items() if k != kind]) for share, f in figures.items()}
        chosen, left = max(f[kind] for f in figures.values()), figures[max(others, key=lambda s: others[s])][kind]
        gaps.append(chosen - left)
        rows.append(
            [kind, f"{chosen:.3f}", f"{left:.3f}", f"{chosen - left:.3f}", f"{max(others, key=lambda s: others[s]):g}"]
        )
    rows.append(["**mean**", "", "", f"{np.mean(gaps):.3f}", ""])
    head = ["F1, or within 1", "share chosen on it", "chosen on all other sets", "gap", "that share"]
    return Section("Chosen on a set, and without it", head, rows)


class Tally:
    """Figures of each set."""

    def __init__(self) -> None:
        self.figures: dict[str, dict[str, list[float]]] = {}

    def take(self, item: Item, found: Found) -> None:
        mine = self.figures.setdefault(item.kind, {})
        tops = peaks(item.features) if item.counts else np.empty(0)
        if item.truth is not None and len(item.truth.boundaries()):
            made = score(found, item.truth)
            for name in ("f1", "covering", "strict", "tolerant"):
                mine.setdefault(name, []).append(getattr(made, name))
        middles = found.repetitions().mean(1)
        for start, end, count in item.counts:
            within = (middles > start) & (middles < end)
            if "half repetitions" in item.kind:
                within[within] = are_full(item.features, found.repetitions()[within])
            counted = int(within.sum())
            mine.setdefault("exact", []).append(counted == count)
            mine.setdefault("within 1", []).append(abs(counted - count) <= 1)
            mine.setdefault("MAE", []).append(abs(counted - count) / max(1, count))
            mine.setdefault("peaks", []).append(abs(int(((tops > start) & (tops < end)).sum()) - count) <= 1)
        if item.idle_min or item.kind == "UTKinect":
            minutes = item.idle_min or len(item.features.data) / RATE / 60
            mine.setdefault("counts a minute", []).append(len(middles) / minutes)
            if "walking" not in item.kind:  # which a report knows by its way, and leaves out
                mine.setdefault("in a report", []).append(in_sets(found, middles) / minutes)
            for one in item.done:
                within = ((middles >= one.start) & (middles < one.end)).sum()
                mine.setdefault(f"  {one.label}", []).append(within / minutes * len(item.done) / 6)

    def rows(self) -> list[list[str]]:
        names = (
            "f1",
            "covering",
            "strict",
            "tolerant",
            "exact",
            "within 1",
            "peaks",
            "MAE",
            "counts a minute",
            "in a report",
        )
        made = []
        for kind, figures in self.figures.items():
            count = max(len(v) for v in figures.values())
            made.append([kind, str(count), *(f"{np.mean(figures[n]):.3f}" if n in figures else "" for n in names)])
        return made


HEADER = [
    "set",
    "of",
    "F1",
    "covering",
    "strict",
    "tolerant",
    "exact",
    "within 1",
    "within 1, peaks",
    "MAE",
    "false counts a minute",
    "in a report",
]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.generalise", description=__doc__)
    parser.add_argument("--only", default="", help="sets with one of these in their name, separated by commas")
    parser.add_argument("--left-out", action="store_true", help="the radius chosen without each set, too")
    parser.add_argument("--quick", action="store_true", help="a few of each")
    parser.add_argument("--write", action="store_true", help="write the tables into docs/lab/segmentation-figures.md")
    given = parser.parse_args()
    folder = Path(os.environ.get("KINEGRAPH_DATA", "")) / "segmentation"
    if not os.environ.get("KINEGRAPH_DATA") or not folder.is_dir():
        sys.exit("KINEGRAPH_DATA must name a folder of recordings that holds `segmentation`")
    tallies = {share: Tally() for share in (SHARES if given.left_out else (Segment().radius_share,))}
    for item in items(folder, tuple(filter(None, given.only.split(","))), quick=given.quick):
        for share, tally in tallies.items():
            tally.take(item, segment(item.features, Segment(radius_share=share)))
    sections = [Section("Every set at hand", HEADER, tallies[Segment().radius_share].rows())]
    if given.left_out:
        sections.append(left_out(tallies))
    print(whole(sections, "By `python -m bench.generalise`."))
    if given.write:
        publish(sections, "By `python -m bench.generalise`.", "lab/segmentation-figures.md", *marks("bench.generalise"))


if __name__ == "__main__":
    main()
