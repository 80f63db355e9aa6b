"""XDF files (Lab Streaming Layer, LabRecorder) as streams, through pyxdf: clock offsets applied, jitter removed."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from kinegraph.devices.formats.findings import Claims, Findings
from kinegraph.devices.formats.timing import MAX_NS, lost_by_stamps
from kinegraph.stream.chunk import NS, Array, StreamSpec, Times
from kinegraph.stream.data.bounded import check_gzip, reading
from kinegraph.stream.data.columns import assemble
from kinegraph.stream.domain.finding import Finding
from kinegraph.stream.errors import RecordingError, nearest
from kinegraph.stream.recording.series import Series

UNITS = {
    "microvolts": "uV",
    "microvolt": "uV",
    "millivolts": "mV",
    "millivolt": "mV",
    "volts": "V",
    "volt": "V",
    "normalized": "",
    "none": "",
    "meters": "m",
    "degrees": "deg",
}
"""Units as LSL's metadata conventions spell them, and as we do."""
log = structlog.get_logger(__name__)

EPOCH_S = 86_400.0
"""Streams of one recording that lie further apart than this were stamped by clocks that count from different years."""
JITTER_S = 0.5
"""By more than this no stamp is wrong because a computer was late."""
TEXT_WIDTH, MAX_TEXT = 64, 1 << 16
"""Characters that a string marker has room for: at least the first by default, and never more than the second."""


def read_xdf(
    path: Path,
    *,
    streams: dict[str, str],
    text_width: int | None = None,
    start_ns: int | None = None,
    dejitter: bool = True,
    synchronize: bool = True,
    claims: Claims = "warn",
    findings: Findings | None = None,
) -> list[Series]:
    """The streams of an XDF file, or the chosen ones: {our name: the name in the file, or name/type where that is ambiguous}.

    `start_ns` is when the first sample was (ns UTC). Without it, times are those that kinegraph's own export wrote down, or
    else begin at the file's date. String streams become events with the fields `onset` and `text` (at most
    `text_width` characters; None: as long as they are). A claim of the file that does not hold is added to
    `findings`, or as `claims` has it. Raises RecordingError.
    """
    with reading(path, "an XDF file"):
        result = _Claims(path, claims, findings if findings is not None else Findings())
        found, head = _load(path, dejitter=dejitter, synchronize=synchronize, result=result)
        return _chosen(path, found, head, streams, text_width, start_ns, result)


@dataclass(frozen=True, slots=True)
class _Claims:
    """Where findings of a file go. `policy`: what is done with them."""

    path: Path
    policy: Claims
    findings: Findings

    def find(self, kind: str, stream: str, claimed: str, seen: str, consequence: str, remedy: str) -> None:
        """A claim that does not hold. Raises RecordingError where such files are refused."""
        self.findings.find(self.path, Finding(kind, stream, claimed, seen, consequence, remedy), self.policy)


def _chosen(
    path: Path,
    found: list[dict[str, Any]],
    head: dict[str, Any] | None,
    streams: dict[str, str],
    text_width: int | None,
    start_ns: int | None,
    result: _Claims,
) -> list[Series]:
    found = [s for s in found if int(s["info"]["channel_count"][0]) > 0]
    named = _named(found)
    chosen = streams or {name: name for name in named}
    for name in chosen.values():
        if name not in named:
            raise RecordingError(f"{path}: there is no stream {name!r} in this file; {nearest(name, named)}")
    picked = _readable(path, {name: named[key] for name, key in chosen.items()}, result)
    anchor = _anchor(path, list(picked.values()), head, start_ns)
    return [_series(name, stream, anchor, text_width, result) for name, stream in picked.items()]


def _readable(path: Path, streams: dict[str, dict[str, Any]], result: _Claims) -> dict[str, dict[str, Any]]:
    """The streams with stamps of one epoch, that of most samples; the others are left out by name."""
    bad = {n for n, s in streams.items() if not (np.abs(np.asarray(s["time_stamps"], float)) <= MAX_NS / NS).all()}
    if bad and len(bad) == len(streams):
        raise RecordingError(f"{path}: stream {min(bad)!r} holds times that are not numbers; the file is damaged")
    for name in sorted(bad):
        result.find("epoch", name, "times", "times that are not numbers", "the stream is left out", "record it again")
    timed = {n: s for n, s in streams.items() if n not in bad and len(s["time_stamps"])}
    main = max(timed.values(), key=lambda s: (bool(_declared(s)), len(s["time_stamps"])), default=None)
    for name, stream in timed.items():
        assert main is not None
        first, last = float(np.min(stream["time_stamps"])), float(np.max(stream["time_stamps"]))
        apart = max(first - float(np.max(main["time_stamps"])), float(np.min(main["time_stamps"])) - last)
        if apart > EPOCH_S:
            bad.add(name)
            result.find(
                "epoch", name, f"the clock of {main['info']['name'][0]!r}, which begins at {float(np.min(main['time_stamps'])):.0f} s",
                f"times of another epoch, from {first:.0f} s on", "the stream is left out", "read it alone with --stream",
            )  # fmt: skip
    return {name: stream for name, stream in streams.items() if name not in bad}


def _declared(stream: dict[str, Any]) -> float:
    return float(_text(stream["info"], "nominal_srate") or 0.0)


def _load(
    path: Path, *, dejitter: bool, synchronize: bool, result: _Claims
) -> tuple[list[dict[str, Any]], dict[str, Any] | None]:
    import pyxdf

    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    with path.open("rb") as file:
        magic = file.read(4)
    if magic != b"XDF:" and magic[:2] != b"\x1f\x8b":
        raise RecordingError(f"{path}: cannot be read as an XDF file (it does not begin with XDF:)")
    if magic[:2] == b"\x1f\x8b":
        with reading(path, "a compressed XDF file"):
            check_gzip(path)
    logger, complaints = logging.getLogger("pyxdf"), _Complaints(logging.ERROR)
    logger.setLevel(logging.ERROR)
    logger.propagate = False
    logger.addHandler(complaints)
    try:
        streams, head = pyxdf.load_xdf(str(path), synchronize_clocks=synchronize, dejitter_timestamps=False)
        if dejitter:
            even, _ = pyxdf.load_xdf(str(path), synchronize_clocks=synchronize, dejitter_timestamps=True)
            streams = [_evened(raw, other, result) for raw, other in zip(streams, even, strict=True)]
    except RecordingError:
        raise
    except Exception as error:  # noqa: BLE001 - of a damaged file pyxdf raises whatever comes up
        raise RecordingError(f"{path}: cannot be read as an XDF file ({type(error).__name__}: {error})") from None
    finally:
        logger.removeHandler(complaints)
    if complaints.texts or any("footer" not in stream for stream in streams):
        log.warning("the XDF file was cut off, or is damaged: what could be read is imported", file=str(path))
    return streams, head


def _evened(raw: dict[str, Any], even: dict[str, Any], result: _Claims) -> dict[str, Any]:
    """The stream with even stamps, unless evening would move samples by more than jitter does."""
    before, after = np.asarray(raw["time_stamps"], float), np.asarray(even["time_stamps"], float)
    if not len(before) or not np.isfinite(before).all() or not _declared(raw):
        return even
    moved = float(np.abs(after - before).max())
    if moved <= JITTER_S:
        return even
    unordered = bool((np.diff(before) < 0).any())
    result.find(
        "order" if unordered else "leap", raw["info"]["name"][0], "even stamps with jitter",
        "blocks of samples out of order" if unordered else f"leaps, by which evening would move samples by {moved:.1f} s",
        "stamps are kept as they are, in the order of time", "look at the sender's clock",
    )  # fmt: skip
    return raw


class _Complaints(logging.Handler):
    """Keeps what pyxdf says about a damaged file, instead of printing it with tracebacks."""

    def __init__(self, level: int) -> None:
        super().__init__(level)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())


def _named(streams: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Streams by name; by name/type, or name/type/number, where several have the same."""
    names = [s["info"]["name"][0] or f"stream{s['info']['stream_id']}" for s in streams]
    full = [f"{n}/{s['info']['type'][0]}" for n, s in zip(names, streams, strict=True)]
    keys = [n if names.count(n) == 1 else f for n, f in zip(names, full, strict=True)]
    return {k if keys.count(k) == 1 else f"{k}/{s['info']['stream_id']}": s for k, s in zip(keys, streams, strict=True)}


def _text(element: Any, *path: str) -> str:
    """The text below nested XML elements as pyxdf gives them (each a list of one), or ""."""
    for name in path:
        element = element.get(name) if isinstance(element, dict) else None
        element = element[0] if isinstance(element, list) and element else element
    return element.strip() if isinstance(element, str) else ""


def _anchor(path: Path, streams: Sequence[dict[str, Any]], head: dict[str, Any] | None, start_ns: int | None) -> int:
    """What to add to the file's times (ns)."""
    first = min((round(float(s["time_stamps"][0]) * NS) for s in streams if len(s["time_stamps"])), default=0)
    if start_ns is not None:
        return start_ns - first
    ours = [_text(s["info"], "desc", "kinegraph", "time_zero_ns") for s in streams]
    if ours and all(ours):
        return int(ours[0])
    date = _text((head or {}).get("info"), "datetime")
    try:
        moment = datetime.fromisoformat(date)
    except ValueError:
        return 0
    return round(moment.timestamp()) * NS - first


def _series(name: str, stream: dict[str, Any], anchor: int, text_width: int | None, result: _Claims) -> Series:
    info = stream["info"]
    seconds = np.asarray(stream["time_stamps"], np.float64)
    time = np.round(seconds * NS).astype(np.int64) + anchor
    order = np.argsort(time, kind="stable")
    time = time[order]
    ours = _text(info, "desc", "kinegraph", "spec")
    if ours and (made := _ours(name, ours, stream, time, order)) is not None:
        return made
    channels = _channel_facts(info)
    meta = {"xdf_type": _text(info, "type"), "source_id": _text(info, "source_id")}
    if _text(info, "channel_format") == "string":
        return _markers(result.path, name, stream, time, order, [label for label, _ in channels], meta, text_width)
    data = np.ascontiguousarray(np.asarray(stream["time_series"])[order])
    rate = _declared(stream)
    labels = tuple(label for label, _ in channels)
    spec = StreamSpec(
        shape=data.shape[1:],
        dtype=data.dtype,
        rate_hz=rate or None,
        channels=labels if len(labels) == data.shape[1] and len(set(labels)) == len(labels) and all(labels) else (),
        units=_units([unit for _, unit in channels]),
        meta=meta,
    )
    return Series(name, spec, time, data, lost_by_stamps(time, rate) if rate else None)


def _ours(name: str, spec_json: str, stream: dict[str, Any], time: Times, order: Array) -> Series | None:
    """A stream that kinegraph wrote, with the spec it had; None if the samples are not of that spec any more."""
    rows = stream["time_series"]
    table = np.asarray(rows)[order] if isinstance(rows, np.ndarray) else np.array([rows[i] for i in order], object)
    table = table if len(time) else table.reshape(0, int(stream["info"]["channel_count"][0]))
    try:
        spec = StreamSpec.from_json(json.loads(spec_json))
        data = assemble(spec, [table[:, i] for i in range(table.shape[1])])
    except (ValueError, KeyError, TypeError, IndexError, StopIteration):
        return None
    return Series(name, spec, time, data, lost_by_stamps(time, spec.rate_hz) if spec.rate_hz else None)


def _channel_facts(info: dict[str, Any]) -> list[tuple[str, str]]:
    """(label, unit) of each channel, as the conventions for LSL metadata have it."""
    description = (info.get("desc") or [None])[0]
    listed = (description or {}).get("channels") if isinstance(description, dict) else None
    channels = ((listed or [None])[0] or {}).get("channel", []) if isinstance(listed, list) else []
    facts = [(_text(c, "label"), _text(c, "unit")) for c in channels]
    return [(label, UNITS.get(unit.lower(), unit)) for label, unit in facts]


def _units(units: list[str]) -> tuple[str, ...]:
    return tuple(units[:1]) or ("",) if len(set(units)) <= 1 else tuple(units)


def _markers(
    path: Path,
    name: str,
    stream: dict[str, Any],
    time: Times,
    order: Array,
    labels: list[str],
    meta: dict[str, Any],
    wanted: int | None,
) -> Series:
    """A string stream as events: `onset` (ns), and one text for each channel."""
    rows = [stream["time_series"][i] for i in order]
    count = int(stream["info"]["channel_count"][0])
    fields = labels if count > 1 and len({*labels, "onset"}) == count + 1 and all(labels) else ["text"]
    fields = fields if len(fields) == count else [f"text{i + 1}" for i in range(count)]
    longest = max((len(cell) for row in rows for cell in row), default=0)
    width = wanted or max(TEXT_WIDTH, min(longest, MAX_TEXT))
    if longest > width:
        raise RecordingError(
            f"{path}: a marker of stream {name!r} has {longest} characters; allow them with --text-width {longest}"
        )
    dtype = np.dtype([("onset", "<i8"), *((field, f"<U{width}") for field in fields)])
    data = np.array([(t, *row) for t, row in zip(time.tolist(), rows, strict=True)], dtype)
    return Series(name, StreamSpec((), dtype, units=("ns", *("" for _ in fields)), meta=meta), time, data)
