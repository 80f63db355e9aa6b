"""Videos in: the frames of a file, as a stream of images on the file's own times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinegraph.devices.formats.importer import Importer
from kinegraph.stream.errors import DeviceError, ParameterError, RecordingError

if TYPE_CHECKING:
    from kinegraph.devices.formats.column_table import ImportOptions
    from kinegraph.stream.recording.series import Series

SUFFIXES = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm")
MAX_BYTES = 2 << 30
"""Pictures that take more than this are not unpacked into a recording."""


def _video(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
    return [_series(file, options) for file in files], options


def _series(path: Path, options: ImportOptions) -> Series:
    from kinegraph.devices.cameras.video import container
    from kinegraph.devices.cameras.video.source import Video, VideoReading, frames_of
    from kinegraph.stream.recording.series import Series

    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    source = Video(str(path))
    try:
        spec, facts = source.specs()["image"], container.file_facts(str(path))
    except (DeviceError, ParameterError) as error:
        raise RecordingError(f"{path}: cannot be read as a video ({error})") from None
    if facts.frames * int(np.prod(spec.shape)) > MAX_BYTES:
        raise RecordingError(
            f"{path}: its {facts.frames} pictures would fill {facts.frames * int(np.prod(spec.shape)) / 1e9:.0f} GB; "
            f"play it in a graph instead: kinegraph run webcam_avatar --set url={path}"
        )
    reading = VideoReading(source, source.size())
    images, times, lost = [], [], []
    try:
        with container.opened(str(path), 0, 0, 0.0) as (opened, _):
            for frame in frames_of(opened, str(path)):
                stamp, _, missing = reading.filed(frame)
                if stamp is not None:
                    images.append(reading.image(frame))
                    times.append(stamp)
                    lost.append(missing)
    except DeviceError as error:
        raise RecordingError(f"{path}: {error}") from None
    stamps = np.array(times, np.int64) + options.start_ns
    return Series(path.stem, spec, stamps, np.array(images), np.array(lost) if any(lost) else None)


def _is_video(path: Path, head: bytes) -> bool:
    """ISO media files (mp4, mov), Matroska (mkv, webm), AVI."""
    return head[4:8] == b"ftyp" or head.startswith(b"\x1aE\xdf\xa3") or (head[:4] == b"RIFF" and head[8:12] == b"AVI ")


VIDEO = Importer("videos (images are stored)", SUFFIXES, _video, order=20, claims=_is_video)
