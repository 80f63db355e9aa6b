"""Skeletons in tables, as Kinect programs write them: x, y and z of every joint, perhaps with how well it was seen."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TypeAlias

import numpy as np

from kinegraph.devices.formats.table.landmarks import read_landmarks
from kinegraph.devices.formats.timing import UNITS, check_order, grid_of, to_ns, unit_in
from kinegraph.stream.chunk import NS, Array, StreamSpec, Times
from kinegraph.stream.data.tables import FileColumn, read_csv, read_rows
from kinegraph.stream.domain.axes import FACED
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import Series

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
FRAMES = ("frame", "frame_number", "frame_id")
"""FileColumn names that are taken for the number of a frame where a rate is given."""
NO_TIMES = f"times; call it {', '.join(TIMES[:3])}, or name its unit as in t_ms; a column called {FRAMES[0]} will do with --rate"
TICKS = 100
"""Windows counts time in steps of 100 ns."""


def read_kinect(
    path: Path, unit: str = "m", scale: float = 1.0, start_ns: int = 0, rate_hz: float | None = None
) -> list[Series]:
    """One stream named like the file: joint positions (joints, 3), irregular, NaN where a joint was not seen.

    With a header, columns are known by name: `WristLeft_x` or `wrist_l.x`, and so on; `..._state` (or tracked, confidence) of 0 means not
    seen; the time is called time, t or timestamp. Without one, a line is the time (or nothing), then 20 or 25 joints in the Kinect's own
    order and axes, with three or four numbers each, the fourth being that state. A joint at exactly 0, 0, 0 was not seen either. Where the
    times do not say their unit, it is the one in which 4 to 70 frames make a second. With `rate_hz`, the number of a frame takes the place
    of the time, and `rate_hz` numbers make a second: the first frame is at time 0, and numbers left out are lost frames (where all steps
    are multiples of two, every second number). Tables of 33 landmarks: see landmarks.py. Raises RecordingError with file and line.
    """
    if (landmarks := read_landmarks(path, rate_hz, start_ns)) is not None:
        return landmarks
    rows = read_rows(path)
    columns = read_csv(path) if rows is None else {}
    names, data, clock, result, row = _named(path, columns, rate_hz) if rows is None else _ordered(path, rows)
    time, lost = (_times(path, clock, row, result), None) if rate_hz is None else _counted(path, clock, row, rate_hz)
    data = data * scale
    data[~np.isfinite(data).all(axis=2) | (data == 0.0).all(axis=2)] = np.nan
    check_order(time, f"{path}: line", row, repeated=False)
    meta = {"axes": FACED.facts()} if rows is not None else {}
    spec = StreamSpec(data.shape[1:], channels=names, units=(unit or "m",), meta=meta)
    return [Series(path.stem, spec, time + start_ns, np.ascontiguousarray(data), lost)]


Found: TypeAlias = tuple[tuple[str, ...], Array, Array, str, int]
"""Joint names, positions, what stands for the time and its unit ("": unknown), and the first line."""


def _named(path: Path, columns: dict[str, FileColumn], rate_hz: float | None) -> Found:
    """What a table with a header holds."""
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
    clock = next((name for name in columns if name.lower() in (FRAMES if rate_hz else TIMES)), None)
    if clock is None:
        wanted = f"frame numbers, which --rate speaks of; call it {FRAMES[0]}" if rate_hz else NO_TIMES
        raise RecordingError(f"{path}: line 1: there is no column of {wanted}")
    column = columns[clock]
    declared = column.unit in UNITS or re.search(r"_(ns|us|ms|s)$", clock) is not None
    return tuple(joints), data, column.data, unit_in(clock, column.unit) if declared else "", column.row


def _ordered(path: Path, rows: Array) -> Found:
    """The same of a table without one."""
    width = rows.shape[1]
    for names in (ONE, TWO):
        for each in (3, 4):
            if width - len(names) * each == 1:
                data = rows[:, 1:].reshape(len(rows), len(names), each).copy()
                if each == 4:
                    data[data[:, :, 3] == 0.0] = np.nan
                return names, data[:, :, :3], rows[:, 0], "", 1
    raise RecordingError(
        f"{path}: line 1: {width} numbers; without a header there must be time or frame and 20 or 25 joints of 3 or 4 (61, 81, 76, 101)"
    )


def _counted(path: Path, frames: Array, row: int, rate_hz: float) -> tuple[Times, Array]:
    """Times of frames by their numbers, and how many are missing before each."""
    wrong = np.flatnonzero(~(np.abs(frames) < 2**31) | (frames != np.round(frames)))
    if len(wrong):
        raise RecordingError(f"{path}: line {row + int(wrong[0])}: {frames[wrong[0]]:g} is not a frame number")
    numbers = frames.astype(np.int64)
    steps = np.diff(numbers)
    lost = np.concatenate([[0], steps // max(int(np.gcd.reduce(steps)), 1) - 1])
    return grid_of(rate_hz, numbers - numbers[0], 0), lost


def _times(path: Path, values: Array, row: int, unit: str) -> Times:
    factor = UNITS.get(unit, 0)
    if not factor:
        step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
        known = [f for f in (*UNITS.values(), TICKS) if f < 60 * NS and USUAL_S[0] <= step * f / NS <= USUAL_S[1]]
        if len(known) != 1:
            raise RecordingError(
                f"{path}: line {row}: times {step:g} apart are in no unit that makes 4 to 70 a second; name it in the header, as in t_ms;"
                " if they are frame numbers, say --rate"
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
