"""All of a batch in order: the graph is checked, workers are started, jobs are done, what came of them is collected."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from filelock import FileLock, Timeout

from kinegraph.stream.batch.cluster import LOCAL, Lost, spread, workers
from kinegraph.stream.batch.jobs import Job
from kinegraph.stream.batch.manifest import JobEntry, Manifest
from kinegraph.stream.batch.parquet import ROWS, arrow
from kinegraph.stream.batch.results import write_lists
from kinegraph.stream.batch.work import Common, do, recorded_edges
from kinegraph.stream.errors import KinegraphError, RecordingError
from kinegraph.stream.graph import Graph
from kinegraph.stream.graph.plan import plan
from kinegraph.stream.recording import Recording
from kinegraph.stream.system.atomic_file import private_folder
from kinegraph.stream.system.memory_limit import ceiling

LOCK = ".lock"
WORKER_BYTES = 400_000_000
"""What a worker takes before it holds anything of a job: Python, numba, the kernels, Arrow."""


@dataclass(slots=True)
class BatchState:
    """How a batch stands.

    made     jobs done now, by status ("done", "incomplete", "failed")
    kept     jobs with results that are still valid
    failed, incomplete   what failed, and what is of recordings that broke off, done now or before
    left_out  outputs that the graph records and that are in no table, with the reason
    seconds  of recordings replayed now
    workers  jobs done now, by worker
    """

    jobs: int
    made: Counter[str] = field(default_factory=Counter)
    kept: int = 0
    failed: list[JobEntry] = field(default_factory=list)
    incomplete: list[JobEntry] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    workers: Counter[str] = field(default_factory=Counter)

    @property
    def finished(self) -> int:
        return self.kept + sum(self.made.values())

    def add(self, entry: JobEntry, now: bool) -> None:
        self.kept += not now
        self.made[entry.status] += now
        self.workers.update([entry.worker] if now and entry.worker else [])
        self.seconds += entry.seconds if now else 0.0
        self.left_out |= entry.left_out
        if entry.failed:
            self.failed.append(entry)
        elif entry.status == "incomplete":
            self.incomplete.append(entry)


def batch(
    common: Common,
    jobs: Sequence[Job],
    folder: Path,
    *,
    where: str = LOCAL,
    count: int = 0,
    retries: int = 1,
    progress: Callable[[BatchState], None] = lambda tally: None,
) -> BatchState:
    """Do all jobs that are not done, into `folder`; what came of each lies there as soon as it is finished.

    count   of workers; 0: as many as there are cores, and memory for (four on a cluster)

    Raises GraphError where the graph suits no recording, KinegraphError where there are no workers or not enough memory.
    """
    arrow()
    private_folder(folder)
    with _owned(folder):
        needed = memory_of(common, jobs)
        count = number_of_workers(where, count, len(jobs), needed)
        common.save(folder)
        tally, manifest = BatchState(len(jobs)), Manifest(folder)
        progress(tally)
        one = partial(do, folder.absolute(), digest=common.digest)
        try:
            with workers(where, count, needed, retries, folder) as client:
                for job, came in spread(client, one, jobs):
                    entry, now = (_lost(manifest, job, came.error), True) if isinstance(came, Lost) else came
                    tally.add(entry, now)
                    progress(tally)
        finally:
            write_lists(manifest)
    return tally


@contextmanager
def _owned(folder: Path) -> Iterator[None]:
    """Within: the folder is this batch's alone. Raises KinegraphError while another one is at work there."""
    held = FileLock(folder / LOCK)
    try:
        held.acquire(blocking=False)
    except Timeout:
        raise KinegraphError(
            f"{folder}: another batch is at work there; name another folder with -o, or wait"
        ) from None
    try:
        yield
    finally:
        held.release()


def memory_of(common: Common, jobs: Sequence[Job]) -> int:
    """Bytes that a worker needs for the largest of these jobs, as planned on the first recording that can be read.

    Raises GraphError where the graph cannot run on it.
    """
    combinations = list({job.key: job for job in jobs}.values())
    for path in dict.fromkeys(job.recording for job in jobs):
        try:
            recording = Recording.open(path)
        except (KinegraphError, OSError):
            continue
        with recording:
            here = [common.graph(recording, job.settings) for job in combinations if job.recording == path]
            return WORKER_BYTES + max(plan(graph, enforce=False).memory_bytes + _waiting(graph) for graph in here)
    raise RecordingError("no recording can be read; `kinegraph info RECORDING` says why")


def number_of_workers(where: str, asked: int, jobs: int, needed: int) -> int:
    """How many work at the same time: on this machine, no more than there is memory for. Raises KinegraphError."""
    if where != LOCAL:
        return min(asked or 4, jobs)
    room = ceiling(0) // needed if ceiling(0) else jobs
    if not room:
        raise KinegraphError(f"a job needs {needed / 1e6:.0f} MB; {ceiling(0) / 1e6:.0f} MB may be taken here")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(asked or cores, jobs, room))


def _waiting(graph: Graph) -> int:
    """Bytes of rows that wait for the tables."""
    specs = [graph.nodes[edge.node].specs[edge.output] for edge in recorded_edges(graph)]
    return sum(ROWS * (spec.sample_bytes + 16) * 2 for spec in specs)


def _lost(manifest: Manifest, job: Job, error: BaseException) -> JobEntry:
    """The entry of a job after its worker died."""
    died = type(error).__name__ == "KilledWorker"
    text = "its worker died while it was at work (killed for memory, or crashed)" if died else f"{error}"
    manifest.forget(job.key)
    entry = JobEntry(job.key, job.name, job.settings, "failed", "", error=text)
    manifest.save(entry)
    return entry
