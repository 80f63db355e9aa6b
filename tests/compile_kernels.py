"""`python -m tests.compile_kernels`: runs every operator once on its own case, in as many processes as there are cores.

Two test processes that start without a cache would otherwise compile the same kernels side by side.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import time

from kinegraph.stream.engine.warmup import _run_cases
from kinegraph.stream.graph.components import catalogue, find
from kinegraph.stream.operator import Operator

SLOWEST = ("Segment", "NameRepetitions", "WholePose", "SteerMesh", "PoseGrid", "MotionMap", "PeakMixtures", "Extrema")
"""These compile longest and start first, so that the last process does not end alone."""


def main() -> None:
    began = time.perf_counter()
    found, _ = catalogue(("operators",))
    order = {name: place for place, name in enumerate(SLOWEST)}
    uses = sorted(found, key=lambda use: (order.get(use.rpartition(".")[2], len(order)), use))
    with multiprocessing.get_context("spawn").Pool(min(os.cpu_count() or 1, 8)) as pool:
        for _ in pool.imap_unordered(compile_kernels, uses):
            pass
    print(f"compiled the kernels of {len(uses)} operators in {time.perf_counter() - began:.0f} s")


def compile_kernels(use: str) -> None:
    importlib.import_module("kinegraph.stream.graph.reading.load")
    part = find(use)
    if issubclass(part, Operator) and (cases := part.cases()):
        _run_cases(cases[0].operator)


if __name__ == "__main__":
    main()
