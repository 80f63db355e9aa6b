"""C3D files: markers, analogue channels and events, read by the library ezc3d."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from devices.files.c3d_check import DEC, HEAD, INTEL, MIPS, broken_at
from devices.files.c3d_facts import note
from devices.files.c3d_turn import low_byte_first
from devices.files.findings import Findings
from devices.files.timing import grid_of
from stream.chunk import NS, Array, StreamSpec
from stream.errors import RecordingError
from stream.optional import optional
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
HEADER_EVENTS = 12345
"""A header with this key holds events."""
MOST_FRAMES = 0xFFFF
"""A C3D header counts frames in 16 bits: longer recordings say so elsewhere, each program in its own place."""


def read_c3d(path: Path, start_ns: int = 0, findings: Findings | None = None) -> list[Series]:
    """The streams of a C3D file, as far as it has them, by its name and

    .markers   positions (markers, 3), NaN where a marker was not seen; names without what is before a colon, if they differ all the same
    .analog    the analogue channels, at their own rate
    .right_foot_strike, ...  one stream of events for each context and label, each event with its `onset`; the side stands in `meta`

    The file's first frame is at `start_ns` if it is number 1, else as much later. What else stands in it is noted in `findings`.
    Raises RecordingError.
    """
    made = _open(path)
    parameters, header = made["parameters"], made["header"]
    if findings is not None:
        note(path, parameters, header, findings)
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
    ezc3d = optional("ezc3d", "a C3D file", "pip install ezc3d (for ARM there is no wheel)", RecordingError)

    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    with path.open("rb") as file:
        head = file.read(HEAD)
    if (byte := broken_at(head)) >= 0:
        raise RecordingError(f"{path}: cannot be read as a C3D file (its parameters break off at byte {byte})")
    try:
        whole = path.read_bytes()
        if (turned := _for_a_pc(whole)) is not whole:
            with TemporaryDirectory() as folder:
                copy = Path(folder, "turned.c3d")
                copy.write_bytes(turned)
                return ezc3d.c3d(str(copy))
        return ezc3d.c3d(str(path))
    except (OSError, RuntimeError, ValueError, IndexError, KeyError, TypeError, MemoryError) as error:
        reason = str(error).splitlines()[0].partition(": iostream")[0] if str(error) else type(error).__name__
        raise RecordingError(f"{path}: cannot be read as a C3D file ({reason})") from None


def _announced(path: Path) -> int:
    """How many frames the header speaks of; 0 where it does not say so in 16 bits."""
    with path.open("rb") as file:
        head = file.read(512)
        file.seek((head[0] - 1) * 512 + 3)
        kind = file.read(1)
    if not kind or kind[0] not in (INTEL, DEC, MIPS):
        return 0
    first, last = struct.unpack(">HH" if kind[0] == MIPS else "<HH", head[6:10])
    return max(0, last - first + 1) if last < MOST_FRAMES else 0


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
    units = (units + [""] * len(names))[: len(names)] if len(units) > 1 else units
    told = tuple(units) if len(set(units)) > 1 else tuple(units[:1]) or ("",)
    spec = StreamSpec((data.shape[1],), rate_hz=rate, channels=names, units=told)
    stamps = grid_of(rate, np.arange(len(data)), start)
    return Series(f"{path.stem}.analog", spec, stamps, np.ascontiguousarray(data, np.float64))


def _events(path: Path, parameters: Any, start_ns: int) -> list[Series]:
    labels, contexts = _texts(parameters, "EVENT", "LABELS"), _texts(parameters, "EVENT", "CONTEXTS")
    times = np.asarray(parameters.get("EVENT", {}).get("TIMES", {}).get("value", np.zeros((2, 0))), np.float64)
    used = np.asarray(parameters.get("EVENT", {}).get("USED", {}).get("value", [len(labels)])).ravel()
    count = min(len(labels), int(used[0])) if len(used) else len(labels)
    if times.ndim == 2 and times.shape[1] > count >= 0:
        times = times[:, :count]
    labels, contexts = labels[: max(0, count)], contexts[: max(0, count)]
    if not any(labels):
        return _header_events(path, _for_a_pc(path.read_bytes()), start_ns)
    if times.shape != (2, len(labels)) or not np.isfinite(times).all():
        raise RecordingError(
            f"{path}: {len(labels)} events, but times for {times.shape[-1]}; they cannot be told apart"
        )
    onsets = start_ns + np.round((times[0] * 60.0 + times[1]) * 1e6).astype(np.int64) * 1000
    contexts += [""] * (len(labels) - len(contexts))
    return _event_streams(path, labels, contexts, onsets)


def _for_a_pc(data: bytes) -> bytes:
    """A file's bytes, those of an SGI machine turned."""
    place = (data[0] - 1) * 512 + 3
    return low_byte_first(data) if data[place : place + 1] == bytes([MIPS]) else data


def _header_events(path: Path, head: bytes, start_ns: int) -> list[Series]:
    """The events of the header, as older programs write them: labels of four letters, times since frame 1, each shown or not."""
    key, count = struct.unpack_from("<h", head, 298)[0], struct.unpack_from("<h", head, 300)[0]
    if key != HEADER_EVENTS or not 0 < count <= 18:
        return []
    times = np.frombuffer(_float_order(head, head[304:376]), "<f4")[:count].astype(np.float64)
    labels = [head[396 + 4 * i : 400 + 4 * i].decode("latin-1").strip() or f"event{i + 1}" for i in range(count)]
    if not (np.abs(times) < 1e6).all():
        raise RecordingError(f"{path}: the times of the header's events are none; the file is damaged")
    onsets = start_ns + np.round(times * 1e6).astype(np.int64) * 1000
    return _event_streams(path, labels, [""] * count, onsets)


def _float_order(head: bytes, data: bytes) -> bytes:
    """Floating-point numbers of a header as IEEE has them, low byte first: DEC puts the high word first, and an exponent greater by two."""
    if head[(head[0] - 1) * 512 + 3] != DEC:
        return data
    words = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]
    values = np.ascontiguousarray(words).view("<f4").ravel() / 4.0
    return values.astype("<f4").tobytes()


def _event_streams(path: Path, labels: list[str], contexts: list[str], onsets: Array) -> list[Series]:
    """A stream for each context and label."""
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
