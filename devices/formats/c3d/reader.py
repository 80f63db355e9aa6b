"""C3D files: markers, analogue channels and events."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.c3d.data import frames_of, read_frames
from kinegraph.devices.formats.c3d.facts import note
from kinegraph.devices.formats.c3d.parameters import HEAD, Parameters, read_parameters, reals, text_of, wholes
from kinegraph.devices.formats.findings import Findings
from kinegraph.devices.formats.timing import grid_of
from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.domain.axes import WAYS, Axes
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import Series

UNITS = {
    "mm": "mm",
    "millimeters": "mm",
    "millimetres": "mm",
    "cm": "cm",
    "m": "m",
    "meters": "m",
    "metres": "m",
    "v": "V",
    "volts": "V",
    "uv": "uV",
    "mv": "mV",
    "nt": "N",
    "n": "N",
    "newtons": "N",
    "ntmm": "Nmm",
    "nmm": "Nmm",
    "ntm": "Nm",
    "nm": "Nm",
    "g": "g",
}
SIDES = ("left", "right")
MAX_S = 1e6
"""No event of a trial is later than this."""
HEADER_EVENTS = 12345
"""A header with this key holds events."""


def read_c3d(path: Path, start_ns: int = 0, findings: Findings | None = None) -> list[Series]:
    """The streams of a C3D file, as far as it has them, by its name and

    .markers   positions (markers, 3), NaN where a marker was not seen; names without what is before a colon, if they differ all the same.
               What the file calls Y_SCREEN points up
    .analog    the analogue channels, at their own rate
    .right_foot_strike, ...  one stream of events for each context and label, each event with its `onset`; the side is in `meta`

    The file's first frame is at `start_ns` if it is number 1, else as much later. What else it holds is noted in `findings`.
    Raises RecordingError.
    """
    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    with path.open("rb") as file:
        head = file.read(HEAD)
    try:
        parameters = read_parameters(head)
    except ValueError as error:
        raise RecordingError(f"{path}: cannot be read as a C3D file ({error})") from None
    frames = frames_of(path, head, parameters)
    findings = Findings() if findings is None else findings
    note(path, parameters, frames, findings)
    points, analogue = read_frames(path, frames, parameters)
    start = start_ns + round(frames.first / frames.rate_hz * NS)
    series = []
    if points.size:
        series.append(_markers(path, parameters, points, frames.rate_hz, start))
    if analogue.size:
        series.append(_analogue(path, parameters, analogue, frames.rate_hz * frames.per_frame, start))
    return [*series, *_events(path, parameters, head, start_ns, findings)]


def _markers(path: Path, parameters: Parameters, data: Array, rate: float, start: int) -> Series:
    names = _distinct(parameters.texts("POINT", "LABELS"), data.shape[1], "marker")
    unit = next(iter(parameters.texts("POINT", "UNITS")), "")
    screen_axis = next(iter(parameters.texts("POINT", "Y_SCREEN")), "").strip().lower().lstrip("+")
    meta = {"axes": Axes(screen_axis).facts()} if screen_axis in WAYS else {}
    spec = StreamSpec(data.shape[1:], rate_hz=rate, channels=names, units=(UNITS.get(unit.lower(), unit),), meta=meta)
    return Series(f"{path.stem}.markers", spec, grid_of(rate, np.arange(len(data)), start), data)


def _analogue(path: Path, parameters: Parameters, data: Array, rate: float, start: int) -> Series:
    names = _distinct(parameters.texts("ANALOG", "LABELS"), data.shape[1], "channel")
    units = [UNITS.get(unit.lower(), unit) for unit in parameters.texts("ANALOG", "UNITS")]
    units = (units + [""] * len(names))[: len(names)] if len(units) > 1 else units
    declared_units = tuple(units) if len(set(units)) > 1 else tuple(units[:1]) or ("",)
    spec = StreamSpec((data.shape[1],), rate_hz=rate, channels=names, units=declared_units)
    return Series(f"{path.stem}.analog", spec, grid_of(rate, np.arange(len(data)), start), data)


def _events(path: Path, parameters: Parameters, head: bytes, start_ns: int, findings: Findings) -> list[Series]:
    """Events, as far as each has a time: where they do not match, that is noted, and markers are read all the same."""
    labels, contexts = parameters.texts("EVENT", "LABELS"), parameters.texts("EVENT", "CONTEXTS")
    used = parameters.count("EVENT", "USED")
    count = len(labels) if used is None else min(len(labels), used)
    times = _event_times(parameters)[:, :count]
    labels, contexts = labels[:count], contexts[:count]
    if not any(labels):
        return _header_events(path, parameters.processor, head, start_ns, findings)
    if times.shape != (2, len(labels)) or not (np.abs(times) < MAX_S).all():
        findings.doubts.append(
            f"{path.name}: {len(labels)} events, but times for {times.shape[-1]}: they cannot be matched and are left out"
            if times.shape != (2, len(labels))
            else f"{path.name}: the times of its {len(labels)} events are not numbers: they are left out"
        )
        return []
    onsets = start_ns + np.round((times[0] * 60.0 + times[1]) * 1e6).astype(np.int64) * 1000
    contexts += [""] * (len(labels) - len(contexts))
    return _event_streams(path, labels, contexts, onsets)


def _event_times(parameters: Parameters) -> Array:
    """Minutes and seconds (2, n) of the events: a table of two rows, or, by some programs, one list of pairs."""
    times = parameters.groups.get("EVENT", {}).get("TIMES", np.zeros((2, 0)))
    if isinstance(times, tuple) or (times.ndim > 1 and times.shape[0] != 2):
        return np.zeros((2, 0))
    flat = times.ravel(order="F")
    return flat[: len(flat) // 2 * 2].reshape(2, -1, order="F")


def _header_events(path: Path, processor: int, head: bytes, start_ns: int, findings: Findings) -> list[Series]:
    """The events of the header, as older programs write them: labels of four letters, times since frame 1, each shown or not."""
    key, count = wholes(head[298:302], processor)
    if key != HEADER_EVENTS or not 0 < count <= 18:
        return []
    times = reals(head[304:376], processor)[:count].astype(np.float64)
    labels = [text_of(head[396 + 4 * i : 400 + 4 * i]) or f"event{i + 1}" for i in range(count)]
    if not (np.abs(times) < MAX_S).all():
        findings.doubts.append(f"{path.name}: the times of the header's events are not numbers: they are left out")
        return []
    onsets = start_ns + np.round(times * 1e6).astype(np.int64) * 1000
    return _event_streams(path, labels, [""] * count, onsets)


def _event_streams(path: Path, labels: list[str], contexts: list[str], onsets: Array) -> list[Series]:
    """A stream for each context and label."""
    kinds: dict[tuple[str, str], list[int]] = {}
    for i, kind in enumerate(zip(contexts, labels, strict=False)):
        kinds.setdefault(kind, []).append(i)
    made, taken = [], Counter(("markers", "analog"))
    for (context, label), mine in kinds.items():
        onset = np.sort(onsets[mine])
        data = np.empty(len(onset), [("onset", "<i8")])
        data["onset"] = onset
        side = context.lower() if context.lower() in SIDES else ""
        spec = StreamSpec((), data.dtype, units=("ns",), meta={"label": label, "side": side})
        name = re.sub(r"\W+", "_", f"{context} {label}".strip()).lower()
        again = f"_{taken[name] + 1}" if name in taken else ""
        made.append(Series(f"{path.stem}.{name}{again}", spec, onset, data))
        taken[name] += 1
    return made


def _distinct(names: Sequence[str], count: int, kind: str) -> tuple[str, ...]:
    """A name for each; those without one, or with that of another, by number."""
    short = [name.rpartition(":")[2] for name in names]
    given = short if len(set(short)) == len(short) else list(names)
    made = [given[i] if i < len(given) and given[i] else f"{kind}{i + 1}" for i in range(count)]
    first = {name: i for i, name in reversed(list(enumerate(made)))}
    return tuple(name if first[name] == i else f"{name}_{i + 1}" for i, name in enumerate(made))
