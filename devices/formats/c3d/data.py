"""The samples of a C3D file: of every frame its markers, then its analogue samples, whole numbers or floating-point ones."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.c3d.parameters import BLOCK, MIPS, Parameters, reals, wholes
from kinegraph.stream.chunk import Array
from kinegraph.stream.errors import RecordingError

MAX_FRAMES = 0xFFFF
"""A C3D header counts frames in 16 bits: longer recordings say so elsewhere, each program in its own place."""


@dataclass(frozen=True, slots=True)
class C3dFrames:
    """How samples lie in a file.

    begin      the byte at which they begin
    count      frames
    markers, channels, per_frame  of each; analogue samples per channel
    first      the number of the first frame, counted from 0
    scale      of whole numbers, in units of length; negative: they are floating-point numbers
    doubt      what was taken for granted, in words
    """

    begin: int
    count: int
    markers: int
    channels: int
    per_frame: int
    first: int
    rate_hz: float
    scale: float
    doubt: str = ""

    @property
    def numbers(self) -> int:
        """Numbers of one frame."""
        return 4 * self.markers + self.channels * self.per_frame

    @property
    def width(self) -> int:
        """Bytes of a number."""
        return 4 if self.scale < 0.0 else 2


def frames_of(path: Path, head: bytes, parameters: Parameters) -> C3dFrames:
    """What header and parameters say, where they differ the parameters, held against the file's size. Raises RecordingError."""
    order = ">" if parameters.processor == MIPS else "<"
    markers, samples, first, last, _, _, _, block, per_frame = struct.unpack(f"{order}9H", head[2:20])
    rate = parameters.number("POINT", "RATE")
    if not rate > 0.0:
        rate = float(reals(head[20:24], parameters.processor)[0])
    if not (rate > 0.0 and isfinite(rate)):
        raise RecordingError(f"{path}: the frame rate is {rate:g} Hz; it must be positive")
    if (analogue := parameters.number("ANALOG", "RATE")) > 0.0 and isfinite(analogue):
        per_frame = round(analogue / rate)
    scale = parameters.number("POINT", "SCALE")
    scale = float(reals(head[12:16], parameters.processor)[0]) if np.isnan(scale) else scale
    used, channels = parameters.count("POINT", "USED"), parameters.count("ANALOG", "USED")
    made = C3dFrames(
        begin=_begin(path, parameters, block),
        count=0,
        markers=markers if used is None else used,
        channels=samples // max(1, per_frame) if channels is None else channels,
        per_frame=max(1, per_frame),
        first=max(0, first - 1),
        rate_hz=rate,
        scale=scale,
    )
    if made.markers and not (scale and isfinite(scale)):
        raise RecordingError(f"{path}: the scale of its markers is {scale:g}; their positions cannot be determined")
    return _counted(path, made, max(0, last - first + 1) if last < MAX_FRAMES else None, parameters)


def read_frames(path: Path, frames: C3dFrames, parameters: Parameters) -> tuple[Array, Array]:
    """Markers (count, markers, 3), NaN where they were not seen, and analogue samples (count * per_frame, channels)."""
    if not frames.count:
        return np.zeros((0, 0, 3)), np.zeros((0, 0))
    with path.open("rb") as file:
        file.seek(frames.begin)
        data = file.read(frames.count * frames.numbers * frames.width)
    read = reals if frames.scale < 0.0 else wholes
    table = read(data, parameters.processor).reshape(frames.count, frames.numbers)
    points = table[:, : 4 * frames.markers].reshape(frames.count, frames.markers, 4)
    signals = table[:, 4 * frames.markers :].reshape(frames.count * frames.per_frame, frames.channels)
    with np.errstate(all="ignore"):  # a damaged file may hold any numbers
        markers = points[:, :, :3].astype(np.float64)
        if frames.scale > 0.0:
            markers *= frames.scale
        markers[points[:, :, 3] < 0] = np.nan
        return markers, _scaled(signals, frames, parameters)


def _scaled(signals: Array, frames: C3dFrames, parameters: Parameters) -> Array:
    """Analogue samples in their units: what is read less an offset, times a factor of the channel and one of all."""
    offset = _one_each(parameters.numbers("ANALOG", "OFFSET"), frames.channels, 0.0)
    if "UNSIGNED" in (text.upper() for text in parameters.texts("ANALOG", "FORMAT")):
        offset %= 1 << 16
        signals = signals if frames.scale < 0.0 else signals.astype(np.uint16)
    general = parameters.number("ANALOG", "GEN_SCALE")
    made = signals.astype(np.float64)
    made -= offset
    made *= _one_each(parameters.numbers("ANALOG", "SCALE"), frames.channels, 1.0)
    made *= 1.0 if np.isnan(general) else general
    return made


def _one_each(given: Array, count: int, otherwise: float) -> Array:
    made = np.full(count, otherwise)
    made[: min(count, len(given))] = given[:count]
    return made


def _begin(path: Path, parameters: Parameters, block: int) -> int:
    """The byte at which samples begin."""
    size = path.stat().st_size
    for declared in (parameters.count("POINT", "DATA_START"), block):
        if declared and 0 < (begin := (declared - 1) * BLOCK) <= size:
            return begin
    raise RecordingError(f"{path}: its samples begin in block {block}, beyond its end; it is damaged, or was cut off")


def _counted(path: Path, frames: C3dFrames, header: int | None, parameters: Parameters) -> C3dFrames:
    """`frames` with as many as there are; `header` announces a number, None: more than it can say.

    Raises RecordingError where there are fewer than are announced.
    """
    end = path.stat().st_size
    turns = parameters.count("ROTATION", "DATA_START")
    if parameters.count("ROTATION", "USED") and turns and frames.begin < (turns - 1) * BLOCK < end:
        end = (turns - 1) * BLOCK
    size = frames.numbers * frames.width
    held = (end - frames.begin) // size if size else 0
    declared, doubt = parameters.count("POINT", "FRAMES") or header, ""
    if declared is None or declared == MAX_FRAMES:
        declared = header = _long(parameters)
        if declared is None and size:
            declared = held - _filled(path, end, size)
            doubt = "nothing says how many frames it holds: they were counted by its length, zeros at the end left out"
    count = min(declared or 0, held)
    if size and (header or 0) > count:
        raise RecordingError(f"{path}: {header} frames are announced, {count} are there; the file was cut off")
    return replace(frames, count=count, doubt=doubt)


def _filled(path: Path, end: int, size: int) -> int:
    """How many frames of `size` bytes are zeros that fill up the last block."""
    with path.open("rb") as file:
        file.seek(max(0, end - BLOCK))
        last = file.read(min(end, BLOCK))
    return (len(last) - len(last.rstrip(b"\0"))) // size if end % BLOCK == 0 else 0


def _long(parameters: Parameters) -> int | None:
    """Frames of a recording of more than 65535, as Vicon's and Qualisys' programs write it; None where nothing says so."""
    fields = [parameters.numbers("TRIAL", f"ACTUAL_{which}_FIELD") % (1 << 16) for which in ("START", "END")]
    if all(len(field) == 2 and np.isfinite(field).all() for field in fields):
        first, last = (int(field[0]) + (int(field[1]) << 16) for field in fields)
        if last >= first:
            return last - first + 1
    long = parameters.number("POINT", "LONG_FRAMES")
    return int(long) if 0 < long < 1 << 40 else None
