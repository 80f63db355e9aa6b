"""`python -m bench.segmentation`: how well operators.segmentation does on annotated recordings, beside the thesis's batch method; Markdown.

Accuracy needs the folder of recordings that the environment variable KINEGRAPH_DATA names. One set of defaults for all; intervals are 95 %,
from drawing recordings again and again. `--speed`: how long a frame takes instead, beside other libraries. `--write` puts the tables into
docs/lab/segmentation-figures.md. `--quick`: to see that it works, not for figures.
"""

from __future__ import annotations

import argparse
import os
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from bench import batch
from bench.bundling import bundling
from bench.motion import RATE, Series, events, kinect, poses, regular, segment
from bench.report import Goal, Section, marks, publish, whole
from bench.segmentation_speed import many_exemplars, speed
from bench.sides import sides
from bench.surrogates import surrogates
from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.features.standardise import Standardise
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.evaluation.found import Found
from kinegraph.operators.segmentation.evaluation.scores import Scores, boundary_f1, intervals, score
from kinegraph.operators.segmentation.evaluation.truth import Truth, read_truth
from kinegraph.stream.chunk import NS, Samples, StreamSpec
from kinegraph.stream.operator import grid

HOUSE = Path(__file__).resolve().parent.parent
SHARES = np.arange(0.30, 0.62, 0.025).round(3)
RADII = np.geomspace(0.2, 0.9, 25)
"""Fixed radii that are tried, as shares of the median distance between frames of the whole recording."""
BAND = 30
"""The band that the thesis leaves out, in frames: a second."""
SHOWN = {"f1": "F1", "covering": "covering", "strict": "strict", "tolerant": "tolerant"}


def in_batch(features: Series, apart: Samples, radius: float, quiet: int = batch.QUIET) -> Found:
    """What the thesis's method finds, from all distances."""
    made = batch.cut(apart, radius, BAND, quiet)
    edges = np.append(features.stamps, features.stamps[-1] + features.spec.period_ns) / NS
    edges[0] = 0.0
    unknown = np.full(len(made.repetition), -1)
    return Found(edges[made.activities], made.transition, edges[made.primitives], unknown, made.repetition)


Scored = dict[str, dict[str, list[Scores]]]
"""Scores by set of recordings and by method."""
LIVE, LIVE_BEST = "live", "live, best fixed radius"
RAW, RAW_BEST, BUNDLED, BUNDLED_BEST = (
    "batch, the live radius",
    "batch, best radius",
    "batch, bundled, the live radius",
    "batch, bundled, best radius",
)


def activities(folder: Path, *, quick: bool) -> list[Section]:
    """Boundaries of activities, live and by the thesis's method."""
    scored: Scored = {}
    shares: dict[float, list[float]] = {share: [] for share in SHARES}
    rows, beside = [], []
    for kind, name, pose, truth in poses(folder):
        features = pose.through(Stack())
        print(f"{kind}: {name} ...", file=sys.stderr, flush=True)
        found, made = methods(features, truth, quick=quick)
        for group in (kind, "all"):
            for method, one in made.items():
                scored.setdefault(group, {}).setdefault(method, []).append(one)
        first = [f"{kind}: {name.partition('_12ch')[0]}"]
        rows.append([*first, *(f"{getattr(made[LIVE], field):.2f}" for field in SHOWN)])
        agree = boundary_f1(found[LIVE].boundaries(), found[RAW].boundaries())[0]
        beside.append([*first, *(f"{one.f1:.2f}" for one in made.values()), f"{agree:.2f}"])
        if not quick:
            for share, scores in shares.items():
                scores.append(score(segment(features, Segment(radius_share=float(share))), truth).f1)
    methods_ = list(scored["all"])
    beside += [
        [f"**{k}, mean**", *(f"{np.mean([s.f1 for s in v[m]]):.2f}" for m in methods_), ""] for k, v in scored.items()
    ]
    title = "Boundary F1, live and by the thesis's batch method; last, the live boundaries against those of the batch method"
    sections = [
        Section(
            "Activities: one set of defaults, radius found from the data",
            ["", *SHOWN.values()],
            [*rows, *means(scored)],
        ),
        Section(title, ["F1", *methods_, "live against batch, the live radius"], beside),
        Section(
            "All four scores, by method",
            ["", *SHOWN.values()],
            [row for k in ("CMU-86, 4 channels", "all") for row in by_method(k, scored[k])],
        ),
    ]
    sections[0].goals = accuracy_goals(scored)
    sections[0].notes = [] if quick else [left_out(shares)]
    return sections


def methods(features: Series, truth: Truth, *, quick: bool) -> tuple[dict[str, Found], dict[str, Scores]]:
    """What each method finds in one recording, and its scores."""
    found = {LIVE: segment(features)}
    raw = batch.distances(features.data)
    close = batch.distances(batch.bundled(features.data))
    radii = float(np.median(raw[::20, ::20])) * RADII
    if not quick:
        found[LIVE_BEST] = best([segment(features, Segment(radius=float(r))) for r in radii], truth)
    for apart, same, tuned in ((raw, RAW, RAW_BEST), (close, BUNDLED, BUNDLED_BEST)):
        found[same] = in_batch(features, apart, found[LIVE].radius)
        if not quick:
            found[tuned] = best([in_batch(features, apart, float(r)) for r in radii], truth)
    return found, {name: score(one, truth) for name, one in found.items()}


def best(found: list[Found], truth: Truth) -> Found:
    """The first with the highest F1, and of these with the highest covering: picked with the annotations in hand."""
    return max(found, key=lambda one: (score(one, truth).f1, score(one, truth).covering))


def means(scored: Scored) -> list[list[str]]:
    rows = []
    for kind, made in scored.items():
        mean = intervals(made[LIVE])
        cells = [f"{mean[k][0]:.3f} ({mean[k][1]:.2f}-{mean[k][2]:.2f})" for k in SHOWN]
        rows.append([f"**{kind}, mean of {len(made[LIVE])}**", *cells])
    return rows


def by_method(kind: str, made: dict[str, list[Scores]]) -> list[list[str]]:
    return [[f"{kind}: {m}", *(f"{np.mean([getattr(s, k) for s in v]):.3f}" for k in SHOWN)] for m, v in made.items()]


def accuracy_goals(scored: Scored) -> list[Goal]:
    kind = "CMU-86, 4 channels"
    goals = [
        Goal(f"{kind}: {name}", float(np.mean([getattr(s, field) for s in scored[kind][LIVE]])), limit, "", least=True)
        for (field, name), limit in zip(SHOWN.items(), (0.85, 0.88, 0.88, 0.98), strict=True)
    ]
    if LIVE_BEST in scored["all"]:
        lost = np.mean([b.f1 - a.f1 for a, b in zip(scored["all"][LIVE], scored["all"][LIVE_BEST], strict=True)])
        goals.append(Goal("all sets: F1 lost against each recording's best fixed radius", float(lost), 0.05, ""))
    return goals


def left_out(shares: dict[float, list[float]]) -> str:
    f1 = np.array(list(shares.values()))
    left = [f1[np.delete(f1, k, 1).mean(1).argmax(), k] for k in range(f1.shape[1])]
    text = f"With `radius_share` chosen on all recordings but the one that is scored: F1 {np.mean(left):.3f}. By share, all: "
    return text + ", ".join(f"{share:g}: {np.mean(scores):.2f}" for share, scores in shares.items()) + "."


def joined(poses: list[tuple[Series, Truth]], seed: int, draws: int = 72) -> list[list[int]]:
    """Errors of counting, by recording: three recordings, cut to 3 to 8 repetitions each, joined in random order."""
    rng, errors = np.random.default_rng(seed), [list[int]() for _ in poses]
    for _ in range(draws):
        pieces, counts = [], []
        chosen = rng.choice(len(poses), 3, replace=False)
        for k in chosen:
            pose, truth = poses[k]
            count = int(rng.integers(3, 9))
            first = int(rng.integers(0, len(truth.keys) - count + 1))
            between = (truth.keys[1:] + truth.keys[:-1]) / 2.0
            start = between[first - 1] if first else max(0.0, 2 * truth.keys[0] - between[0])
            last = first + count - 1
            stop = between[last] if last < len(between) else 2 * truth.keys[-1] - between[-1]
            pieces.append(pose.part(start, stop))
            counts.append(count)
        found = segment(regular(np.concatenate(pieces)).through(Stack()))
        middle = found.primitives.mean(1)[found.repetition > 0]
        ends = np.cumsum([len(piece) for piece in pieces]) / RATE
        for k, end, p, c in zip(chosen, ends, pieces, counts, strict=True):
            errors[k].append(abs(int(((middle >= end - len(p) / RATE) & (middle < end)).sum()) - c))
    return errors


def repetitions(folder: Path) -> Section:
    """Kinect recordings of ten repetitions or so, counted, and where the annotated moment stands in them."""
    names = [path.stem for path in sorted(folder.glob("msrc12/*.npz"))]
    recorded = [(kinect(path), read_truth(path)) for path in sorted(folder.glob("msrc12/*.npz"))]
    rows, scores, others, counted = [], [], [], joined(recorded, 0)
    for name, (pose, truth), missed in zip(names, recorded, counted, strict=True):
        features = pose.through(Stack())
        found = segment(features)
        whole_ = in_batch(features, batch.distances(features.data), found.radius)
        made, other = score(found, truth), score(whole_, truth)
        scores.append(made)
        others.append(other)
        bouts = len(events(features, Segment())["bout"])
        counts = [len(truth.keys), (found.repetition > 0).sum(), bouts, (whole_.repetition > 0).sum()]
        places = [made.key_place, made.key_sd, other.key_sd]
        close = f"{sum(error <= 1 for error in missed)} of {len(missed)}"
        with np.load(folder / "msrc12" / f"{name}.npz") as found_in:
            gesture = str(found_in["tag_name"][0]).split(maxsplit=1)[1].lower()
        rows.append([name, gesture, *map(str, counts), close, *(f"{v:.2f}" for v in places)])
    errors = np.concatenate(counted)
    within, pieces = float(np.mean([s.within_1 for s in scores])), float(np.mean(errors <= 1))
    note = (
        f"Counted within 1: {within:.0%} of {len(scores)} recordings (batch: {np.mean([s.within_1 for s in others]):.0%}); "
        f"{pieces:.0%} of {len(errors)} pieces of 3 to 8 repetitions joined by threes."
    )
    goals = [
        Goal("MSRC-12: recordings counted within 1", 100 * within, 80, "%", least=True),
        Goal("MSRC-12: pieces counted within 1", 100 * pieces, 80, "%", least=True),
        Goal(
            "MSRC-12: circular sd of the key point's place, mean",
            100 * float(np.mean([s.key_sd for s in scores])),
            15,
            "%",
        ),
    ]
    head = [
        "MSRC-12",
        "gesture",
        "annotated",
        "counted",
        "in bouts",
        "counted, batch",
        "pieces within 1",
        "key point's place",
        "its circular sd",
        "circular sd, batch",
    ]
    return Section("Repetitions before a Kinect", head, rows, [note], goals)


def muscles(path: Path) -> Section:
    """Gait cycles from muscle signals."""
    with np.load(path) as found:
        emg, touch = found["emg_uV"], found["touchdown_s"] - found["t_s"][0]
    raw = Series(StreamSpec((emg.shape[1],), rate_hz=1000.0, units=("uV",)), grid(1000.0, len(emg), 0), emg)
    found_ = segment(raw.through(Envelope(cutoff_hz=10.0, rate_hz=RATE), Standardise(freeze_s=10.0), Stack()))
    starts = found_.primitives[found_.repetition > 0, 0]
    places = np.array([(s - a) / (b - a) for s in starts for a, b in pairwise(touch) if a <= s < b])
    spread = np.sqrt(-2 * np.log(np.abs(np.exp(2j * np.pi * places).mean()))) / (2 * np.pi) if len(places) else np.nan
    note = (
        f"{len(touch) - 1} gait cycles, {len(starts)} repetitions; circular sd of their start {spread:.1%} of a cycle."
    )
    goals = [
        Goal("EMG: gait cycles counted wrongly", abs(len(touch) - 1 - len(starts)), 1, ""),
        Goal("EMG: circular sd of the cycles' start", 100 * float(spread), 5, "%"),
    ]
    return Section("Treadmill walking, 13 muscles", notes=[note], goals=goals)


def accuracy(*, quick: bool) -> list[Section]:
    """All that is measured on recordings. Exits without recordings."""
    folder = Path(os.environ.get("KINEGRAPH_DATA", "")) / "segmentation"
    if not os.environ.get("KINEGRAPH_DATA") or not folder.is_dir():
        sys.exit("KINEGRAPH_DATA must name a folder of recordings that holds `segmentation`")
    return [
        *activities(folder, quick=quick),
        bundling(folder),
        repetitions(folder),
        muscles(folder.parent / "emg" / "emg_santuz_tw12.npz"),
        sides(folder),
        surrogates(folder, draws=1 if quick else 3),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.segmentation", description=__doc__)
    parser.add_argument("--speed", action="store_true", help="how long a frame takes")
    parser.add_argument("--quick", action="store_true", help="no best radii, short windows, no other libraries")
    parser.add_argument(
        "--write", action="store_true", help="write goals and tables into docs/lab/segmentation-figures.md"
    )
    given = parser.parse_args()
    sections = (
        [speed(quick=given.quick), many_exemplars(quick=given.quick)] if given.speed else accuracy(quick=given.quick)
    )
    name = "bench.segmentation" + (" --speed" if given.speed else "")
    print(whole(sections, f"By `python -m {name}`."))
    if given.write:
        publish(sections, f"By `python -m {name}`.", "lab/segmentation-figures.md", *marks(name))


if __name__ == "__main__":
    main()
