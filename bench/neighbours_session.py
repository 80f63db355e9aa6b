"""`python -m bench.neighbours_session`: a segmentation's neighbours by plain loops and by the index, from 10 s to an hour; Markdown.

One insertion and one query for the 32 nearest, 72 features at 30 Hz, processor time of the thread in microseconds, median / p99. Blocks of
the index are kd-sorted from windows of 8192 frames on; here each window with and without, to see from where it pays. `--write` puts the
table into docs/lab/neighbours.md.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

from bench.neighbours import Brute, Figure, Ours, motion
from bench.report import Section, marks, publish, short, whole
from kinegraph.operators.neighbours import Index, layout
from kinegraph.operators.neighbours.returning import Returning
from kinegraph.stream.chunk import Chunk, StreamSpec, grid

WIDTH, RATE = 72, 30
WINDOWS = {"10 s": 300, "1 min": 1800, "10 min": 18_000, "60 min": 108_000}
PRIMITIVE = np.dtype([("onset", "<i8"), ("end", "<i8"), ("cluster", "<i8"), ("repetition", "<i4")])
LASTS = 40
"""Frames of a repetition."""
AGAIN = 1500
"""Frames that are timed."""
MOST_MS = 0.25
"""A frame's share of the search at an hour's depth, at most."""


def sealed(frames: int, wanted: bool) -> type[Ours]:
    """The index with its blocks sorted, or not, whatever the size of its window."""

    class Chosen(Ours):
        def __init__(self, first: object) -> None:
            before, layout.SEAL_FROM = layout.SEAL_FROM, 0 if wanted else 10 * frames
            try:
                super().__init__(first)  # type: ignore[arg-type]
            finally:
                layout.SEAL_FROM = before

    return Chosen


def session(budget_s: float = 6.0) -> Section:
    rows = []
    for name, frames in WINDOWS.items():
        x = motion(frames + AGAIN, WIDTH)
        made = [
            way(x[:frames])
            for way in (Brute, sealed(frames, wanted=False), *((sealed(frames, wanted=True),) if frames > 1024 else ()))
        ]
        found = [Figure.of(one.step, x[frames:], budget_s) for one in made]
        memory = f"{made[1].index.memory_bytes / 1e6:.1f}"
        cells = [*map(str, found), *["-"] * (3 - len(found))]
        best = min(one.median for one in found[1:])
        rows.append([f"{name}, {frames} frames", *cells, f"{short(found[0].median / best)}", memory])
    head = ["window", "plain loop", "index, blocks as they came", "index, blocks kd-sorted", "loop over index", "MB"]
    note = f"Asked for is at most {1000 * MOST_MS:.0f} us a frame at an hour's depth."
    return Section("A segmentation's neighbours: 72 features at 30 Hz, the 32 nearest", head, rows, [note])


def returning(minutes: Sequence[int] = (1, 10, 60)) -> Section:
    """What `Returning` takes, a frame at a time, with so many minutes of repetitions in its index."""
    rows = []
    for depth in minutes:
        frames = depth * 60 * RATE
        x, stamps = motion(frames + AGAIN, WIDTH).astype(np.float64), grid(RATE, frames + AGAIN)
        operator = Returning(within=1.0)
        operator.open({"in": StreamSpec((WIDTH,), rate_hz=RATE), "primitive": StreamSpec((), PRIMITIVE)})
        index = Index.of(operator.state.index)
        index.follow(x[:frames], 0)
        operator.state.labels[:frames] = np.arange(frames) // (LASTS * 5)
        took = np.empty(AGAIN)
        for k in range(frames, frames + AGAIN):
            stamp, ends = int(stamps[k]), (k - frames) % LASTS == LASTS - 1
            began = time.thread_time()
            operator.process("in", Chunk(stamps[k : k + 1], x[k : k + 1], stamp))
            if ends:
                row = np.array([(stamps[k - LASTS + 1], stamp, k // (LASTS * 5) % 4096, 1)], PRIMITIVE)
                operator.process("primitive", Chunk(stamps[k : k + 1], row, stamp))
            took[k - frames] = time.thread_time() - began
        ended = took[LASTS - 1 :: LASTS]
        rows.append(
            [
                f"{depth} min",
                *(f"{1e6 * one:.0f}" for one in (np.median(took), took.mean(), np.median(ended), ended.max())),
            ]
        )
    head = ["repetitions remembered", "us a frame, median", "mean", "us where a repetition ends, median", "longest"]
    return Section(
        f"`Returning`: {WIDTH} features at {RATE} Hz, a repetition of {LASTS} frames after another", head, rows, []
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.neighbours_session", description=__doc__)
    parser.add_argument("--write", action="store_true", help="into docs/lab/neighbours.md")
    parser.add_argument("--returning", action="store_true", help="only what Returning takes")
    given = parser.parse_args()
    if given.returning:
        print(whole([returning()], "By `python -m bench.neighbours_session --returning`."))
        return
    sections = [session()]
    about = "By `python -m bench.neighbours_session`."
    print(whole(sections, about))
    if given.write:
        publish(sections, about, "lab/neighbours.md", *marks("bench.neighbours_session"))


if __name__ == "__main__":
    main()
