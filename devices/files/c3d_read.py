"""C3D files: markers, analogue channels and events, read by the library ezc3d."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from devices.files.c3d_check import DEC, HEAD, INTEL, broken_at
from devices.files.timing import grid_of
from stream.chunk import NS, Array, StreamSpec
from stream.errors import RecordingError
from stream.recording.series import Series

UNITS = {
    "mm": "mm",
    "millimeters": "mm",
    "millimetres": "mm",
    "cm": "cm",
    "m": "m",
    "meters": "m",
    "metres": "m",
    "v": "V",
}
SIDES = ("left", "right")
MOST_FRAMES = 0xFFFF
"""A C3D header counts frames in 16 bits: longer recordings say so elsewhere, each program in its own place."""


def read_c3d(path: Path, start_ns: int = 0) -> list[Series]:
    """The streams of a C3D file, as far as it has them, by its name and

    .markers   positions (markers, 3), NaN where a marker was not seen; names without what is before a colon, if they differ all the same
    .analog    the analogue channels, at their own rate
    .right_foot_strike, ...  one stream of events for each context and label, each event with its `onset`; the side stands in `meta`

    The file's first frame is at `start_ns` if it is number 1, else as much later. Raises RecordingError.
    """
    made = _open(path)
    parameters, header = made["parameters"], made["header"]
    first = int(header["points"]["first_frame"])
    frames = _announced(path)
    rate = float(header["points"]["frame_rate"])
    points, analogue = np.asarray(made["data"]["points"]), np.asarray(made["data"]["analogs"])
    held = max(points.shape[2], analogue.shape[2] // max(1, _per_frame(header)))
    if frames > 0 and held < frames:
        raise RecordingError(f"{path}: {frames} frames are announced, {held} are there; the file was cut off")
    there = _there(path, header, parameters)
    if there > held:
        raise RecordingError(
            f"{path}: holds {there} frames, of which {held} can be read; save it in parts of less than {MOST_FRAMES} frames"
        )
    if rate <= 0.0:
        raise RecordingError(f"{path}: the frame rate is {rate:g} Hz; it must be positive")
    start = start_ns + round(first / rate * NS)
    series = []
    if points.shape[1] and points.shape[2]:
        series.append(
            _markers(path, parameters, points, np.asarray(made["data"]["meta_points"]["residuals"]), rate, start)
        )
    if analogue.shape[1] and analogue.shape[2]:
        series.append(_analogue(path, parameters, analogue[0].T, rate * _per_frame(header), start))
    return [*series, *_events(path, parameters, start_ns)]


def _open(path: Path) -> Any:
    import ezc3d

    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    with path.open("rb") as file:
        head = file.read(HEAD)
    if (byte := broken_at(head)) >= 0:
        raise RecordingError(f"{path}: cannot be read as a C3D file (its parameters break off at byte {byte})")
    try:
        return ezc3d.c3d(str(path))
    except (OSError, RuntimeError, ValueError, IndexError, KeyError, TypeError, MemoryError) as error:
        reason = str(error).splitlines()[0].partition(": iostream")[0] if str(error) else type(error).__name__
        raise RecordingError(f"{path}: cannot be read as a C3D file ({reason})") from None


def _announced(path: Path) -> int:
    """How many frames the header speaks of; 0 where it does not say so in 16 bits of this machine's kind."""
    head = path.read_bytes()[:512]
    first, last = struct.unpack("<HH", head[6:10])
    with path.open("rb") as file:
        file.seek((head[0] - 1) * 512 + 3)
        kind = file.read(1)
    return max(0, last - first + 1) if kind and kind[0] in (INTEL, DEC) and last < 0xFFFF else 0


def _there(path: Path, header: Mapping[str, Any], parameters: Any) -> int:
    """How many frames a file holds whose header can count no further, by its length; 0 for all others."""
    turns = np.asarray(parameters.get("ROTATION", {}).get("USED", {}).get("value", 0)).any()
    if turns or header["points"]["last_frame"] - header["points"]["first_frame"] < MOST_FRAMES - 1:
        return 0
    numbers = 4 * int(header["points"]["size"]) + int(header["analogs"]["size"]) * _per_frame(header)
    begin = (int(parameters["POINT"]["DATA_START"]["value"][0]) - 1) * 512
    size = 4 if float(parameters["POINT"]["SCALE"]["value"][0]) < 0.0 else 2
    frames = (path.stat().st_size - begin) // (size * numbers) if numbers else 0
    return frames if frames - 512 // (size * numbers or 1) > MOST_FRAMES else 0


def _per_frame(header: Mapping[str, Any]) -> int:
    """Analogue samples per frame."""
    points, analogue = float(header["points"]["frame_rate"]), float(header["analogs"]["frame_rate"])
    return max(1, round(analogue / points)) if points > 0 else 1


def _markers(path: Path, parameters: Any, points: Array, residuals: Array, rate: float, start: int) -> Series:
    data = np.ascontiguousarray(points[:3].transpose(2, 1, 0), np.float64)
    data[residuals[0].T < 0] = np.nan
    names = _distinct(_texts(parameters, "POINT", "LABELS"), data.shape[1], "marker")
    unit = next(iter(_texts(parameters, "POINT", "UNITS")), "")
    spec = StreamSpec(data.shape[1:], rate_hz=rate, channels=names, units=(UNITS.get(unit.lower(), unit),))
    return Series(f"{path.stem}.markers", spec, grid_of(rate, np.arange(len(data)), start), data)


def _analogue(path: Path, parameters: Any, data: Array, rate: float, start: int) -> Series:
    names = _distinct(_texts(parameters, "ANALOG", "LABELS"), data.shape[1], "channel")
    units = [UNITS.get(unit.lower(), unit) for unit in _texts(parameters, "ANALOG", "UNITS")]
    told = tuple(units) if len(units) == len(names) and len(set(units)) > 1 else tuple(units[:1]) or ("",)
    spec = StreamSpec((data.shape[1],), rate_hz=rate, channels=names, units=told)
    stamps = grid_of(rate, np.arange(len(data)), start)
    return Series(f"{path.stem}.analog", spec, stamps, np.ascontiguousarray(data, np.float64))


def _events(path: Path, parameters: Any, start_ns: int) -> list[Series]:
    labels, contexts = _texts(parameters, "EVENT", "LABELS"), _texts(parameters, "EVENT", "CONTEXTS")
    times = np.asarray(parameters.get("EVENT", {}).get("TIMES", {}).get("value", np.zeros((2, 0))), np.float64)
    if not labels:
        return []
    if times.shape != (2, len(labels)) or not np.isfinite(times).all():
        raise RecordingError(
            f"{path}: {len(labels)} events, but times for {times.shape[-1]}; they cannot be told apart"
        )
    onsets = start_ns + np.round((times[0] * 60.0 + times[1]) * 1e6).astype(np.int64) * 1000
    contexts += [""] * (len(labels) - len(contexts))
    made, taken = [], ["markers", "analog"]
    for context, label in dict.fromkeys(zip(contexts, labels, strict=False)):
        mine = np.array([c == context and k == label for c, k in zip(contexts, labels, strict=False)])
        onset = np.sort(onsets[mine])
        data = np.empty(len(onset), [("onset", "<i8")])
        data["onset"] = onset
        side = context.lower() if context.lower() in SIDES else ""
        spec = StreamSpec((), data.dtype, units=("ns",), meta={"label": label, "side": side})
        name = re.sub(r"\W+", "_", f"{context} {label}".strip()).lower()
        again = f"_{taken.count(name) + 1}" if name in taken else ""
        made.append(Series(f"{path.stem}.{name}{again}", spec, onset, data))
        taken.append(name)
    return made


def _texts(parameters: Any, group: str, name: str) -> list[str]:
    """A parameter's texts, with those of its continuations (LABELS2, ...)."""
    made: list[str] = []
    for key in (name, *(f"{name}{i}" for i in range(2, 20))):
        found = parameters.get(group, {}).get(key)
        if not found:
            break
        made += [str(text).strip() for text in found["value"]]
    return made


def _distinct(names: Sequence[str], count: int, kind: str) -> tuple[str, ...]:
    """A name for each; those without one, or with that of another, by number."""
    short = [name.rpartition(":")[2] for name in names]
    given = short if len(set(short)) == len(short) else list(names)
    made = [given[i] if i < len(given) and given[i] else f"{kind}{i + 1}" for i in range(count)]
    return tuple(name if made.index(name) == i else f"{name}_{i + 1}" for i, name in enumerate(made))
