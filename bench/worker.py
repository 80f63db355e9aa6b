"""One contender in a process of its own: takes orders as lines of JSON, and answers each with one.

An order: {"style": ..., "operators": identities, "chunk": samples, "count": chunks, "paced": bool, "keep": samples}. With `keep`, so many
samples are sent and the output is hashed. Between orders it sleeps, so that
contenders can take turns within seconds, and what disturbs the machine disturbs all of them alike.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from bench.work import POOL, Feed, Sink, kernel_steps, outcome, samples, scipy_steps, stamped_steps

KERNELS, RECORDED, STAMPED, PROFILED, SCIPY, OWN, FED, SESSION, UNRECORDED = (
    "kernels",
    "recorded",
    "stamped",
    "profiled",
    "scipy",
    "own",
    "fed",
    "session",
    "unrecorded",
)
"""What a contender's operators run: our kernels on bare arrays (also recording what comes in), or on all that we carry, stamps too (with a
profiler, too), scipy, its own operators; and kinegraph's ways in: a session records, or, like the peers, does not."""


class Driver(Protocol):
    """How one engine is made to do the work."""

    def versions(self) -> dict[str, str]:
        """What is being measured."""

    def drive(self, style: str, steps: Sequence[Any], feed: Feed, sink: Sink) -> tuple[int, int]:
        """Send all of `feed` through one operator per step into `sink` (None: an operator that passes on what it gets).

        Returns (samples per row, place of the sample that completes a row), where the style does not keep to the chain's.
        """


def steps_of(order: dict[str, Any]) -> Sequence[Any]:
    """What the operators do: nothing, if a number of them is ordered, or the chain's four steps."""
    if order.get("operators"):
        return [None] * order["operators"]
    if order["style"] in (STAMPED, PROFILED):
        return stamped_steps()
    return scipy_steps() if order["style"] == SCIPY else kernel_steps()


def run(driver: Driver, order: dict[str, Any]) -> dict[str, Any]:
    """One run of the driver, and what came of it."""
    chunk, count, paced = order["chunk"], order["count"], order.get("paced", False)
    if keep := order.get("keep"):
        data = samples(keep)
        arrays = [data[i : i + chunk].copy() for i in range(0, keep, chunk)]
        count = len(arrays)
    else:
        data = samples(POOL * chunk)
        arrays = [data[i : i + chunk].copy() for i in range(0, len(data), chunk)]
    feed = Feed(arrays, count, paced=paced)
    sink = Sink(bool(keep))
    rows = driver.drive(order["style"], steps_of(order), feed, sink)
    if order.get("operators"):
        rows = (1, 0)
    return outcome(feed, sink, *rows)


def serve(driver: Driver) -> None:
    """Answer orders until the input ends. What libraries print goes to the error output."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    sys.path.insert(0, str(Path.cwd()))
    print(json.dumps(driver.versions()), file=answers, flush=True)
    for line in sys.stdin:
        try:
            answer = run(driver, json.loads(line))
        except Exception:  # noqa: BLE001  (whatever it was: it is reported, and the others go on)
            answer = {"error": traceback.format_exc()}
        print(json.dumps(answer), file=answers, flush=True)
