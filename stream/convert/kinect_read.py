"""Skeletons in tables, as Kinect programs write them: x, y and z of every joint, perhaps with how well it was seen."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from stream.chunk import NS, Array, StreamSpec, Times
from stream.convert.series import Series
from stream.convert.shelf import Column
from stream.convert.tables import read_csv, read_rows
from stream.convert.timing import UNITS, check_order, to_ns, unit_in
from stream.errors import RecordingError

TIMES = ("time", "t", "timestamp", "time_s", "t_s", "time_ms", "t_ms", "timestamp_ms", "time_us", "t_us", "time_ns")
COORDINATE = re.compile(r"(.+?)[ _.:/-]?([xyz])", re.IGNORECASE)
SEEN = re.compile(r"(.+?)[ _.:/-]?(state|tracked|tracking|trackingstate|confidence|seen)", re.IGNORECASE)
ONE = (
    "hip_center", "spine", "shoulder_center", "head", "shoulder_l", "elbow_l", "wrist_l", "hand_l", "shoulder_r", "elbow_r",
    "wrist_r", "hand_r", "hip_l", "knee_l", "ankle_l", "foot_l", "hip_r", "knee_r", "ankle_r", "foot_r",
)  # fmt: skip
TWO = (
    "spine_base", "spine_mid", "neck", "head", "shoulder_l", "elbow_l", "wrist_l", "hand_l", "shoulder_r", "elbow_r", "wrist_r",
    "hand_r", "hip_l", "knee_l", "ankle_l", "foot_l", "hip_r", "knee_r", "ankle_r", "foot_r", "spine_shoulder", "hand_tip_l",
    "thumb_l", "hand_tip_r", "thumb_r",
)  # fmt: skip
"""The joints of a Kinect's skeleton in its own order: of the first device, and of the second."""

USUAL_S = (1.0 / 70.0, 1.0 / 4.0)
"""The time between frames of a depth camera, from 70 to 4 Hz: tells the unit of times that do not say theirs."""
TICKS = 100
"""Windows counts time in steps of 100 ns."""


def read_kinect(path: Path, unit: str = "m", scale: float = 1.0, start_ns: int = 0) -> list[Series]:
    """One stream named like the file: joint positions (joints, 3), irregular, NaN where a joint was not seen.

    With a header, columns are told by name: `WristLeft_x` or `wrist_l.x`, and so on; `..._state` (or tracked, confidence) of 0 means not
    seen; the time is called time, t or timestamp. Without one, a line is the time (or nothing), then 20 or 25 joints in the Kinect's own
    order, with three or four numbers each, the fourth being that state. A joint at exactly 0, 0, 0 was not seen either. Where the times do
    not say their unit, it is the one in which 4 to 70 frames make a second. Raises RecordingError with file and line.
    """
    rows = read_rows(path)
    columns = read_csv(path) if rows is None else {}
    names, data, time, row = _named(path, columns) if rows is None else _ordered(path, rows)
    data = data * scale
    data[~np.isfinite(data).all(axis=2) | (data == 0.0).all(axis=2)] = np.nan
    check_order(time, f"{path}: line", row, repeated=False)
    spec = StreamSpec(data.shape[1:], channels=names, units=(unit or "m",))
    return [Series(path.stem, spec, time + start_ns, np.ascontiguousarray(data))]


def _named(path: Path, columns: dict[str, Column]) -> tuple[tuple[str, ...], Array, Times, int]:
    """Joint names, positions, times and the first line of a table with a header."""
    found: dict[str, dict[str, str]] = {}
    for name in columns:
        if part := COORDINATE.fullmatch(name):
            found.setdefault(part[1], {})[part[2].lower()] = name
    joints = [joint for joint, parts in found.items() if len(parts) == 3]
    if len(joints) < 2:
        raise RecordingError(
            f"{path}: line 1: x, y and z of at least two joints are needed (WristLeft_x, ...), got {', '.join(columns)}"
        )
    data = np.stack([np.stack([columns[found[joint][axis]].data for axis in "xyz"], 1) for joint in joints], 1)
    for name, column in columns.items():
        part = SEEN.fullmatch(name)
        if part and part[1] in joints:
            data[column.data == 0.0, joints.index(part[1])] = np.nan
    clock = next((name for name in columns if name.lower() in TIMES), None)
    if clock is None:
        raise RecordingError(
            f"{path}: line 1: there is no column of times; call it {', '.join(TIMES[:3])}, or name its unit as in t_ms"
        )
    column = columns[clock]
    said = column.unit in UNITS or re.search(r"_(ns|us|ms|s)$", clock) is not None
    return (
        tuple(joints),
        data,
        _times(path, column.data, column.row, unit_in(clock, column.unit) if said else ""),
        column.row,
    )


def _ordered(path: Path, rows: Array) -> tuple[tuple[str, ...], Array, Times, int]:
    """The same of a table without one."""
    width = rows.shape[1]
    for names in (ONE, TWO):
        for each in (3, 4):
            if width - len(names) * each == 1:
                data = rows[:, 1:].reshape(len(rows), len(names), each).copy()
                if each == 4:
                    data[data[:, :, 3] == 0.0] = np.nan
                return names, data[:, :, :3], _times(path, rows[:, 0], 1, ""), 1
    raise RecordingError(
        f"{path}: line 1: {width} numbers; without a header there must be the time and 20 or 25 joints of 3 or 4 numbers (61, 81, 76, 101)"
    )


def _times(path: Path, values: Array, row: int, unit: str) -> Times:
    factor = UNITS.get(unit, 0)
    if not factor:
        step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
        known = [f for f in (*UNITS.values(), TICKS) if f < 60 * NS and USUAL_S[0] <= step * f / NS <= USUAL_S[1]]
        if len(known) != 1:
            raise RecordingError(
                f"{path}: line {row}: times {step:g} apart are in no unit that makes 4 to 70 a second; name it in the header, as in t_ms"
            )
        factor = known[0]
    try:
        return (
            to_ns(values, next(u for u, f in UNITS.items() if f == factor))
            if factor != TICKS
            else to_ns(values * TICKS, "ns")
        )
    except ValueError as error:
        raise RecordingError(f"{path}: line {row + int(str(error).split()[1])}: holds no time") from None
