"""Whole streams of a recording for formats that hold them as wholes: on their regular grid, with missing samples as NaN."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from devices.files.exporter import Export
from devices.files.timing import regular
from stream.chunk import NS, Array, Samples, StreamSpec, Times
from stream.errors import RecordingError

MOST_SAMPLES = 1 << 30
"""A stream with gaps so long that its grid would have more samples is refused."""


@dataclass(frozen=True, slots=True)
class Gathered:
    """A stream: stamps (n,) ns, samples (n, ...)."""

    name: str
    spec: StreamSpec
    time: Times
    data: Array

    @property
    def is_markers(self) -> bool:
        return not self.spec.is_event and len(self.spec.shape) == 2 and self.spec.shape[1] == 3

    @property
    def labels(self) -> list[str]:
        count = self.spec.shape[self.spec.channel_axis] if self.spec.shape else 0
        return list(self.spec.channels) or [f"channel{i + 1}" for i in range(count)]

    def gridded(self) -> tuple[float, int, Samples]:
        """Rate, the first stamp, and samples on the regular grid, NaN where some are missing. Raises RecordingError."""
        rate = self.spec.rate_hz
        if rate is None or not len(self.time):
            raise RecordingError(
                f"stream {self.name!r} has {'no samples' if rate else 'no regular rate'}; leave it out with --stream"
            )
        index = np.round((self.time - self.time[0]) * (rate / NS)).astype(np.int64)
        if len(self.time) > 2 and (found := regular(self.time, rate)) is not None:
            index = np.round((found[1] - found[1][0]) * (rate / NS)).astype(np.int64)
        if (np.diff(index) < 1).any() or index[-1] >= MOST_SAMPLES:
            raise RecordingError(
                f"stream {self.name!r}: its stamps are not those of samples at {rate:g} Hz; resample it first"
            )
        out = np.full((int(index[-1]) + 1, *self.data.shape[1:]), np.nan)
        out[index] = self.data
        return rate, int(self.time[0]), out


def gather(wanted: Export) -> list[Gathered]:
    """Every stream that is wanted, in memory."""
    made = []
    for name in wanted.names:
        time, data = wanted.recording.read(name)
        made.append(Gathered(name, wanted.recording.streams[name].spec, time, data))
        wanted.progress(len(time))
    return made


def the_one(streams: list[Gathered], what: str, kind: str) -> Gathered:
    """The only stream that fits into a file of one stream. Raises RecordingError with those there are."""
    if len(streams) != 1:
        listed = ", ".join(one.name for one in streams) or "there are none"
        raise RecordingError(f"{what} holds one stream of {kind}; name it with --stream ({listed})")
    return streams[0]


def events_of(streams: list[Gathered]) -> list[tuple[int, int | None, str, str]]:
    """Of every event stream: (onset ns, length ns or None, label, side) in the order of time."""
    made: list[tuple[int, int | None, str, str]] = []
    for one in streams:
        names = one.spec.dtype.names or ()
        if not one.spec.is_event:
            continue
        onsets = one.data["onset"] if "onset" in names else one.time
        ends = one.data["end"] if "end" in names else None
        text = next(
            (name for name in ("text", "label", "name") if name in names and one.spec.dtype[name].kind == "U"), ""
        )
        label = str(one.spec.meta.get("label") or one.name.rpartition(".")[2])
        for i, onset in enumerate(onsets.tolist()):
            length = int(ends[i]) - onset if ends is not None and ends[i] > onset else None
            told = str(one.data[text][i]) if text else ""
            made.append((onset, length, told or label, str(one.spec.meta.get("side") or "")))
    return sorted(made, key=lambda event: event[0])
