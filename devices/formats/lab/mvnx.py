"""Xsens MVN's XML (.mvnx, version 4): positions, orientations and joint angles of the segments, and what the sensors measured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.axes import Axes
from kinegraph.stream.errors import RecordingError

UNITS = {
    "position": "m",
    "velocity": "m/s",
    "acceleration": "m/s2",
    "angularVelocity": "rad/s",
    "angularAcceleration": "rad/s2",
    "sensorFreeAcceleration": "m/s2",
    "sensorMagneticField": "",
    "jointAngle": "deg",
    "jointAngleXZY": "deg",
    "jointAngleErgo": "deg",
    "jointAngleErgoXZY": "deg",
    "centerOfMass": "m",
}
AXES = {1: ("",), 3: (".x", ".y", ".z"), 4: (".w", ".x", ".y", ".z")}


def knows(head: str) -> bool:
    return "<mvnx" in head


def read_mvnx(path: Path, asked: Asked) -> Understood:
    """A stream for each element of a normal frame: .position and the like (n, segments, 3), .jointAngle, .orientation (w, x, y, z), ...

    Calibration frames are left out. Times are the frames' `ms` (UTC), else their index at the file's rate. Raises RecordingError.
    """
    root = _parsed(path)
    subject = next(iter(root.iter("subject")), None)
    if subject is None:
        raise RecordingError(f"{path}: there is no subject in it")
    made = Understood(path, f"Xsens MVN XML (version {root.get('version', '?')})")
    names = {kind: [one.get("label", "") for one in subject.iter(kind)] for kind in ("segment", "sensor", "joint")}
    frames = [frame for frame in subject.iter("frame") if frame.get("type", "normal") == "normal"]
    if not frames:
        raise RecordingError(f"{path}: there are no frames of motion in it")
    rate = _number(path, subject.get("frameRate") or "", "frameRate")
    seconds = _times(made, frames, rate, path)
    elements: dict[str, list[Samples | None]] = {}
    for i, frame in enumerate(frames):
        for element in frame:
            elements.setdefault(element.tag, [None] * len(frames))[i] = _values(made, element)
    for tag, rows in elements.items():
        _stream(made, tag, rows, names, seconds, rate, asked)
    if configuration := subject.get("configuration"):
        made.facts["configuration"] = configuration
    return made


def _parsed(path: Path) -> ElementTree.Element:
    data = path.read_bytes()
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise RecordingError(f"{path}: declares entities, which no export does; it is refused")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise RecordingError(
            f"{path}: line {error.position[0]}: is not complete XML ({error}); was the file cut off?"
        ) from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""
    return root


def _number(path: Path, text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1e6:
        raise RecordingError(f"{path}: {what} is {text!r}; it must be a positive number")
    return value


def _times(made: Understood, frames: Sequence[ElementTree.Element], rate: float, path: Path) -> Samples:
    stamps = [frame.get("ms", "") for frame in frames]
    if all(ms.isdigit() and 10**11 < int(ms) < 10**14 for ms in stamps):
        made.begin = int(stamps[0]) * 1_000_000
        return np.array([(int(ms) - int(stamps[0])) / 1e3 for ms in stamps])
    made.doubt("frames have no time of day: their index at the file's rate is taken")
    return np.array([_index(frame, i) / rate for i, frame in enumerate(frames)])


def _index(frame: ElementTree.Element, i: int) -> int:
    index = frame.get("index", "")
    return int(index) if index.isdigit() and len(index) < 12 else i


def _values(made: Understood, element: ElementTree.Element) -> Samples | None:
    """The numbers of an element; None, and a doubt, for one that holds something else."""
    try:
        return np.array([float(word) for word in (element.text or "").split()])
    except ValueError:
        made.doubt(f"{element.tag} holds something else than numbers: left out")
        return None


def _stream(
    made: Understood,
    tag: str,
    rows: list[Samples | None],
    names: dict[str, list[str]],
    seconds: Samples,
    rate: float,
    asked: Asked,
) -> None:
    width = max((len(row) for row in rows if row is not None), default=0)
    if not width or sum(row is not None for row in rows) * 2 < len(rows):
        return
    data = np.full((len(rows), width), np.nan)
    for i, row in enumerate(rows):
        if row is not None and len(row) != width:
            raise RecordingError(f"{made.path}: frame {i}: {tag} has {len(row)} numbers, elsewhere {width}")
        if row is not None:
            data[i] = row
    labels = _labels(tag, width, names)
    points = tag in ("position", "velocity", "acceleration") and labels and width == 3 * len(names["segment"])
    shaped = np.ascontiguousarray(data.reshape(len(data), -1, 3)) if points else data
    spec: dict[str, Any] = {"channels": names["segment"] if points else labels, "units": (UNITS.get(tag, ""),)}
    if tag in ("position", "centerOfMass"):
        spec["meta"] = {"axes": Axes("z").facts()}
    made.add_timed(tag, seconds, shaped, 1, asked, rate_hz=rate, **spec)


def _labels(tag: str, width: int, names: dict[str, list[str]]) -> tuple[str, ...]:
    """Names of the numbers: those of whatever there are as many of, with axes behind them."""
    first = (
        "sensor"
        if tag.startswith("sensor")
        else "joint"
        if tag.startswith("jointAngle") and "Ergo" not in tag
        else "segment"
    )
    for kind in dict.fromkeys((first, "segment", "joint", "sensor")):
        count = len(names[kind])
        if count and width % count == 0 and width // count in (3, 4) and (width // count == 4) == ("rientation" in tag):
            return tuple(f"{name}{axis}" for name in names[kind] for axis in AXES[width // count])
    return ()
