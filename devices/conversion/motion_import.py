"""Motion capture files of several kinds, with options for their streams."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.asf.reader import Skeleton, read_amc, read_asf
from kinegraph.devices.formats.bvh.reader import read_bvh
from kinegraph.devices.formats.c3d.reader import read_c3d
from kinegraph.devices.formats.column_table import ImportOptions, positive
from kinegraph.devices.formats.table.kinect import read_kinect
from kinegraph.devices.formats.table.landmarks import read_landmark_array
from kinegraph.stream.data.bounded import reading
from kinegraph.stream.errors import RecordingError, nearest
from kinegraph.stream.recording.series import Series

RATE_HZ = 120.0
"""Of AMC files, which do not say theirs."""

OPTIONS = ("rate", "time", "time_unit", "counter", "names", "unit", "scale")
TAKES = {".bvh": ("unit", "scale"), ".c3d": (), ".amc": ("rate",), ".asf": ()}
"""Options that each kind of file needs or accepts; the file holds the rest. Kinect tables take those of TABLE."""
TABLE = ("rate", "unit", "scale")


def read_motion(
    files: Sequence[Path], options: ImportOptions, *, alone: bool = True
) -> tuple[list[Series], ImportOptions]:
    """The streams of BVH, C3D, AMC and Kinect files, called after their files or as `--stream NAME=STREAM` names those that are chosen;
    and what was wished of other files, which there are unless these are `alone`. Raises RecordingError.
    """
    skeletons = {file.stem: read_asf(file) for file in files if kind_of(file) == ".asf"}
    made: list[Series] = []
    for file in files:
        made += _read(file, skeletons, options)
    if skeletons and not any(kind_of(file) == ".amc" for file in files):
        raise RecordingError(
            f"{next(iter(skeletons.values())).path}: a skeleton alone does not move; name its AMC files too"
        )
    known = [one.name for one in made]
    chosen = {name: parts[0] for name, parts in options.streams.items() if parts and parts[0] in known}
    rest = _rest(files, options, chosen, known)
    if alone:
        _nothing_left(rest, known, {kind_of(file) for file in files})
    for one in made:
        names = (one.name, *(new for new, old in chosen.items() if old == one.name))
        facts = {key: value for name in names for key, value in options.meta.get(name, {}).items()}
        one.spec = one.spec.derive(meta={**one.spec.meta, **facts}) if facts else one.spec
    by_name = {one.name: one for one in made}
    return [replace(by_name[old], name=new) for new, old in chosen.items()] if chosen else made, rest


def _rest(
    files: Sequence[Path], options: ImportOptions, chosen: Mapping[str, str], known: Sequence[str]
) -> ImportOptions:
    """The options for other files than these. Raises RecordingError for an option that a file states itself."""
    left: dict[str, Any] = {}
    for option in OPTIONS:
        given = getattr(options, option)
        for file in files:
            for name in _names(given, file, options):
                if option not in TAKES.get(kind_of(file), TABLE):
                    raise RecordingError(f"{_option(option)} {name}=...: {file.name} says this itself; leave it out")
        mine = {name for file in files for name in _names(given, file, options)}
        left[option] = {name: value for name, value in given.items() if name not in mine}
    left["meta"] = {name: facts for name, facts in options.meta.items() if name not in (*known, *chosen)}
    left["streams"] = {name: parts for name, parts in options.streams.items() if name not in chosen}
    return replace(options, **left)


def _nothing_left(rest: ImportOptions, known: Sequence[str], kinds: Iterable[str]) -> None:
    """Raises for an option about an unknown stream, or one that motion files state themselves."""
    for name, parts in rest.streams.items():
        what = ",".join(parts)
        raise RecordingError(f"--stream {name}={what}: there is no such stream in these files; {nearest(what, known)}")
    for option in (*OPTIONS, "meta"):
        for name in filter(None, getattr(rest, option)):
            raise RecordingError(f"{_option(option)} {name}=...: no such stream is made; {nearest(name, known)}")
    taken = {option for kind in kinds for option in TAKES.get(kind, TABLE)}
    for option in ("events", *OPTIONS):
        if option not in taken and getattr(rest, option):
            raise RecordingError(f"{_option(option)}: files of motion say this themselves; leave it out")


def kind_of(file: Path) -> str:
    """The suffix that a file should have, by its content where that tells, else as its name has it."""
    try:
        with file.open("rb") as opened:
            head = opened.read(512)
    except OSError:
        return file.suffix.lower()
    if claims(file, head):
        return ".c3d" if head[1:2] == b"\x50" else ".bvh"
    return file.suffix.lower()


def claims(file: Path, head: bytes) -> bool:
    """Whether a file is C3D or BVH by its first bytes, whatever it is called."""
    c3d = len(head) >= 512 and head[1] == 0x50 and head[0] > 0
    return (c3d and b"\0" in head) or head.lstrip().startswith(b"HIERARCHY")


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _names(given: Iterable[str], file: Path, options: ImportOptions) -> list[str]:
    """Those names that stand for a file, or for one of its streams, as the file calls it or as it shall be called."""
    found = []
    for name in given:
        old = (options.streams.get(name) or [name])[0]
        if old == file.stem or old.startswith(f"{file.stem}."):
            found.append(name)
    return found


def _said(option: Mapping[str, str], file: Path, options: ImportOptions) -> str:
    return next((option[name] for name in _names(option, file, options)), option.get("", ""))


def _read(file: Path, skeletons: dict[str, Skeleton], options: ImportOptions) -> list[Series]:
    with reading(file, f"a file of motion ({file.suffix.lower()})"), np.errstate(all="ignore"):
        return _of_kind(file, skeletons, options)


def _of_kind(file: Path, skeletons: dict[str, Skeleton], options: ImportOptions) -> list[Series]:
    kind, unit = kind_of(file), _said(options.unit, file, options)
    options.findings.kinds[file] = {".bvh": "BVH", ".asf": "ASF skeleton", ".amc": "AMC"}.get(
        kind, "table of a skeleton's joints"
    )
    scale = positive(_said(options.scale, file, options) or "1", f"--scale {file.stem}")
    if kind == ".asf":
        return []
    if kind == ".bvh":
        return read_bvh(file, unit, scale, options.start_ns)
    if kind == ".c3d":
        return read_c3d(file, options.start_ns, options.findings)
    rate_text = _said(options.rate, file, options)
    rate = positive(rate_text or str(RATE_HZ), f"--rate {file.stem}")
    if kind == ".amc":
        return read_amc(file, _skeleton_of(file, skeletons), rate, options.start_ns)
    if kind == ".npy":
        return read_landmark_array(file, rate if rate_text else None, options.start_ns)
    return read_kinect(file, unit, scale, options.start_ns, rate if rate_text else None)


def _skeleton_of(file: Path, skeletons: dict[str, Skeleton]) -> Skeleton:
    """The only skeleton, or the one that the file's name begins with: 86.asf for 86_01.amc."""
    fitting = [name for name in skeletons if file.stem.startswith(name)] if len(skeletons) > 1 else list(skeletons)
    if not fitting:
        raise RecordingError(
            f"{file}: an AMC file is read with its skeleton; name the ASF file too, as in 86.asf 86_01.amc"
        )
    return skeletons[max(fitting, key=len)]
