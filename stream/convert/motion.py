"""Motion capture files of several kinds, with what is said about their streams."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path

from stream.convert.asf_read import Skeleton, read_amc, read_asf
from stream.convert.bvh_read import read_bvh
from stream.convert.c3d_read import read_c3d
from stream.convert.kinect_read import read_kinect
from stream.convert.series import Series
from stream.convert.shelf import Wishes
from stream.errors import RecordingError

RATE_HZ = 120.0
"""Of AMC files, which do not say theirs."""


def read_motion(files: Sequence[Path], wishes: Wishes) -> list[Series]:
    """The streams of BVH, C3D, AMC and Kinect files, each called after its file. Raises RecordingError."""
    skeletons = {file.stem: read_asf(file) for file in files if file.suffix.lower() == ".asf"}
    made: list[Series] = []
    for file in files:
        made += _read(file, skeletons, wishes)
    if skeletons and not any(file.suffix.lower() == ".amc" for file in files):
        raise RecordingError(
            f"{next(iter(skeletons.values())).path}: a skeleton alone does not move; name its AMC files too"
        )
    for one in made:
        if facts := wishes.meta.get(one.name):
            one.spec = one.spec.derive(meta={**one.spec.meta, **facts})
    return made


def _read(file: Path, skeletons: dict[str, Skeleton], wishes: Wishes) -> list[Series]:
    kind, unit = file.suffix.lower(), wishes.of(wishes.unit, file.stem)
    scale = _number(wishes.of(wishes.scale, file.stem) or "1", f"--scale {file.stem}")
    if kind == ".asf":
        return []
    if kind == ".bvh":
        return read_bvh(file, unit, scale, wishes.start_ns)
    if kind == ".c3d":
        return read_c3d(file, wishes.start_ns)
    if kind == ".amc":
        rate = _number(wishes.of(wishes.rate, file.stem) or str(RATE_HZ), f"--rate {file.stem}")
        return read_amc(file, _skeleton_of(file, skeletons), rate, wishes.start_ns)
    return read_kinect(file, unit, scale, wishes.start_ns)


def _skeleton_of(file: Path, skeletons: dict[str, Skeleton]) -> Skeleton:
    """The only skeleton, or the one whose name begins the file's: 86.asf for 86_01.amc."""
    fitting = [name for name in skeletons if file.stem.startswith(name)] if len(skeletons) > 1 else list(skeletons)
    if not fitting:
        raise RecordingError(
            f"{file}: an AMC file is read with its skeleton; name the ASF file too, as in 86.asf 86_01.amc"
        )
    return skeletons[max(fitting, key=len)]


def _number(text: str, option: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not isfinite(number) or number <= 0.0:
        raise RecordingError(f"{option}: {text} must be a positive number")
    return number
