"""How whole streams, from files or arrays, become a recording that replays as if it had been live."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import FOREVER, NS, Chunk
from kinegraph.stream.data.series import Series as Series
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder
from kinegraph.stream.recording.format.paths import (
    discard,
    draft_of,
    lock_recording,
    parts_of,
    publish,
    unlock_recording,
)


def write_recording(
    path: Path,
    series: Sequence[Series],
    header: dict[str, Any],
    *,
    chunk_s: float = 0.02,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write `series` as the input log of a session in which samples came in windows of `chunk_s`, all streams side by side.

    Each window gives every stream a chunk, empty where it has no sample, with `until` at the window's last nanosecond; the last ones
    say that the streams have ended. Windows in which nothing at all happens are left out. The recording appears under its name when it
    is complete, and not at all if something fails; with `overwrite` it takes the place of one that is there. Raises RecordingError.
    """
    if not series or not any(len(s.time) for s in series):
        raise RecordingError("there are no samples to record")
    if parts_of(path) and not overwrite:
        raise RecordingError(f"{path}: already holds a recording; choose another --out, or replace it with --overwrite")
    held, _ = lock_recording(path, taken=overwrite)
    draft = draft_of(path)
    try:
        discard(draft)  # of an import that was killed
        _write(draft, series, header, _Windows(series, round(chunk_s * NS)), progress)
        publish(draft, path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        discard(draft)
        unlock_recording(path, held)


def _write(
    path: Path,
    series: Sequence[Series],
    header: dict[str, Any],
    windows: _Windows,
    progress: Callable[[int, int], None] | None,
) -> None:
    recorder = Recorder(path, header, RecordingOptions(), wait=True)
    try:
        numbers = [recorder.add_stream(s.name, s.spec, "input") for s in series]
        sequence = 0
        for k in range(len(windows.ends)):
            for number, one, cuts in zip(numbers, series, windows.cuts, strict=True):
                for chunk in windows.chunks(one, cuts, k):
                    recorder.write(number, chunk, int(windows.ends[k]), sequence)
                    sequence += 1
            if progress and k % 256 == 0:
                progress(k, len(windows.ends))
    finally:
        recorder.close()
    recorder.check()


class _Windows:
    """Times at which all streams are cut, and where that is in each."""

    def __init__(self, series: Sequence[Series], width: int) -> None:
        start = min(int(s.time[0]) for s in series if len(s.time))
        taken = np.unique(np.concatenate([(s.time - start) // width for s in series]))
        self.ends = start + (taken + 1) * width - 1
        self.cuts = [np.concatenate([[0], np.searchsorted(s.time, self.ends, side="right")]).tolist() for s in series]

    def chunks(self, series: Series, cuts: list[int], k: int) -> Iterator[Chunk]:
        """What `series` has in the k-th window: one chunk, or several where samples are missing inside it."""
        first, last = cuts[k], cuts[k + 1]
        until = FOREVER if k == len(self.ends) - 1 else int(self.ends[k])
        whole = Chunk(series.time[first:last], series.data[first:last], until)
        if series.lost is None or first == last:
            yield whole
            return
        lost = series.lost[first:last]
        at = [0, *(np.flatnonzero(lost[1:]) + 1).tolist(), last - first]
        for start, stop in pairwise(at):
            piece = whole.part(start, stop)
            piece.lost = int(lost[start])
            yield piece
