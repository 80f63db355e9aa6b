"""`python -m bench.missing`: what missing values cost the count of repetitions. Simulated, through the nodes of segment_kinect; Markdown.

Three exercises of ten repetitions, 4 s apart, before a depth camera with 6 mm of noise; lost is a wrist, or by chance a share of the frames
or of every joint's values. `--write` puts the table into docs/lab/segmentation-figures.md; `--quick`: to see that
it works, not for figures.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from bench.motion import Series, before_camera, events, features
from bench.report import Section, marks, publish, whole
from kinegraph.devices.people.exerciser import JOINTS, Exerciser
from kinegraph.operators.segmentation import Segment
from kinegraph.stream.chunk import NS

EXERCISES = ("arms", "squat", "knees")
TIMES, PAUSE_S, NOISE_MM = 10, 4.0, 6.0
LOSSES = {
    "nothing is missing": (0.0, 0.0),
    "a wrist throughout": (0.0, 0.0),
    "a tenth of the frames, by chance": (0.1, 0.0),
    "a fifth of the frames": (0.2, 0.0),
    "three frames in ten": (0.3, 0.0),
    "a tenth of every joint's values, by chance": (0.0, 0.1),
    "a fifth of every joint's values": (0.0, 0.2),
    "three in ten of every joint's values": (0.0, 0.3),
}
"""By what is lost: the share of frames, and of every joint's values."""


def seen(seed: int, lost: str) -> tuple[Series, list[tuple[float, float]]]:
    """The joints that come, and from when to when each exercise is done."""
    exerciser = Exerciser(exercises=EXERCISES, repetitions=TIMES, pause_s=PAUSE_S, noise_mm=NOISE_MM, seed=seed)
    rng = np.random.default_rng((seed, 9))
    joints, spans = before_camera(exerciser, len(EXERCISES), rng)
    frames, values = LOSSES[lost]
    joints.data[rng.random(len(joints.data)) < frames] = np.nan
    joints.data[rng.random(joints.data.shape[:2]) < values] = np.nan
    if "wrist" in lost:
        joints.data[:, JOINTS.index("wrist_r")] = np.nan
    return joints, spans


def off_by(seed: int, lost: str, *, fills: bool = True) -> list[int]:
    """How many repetitions more or fewer than were done are counted in the time of each exercise."""
    joints, spans = seen(seed, lost)
    parts = events(features(joints, fills=fills), Segment())["primitive"]
    parts = parts[parts["repetition"] > 0]
    middle = (parts["onset"] + parts["end"]) / 2 / NS
    return [abs(int(((middle >= a - 0.5) & (middle < b + 0.5)).sum()) - TIMES) for a, b in spans]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.missing", description=__doc__)
    parser.add_argument("--draws", type=int, default=20, help="how many sessions of each kind (20)")
    parser.add_argument("--quick", action="store_true", help="one session of each")
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/segmentation-figures.md")
    given = parser.parse_args()
    seeds, rows = range(1 if given.quick else given.draws), []
    for lost in LOSSES:
        print(f"{lost} ...", file=sys.stderr, flush=True)
        filled, bare = (np.array([off_by(seed, lost, fills=fills) for seed in seeds]) for fills in (True, False))
        rows.append([lost, *(str(int(n)) for n in ((filled == 0).sum(), (filled <= 1).sum(), (bare == 0).sum()))])
    header = ["counted", "exactly", "within 1", "exactly, if nothing is filled in"]
    about = f"Of {len(seeds) * len(EXERCISES)} sets of {TIMES}, {PAUSE_S:g} s apart, with {NOISE_MM:g} mm of noise."
    sections = [Section("Missing values", header, rows, [about])]
    print(whole(sections, "By `python -m bench.missing`."))
    if given.write:
        publish(sections, "By `python -m bench.missing`.", "lab/segmentation-figures.md", *marks("bench.missing"))


if __name__ == "__main__":
    main()
