"""Whole streams of a recording for formats that hold them as wholes: on their regular grid, with missing samples as NaN."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.devices.formats.exporter import Export
from kinegraph.devices.formats.timing import regular
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, Times
from kinegraph.stream.data.series import Series
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.text.safe_text import say

MAX_OFF = 0.5
"""A stamp may be this many periods away from its place on a regular grid."""
MAX_STEP = 3.0
"""Between samples that are further apart, in periods, nothing is interpolated."""
MAX_SAMPLES = 1 << 30
"""A stream with gaps so long that its grid would have more samples is refused."""


@dataclass(frozen=True, slots=True)
class Gathered:
    """A stream: stamps (n,) ns, samples (n, ...), samples lost before each (n,) (-1: some; None: nothing is lost)."""

    name: str
    spec: StreamSpec
    time: Times
    data: Array
    lost: Array | None = None

    @property
    def is_markers(self) -> bool:
        return not self.spec.is_event and len(self.spec.shape) == 2 and self.spec.shape[1] == 3

    @property
    def labels(self) -> list[str]:
        count = self.spec.shape[self.spec.channel_axis] if self.spec.shape else 0
        return list(self.spec.channels) or [f"channel{i + 1}" for i in range(count)]

    def on_grid(self, share: float) -> GriddedStream | None:
        """The samples at `share` times their nominal rate; None where a stamp is more than half a period away from that grid."""
        rate = self.nominal_hz * share
        if share == 1.0 and len(self.time) > 2 and (found := regular(self.time, rate)) is not None:
            index = np.round((found[1] - found[1][0]) * (rate / NS)).astype(np.int64)
            return GriddedStream(self, rate, int(self.time[0]), self._at(index))
        index = self.index
        away = (self.time - self.time[0]) - index * (NS / rate)
        middle, off = (away.max() + away.min()) / 2, (away.max() - away.min()) / 2 * rate / NS
        if off > MAX_OFF:
            return None
        return GriddedStream(self, rate, int(self.time[0]) + round(middle), self._at(index), off)

    def interpolated(self) -> GriddedStream:
        """The samples at the nominal rate by cubic splines through their stamps, NaN where some are missing."""
        from scipy.interpolate import CubicSpline

        rate, seconds = self.nominal_hz, (self.time - self.time[0]) / NS
        wanted = np.arange(self._within(int(seconds[-1] * rate) + 1)) / rate
        after = np.clip(np.searchsorted(seconds, wanted), 1, len(seconds) - 1) if len(seconds) > 1 else 0 * wanted
        hole = np.diff(seconds, prepend=seconds[:1]) * rate > MAX_STEP
        if self.lost is not None:
            hole |= self.lost != 0
        data = self.data.reshape(len(seconds), -1)
        out = np.full((len(wanted), data.shape[1]), np.nan)
        distinct = np.diff(seconds, prepend=-1.0) > 0
        for c, column in enumerate(data.T):
            fine = np.isfinite(column)
            if (fine & distinct).sum() < 2:
                continue
            values = CubicSpline(seconds[fine & distinct], column[fine & distinct])(wanted)
            out[:, c] = np.where(hole[after] | ~fine[after] | ~fine[after - 1], np.nan, values)
        return GriddedStream(
            self, rate, int(self.time[0]), out.reshape(len(wanted), *self.data.shape[1:]), self.off, resampled=True
        )

    @property
    def nominal_hz(self) -> float:
        """The rate that the stream declares. Raises RecordingError without a rate or samples."""
        rate = self.spec.rate_hz
        if rate is None or not len(self.time):
            raise RecordingError(
                f"stream {self.name!r} has {'no samples' if rate else 'no regular rate'}; leave it out with --stream"
            )
        return rate

    @property
    def index(self) -> Times:
        """The number (n,) of each sample: what was recorded as lost counts, unless the stamps differ from it by more than one sample."""
        lost = np.zeros(len(self.time), np.int64) if self.lost is None else self.lost
        seen, counted = np.diff(self.time) * (self.nominal_hz / NS), lost[1:] + 1
        known = (lost[1:] >= 0) & (np.abs(seen - counted) <= 1)
        steps = np.where(known, counted, np.maximum(1, np.round(seen))).astype(np.int64)
        return np.concatenate([[0], np.cumsum(steps)])

    @property
    def fitted_hz(self) -> float:
        """The rate of the straight line that fits the stamps best."""
        if len(self.time) < 3:
            return self.nominal_hz
        return float(NS / np.polyfit(self.index, self.time - self.time[0], 1)[0])

    @property
    def off(self) -> float:
        """By how many periods a stamp is away from the grid of the fitted rate, at most."""
        away = (self.time - self.time[0]) - self.index * (NS / self.fitted_hz)
        return float((away.max() - away.min()) / 2 * self.fitted_hz / NS)

    def _at(self, index: Times) -> Samples:
        out = np.full((self._within(int(index[-1]) + 1), *self.data.shape[1:]), np.nan)
        out[index] = self.data
        return out

    def _within(self, count: int) -> int:
        if count > MAX_SAMPLES:
            raise RecordingError(f"stream {self.name!r}: its gaps are so long that it would have {count} samples")
        return count


@dataclass(frozen=True, slots=True)
class GriddedStream:
    """A stream at a regular rate: stamp of the first sample, samples (n, ...), NaN where some are missing.

    off        by how many periods a stamp is away from this grid, at most; None: by no more than the rounding of stamps
    resampled  whether the samples are interpolated
    """

    stream: Gathered
    rate_hz: float
    start: int
    data: Samples
    off: float | None = None
    resampled: bool = False

    def report(self) -> None:
        if self.off is None:
            return
        far = f"{self.off:.2g} periods ({1000 * self.off / self.rate_hz:.2g} ms)"
        if self.resampled:
            say(
                f"{self.stream.name}: resampled to {self.rate_hz:.7g} Hz; its stamps are up to {far} off a regular rate"
            )
            return
        nominal = self.stream.nominal_hz
        fitted = "" if self.rate_hz == nominal else f", the rate that fits its stamps (nominal {nominal:.7g} Hz)"
        say(f"{self.stream.name}: written at {self.rate_hz:.7g} Hz{fitted}; a stamp is at most {far} off it")


def on_grids(streams: Sequence[Gathered], *, resample: bool = False) -> list[GriddedStream]:
    """All streams of a file that has one clock, at their nominal rates, or at the rates that fit the stamps of one of them.

    The nominal rates hold if every stamp lies within half a period of its place; a device's true rate differs by some millionths. With
    `resample` a stream that does not fit is interpolated at its nominal rate. Raises RecordingError where nothing fits.
    """
    longest = sorted(streams, key=lambda one: -len(one.time))
    for share in [1.0] if resample else [1.0, *(one.fitted_hz / one.nominal_hz for one in longest)]:
        grids = [one.on_grid(share) or (one.interpolated() if resample else None) for one in streams]
        if len(fitting := [grid for grid in grids if grid is not None]) == len(streams):
            for grid in fitting:
                grid.report()
            return fitting
    worst = max(streams, key=lambda one: one.off)
    if worst.off <= MAX_OFF:
        rates = ", ".join(f"{one.name} {one.fitted_hz:.7g} Hz" for one in streams)
        raise RecordingError(
            f"one file has one clock, these streams have several ({rates}): choose with --stream, or --resample"
        )
    raise RecordingError(
        f"stream {worst.name!r}: its stamps are up to {worst.off:.2g} periods off those of samples at {worst.fitted_hz:.7g} Hz, the "
        f"rate that fits them; interpolate it at {worst.nominal_hz:.7g} Hz with --resample"
    )


def gather(wanted: Export) -> list[Gathered]:
    """Every stream that is wanted, in memory."""
    made = []
    for name in wanted.names:
        spec = wanted.recording.stream(name).spec
        whole = Series.of_chunks(name, spec, wanted.recording.chunks(name))
        made.append(Gathered(name, spec, whole.time, whole.data, whole.lost))
        wanted.progress(len(whole))
    return made


def the_one(streams: list[Gathered], what: str, kind: str) -> Gathered:
    """The only stream that fits into a file of one stream. Raises RecordingError with those there are."""
    if len(streams) != 1:
        listed = ", ".join(one.name for one in streams) or "it holds no streams"
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
            result = str(one.data[text][i]) if text else ""
            made.append((onset, length, result or label, str(one.spec.meta.get("side") or "")))
    return sorted(made, key=lambda event: event[0])
