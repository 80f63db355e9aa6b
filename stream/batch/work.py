"""One job, in a worker: a recording replayed through the graph, its recorded outputs written as tables."""

from __future__ import annotations

import hashlib
import json
import os
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from kinegraph.stream.batch.digests import job_digest, recording_digest
from kinegraph.stream.batch.jobs import Job
from kinegraph.stream.batch.manifest import JobEntry, Manifest
from kinegraph.stream.batch.parquet import ParquetTable
from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.errors import KinegraphError, RecordingError, explain
from kinegraph.stream.graph import Edge, Graph
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format.versions import release
from kinegraph.stream.system.atomic_file import complete, private_folder, write_complete
from kinegraph.stream.system.file_permissions import is_foreign

STUDY = ".graph.json"


@dataclass(frozen=True, slots=True)
class Common:
    """What all jobs of a batch share; lies in the results' folder, where every worker finds it.

    path   where the graph's file is: modules and models are looked for beside it
    again  do what is done already, too
    """

    text: str
    name: str
    path: str
    trusted_only: bool = False
    again: bool = False

    def save(self, folder: Path) -> None:
        """Raises OSError."""
        write_complete(folder / STUDY, json.dumps(asdict(self)))

    @property
    def digest(self) -> str:
        """What the jobs of a batch know it by."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()

    @classmethod
    def load(cls, folder: Path) -> Common:
        return cls(**json.loads((folder / STUDY).read_text(encoding="utf-8")))

    def graph(self, recording: Recording, settings: Mapping[str, Any]) -> Graph:
        """The graph of a job; raises GraphError."""
        specs = {name: stream.spec for name, stream in recording.streams.items()}
        trusted_only = self.trusted_only or is_foreign(Path(self.path))
        return load_text(
            self.text, self.name, path=self.path, recorded=specs, overrides=settings, trusted_only=trusted_only
        )


def do(folder: Path, job: Job, *, digest: str = "") -> tuple[JobEntry, bool]:
    """Do a job, unless what its results depend on is as it was: what came of it, and whether it was done now.

    What is wrong with a graph, a recording or the disk is in the entry; nothing is raised for it. `digest` is that of the job's batch, ""
    that of any: a job fails and writes nothing after another batch took the folder.
    """
    manifest, common, began = Manifest(folder), Common.load(folder), time.monotonic()
    if digest not in ("", common.digest):
        other = f"{folder} is another batch's now, with another graph or other options; nothing was written"
        return JobEntry(job.key, job.name, job.settings, "failed", "", error=other), True
    before = manifest.load(job.key)
    facts: dict[str, Any] = {
        "key": job.key,
        "name": job.name,
        "settings": job.settings,
        "digest": "",
        "version": release(),
    }
    facts["worker"] = f"{socket.gethostname()}:{os.getpid()}"
    try:
        found = recording_digest(job.recording, before.recording if before else {})
        with Recording.open(job.recording) as recording:
            graph = common.graph(recording, job.settings)
            facts |= {"digest": job_digest(job, graph, found["sha256"]), "recording": found}
            facts["graph"] = hashlib.sha256(graph.text.encode()).hexdigest()
            if before and before.digest == facts["digest"] and not (before.failed or common.again):
                return before, False
            manifest.forget(job.key)
            facts |= _replayed(folder, job, graph, recording)
        entry = JobEntry(**facts, took_s=time.monotonic() - began)
    except Exception as error:  # noqa: BLE001 - a job's failure is a row in `failed`, whatever it is; the other jobs go on
        manifest.forget(job.key)
        entry = JobEntry(**facts, status="failed", error=_why(error), took_s=time.monotonic() - began)
    manifest.save(entry)
    return entry, True


def _replayed(folder: Path, job: Job, graph: Graph, recording: Recording) -> dict[str, Any]:
    """Replay the recording and write its tables: what goes into the job's entry."""
    facts = dict(recording.header.get("session") or {})
    graph.session = facts
    replay = Replay(graph, recording)
    labels = facts | {name: _label(value) for name, value in job.settings.items()}
    files, left_out = dict[str, str](), dict[str, str]()
    tables: dict[str, ParquetTable] = {}
    with ExitStack() as written:
        for edge in recorded_edges(replay.graph):
            name = f"{edge}/recording={quote(job.name, safe='')}/{job.key}.parquet"
            spec = replay.graph.nodes[edge.node].specs[edge.output]
            try:
                table = written.enter_context(_table(folder / name, spec, labels))
            except RecordingError as error:
                left_out[str(edge)] = str(error)
                continue
            files[str(edge)], tables[str(edge)] = name, table
            replay.observe(str(edge), table.add)
        done = replay.run()
    return {
        "status": "incomplete" if recording.missing else "done",
        "error": f"the recording was not closed cleanly; missing: {recording.missing.words}"
        if recording.missing
        else "",
        "facts": facts,
        "tables": files,
        "rows": {name: table.rows for name, table in tables.items()},
        "left_out": left_out,
        "begin_ns": recording.begin_of_inputs,
        "seconds": done.seconds,
    }


def _why(error: Exception) -> str:
    return str(error) if isinstance(error, KinegraphError) else explain(error)


def recorded_edges(graph: Graph) -> list[Edge]:
    """The outputs that become tables: those that the graph records, or else all of its operators. Raises KinegraphError."""
    computed = [Edge(node.name, out) for node in graph.nodes.values() if not node.is_source for out in node.specs]
    found = [edge for edge in graph.record if not graph.nodes[edge.node].is_source] or computed
    if not found:
        raise KinegraphError("the graph computes nothing that could go into a table; name outputs under `record`")
    return found


@contextmanager
def _table(path: Path, spec: Any, labels: Mapping[str, Any]) -> Iterator[ParquetTable]:
    """Within: a table is written; it takes its name when it is complete."""
    private_folder(path.parent)
    with complete(path) as draft:
        table = ParquetTable(draft, spec, labels)
        try:
            yield table
        finally:
            table.close()


def _label(value: Any) -> Any:
    return value if isinstance(value, bool | int | float | str) else json.dumps(value, default=str)
