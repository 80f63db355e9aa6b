"""`python -m bench.tssb`: the segmentation on series of shapes in a row (Time Series Segmentation Benchmark); Markdown.

Given is what the benchmark gives: the window, made a second of 20 frames; a frame is one window around it, in seven steps.
All else is the operator's defaults. Beside it: no cut at all, and whether the operator itself is sure that something repeats, to see
whether that tells where its cuts are good. `--write` puts the table into docs/lab/segmentation-figures.md.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import numpy as np

from bench.motion import Series, events, regular
from bench.report import Section, marks, publish, whole
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.evaluation.scores import covering
from kinegraph.stream.chunk import NS, Samples

FRAMES = 20
OFFSETS = (-10, -7, -3, 0, 3, 7, 10)
GOOD = 0.5
"""Below this covering a cut is worth little."""


def frames(x: Samples, window: int) -> Series:
    """A series as one number a frame, FRAMES of them in a window."""
    width = max(1, round(window / FRAMES))
    calm = np.convolve((x - x.mean()) / x.std(), np.full(width, 1.0 / width), "same")
    at = np.arange(round(len(x) * FRAMES / window)) * window / FRAMES
    return regular(np.interp(at, np.arange(len(x)), calm)[:, None], float(FRAMES)).through(Stack(offsets=OFFSETS))


def scored(series: Series, truth: Samples) -> tuple[float, float, float]:
    """Covering, that without any cut, and the share of the time that lies in activities which are certain to repeat."""
    found = events(series, Segment())["activity"]
    length_s = len(series.data) / FRAMES
    lasted = (found["end"] - found["onset"]) / NS
    sure = lasted[found["repeats"] & (found["certainty"] > 0.0)].sum() / length_s
    cuts = np.sort(found["onset"][1:] - series.stamps[0]) / NS
    return covering(cuts, truth, length_s), covering(np.empty(0), truth, length_s), float(sure)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.tssb", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/segmentation-figures.md")
    given = parser.parse_args()
    folder = Path(os.environ.get("KINEGRAPH_DATA", "")) / "segmentation" / "tssb"
    if not os.environ.get("KINEGRAPH_DATA") or not folder.is_dir():
        sys.exit("KINEGRAPH_DATA must name a folder of recordings that holds `segmentation/tssb`")
    rows = []
    for line in (folder / "desc.txt").read_text(encoding="utf-8").split():
        name, window, *changes = line.split(",")
        series = frames(np.loadtxt(folder / f"{name}.txt"), int(window))
        rows.append(scored(series, np.array(changes, float) / int(window)))
    table = np.array(rows)
    made = []
    for label, chosen in (
        ("all", np.ones(len(table), bool)),
        ("certain to repeat, most of the time", table[:, 2] >= 0.5),
        ("not", table[:, 2] < 0.5),
    ):
        part = table[chosen]
        good = f"{(part[:, 0] >= GOOD).sum()} of {len(part)}"
        made.append([label, f"{part[:, 0].mean():.3f}", f"{part[:, 1].mean():.3f}", good])
    head = ["series", "covering", "without any cut", f"covering of {GOOD} and more"]
    sections = [Section("Shapes in a row (TSSB)", head, made)]
    print(whole(sections, "By `python -m bench.tssb`."))
    if given.write:
        publish(sections, "By `python -m bench.tssb`.", "lab/segmentation-figures.md", *marks("bench.tssb"))


if __name__ == "__main__":
    main()
