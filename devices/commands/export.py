"""`kinegraph export`: a recording's streams as CSV tables or as one XDF file."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from stream.bounded import reading
from stream.complete import complete, private_folder
from stream.errors import RecordingError
from stream.plain import say

if TYPE_CHECKING:
    from stream.recording import Recording


class ExportFormat(StrEnum):
    csv = "csv"
    xdf = "xdf"


class Clock(StrEnum):
    seconds = "seconds"
    iso = "iso"
    ns = "ns"


def export(
    recording: Annotated[File, typer.Argument(help="the recording", metavar="FILE")],
    output: Annotated[File | None, typer.Option("-o", "--out", help="a folder for CSV, a file for XDF")] = None,
    format: Annotated[
        ExportFormat | None,
        typer.Option(help="csv: one table per stream; xdf: all streams in one file (default: as --out ends, else csv)"),
    ] = None,
    stream: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="only this stream; can be given again")
    ] = None,
    time: Annotated[
        Clock, typer.Option(help="CSV: seconds since the recording's first sample, ISO 8601 in UTC, or ns since 1970")
    ] = Clock.seconds,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace files that are there already")] = False,
) -> None:
    """Write streams as CSV or XDF. Frames are left out: they do not fit into a table."""
    from stream.recording import Recording

    with reading(recording, "a recording"), Recording.open(recording) as opened:
        names = _chosen(opened, stream or [])
        total = sum(opened.streams[name].samples for name in names)
        to_xdf = format is ExportFormat.xdf or (
            format is None and output is not None and output.suffix.lower() == ".xdf"
        )
        whole = recording.absolute()
        place = output or whole.with_name(whole.stem + (".xdf" if to_xdf else "_csv"))
        if not to_xdf and place.suffix.lower() == ".csv" and not place.is_dir():
            raise RecordingError(
                f"--out {place}: each stream becomes a table of its own; name a folder, as in -o {place.stem}"
            )
        written = (
            _xdf(opened, names, place, total, overwrite)
            if to_xdf
            else _csv(opened, names, place, total, time, overwrite)
        )
    for name, path, rows in written:
        say(f"{name}: {rows} samples to {path}")


def _chosen(recording: Recording, wanted: list[str]) -> list[str]:
    from stream.columns import column_names

    fit = []
    for name in wanted or recording.streams:
        try:
            column_names(recording.stream(name).spec)
        except RecordingError as error:
            if wanted:
                raise RecordingError(f"stream {name!r}: {error}") from None
            say(f"{name}: left out ({error})", err=True)
            continue
        fit.append(name)
    if not fit:
        raise RecordingError(f"{recording.path}: there is no stream to export")
    return fit


def _csv(
    recording: Recording, names: list[str], folder: File, total: int, clock: Clock, overwrite: bool
) -> list[tuple[str, File, int]]:
    from devices.files.csv_write import write_csv
    from stream.progress import bar

    done = 0
    written = []
    origin = _origin(recording)
    paths = _tables(names, folder, overwrite)
    try:
        private_folder(folder)
        with bar(f"exporting {recording.path.name}") as progress:

            def more(rows: int) -> None:
                nonlocal done
                done += rows
                progress(done, total)

            for name, path in paths.items():
                spec, chunks = recording.streams[name].spec, recording.chunks(name)
                with complete(path) as draft:
                    rows = write_csv(draft, spec, chunks, clock=clock.value, origin=origin, progress=more)
                written.append((name, path, rows))
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written ({error.strerror or error})") from None
    return written


def _tables(names: list[str], folder: File, overwrite: bool) -> dict[str, File]:
    """The file of each stream. Raises RecordingError where one would be lost: two of a name, or one that is there already."""
    if folder.exists() and not folder.is_dir():
        raise RecordingError(f"--out {folder}: is a file; name a folder for the tables")
    paths: dict[str, File] = {}
    for name in names:
        path = folder / f"{re.sub(r'[^A-Za-z0-9._-]', '_', name)}.csv"
        if other := next((n for n, p in paths.items() if p == path), None):
            raise RecordingError(
                f"streams {other!r} and {name!r} would both become {path}; export one of them with --stream"
            )
        _refuse_existing(path, overwrite)
        paths[name] = path
    return paths


def _refuse_existing(path: File, overwrite: bool) -> None:
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; choose another --out")
    if path.exists() and not overwrite:
        raise RecordingError(f"{path}: is there already; choose another --out, or replace it with --overwrite")


def _xdf(
    recording: Recording, names: list[str], path: File, total: int, overwrite: bool
) -> list[tuple[str, File, int]]:
    from devices.files.xdf_write import XdfWriter
    from stream.progress import bar

    if path.is_dir():
        raise RecordingError(f"--out {path}: is a folder; name the XDF file")
    _refuse_existing(path, overwrite)
    done = 0
    try:
        private_folder(path.parent)
        with complete(path) as draft, draft.open("wb") as file, bar(f"exporting {recording.path.name}") as progress:
            writer = XdfWriter(file, _origin(recording))
            numbers = {name: writer.add_stream(name, recording.streams[name].spec) for name in names}
            for name, number in numbers.items():
                for chunk in recording.chunks(name):
                    writer.write(number, chunk)
                    done += len(chunk)
                    progress(done, total)
            writer.close()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror or error})") from None
    return [(name, path, recording.streams[name].samples) for name in names]


def _origin(recording: Recording) -> int:
    return min((s.first for s in recording.streams.values() if s.first is not None), default=0)
