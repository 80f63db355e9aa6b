"""`python -m bench.segmentation`: how well operators.segmentation does on annotated recordings, and how long a frame takes; Markdown.

Accuracy needs the folder of recordings that the environment variable KINEGRAPH_DATA names, and is left out without it. One set of defaults
for all; intervals are 95 %, from drawing recordings again and again. `--radii` also finds every recording's best fixed radius.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import table
from operators.align import Align
from operators.emg.envelope import Envelope
from operators.features.pose import Pose
from operators.features.stack import Stack
from operators.features.standardise import Standardise
from operators.segmentation import Segment
from operators.segmentation.found import Found, merged
from operators.segmentation.scores import Scores, intervals, score
from operators.segmentation.truth import Truth, read_truth
from stream.chunk import NS, Array, Chunk, StreamSpec
from stream.operator import Operator, grid

RATE = 30.0


class Series:
    """A stream as a whole: its spec, stamps (n,) ns from 0, samples."""

    def __init__(self, spec: StreamSpec, stamps: Array, data: Array) -> None:
        self.spec, self.stamps, self.data = spec, np.asarray(stamps, np.int64), np.ascontiguousarray(data, np.float64)

    def through(self, *operators: Operator[Any]) -> Series:
        made = self
        for operator in operators:
            made = made._through(operator)
        return made

    def _through(self, operator: Operator[Any]) -> Series:
        port = operator.inputs[0] if operator.inputs else "pose"
        (spec,) = operator.open({port: self.spec}).values()
        chunks = [
            *_chunks(operator.process(port, Chunk(self.stamps, self.data, int(self.stamps[-1])))),
            *_chunks(operator.close()),
        ]
        return Series(spec, np.concatenate([c.time for c in chunks]), np.concatenate([c.data for c in chunks]))

    def part(self, first_s: float, last_s: float) -> Array:
        return self.data[(self.stamps >= first_s * NS) & (self.stamps < last_s * NS)]


def _chunks(emitted: Any) -> list[Chunk]:
    if emitted is None:
        return []
    return [emitted] if isinstance(emitted, Chunk) else [chunk for _, chunk in emitted]


def regular(data: Array, rate_hz: float = RATE) -> Series:
    return Series(StreamSpec(data.shape[1:], rate_hz=rate_hz), grid(rate_hz, len(data), 0), data)


def segment(features: Series, operator: Segment | None = None) -> Found:
    """What is found in stacked features."""
    operator = operator or Segment()
    found: dict[str, list[Array]] = {
        name: [np.empty(0, spec.dtype)] for name, spec in operator.open({"in": features.spec}).items()
    }
    chunk = Chunk(features.stamps, features.data, int(features.stamps[-1]))
    for name, made in [*operator.process("in", chunk), *operator.close()]:
        found[name].append(made.data)
    activity, primitive, merge = (np.concatenate(found[name]) for name in ("activity", "primitive", "merge"))
    clusters = merged(primitive["cluster"], zip(merge["cluster"].tolist(), merge["into"].tolist(), strict=True))
    return Found(
        _spans(activity, features),
        activity["transition"],
        _spans(primitive, features),
        clusters,
        primitive["repetition"],
    )


def _spans(events: Array, features: Series) -> Array:
    """Start and end in seconds: a segment ends where the next one starts; frames that have no stack belong to the first and last."""
    spans = np.stack([events["onset"], events["end"] + features.spec.period_ns], 1) / NS
    spans[0, 0] = 0.0
    return spans


def cmu_and_mocap6(folder: Path) -> Iterable[tuple[str, str, Series, Truth]]:
    """(set, name, stacked features, annotations) of the annotated motion capture."""
    for path in sorted(folder.glob("cmu86_4ch/*.npz")):
        angles = np.rad2deg(np.unwrap(np.deg2rad(np.load(path)["angles_deg"].astype(np.float64)), axis=0))[::4]
        yield "CMU-86, 4 channels", path.stem, regular(angles).through(Stack()), read_truth(path)
    for path in sorted([*folder.glob("cmu86_full/*.npz"), *folder.glob("mocap6/1?_??.npz")]):
        kind = "CMU-86, full body" if path.parent.name == "cmu86_full" else "exercises, full body"
        yield kind, path.stem, regular(np.load(path)["e15_cm"]).through(Stack()), read_truth(path)
    for path in sorted(folder.glob("mocap6/*12ch*.npz")):
        slow = regular(np.load(path)["x"], 10.0)
        yield "exercises, 12 channels", path.stem, slow.through(Align(rate_hz=RATE), Stack()), read_truth(path)


def kinect(path: Path) -> Series:
    """A Kinect recording's pose at 30 Hz, joints that are lost filled in."""
    with np.load(path) as found:
        joints, names = found["joints_m"].astype(np.float64), tuple(str(name) for name in found["joint_names"])
        stamps = (found["t_us"] - found["t_us"][0]) * 1000
        joints[~found["tracked"] | ~joints.any(axis=(1, 2))] = np.nan
    keep = np.append(True, np.diff(stamps) > 0)
    return Series(StreamSpec(joints.shape[1:], channels=names, units=("m",)), stamps[keep], joints[keep]).through(
        Pose(), Align(rate_hz=RATE, max_distance_s=0.5)
    )


def joined(poses: list[tuple[Series, Truth]], seed: int, draws: int = 24) -> list[int]:
    """Errors of counting: three recordings, cut to 3 to 8 repetitions each, joined in random order."""
    rng, errors = np.random.default_rng(seed), []
    for _ in range(draws):
        pieces, counts = [], []
        for k in rng.choice(len(poses), 3, replace=False):
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
        errors += [
            abs(int(((middle >= end - len(p) / RATE) & (middle < end)).sum()) - c)
            for end, p, c in zip(ends, pieces, counts, strict=True)
        ]
    return errors


def activities(folder: Path, radii: bool) -> str:
    sets: dict[str, list[Scores]] = {}
    rows, best, shares = [], [], {share: [] for share in np.arange(0.30, 0.62, 0.025).round(3)}
    for kind, name, features, truth in cmu_and_mocap6(folder):
        made = score(segment(features), truth)
        sets.setdefault(kind, []).append(made)
        sets.setdefault("all", []).append(made)
        row = [f"{kind}: {name}", *(f"{v:.2f}" for v in (made.f1, made.covering, made.strict, made.tolerant))]
        if radii:
            median = (
                float(np.median(np.linalg.norm(features.data[::20, None] - features.data[None, ::20], axis=2)))
                / features.data.shape[1] ** 0.5
            )
            best.append(
                max(score(segment(features, Segment(radius=median * r)), truth).f1 for r in np.geomspace(0.2, 0.9, 25))
            )
            row.append(f"{best[-1]:.2f}")
            for share, scores in shares.items():
                scores.append(score(segment(features, Segment(radius_share=float(share))), truth).f1)
        rows.append(row)
    for kind, scores in sets.items():
        means = intervals(scores)
        cells = [
            f"{means[k][0]:.3f} ({means[k][1]:.2f}-{means[k][2]:.2f})" for k in ("f1", "covering", "strict", "tolerant")
        ]
        rows.append(
            [
                f"**{kind}, mean of {len(scores)}**",
                *cells,
                *([f"{np.mean(best):.2f}" if kind == "all" else ""] if radii else []),
            ]
        )
    text = table(["", "F1", "covering", "strict", "tolerant", *(["F1, best fixed radius"] if radii else [])], rows)
    if radii:
        f1 = np.array(list(shares.values()))
        left = [f1[np.delete(f1, k, 1).mean(1).argmax(), k] for k in range(f1.shape[1])]
        text += f"\n\nWith `radius_share` chosen on all recordings but the one that is scored: F1 {np.mean(left):.3f}. By share, all: "
        text += ", ".join(f"{share:g}: {np.mean(scores):.2f}" for share, scores in shares.items()) + "."
    return text


def repetitions(folder: Path) -> str:
    poses = [(kinect(path), read_truth(path)) for path in sorted(folder.glob("msrc12/*.npz"))]
    names = [path.stem for path in sorted(folder.glob("msrc12/*.npz"))]
    rows, scores = [], []
    for name, (pose, truth) in zip(names, poses, strict=True):
        found = segment(pose.through(Stack()))
        made = score(found, truth)
        scores.append(made)
        rows.append(
            [
                name,
                str(len(truth.keys)),
                str(int((found.repetition > 0).sum())),
                f"{made.key_place:.2f}",
                f"{made.key_sd:.2f}",
            ]
        )
    errors = np.array(joined(poses, 0))
    text = table(["MSRC-12", "annotated", "counted", "key point's place", "its circular sd"], rows)
    return text + (
        f"\n\nCounted within 1: {np.mean([s.within_1 for s in scores]):.0%} of {len(scores)} recordings; "
        f"{np.mean(errors <= 1):.0%} of {len(errors)} pieces of 3 to 8 repetitions joined by threes."
    )


def muscles(path: Path) -> str:
    with np.load(path) as found:
        emg, touch = found["emg_uV"], found["touchdown_s"] - found["t_s"][0]
    raw = Series(StreamSpec((emg.shape[1],), rate_hz=1000.0, units=("uV",)), grid(1000.0, len(emg), 0), emg)
    found_ = segment(raw.through(Envelope(cutoff_hz=10.0, rate_hz=RATE), Standardise(freeze_s=10.0), Stack()))
    starts = found_.primitives[found_.repetition > 0, 0]
    places = [(s - a) / (b - a) for s in starts for a, b in pairwise(touch) if a <= s < b]
    spread = (
        np.sqrt(-2 * np.log(np.abs(np.exp(2j * np.pi * np.array(places)).mean()))) / (2 * np.pi) if places else np.nan
    )
    return (
        f"Treadmill walking, 13 muscles: {len(touch) - 1} gait cycles, {len(starts)} repetitions; "
        f"circular sd of their start {spread:.1%} of a cycle."
    )


def speed() -> str:
    """Stack and segment 75 features at 30 Hz, one frame at a time; in the thread's own time, which other work does not change."""
    rng, n = np.random.default_rng(0), 9000
    turn = np.arange(n) * 0.2
    kind = (np.arange(n) // 450) % 5
    mix = rng.normal(size=(5, 4, 15))
    circle = np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)], 1)
    x = np.einsum("nk,nkd->nd", circle, mix[kind]) + 0.1 * rng.normal(size=(n, 15))
    rows = []
    for window_s in (60.0, 600.0):
        stack, segments = Stack(), Segment(window_s=window_s)
        spec = stack.open({"in": StreamSpec((15,), rate_hz=RATE)})["out"]
        segments.open({"in": spec})
        stamps, took = grid(RATE, n), np.empty(n)
        for i in range(n):
            begun = time.thread_time_ns()
            for stacked in _chunks(stack.process("in", Chunk(stamps[i : i + 1], x[i : i + 1], int(stamps[i])))):
                segments.process("in", stacked)
            took[i] = (time.thread_time_ns() - begun) / 1e6
        took = took[100:]
        cells = [took.mean(), *np.quantile(took, [0.5, 0.99, 0.999]), took.max()]
        rows.append([f"{window_s:g} s", *(f"{v:.3f}" for v in cells), f"{segments.memory_bytes / 1e6:.1f}"])
    return table(["window", "mean ms/frame", "median", "p99", "p99.9", "longest", "memory, MB"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--radii", action="store_true", help="every recording's best fixed radius, and leave-one-out")
    parser.add_argument("--speed", action="store_true", help="only the speed")
    args = parser.parse_args()
    folder = Path(os.environ.get("KINEGRAPH_DATA", "")) / "segmentation"
    if not args.speed and folder.is_dir():
        print(
            activities(folder, args.radii),
            repetitions(folder),
            muscles(folder.parent / "emg" / "emg_santuz_tw12.npz"),
            sep="\n\n",
        )
        print()
    print(speed())


if __name__ == "__main__":
    main()
