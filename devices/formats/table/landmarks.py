"""33 body landmarks found in a video (BlazePose), as RepCount-pose has them: tables of a frame's name, then x, y, z of each; or an array.

Written from public descriptions of the format and tried on imitations of it only. Coordinates are those of the picture, in pixels or
shares of its size: x to the right, y down, z away from the camera.
"""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.timing import grid_of
from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.tables import read_text
from kinegraph.stream.domain.axes import FACED
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import Series

_SIDED = ("eye_inner", "eye", "eye_outer")
LANDMARKS = (
    "nose", *(f"left_{part}" for part in _SIDED), *(f"right_{part}" for part in _SIDED), "left_ear", "right_ear",
    "mouth_left", "mouth_right",
    *(f"{side}_{part}" for part in ("shoulder", "elbow", "wrist", "pinky", "index", "thumb", "hip", "knee", "ankle", "heel", "foot_index")
      for side in ("left", "right")),
)  # fmt: skip
"""In BlazePose's order."""
USUAL_HZ = 30.0
TORSO_M = 0.5
"""From the middle of the shoulders to that of the hips: pictures say nothing of size."""
FRAME = re.compile(r"(.*?)(\d+)(?:\.\w+)?")


def read_landmarks(path: Path, rate_hz: float | None = None, start_ns: int = 0) -> list[Series] | None:
    """One stream (33, 3) in m for each video; None if the table is no such one. Raises RecordingError with file and line.

    A row is the frame's name, perhaps its class or other words, and 99 numbers; a first row of words is a header. A video's frames follow
    one another with the same name but for the last number, which is the frame's. A landmark at 0, 0, 0 was not found.
    """
    rows = [
        (number, line.split(",")) for number, line in enumerate(read_text(path, "CSV").splitlines(), 1) if line.strip()
    ]
    if rows and len(rows[0][1]) > 3 * len(LANDMARKS) and _numbers(rows[0][1]) is None and _words(rows[0][1][-1]):
        rows = rows[1:]
    if not rows or len(rows[0][1]) <= 3 * len(LANDMARKS) or not _words(rows[0][1][0]) or _numbers(rows[0][1]) is None:
        return None
    found: list[tuple[str, int, Samples]] = []
    for number, cells in rows:
        values = _numbers(cells)
        if values is None or len(cells) != len(rows[0][1]):
            raise RecordingError(f"{path}: line {number}: a name and 99 numbers are needed, x, y and z of 33 landmarks")
        name = FRAME.fullmatch(cells[0].strip())
        found.append((name[1] if name else "", int(name[2]) if name else len(found), values))
    made = []
    for name, group in groupby(found, key=lambda row: row[0]):
        frames = list(group)
        data, numbers = np.array([values for _, _, values in frames]), np.array([n for _, n, _ in frames], np.int64)
        made.append(_video(path, name, data, numbers, rate_hz, start_ns))
    return made


def read_landmark_array(path: Path, rate_hz: float | None = None, start_ns: int = 0) -> list[Series]:
    """The same of an .npy file that holds all frames of one video: (frames, 33, 3) or (frames, 99). Raises RecordingError."""
    data = np.load(path, mmap_mode="r", allow_pickle=False)
    if (
        data.dtype.kind not in "fiu"
        or not data.size
        or data.shape[1:] not in ((len(LANDMARKS), 3), (3 * len(LANDMARKS),))
    ):
        raise RecordingError(f"{path}: {data.dtype} {data.shape}; frames of 33 landmarks with x, y and z are needed")
    values = np.array(data, np.float64).reshape(-1, len(LANDMARKS), 3)
    return [_video(path, "", values, np.arange(len(values)), rate_hz, start_ns)]


def _words(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return True
    return False


def _numbers(cells: list[str]) -> Samples | None:
    try:
        return np.array([float(cell) for cell in cells[-3 * len(LANDMARKS) :]]).reshape(-1, 3)
    except ValueError:
        return None


def _video(path: Path, name: str, data: Samples, numbers: Times, rate_hz: float | None, start_ns: int) -> Series:
    data[(data == 0.0).all(axis=2) | ~np.isfinite(data).all(axis=2)] = np.nan
    if (np.diff(numbers) <= 0).any():
        numbers = np.arange(len(data))
    shoulders, hips = (
        data[:, [LANDMARKS.index(f"{side}_{part}") for side in ("left", "right")]].mean(1)
        for part in ("shoulder", "hip")
    )
    torso = np.linalg.norm(shoulders - hips, axis=1)
    if not (torso > 0.0).any():
        raise RecordingError(
            f"{path}: no frame of {name or path.stem} has both shoulders and both hips; they give the scale"
        )
    data *= TORSO_M / np.median(torso[torso > 0.0]) * np.array([-1.0, -1.0, 1.0])
    spec = StreamSpec(data.shape[1:], channels=LANDMARKS, units=("m",), meta={"axes": FACED.facts()})
    stem = re.sub(r"\W+", "_", name).strip("_") or path.stem
    return Series(stem, spec, grid_of(rate_hz or USUAL_HZ, numbers - numbers[0], start_ns), np.ascontiguousarray(data))
