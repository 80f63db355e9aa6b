"""stumpy's FLOSS and claspy's streaming ClaSP, fed one channel sample by sample: `python segmenters.py NAME FILE WINDOW LENGTH`.

FILE holds the channel (.npy). Its first WINDOW samples fill the window, those after FIRST more are timed, in the thread's own time.
Subsequences are of LENGTH samples; all else is as the library has it. Prints JSON: its version, and milliseconds of every sample timed.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np

FIRST = 100
"""Samples after the window is full that are not timed: functions are compiled in the first."""

Update = Callable[[float], Any]


def stumpy(filled: Any, length: int) -> Update:
    import stumpy

    profile = stumpy.stump(filled, length)
    update: Update = stumpy.floss(profile, filled, m=length, L=length).update
    return update


def claspy(filled: Any, length: int) -> Update:
    from claspy.streaming.segmentation import StreamingClaSPSegmentation

    stream = StreamingClaSPSegmentation(n_timepoints=len(filled), n_warmup=10 * length, window_size=length)
    for value in filled:
        stream.update(value)
    update: Update = stream.update
    return update


def main() -> None:
    name, file, window, length = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    x = np.load(file)
    update = {"stumpy": stumpy, "claspy": claspy}[name](x[:window].copy(), length)
    took = []
    for value in x[window : window + FIRST].tolist():
        update(value)
    for value in x[window + FIRST :].tolist():
        begun = time.thread_time_ns()
        update(value)
        took.append((time.thread_time_ns() - begun) / 1e6)
    print(json.dumps({"version": version(name), "ms": took}))


if __name__ == "__main__":
    main()
