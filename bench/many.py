"""`python -m bench.many`: what a batch costs beside its jobs, as a table for docs/lab/batch.md.

cores      the same jobs by one worker and by two, in turns: how much faster two are
overhead   a job's wall time in a batch beside a bare loop of replays that write the same tables, in one process
scheduler  sleeping jobs on 1 to 16 workers of one thread: what Dask adds to a job beyond its sleep, through the loop of a batch

`--sleeping 100000` is the whole; it takes 40 minutes, most of them asleep.
"""

from __future__ import annotations

import argparse
import statistics
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import kinegraph as kg
from bench.report import short
from kinegraph.stream.batch.cluster import LOCAL, Lost, spread, workers
from kinegraph.stream.batch.jobs import jobs
from kinegraph.stream.batch.study import batch
from kinegraph.stream.batch.work import Common, do

GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 120}
  rectify: {use: operators.filters.rectify.Rectify, from: board.emg}
  smooth: {use: operators.filters.iir.Lowpass, from: rectify, cutoff_hz: 6}
record: [smooth]
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m bench.many", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--jobs", type=int, default=12, help="replays of two minutes of 13 channels at 1 kHz; 0: skip")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--sleeping", type=int, default=2000, help="jobs that only sleep; up to 100000; 0: skip")
    parser.add_argument("--sleep-ms", type=float, default=10.0)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 4, 16], help="of the sleeping jobs")
    given = parser.parse_args()
    tell("| | |")
    tell("|---|--:|")
    if given.jobs:
        with TemporaryDirectory(prefix="kinegraph-bench-") as folder:
            replays(Path(folder), max(given.jobs, 5), given.rounds)
    for count in given.workers if given.sleeping else ():
        over, busy, theirs = overhead_s(count, given.sleeping, given.sleep_ms / 1e3)
        what = f"{given.sleeping} jobs that sleep {given.sleep_ms:g} ms, {count} workers"
        tell(f"| scheduler, {what}: beyond the sleep | {short(over * 1e3)} ms a job |")
        tell(f"| CPU time of the scheduler and its client, {count} workers | {short(busy * 1e3)} ms a job |")
        tell(f"| CPU time of the {count} workers together | {short(theirs * 1e3)} ms a job |")


def tell(line: str) -> None:
    print(line, flush=True)


def replays(folder: Path, count: int, rounds: int) -> None:
    """Rows of the table: a job in a bare loop, with one worker and with two."""
    (folder / "graph.yaml").write_text(GRAPH)
    kg.run(kg.load(folder / "graph.yaml"), folder / "walk")
    common = Common(GRAPH, "graph", str(folder / "graph.yaml"))
    todo = jobs([folder / "walk"], {"smooth.cutoff_hz": [4 + k / 8 for k in range(count)]})
    took: dict[str, list[float]] = {"bare loop": [], "one worker": [], "two workers": []}
    for at in range(rounds):
        took["bare loop"].append(bare_s(folder / f"bare{at}", common, todo))
        for name, number in (("one worker", 1), ("two workers", 2)):
            took[name].append(batch_s(folder / f"{name}{at}", common, todo, number))
    for name, values in took.items():
        rest = ", ".join(f"{value * 1e3:.0f}" for value in values)
        tell(
            f"| {name}, {count} replays of 2 minutes (rounds: {rest}) | {statistics.median(values) * 1e3:.0f} ms a job |"
        )
    ratios = [one / two for one, two in zip(took["one worker"], took["two workers"], strict=True)]
    tell(f"| two workers against one | {statistics.median(ratios):.2f} times |")
    over = [one - bare for one, bare in zip(took["one worker"], took["bare loop"], strict=True)]
    tell(f"| one worker beyond the bare loop | {statistics.median(over) * 1e3:.0f} ms a job |")


def bare_s(folder: Path, common: Common, todo: list[Any]) -> float:
    """Seconds a job, in one process and thread; what the first job imports and loads is not counted."""
    folder.mkdir()
    common.save(folder)
    do(folder, todo[0])
    began = time.perf_counter()
    for job in todo[1:]:
        do(folder, job)
    return (time.perf_counter() - began) / (len(todo) - 1)


def batch_s(folder: Path, common: Common, todo: list[Any], number: int) -> float:
    """Seconds a job once every worker has done its first, which imports and loads the kernels."""
    marks: list[float] = []
    batch(common, todo, folder, count=number, progress=lambda _: marks.append(time.perf_counter()))
    return (marks[-1] - marks[number]) / (len(marks) - 1 - number)  # marks[0] is the begin


def overhead_s(count: int, jobs: int, sleep_s: float) -> tuple[float, float, float]:
    """Seconds that a job takes beyond its share of the sleep, on `count` workers of one thread each; of CPU here; of CPU in the workers."""
    with workers(LOCAL, count, 0, 0) as client:
        made: Any = client  # distributed is not typed
        made.wait_for_workers(count)
        made.gather([made.submit(time.sleep, 0.01, pure=False) for _ in range(4 * count)])  # each has done one
        theirs = -sum(made.run(time.process_time).values())
        began, busy = time.perf_counter(), time.process_time()
        ended = sum(not isinstance(came, Lost) for _, came in spread(client, partial(_sleep, sleep_s), range(jobs)))
        took, busy = time.perf_counter() - began, time.process_time() - busy
        theirs += sum(made.run(time.process_time).values())
    assert ended == jobs
    return (took - sleep_s * jobs / count) / jobs, busy / jobs, theirs / jobs


def _sleep(seconds: float, _: int) -> None:
    time.sleep(seconds)


if __name__ == "__main__":
    main()
