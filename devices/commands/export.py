"""`kinegraph files export`: a recording's streams as CSV tables, as one XDF file, as motion (BVH, glTF), or in another package's format."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.devices.formats.exporter import Export, Exporter, chosen, exporters
from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.data.bounded import reading
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.text.safe_text import say
from kinegraph.stream.text.short_names import whole_name

if TYPE_CHECKING:
    from kinegraph.stream.chunk import StreamSpec
    from kinegraph.stream.recording import Recording

FORMATS = "; ".join(f"{name}: {one.what}" for name, one in exporters().items())


class ExportClock(StrEnum):
    seconds = "seconds"
    iso = "iso"
    ns = "ns"


def export(
    recording: Annotated[File, typer.Argument(help="the recording", metavar="FILE")],
    output: Annotated[
        File | None, typer.Option("-o", "--out", help="what is made: a folder for CSV, else a file")
    ] = None,
    format: Annotated[str, typer.Option(metavar="NAME", help=f"{FORMATS} (default: as --out ends, else csv)")] = "",
    stream: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="only this stream; can be given again")
    ] = None,
    time: Annotated[
        ExportClock,
        typer.Option(help="CSV: seconds since the recording's first sample, ISO 8601 in UTC, or ns since 1970"),
    ] = ExportClock.seconds,
    resample: Annotated[
        bool,
        typer.Option(
            "--resample", help="interpolate signals with stamps that are too irregular for EDF, BIDS, C3D or TRC"
        ),
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace files that are there already")] = False,
    as_json: AsJson = False,
) -> None:
    """Export a recording's streams to the formats of other programs.

    What a format cannot hold is left out and reported: a table holds no images.
    """
    from kinegraph.stream.recording import Recording
    from kinegraph.stream.text.progress import bar

    exporter, done = chosen(format, output), 0
    with reading(recording, "a recording"), Recording.open(recording) as opened:
        names = _fitting(opened, stream or [], exporter)
        total = sum(opened.streams[name].samples for name in names)
        whole = recording.absolute()
        place = output or whole.with_name(whole.stem + exporter.suffix)
        with bar(f"exporting {recording.name}") as progress:

            def more(rows: int) -> None:
                nonlocal done
                done += rows
                progress(done, total)

            export = Export(opened, names, place, time.value, overwrite, more, resample)
            try:
                written = exporter.write(export)
            except OSError as error:
                raise RecordingError(f"{place}: cannot be written ({error.strerror or error})") from None
    if as_json:
        made = [{"stream": name, "file": path, "samples": rows} for name, path, rows in written]
        print_json({"written": made, "left_out": [name for name in opened.streams if name not in names]})
        return
    for name, path, rows in written:
        say(f"{name}: {rows} samples to {path}")
    if exporter.suffix == "_csv" and time is ExportClock.seconds and export.origin > 0:
        import numpy as np

        say(f"0 s in the tables is {np.datetime64(export.origin, 'ns')}Z")


def _fitting(recording: Recording, wanted: list[str], exporter: Exporter) -> list[str]:
    fit = []
    for name in [whole_name(name, recording.streams) for name in wanted] or recording.streams:
        why = (exporter.takes or _no_table)(recording.stream(name).spec)
        if not why:
            fit.append(name)
        elif wanted:
            raise RecordingError(f"stream {name!r}: {why}")
        else:
            say(f"{name}: left out ({why})", err=True)
    if not fit:
        raise RecordingError(f"{recording.path}: there is no stream to export")
    return fit


def _no_table(spec: StreamSpec) -> str:
    """Why a stream does not fit into a table."""
    from kinegraph.stream.data.columns import column_names

    try:
        column_names(spec)
    except RecordingError as error:
        return str(error)
    return ""
