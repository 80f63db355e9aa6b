"""What the rules against Python's own stalls are worth (`stream/system/stalls.py`): the paced chain with each of them on and off.

`python -m bench.stalls` prints a table of the latency from when a chunk's last sample is due to the sink, beside nothing, beside a thread
that computes in Python without end, and beside one that makes garbage while a million objects are alive. Every row runs in a process of
its own; rounds are interleaved.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import table
from kinegraph.stream.system.stalls import FIRST_GENERATION, SWITCH_INTERVAL_S

ROOT = Path(__file__).resolve().parent.parent
BESIDE = ("nothing", "busy", "garbage")


@dataclass(slots=True)
class Variant:
    """One setting of the rules.

    freeze     what is alive at the start is frozen
    first      how many new objects set off a collection
    switch_ms  the switch interval
    nogil      the chain's kernels give up the interpreter's lock
    """

    name: str
    freeze: bool = True
    first: int = FIRST_GENERATION
    switch_ms: float = SWITCH_INTERVAL_S * 1000
    nogil: bool = False
    due: dict[str, list[int]] = field(default_factory=dict)


VARIANTS = [
    Variant("as kinegraph sets it"),
    Variant("Python's own settings", freeze=False, first=700, switch_ms=5.0),
    Variant("nothing frozen", freeze=False),
    Variant("a collection every 700 new objects", first=700),
    Variant("a collection every 5 000 new objects", first=5_000),
    Variant("a collection every 50 000 new objects", first=50_000),
    Variant("switch interval 5 ms", switch_ms=5.0),
    Variant("switch interval 0.5 ms", switch_ms=0.5),
    Variant("switch interval 0.2 ms", switch_ms=0.2),
    Variant("switch interval 0.1 ms", switch_ms=0.1),
    Variant("switch interval 0.02 ms", switch_ms=0.02),
    Variant("kernels release the lock", nogil=True),
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=4.0, help="of every run")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--only", default="", help="variants with this text in their name")
    parser.add_argument("--beside", nargs="+", choices=BESIDE, default=BESIDE)
    parser.add_argument("--one", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(_one(**json.loads(given.one))))
    else:
        print(measure(given.seconds, given.rounds, given.only, given.beside))


def measure(seconds: float, rounds: int, only: str, neighbours: Sequence[str]) -> str:
    """The table: median, 99th percentile and maximum in ms, per setting and neighbour."""
    variants = [v for v in VARIANTS if only in v.name]
    for _ in range(rounds):
        for beside in neighbours:
            for v in variants:
                order = {
                    "freeze": v.freeze,
                    "first": v.first,
                    "switch_ms": v.switch_ms,
                    "nogil": v.nogil,
                    "beside": beside,
                    "seconds": seconds,
                }
                v.due.setdefault(beside, []).extend(_ask(order))
    header = ["", *(f"{name}: p50 / p99 / max ms" for name in neighbours)]
    rows = [[v.name, *(_cell(v.due[beside]) for beside in neighbours)] for v in variants]
    return table(header, rows)


def _cell(due: list[int]) -> str:
    return " / ".join(f"{ms:.2f}" for ms in np.percentile(np.array(due) / 1e6, [50, 99, 100]))


def _ask(order: dict[str, Any]) -> list[int]:
    command = [sys.executable, "-m", "bench.stalls", "--one", json.dumps(order)]
    quiet = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=quiet, stdout=subprocess.PIPE, text=True, check=True)
    due: list[int] = json.loads(done.stdout.splitlines()[-1])
    return due


def _one(*, freeze: bool, first: int, switch_ms: float, nogil: bool, beside: str, seconds: float) -> list[int]:
    """One run in this process."""
    import structlog

    from bench.contenders.kinegraph_graph import Kinegraph
    from bench.work import RATE_HZ
    from bench.worker import SESSION, run
    from kinegraph.stream.system import stalls

    structlog.configure(logger_factory=structlog.ReturnLoggerFactory())
    stalls.SWITCH_INTERVAL_S = switch_ms / 1000  # type: ignore[misc]
    stalls.FIRST_GENERATION = first  # type: ignore[misc]
    if not freeze:
        gc.freeze = lambda: None
    if nogil:
        _release_the_lock()
    order = {"style": SESSION, "chunk": 10, "paced": True}
    run(Kinegraph(), order | {"count": 20})
    with _neighbour(beside):
        due: list[int] = run(Kinegraph(), order | {"count": round(seconds * RATE_HZ / 10)})["due_ns"]
    return due


def _release_the_lock() -> None:
    """The chain's kernels, compiled so that they give up the lock."""
    import numba

    from kinegraph.operators.filters import decimate, iir, moving, rectify

    for module, names in (
        (rectify, ["magnitudes"]),
        (iir, ["late_sections", "sections"]),
        (decimate, ["thin_out"]),
        (moving, ["moving_mean"]),
    ):
        for name in names:
            setattr(module, name, numba.njit(nogil=True, error_model="numpy")(getattr(module, name).py_func))


@contextmanager
def _neighbour(beside: str) -> Iterator[None]:
    """Within: a thread that does what `beside` says."""
    stop = threading.Event()
    alive = [[i] for i in range(1_000_000)] if beside == "garbage" else []
    work = {"nothing": lambda: None, "busy": lambda: _compute(stop), "garbage": lambda: _litter(stop)}[beside]
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        alive.clear()


def _compute(stop: threading.Event) -> None:
    while not stop.is_set():
        sum(i * i for i in range(1000))


def _litter(stop: threading.Event) -> None:
    """Objects that only the collector frees, ten thousand each ten milliseconds."""
    while not stop.wait(0.01):
        for _ in range(10_000):
            ring: list[Any] = []
            ring.append(ring)


if __name__ == "__main__":
    main()
