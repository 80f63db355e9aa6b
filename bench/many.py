"""`python -m bench.many`: what a batch costs beside its jobs.

cores      the same jobs by one worker and by two, in turns: how much faster two are
overhead   a job's wall time in a batch beside a bare loop of replays that write the same tables, in one process
scheduler  sleeping jobs on 1 to 16 workers of one thread: what Dask adds to a job
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import kinegraph as kg
from stream.batch.cluster import LOCAL, workers
from stream.batch.jobs import jobs
from stream.batch.study import batch
from stream.batch.work import Common, do

GRAPH = """
nodes:
  board: {use: devices.simulators.treadmill.Treadmill, realtime: false, duration_s: 120}
  rectify: {use: operators.rectify.Rectify, from: board.emg}
  smooth: {use: operators.iir.Lowpass, from: rectify, cutoff_hz: 6}
record: [smooth]
"""
SLEEP_S = 0.05


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.many", description=__doc__)
    parser.add_argument("--jobs", type=int, default=16, help="replays of two minutes of 13 channels at 1 kHz")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--sleeping", type=int, default=2000, help="jobs that only sleep; up to 100 000")
    given = parser.parse_args()
    with TemporaryDirectory(prefix="kinegraph-bench-") as folder:
        _replays(Path(folder), given.jobs, given.rounds)
    _scheduler(given.sleeping)


def _replays(folder: Path, count: int, rounds: int) -> None:
    (folder / "graph.yaml").write_text(GRAPH)
    kg.run(kg.load(folder / "graph.yaml"), folder / "walk")
    common = Common(GRAPH, "graph", str(folder / "graph.yaml"))
    todo = jobs([folder / "walk"], {"smooth.cutoff_hz": [4 + k / 8 for k in range(count)]})
    took: dict[str, list[float]] = {"bare loop": [], "one worker": [], "two workers": []}
    for at in range(rounds):
        bare = folder / f"bare{at}"
        bare.mkdir()
        common.save(bare)
        do(bare, todo[0])  # what is imported and compiled once is not the loop's
        began = time.perf_counter()
        for job in todo:
            do(bare, job)
        took["bare loop"].append((time.perf_counter() - began) / max(count - 1, 1))
        for name, workers_ in (("one worker", 1), ("two workers", 2)):
            marks: list[float] = []
            batch(
                common,
                todo,
                folder / f"{name}{at}",
                count=workers_,
                progress=lambda _, m=marks: m.append(time.perf_counter()),
            )
            first = workers_ + 1  # each worker's first job imports and loads the kernels
            took[name].append((marks[-1] - marks[first]) / max(len(marks) - 1 - first, 1))
    for name, values in took.items():
        print(
            f"{name:12} {statistics.median(values) * 1e3:8.1f} ms a job (rounds: {', '.join(f'{v * 1e3:.0f}' for v in values)})"
        )
    ratios = [one / two for one, two in zip(took["one worker"], took["two workers"], strict=True)]
    print(f"two workers are {statistics.median(ratios):.2f} times as fast as one")
    over = [one - bare for one, bare in zip(took["one worker"], took["bare loop"], strict=True)]
    print(f"one worker takes {statistics.median(over) * 1e3:.1f} ms a job more than the bare loop")


def _scheduler(count: int) -> None:
    from distributed import as_completed

    for threads in (1, 4, 16):
        with workers(LOCAL, threads, 0, 0) as client:
            client.wait_for_workers(threads)
            began = time.perf_counter()
            finished = as_completed([client.submit(time.sleep, SLEEP_S, pure=False) for _ in range(threads)])
            left = count - threads
            for _ in finished:
                if left > 0:
                    left -= 1
                    finished.add(client.submit(time.sleep, SLEEP_S, pure=False))
            took = time.perf_counter() - began
        ideal = SLEEP_S * count / threads
        print(
            f"{threads:3} workers, {count} sleeping jobs: {(took - ideal) / count * 1e3:.2f} ms a job beyond the sleep"
        )


if __name__ == "__main__":
    main()
