"""`python -m bench.rests`: does standing still mislead the segmentation? Before the motion, and between repetitions; Markdown.

The first needs the folder of recordings that KINEGRAPH_DATA names: somebody stands for 0, 20 and 60 s (the first frame, with noise), then
does what was recorded; scores are of what was recorded, and that the motion began is not counted as a cut. The second is simulated: ten
repetitions, standing before each and after the last, and sets of ten with 30 s between them. `--write` puts the tables into
docs/lab/segmentation-figures.md; `--quick`: to see that it works, not for figures.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.motion import RATE, before_camera, events, features, kinect, poses, regular, segment
from bench.report import Section, marks, publish, whole
from kinegraph.devices.people.exerciser import EXERCISES, Exerciser
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.evaluation.found import Found
from kinegraph.operators.segmentation.evaluation.scores import TOLERANCE_S, score
from kinegraph.operators.segmentation.evaluation.truth import read_truth
from kinegraph.stream.chunk import NS, Array

STILL_S = (0, 20, 60)
NOISES = {
    "CMU-86, 4 channels": 0.5,
    "CMU-86, full body": 0.3,
    "exercises, full body": 0.3,
    "exercises, 12 channels": 0.5,
}
"""The noise of somebody who stands: 0.5 degrees, 0.3 cm."""
KINECT_M = 0.003
PAUSES_S = (1.5, 4.0, 8.0)
BREAK_S = 30.0
NOISES_MM = (1.0, 6.0, 10.0)
TIMES = 10


def standing(data: Array, seconds: float, noise: float) -> Array:
    """`data` (n, width) behind its first frame, held for so long with noise."""
    n = round(seconds * RATE)
    return np.concatenate([data[0] + noise * np.random.default_rng(n).normal(size=(n, data.shape[1])), data])


def behind(found: Found, seconds: float) -> Found:
    """What was found after so many seconds, counted from there; without what ends as the motion begins, within the scores' tolerance."""
    begins = seconds + TOLERANCE_S if seconds else 0.0

    def cut(spans: Array) -> Array:
        return np.maximum(spans - seconds, 0.0)

    acts, parts = found.activities[:, 1] > begins, found.primitives[:, 1] > begins
    return replace(
        found,
        activities=cut(found.activities[acts]), transition=found.transition[acts], primitives=cut(found.primitives[parts]),
        cluster=found.cluster[parts], repetition=found.repetition[parts], second=None,
    )  # fmt: skip


def before(folder: Path, *, quick: bool) -> Section:
    """Stillness before the motion: F1 of boundaries by set, and Kinect recordings with repetitions counted within 1."""
    f1: dict[str, list[list[float]]] = {}
    for kind, name, pose, truth in poses(folder):
        print(f"{kind}: {name} ...", file=sys.stderr, flush=True)
        still = [regular(standing(pose.data, s, NOISES[kind])).through(Stack()) for s in STILL_S]
        made = [score(behind(segment(x), s), truth).f1 for x, s in zip(still, STILL_S, strict=True)]
        for group in (kind, "all"):
            f1.setdefault(group, []).append(made)
        if quick:
            break
    rows = [[f"{kind}, mean of {len(made)}", *(f"{v:.3f}" for v in np.mean(made, axis=0))] for kind, made in f1.items()]
    close, many = np.zeros(len(STILL_S), int), 0
    for path in sorted(folder.glob("msrc12/*.npz"))[: 1 if quick else None]:
        print(f"{path.stem} ...", file=sys.stderr, flush=True)
        pose, count = kinect(path), len(read_truth(path).keys)
        many += 1
        for k, s in enumerate(STILL_S):
            found = segment(regular(standing(pose.data, s, 100 * KINECT_M)).through(Stack()))
            close[k] += abs(int((found.repetition > 0).sum()) - count) <= 1
    rows.append([f"MSRC-12: counted within 1, of {many}", *map(str, close)])
    return Section("Standing before the motion", ["F1 of boundaries", *(f"{s} s" for s in STILL_S)], rows)


def between(draws: int) -> Section:
    """Ten repetitions with a pause before each and after the last one, and three sets of ten: how often all are counted exactly."""
    rows = []
    for exercise in EXERCISES:
        made = []
        for repetitions, pause in [(1, pause) for pause in PAUSES_S] + [(TIMES, BREAK_S)]:
            print(f"{exercise}, {pause:g} s ...", file=sys.stderr, flush=True)
            tries = [(noise, seed) for noise in NOISES_MM for seed in range(draws)]
            exact = dict.fromkeys(NOISES_MM, 0)
            for noise, seed in tries:
                exact[noise] += counted(exercise, repetitions, pause, noise, seed)
            made.append(" ".join(map(str, exact.values())))
        rows.append([exercise, *made])
    header = [
        f"exact, of {draws} each",
        *(f"{pause:g} s before each" for pause in PAUSES_S),
        f"sets, {BREAK_S:g} s apart",
    ]
    return Section(
        "Standing between repetitions", header, rows, [f"With {', '.join(f'{n:g}' for n in NOISES_MM)} mm of noise."]
    )


def counted(exercise: str, repetitions: int, pause: float, noise: float, seed: int) -> bool:
    """Whether all that is done is counted, in the time in which it is done, through the nodes of segment_kinect."""
    exerciser = Exerciser(exercises=(exercise,), repetitions=repetitions, pause_s=pause, noise_mm=noise, seed=seed)
    sets = TIMES if repetitions == 1 else 3
    joints, spans = before_camera(exerciser, sets, np.random.default_rng((seed, 9)))
    found = events(features(joints), Segment())["primitive"]
    found = found[found["repetition"] > 0]
    if repetitions == 1:
        return len(found) == sets
    middle = (found["onset"] + found["end"]) / 2.0 / NS
    return (
        all(((middle > a - 0.5) & (middle < b + 0.5)).sum() == repetitions for a, b in spans)
        and len(found) == sets * repetitions
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.rests", description=__doc__)
    parser.add_argument("--draws", type=int, default=12, help="how many simulated sets of each kind (12)")
    parser.add_argument("--quick", action="store_true", help="one recording and one draw of each")
    parser.add_argument("--write", action="store_true", help="write the tables into docs/lab/segmentation-figures.md")
    given = parser.parse_args()
    folder = Path(os.environ.get("KINEGRAPH_DATA", "")) / "segmentation"
    if not os.environ.get("KINEGRAPH_DATA") or not folder.is_dir():
        sys.exit("KINEGRAPH_DATA must name a folder of recordings that holds `segmentation`")
    sections = [before(folder, quick=given.quick), between(1 if given.quick else given.draws)]
    print(whole(sections, "By `python -m bench.rests`."))
    if given.write:
        publish(sections, "By `python -m bench.rests`.", "lab/segmentation-figures.md", *marks("bench.rests"))


if __name__ == "__main__":
    main()
