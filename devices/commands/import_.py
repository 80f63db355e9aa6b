"""`kinegraph import`: files of other programs as a recording that replays as if it had been live."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from devices.commands.import_options import pairs, value, wishes_of
from devices.files.importer import listed, read_files
from stream.errors import RecordingError
from stream.plain import say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from devices.files.column_table import Wishes
    from stream.recording.series import Series

Many = list[str] | None


def import_(
    files: Annotated[
        list[File],
        typer.Argument(
            help=f"files, recognised by their content or the ends of their names. {listed()}", metavar="FILE"
        ),
    ],
    output: Annotated[
        File | None, typer.Option("-o", "--out", help="the recording to be made, ending in .mcap")
    ] = None,
    preview: Annotated[
        bool, typer.Option("--preview", help="only say what was understood; nothing is written")
    ] = False,
    stream: Annotated[
        Many,
        typer.Option(
            metavar="NAME=COLUMNS",
            help="a stream from an array, from columns (a,b,c), or from a stream of a file that has streams",
        ),
    ] = None,
    events: Annotated[Many, typer.Option(metavar="NAME=COLUMN", help="an event stream from a column of times")] = None,
    time: Annotated[
        Many, typer.Option(metavar="[NAME=]COLUMN", help="the column or array with the samples' times")
    ] = None,
    time_unit: Annotated[
        Many,
        typer.Option(
            metavar="[NAME=]UNIT", help="s, ms, us, ns, min or samples (default: by the column's name, else s)"
        ),
    ] = None,
    rate: Annotated[
        Many, typer.Option(metavar="[NAME=]HZ", help="sampling rate: a number, or the array that holds it")
    ] = None,
    counter: Annotated[
        Many, typer.Option(metavar="[NAME=]COLUMN", help="a packet counter, which tells what was lost")
    ] = None,
    names: Annotated[
        Many, typer.Option(metavar="[NAME=]NAMES", help="channel names: a,b,c, or the array that holds them")
    ] = None,
    unit: Annotated[
        Many, typer.Option(metavar="[NAME=]UNIT", help="unit of the samples, e.g. uV; or one for each channel: a,b,c")
    ] = None,
    scale: Annotated[Many, typer.Option(metavar="[NAME=]FACTOR", help="multiply the samples")] = None,
    meta: Annotated[Many, typer.Option(metavar="NAME:KEY=VALUE", help="a fact about a stream, e.g. side=right")] = None,
    fact: Annotated[Many, typer.Option(metavar="KEY=VALUE", help="a fact about the session, e.g. subject=S01")] = None,
    start: Annotated[
        str, typer.Option(metavar="ISO", help="when time 0 was, e.g. 2024-05-01T09:30:00+02:00 (UTC without an offset)")
    ] = "",
    skip_rows: Annotated[
        int | None,
        typer.Option(min=0, metavar="N", help="text files: pass over N lines; below them the header may be missing"),
    ] = None,
    chunk_ms: Annotated[
        float, typer.Option(min=1.0, max=1000.0, help="samples arrive in windows of this many ms")
    ] = 20.0,
    repeated: Annotated[bool, typer.Option(help="accept repeated times (a clock coarser than the rate)")] = False,
    text_width: Annotated[
        int | None,
        typer.Option(min=1, max=4096, help="characters that a marker of an XDF file may have (default: as it has)"),
    ] = None,
    dejitter: Annotated[bool, typer.Option(help="XDF: remove the jitter of regular streams' times")] = True,
    kinect: Annotated[bool, typer.Option(help="CSV: x, y and z of a skeleton's joints, as points")] = False,
    clock_sync: Annotated[bool, typer.Option(help="XDF: apply the clock offsets that were measured")] = True,
    untried: Annotated[
        bool, typer.Option("--untried", help="also read formats of which no real file was at hand to try: MVNX, Cortex")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a recording that is there already")] = False,
) -> None:
    """Turn files of other programs into one recording.

    With --preview it only shows what would be read.

    kinegraph import emg.csv -o emg.mcap --stream board.emg=TA,GM --time time --unit uV
    """
    from stream.commands import logs

    logs.set_up()
    said = {"stream": stream, "events": events, "time": time, "time_unit": time_unit, "rate": rate, "counter": counter,
            "names": names, "unit": unit, "scale": scale, "meta": meta}  # fmt: skip
    wishes = wishes_of(said, start, repeated=repeated, text_width=text_width, dejitter=dejitter, clock_sync=clock_sync,
                       skip_rows=skip_rows, preview=preview, untried=untried)  # fmt: skip
    facts = {key: value(text) for key, text in pairs("fact", fact, named=True).items()}
    if output is None and not preview:
        raise RecordingError(
            "--out is missing: name the recording to be made, as in -o NAME.mcap, or look with --preview"
        )
    if output is not None and output.suffix != ".mcap":
        raise RecordingError(f"--out {output}: the recording's name must end in .mcap")
    series = read_files(files, wishes, kinect=kinect)
    _check_names(series)
    if preview or output is None:
        from devices.commands.preview import show

        show(series, wishes.findings)
    else:
        _write(files, series, wishes, facts, output, chunk_ms / 1000, overwrite=overwrite)


def _write(
    files: Sequence[File],
    series: Sequence[Series],
    wishes: Wishes,
    facts: dict[str, str | int | float],
    output: File,
    chunk_s: float,
    *,
    overwrite: bool,
) -> None:
    from stream.progress import bar
    from stream.recording import versions
    from stream.recording.series import write_recording

    if not any(len(one.time) for one in series):
        raise RecordingError(f"{', '.join(map(str, files))}: there are no samples to record")
    doubts = wishes.findings.doubts
    imported = {"files": [file.name for file in files], "at": datetime.now(UTC).isoformat(timespec="seconds")}
    header = {
        "graph": "",
        "session": {**wishes.findings.facts, **facts},
        "imported": {**imported, **({"doubts": doubts} if doubts else {})},
        "versions": versions(),
    }
    with bar(f"importing {', '.join(file.name for file in files)}") as progress:
        write_recording(output, series, header, chunk_s=chunk_s, overwrite=overwrite, progress=progress)
    for one in series:
        say(f"{one.name}: {len(one.time)} samples, {one.spec.describe()}")
    for doubt in doubts:
        say(f"doubtful: {doubt}", err=True)


def _check_names(series: Sequence[Series]) -> None:
    for one in series:
        if sum(one.name == other.name for other in series) > 1:
            raise RecordingError(f"two streams are named {one.name!r}; name them with --stream")
