"""What a laboratory's file turned out to hold: streams, facts, when it began, and what is doubtful about it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.timing import check_order, grid_of, plain_unit, regular, resolution
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec
from kinegraph.stream.domain.finding import Finding
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import Series

VOLTAGES = ("uV", "mV", "V")
SPELT = {
    "g": "g",
    "nt": "N",
    "ntmm": "Nmm",
    "n": "N",
    "nmm": "Nmm",
    "n.mm": "Nmm",
    "nm": "Nm",
    "n.m": "Nm",
    "volt": "V",
    "volts": "V",
    "v": "V",
    "microv": "uV",
    "uv": "uV",
    "mv": "mV",
    "mm": "mm",
    "m": "m",
    "deg": "deg",
    "degrees": "deg",
    "deg/s": "deg/s",
    "dps": "deg/s",
    "n/a": "",
}
"""Units as laboratories' programs spell them, and as we do; any other stays as it is."""


class RateMissing(RecordingError):
    """A file tells neither times nor a rate: somebody must say it."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What somebody says of a file because it does not say it itself.

    rate_hz    of streams without times; None: not given
    unit       of streams without one; "": not given
    skip_rows  lines before the header that are passed over
    repeated   whether repeated times are accepted
    """

    rate_hz: float | None = None
    unit: str = ""
    skip_rows: int = 0
    repeated: bool = False


@dataclass(slots=True)
class Understood:
    """A file as it was understood. Times of the series are ns since the file's time 0.

    kind    the program that wrote it and the grammar, for people
    begin   when time 0 was (ns UTC); None: the file does not say
    facts   about the session and the person, without names
    doubts  what was taken for granted, or contradicts itself, in words
    claims  what the file claims, and does not hold
    """

    path: Path
    kind: str
    series: list[Series] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)
    claims: list[Finding] = field(default_factory=list)
    begin: int | None = None

    def doubt(self, words: str) -> None:
        """Note something doubtful, once."""
        if words not in self.doubts:
            self.doubts.append(words)

    def find(self, claimed: str, seen: str, consequence: str = "", remedy: str = "") -> None:
        """The file's header claims something that does not hold."""
        self.claims.append(Finding("header", self.path.name, claimed, seen, consequence, remedy))

    def name(self, part: str) -> str:
        return f"{self.path.stem}.{part}"

    def add(self, part: str, data: Array, rate_hz: float, **facts: Any) -> None:
        """A regular stream from `start_ns` (default 0) on; `facts`: channels, units, meta, lost."""
        start, lost = facts.pop("start_ns", 0), facts.pop("lost", None)
        index = np.arange(len(data)) if lost is None else np.arange(len(data)) + np.cumsum(lost)
        spec = _spec(data, rate_hz, **facts)
        keep = lost if lost is not None and lost.any() else None
        self.series.append(Series(self.name(part), spec, grid_of(rate_hz, index, start), data, keep))

    def add_timed(self, part: str, seconds: Samples, data: Array, line: int, asked: Asked, **facts: Any) -> None:
        """A stream with samples taken at `seconds`, the first of them in line `line`.

        `rate_hz` among `facts` is what the file says the rate is: it holds if the times agree with it, and is doubted if not.
        """
        declared_hz = facts.pop("rate_hz", None)
        if bad := np.flatnonzero(~np.isfinite(seconds) | (np.abs(seconds) > 4e9)).tolist():
            raise RecordingError(f"{self.path}: line {line + bad[0]}: the time is missing or not a number")
        time = np.round(seconds * NS).astype(np.int64)
        check_order(time, f"{self.path}: line", line, repeated=asked.repeated)
        middle = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
        sparse = declared_hz is not None and len(seconds) > 1 and middle * declared_hz > 1.5
        found = regular(time, declared_hz) if declared_hz and not sparse else None
        if found is None:
            found = regular(time, None)
            if declared_hz and len(time) > 1:
                self.doubt(
                    f"the file says {declared_hz:g} Hz, but its times are {middle:g} s apart: the times are believed"
                )
        if found is not None and np.abs(found[1] - time).max() > 0.02 * NS / found[0] + resolution(time):
            found = None
        if found is None:
            if len(time) > 2:
                self.doubt(f"{part}: its times are not those of a regular signal; they are kept as they are")
            self.series.append(Series(self.name(part), _spec(data, None, **facts), time, data))
            return
        rate, stamps, lost = found
        keep = lost if lost.any() else None
        self.series.append(Series(self.name(part), _spec(data, rate, **facts), stamps, data, keep))

    def add_events(
        self,
        part: str,
        seconds: Sequence[float],
        texts: Sequence[str] | None = None,
        lengths: Sequence[float] | None = None,
        **meta: Any,
    ) -> None:
        """Events at `seconds`, with a text each if there are any, and with an `end` where lengths (s) are known."""
        order = sorted(range(len(seconds)), key=lambda i: seconds[i])
        onset = np.array([round(seconds[i] * NS) for i in order], np.int64)
        width = max((len(text) for text in texts or ()), default=0) or 1
        fields = [("onset", "<i8")]
        fields += [("end", "<i8")] if lengths is not None else []
        fields += [("text", f"<U{width}")] if texts is not None else []
        data = np.empty(len(onset), np.dtype(fields))
        data["onset"] = onset
        if lengths is not None:
            data["end"] = onset + np.array([round(lengths[i] * NS) for i in order], np.int64)
        if texts is not None:
            data["text"] = [texts[i] for i in order]
        units = tuple("" if name == "text" else "ns" for name, _ in fields)
        self.series.append(Series(self.name(part), StreamSpec((), data.dtype, units=units, meta=meta), onset, data))

    def local_time(self, moment: datetime | None) -> None:
        """When time 0 was; one without a zone is taken for UTC, and doubted."""
        if moment is None:
            return
        if moment.tzinfo is None:
            self.doubt(f"it began at {moment.isoformat()} by a clock of an unknown time zone: taken for UTC (--start)")
            moment = moment.replace(tzinfo=UTC)
        whole = moment.replace(microsecond=0)
        if not 1900 <= moment.year <= 2100:
            self.doubt(f"it claims to be of the year {moment.year}: not believed")
            return
        self.begin = round(whole.timestamp()) * NS + moment.microsecond * 1000


def _spec(data: Array, rate_hz: float | None, **facts: Any) -> StreamSpec:
    channels = distinct(facts.pop("channels", ()))
    units = tuple(unit_of(unit) for unit in facts.pop("units", ("",)))
    units = units[:1] if len(set(units)) == 1 else units
    return StreamSpec(data.shape[1:], data.dtype, rate_hz, channels, units, **facts)


def unit_of(text: str) -> str:
    """A unit as we spell it."""
    plain = plain_unit(text.strip())
    return SPELT.get(plain.lower(), plain)


def distinct(names: Iterable[str]) -> tuple[str, ...]:
    """The names, those that stand there again with their number: EMG, EMG_2."""
    made: list[str] = []
    for i, name in enumerate(names):
        given = name.strip() or f"channel{i + 1}"
        again = given
        while again in made:
            again = f"{given}_{i + 1}" if again == given else f"{again}_"
        made.append(again)
    return tuple(made)


def without_prefix(names: Sequence[str]) -> list[str]:
    """Names without what stands before a colon (a subject), if they differ all the same."""
    short = [name.rpartition(":")[2] for name in names]
    return short if len(set(short)) == len(short) else list(names)


def voltage_by_size(data: Array) -> str:
    """The unit that raw EMG of this size must be in."""
    finite = np.abs(data[np.isfinite(data)])
    size = float(np.median(finite)) if len(finite) else 0.0
    return "V" if size < 2e-3 else "mV" if size < 2.0 else "uV"
