"""Marks that people make in a recording afterwards: a file beside it. The recording itself is never changed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.page.transfer.wire import MAX_TEXT
from kinegraph.stream.chunk import Array, Chunk, StreamSpec, Times
from kinegraph.stream.data.json_file import read_json, write_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.manual import ANNOTATION

MARKS = "marks"
"""The name of their stream on the page."""
SPEC = StreamSpec((), ANNOTATION, units=("ns", ""))
MAX_MARKS = 10_000


class Marks:
    """The marks of a recording, in the order of time. `path` is their file: `marks.json` in a session's folder, else FILE.marks.json."""

    def __init__(self, recording: Path) -> None:
        """Raises KinegraphError for a file that holds no marks."""
        self.path = recording / "marks.json" if recording.is_dir() else recording.with_suffix(".marks.json")
        found = read_json(self.path, "a file of marks") if self.path.exists() else {"marks": []}
        try:
            self._marks = sorted((int(mark["onset_ns"]), str(mark["text"])[:MAX_TEXT]) for mark in found["marks"])
            np.array([onset for onset, _ in self._marks], np.int64)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise KinegraphError(f"{self.path}: is not a file of marks ({error!r})") from None

    def add(self, new: Sequence[tuple[int, str]]) -> None:
        """Mark some moments (ns), and write the file once. Raises KinegraphError where it cannot be written, or has no room for all."""
        room = MAX_MARKS - len(self._marks)
        marks = sorted([*self._marks, *new[:room]])
        if marks != self._marks:
            write_json(self.path, {"marks": [{"onset_ns": onset, "text": text} for onset, text in marks]})
            self._marks = marks
        if len(new) > room:
            raise KinegraphError(f"{self.path}: holds {MAX_MARKS} marks, and takes no more")

    def read(self) -> tuple[Times, Array]:
        """Stamps (n,) and events (n,), as of the stream `annotations`."""
        return np.array([onset for onset, _ in self._marks], np.int64), np.array(self._marks, ANNOTATION)

    def chunk(self) -> Chunk:
        time, data = self.read()
        return Chunk(time, data, int(time[-1]) if len(time) else 0)


def shown_with(panels: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Panels that show annotations show the marks as well; without such a panel there is a table of them."""
    made = [{**p, "of": [*p["of"], MARKS]} if "annotations" in p["of"] and MARKS not in p["of"] else p for p in panels]
    return (
        made
        if any(MARKS in panel["of"] for panel in made)
        else [*made, {"kind": "table", "of": [MARKS], "title": "marks"}]
    )
