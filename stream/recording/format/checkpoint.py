"""The whole session on disk at regular intervals, so that a power cut costs nothing: plain arrays, written beside the recording.

A checkpoint is valid once renamed into place; the one before is kept until then. It holds no pickle and is read without any.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from kinegraph.stream.chunk import Array
from kinegraph.stream.data import bounded
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.format.versions import release
from kinegraph.stream.system.atomic_file import complete
from kinegraph.stream.system.stalls import let_others_go_on

NAME = "checkpoint.npz"
VERSION = 2

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class Checkpoint:
    """A session between two chunks.

    sequence   the last chunk of the input log that this state knows
    time       session time (ns) at which it was taken
    graph      a hash of the graph's text: another graph cannot go on from here
    promised   per source output, the `until` it had given
    indices    per queue before a worker, how many samples had passed
    arrays     the pipeline's state
    """

    sequence: int
    time: int
    graph: str
    promised: dict[str, int]
    indices: dict[str, int] = field(default_factory=dict)
    arrays: dict[str, Array] = field(default_factory=dict)

    def save(self, folder: Path) -> None:
        """Write to disk, atomically; raises OSError."""
        head = {
            "version": VERSION,
            "kinegraph": release(),
            "sequence": self.sequence,
            "time": self.time,
            "graph": self.graph,
            "promised": self.promised,
            "indices": self.indices,
            "names": list(self.arrays),
        }
        with complete(folder / NAME) as draft, draft.open("wb") as file:
            numbered = {f"a{i}": array for i, array in enumerate(self.arrays.values())}
            np.savez(file, head=np.frombuffer(json.dumps(head).encode(), np.uint8), **numbered)  # type: ignore[arg-type]

    @staticmethod
    def load(folder: Path) -> Checkpoint | None:
        """The session's last checkpoint, or None if it never came to one; raises RecordingError if it cannot be used."""
        path = folder / NAME
        if not path.exists():
            return None
        try:
            file = bounded.arrays(path)
            head: dict[str, Any] = json.loads(file["head"].tobytes())
            version, names = int(head["version"]), list(head["names"])
            arrays = {name: file[f"a{i}"] for i, name in enumerate(names)} if version <= VERSION else {}
            kept = {name: head[name] for name in ("sequence", "time", "graph", "promised", "indices")}
        except (OSError, *bounded.DAMAGE) as error:
            raise RecordingError(
                f"{path} is damaged ({error}); remove it to resume from the start of the recording"
            ) from None
        here, there = release(), str(head.get("kinegraph", "an older one"))
        if version != VERSION or there != here:
            raise RecordingError(
                f"{path} was written by another version of kinegraph ({there}; this is {here}), and its session cannot be resumed;"
                " what it recorded can be replayed: start a new session"
            )
        return Checkpoint(**kept, arrays=arrays)


class CheckpointWriter:
    """Writes checkpoints in a thread of its own, at most one at a time; a failure is reported and the run goes on."""

    def __init__(self, folder: Path, before: Callable[[], bool]) -> None:
        """`before` is called in the thread before each write: it must make the input log
        durable up to now, and say whether it did."""
        self._folder, self._before = folder, before
        self._thread: threading.Thread | None = None

    @property
    def busy(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def write(self, checkpoint: Checkpoint, after: Callable[[], None] = lambda: None) -> None:
        """Write in the background, and call `after` in that thread if it was; call this only while not `busy`."""
        self._thread = threading.Thread(target=self._save, args=(checkpoint, after), name="checkpoint", daemon=True)
        self._thread.start()

    def discard(self) -> None:
        """The session has ended well: there is nothing to resume."""
        (self._folder / NAME).unlink(missing_ok=True)

    def wait(self, timeout_s: float = 10.0) -> None:
        if self._thread:
            self._thread.join(timeout_s)

    def _save(self, checkpoint: Checkpoint, after: Callable[[], None]) -> None:
        let_others_go_on()
        try:
            if not self._before():
                raise OSError("the recording could not be written up to it")
            checkpoint.save(self._folder)
            after()
        except OSError as error:
            log.error(
                "checkpoint not written", error=str(error), effect="a resumed session would start from the one before"
            )


def fingerprint(text: str) -> str:
    """A short hash of a graph's text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]
