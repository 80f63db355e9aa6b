"""Files of laboratories' programs with what somebody says about their streams: names, units, rates, facts, the start."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.column_table import ImportOptions, positive
from kinegraph.devices.formats.import_result import Asked, RateMissing, Understood
from kinegraph.devices.formats.importer import Reader
from kinegraph.devices.formats.timing import plain_unit
from kinegraph.stream.data.bounded import reading
from kinegraph.stream.errors import RecordingError, nearest
from kinegraph.stream.recording.series import Series

Grammar = Callable[[Path, Asked], Understood]
PREVIEW_HZ = 1.0
"""Replaces an unknown rate, where a file is only looked at."""


def reader(kind: str, read: Grammar) -> Reader:
    """An importer's reader of files that `read` understands; `kind` completes the sentence "cannot be read as ..."."""

    def read_all(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
        made: list[Series] = []
        for file in files:
            if not file.is_file():
                raise RecordingError(f"{file}: there is no such file")
            with reading(file, kind), np.errstate(all="ignore"):
                made += _placed(_understood(file, read, options), options)
        return renamed(made, options, alone=last)

    return read_all


def _understood(file: Path, read: Grammar, options: ImportOptions) -> Understood:
    asked = Asked(_rate(file, options), _said(options.unit, file), options.skip_rows or 0, options.repeated)
    try:
        return read(file, asked)
    except RateMissing as error:
        if not options.preview:
            raise
        made = read(file, replace(asked, rate_hz=PREVIEW_HZ))
        made.doubt(f"{str(error).removeprefix(f'{file}: ')}; times below count samples")
        return made


def _placed(made: Understood, options: ImportOptions) -> list[Series]:
    """The series at their time: as somebody says, as the file does, or from 1970 on; what was found is noted."""
    options.findings.of(made, options.claims)
    begin = options.begin if options.begin is not None else made.begin or 0
    for one in made.series:
        one.time = one.time + begin
        if one.spec.is_event and "onset" in (one.spec.dtype.names or ()):
            one.data = one.data.copy()
            one.data["onset"] += begin
            if "end" in (one.spec.dtype.names or ()):
                one.data["end"] += begin
    return made.series


def renamed(made: Sequence[Series], options: ImportOptions, *, alone: bool) -> tuple[list[Series], ImportOptions]:
    """The series, those chosen by --stream NAME=STREAM under their new names; unit, scale and meta as wished; and what concerns others."""
    known = [one.name for one in made]
    chosen = {name: parts[0] for name, parts in options.streams.items() if parts and parts[0] in known}
    by_name = {one.name: one for one in made}
    taken = [replace(by_name[old], name=new) for new, old in chosen.items()] if chosen else list(made)
    names = {one.name: (one.name, chosen.get(one.name, one.name)) for one in taken}
    for one in taken:
        _changed(one, names[one.name], options)
    named = {key for pair in names.values() for key in pair} | {key.partition(".")[0] for key in known}
    rest = replace(
        options,
        streams={name: parts for name, parts in options.streams.items() if name not in chosen},
        meta={name: facts for name, facts in options.meta.items() if name not in named},
        rate={name: v for name, v in options.rate.items() if name not in named},
        unit={name: v for name, v in options.unit.items() if name not in named},
        scale={name: v for name, v in options.scale.items() if name not in named},
    )
    if alone:
        _nothing_left(rest, known)
    return taken, rest


def _changed(one: Series, names: tuple[str, ...], options: ImportOptions) -> None:
    if facts := {key: value for name in names for key, value in options.meta.get(name, {}).items()}:
        one.spec = one.spec.derive(meta={**one.spec.meta, **facts})
    if one.spec.is_event:
        return
    unit = next((options.unit[name] for name in names if name in options.unit), "")
    if not unit and not any(one.spec.units):
        unit = options.unit.get("", "")
    if unit:
        one.spec = one.spec.derive(units=(plain_unit(unit),))
    if scale := next((options.scale[name] for name in (*names, "") if name in options.scale), ""):
        one.data = one.data * positive(scale, "--scale")


def _nothing_left(rest: ImportOptions, known: Sequence[str]) -> None:
    for name, parts in rest.streams.items():
        what = ",".join(parts)
        raise RecordingError(f"--stream {name}={what}: there is no such stream in these files; {nearest(what, known)}")
    for option in ("rate", "unit", "scale", "meta"):
        for name in filter(None, getattr(rest, option)):
            raise RecordingError(f"--{option} {name}=...: no such stream is made; {nearest(name, known)}")
    for option in ("events", "time", "time_unit", "counter", "names"):
        if getattr(rest, option):
            raise RecordingError(f"--{option.replace('_', '-')}: these files say this themselves; leave it out")


def _said(option: Mapping[str, str], file: Path) -> str:
    mine = [name for name in option if name == file.stem]
    return option[mine[0]] if mine else option.get("", "")


def _rate(file: Path, options: ImportOptions) -> float | None:
    mine = [name for name in options.rate if name == file.stem or name.startswith(f"{file.stem}.")]
    rate_text = options.rate[mine[0]] if mine else options.rate.get("", "")
    return positive(rate_text, "--rate") if rate_text else None
