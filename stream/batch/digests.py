"""One hash of everything a job's results depend on: an unchanged job is not run again."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields, is_dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from kinegraph.stream.batch.jobs import Job
from kinegraph.stream.graph import Graph
from kinegraph.stream.graph.components import is_ours
from kinegraph.stream.recording import versions
from kinegraph.stream.system.file_digest import sha256_of
from kinegraph.stream.system.names import PACKAGES

LONGEST_PATH = 4096


def job_digest(job: Job, graph: Graph, recording: str) -> str:
    """The hash of a job: its graph and settings, the recording's hash, the code, and the files that parameters name."""
    facts = {
        "graph": graph.text,
        "settings": dict(job.settings),
        "recording": recording,
        "code": code_digest(),
        "own code": {name: sha256_of(path) for name, path in sorted(_own_code(graph).items())},
        "models": {str(path): sha256_of(path) for path in sorted(_files_named(graph))},
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True, default=str).encode()).hexdigest()


@cache
def code_digest() -> str:
    """The hash of kinegraph's own sources, and the versions of what computes beside them."""
    digest = hashlib.sha256(json.dumps(versions(), sort_keys=True).encode())
    for package in PACKAGES:
        root = Path(str(files("kinegraph") / package))
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def recording_digest(path: Path, known: Mapping[str, Any]) -> dict[str, Any]:
    """{"sha256", "files": {name: [bytes, ns of the last change]}} of a recording, which is read only where `known` has other files.

    Of a session's folder, its .mcap files count: reports and tables may be added to it afterwards. Raises OSError, KinegraphError.
    """
    parts = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    files = {part.name: [(found := part.stat()).st_size, found.st_mtime_ns] for part in parts}
    if known.get("files") == files:
        return dict(known)
    whole = hashlib.sha256()
    for part in parts:
        whole.update(sha256_of(part).encode())
    return {"sha256": whole.hexdigest(), "files": files}


def _own_code(graph: Graph) -> dict[str, Path]:
    """The files of nodes from outside kinegraph."""
    modules = {type(node.part).__module__ for node in graph.nodes.values() if not is_ours(node.part)}
    found = {name: getattr(sys.modules.get(name), "__file__", None) for name in modules}
    return {name: Path(file) for name, file in found.items() if file}


def _files_named(graph: Graph) -> set[Path]:
    """The files that nodes' parameters name, in so far as they are there: models, references, calibrations."""
    return {path for node in graph.nodes.values() for path in _paths(_values(node.part)) if path.is_file()}


def _values(part: object) -> list[Any]:
    return [getattr(part, f.name) for f in fields(part)] if is_dataclass(part) else []


def _paths(values: Iterable[Any]) -> Iterable[Path]:
    for value in values:
        if isinstance(value, os.PathLike) or (
            isinstance(value, str) and 0 < len(value) < LONGEST_PATH and "\0" not in value
        ):
            yield Path(value)
        elif isinstance(value, list | tuple):
            yield from _paths(value)
        elif isinstance(value, Mapping):
            yield from _paths(value.values())
        elif is_dataclass(value) and not isinstance(value, type):
            yield from _paths(asdict(value).values())
