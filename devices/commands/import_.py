"""`kinegraph import`: CSV, NPZ, XDF and motion capture files as a recording that replays as if it had been live."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stream.errors import RecordingError
from stream.plain import say

if TYPE_CHECKING:
    from devices.files.column_table import ColumnTable, Wishes
    from stream.recording.series import Series

TIMES = ("time", "t", "timestamp", "time_s", "t_s", "time_ms", "t_ms", "time_us", "time_ns")
"""Column names that are taken for the time where nothing is said."""

Many = list[str] | None

MOTION = (".bvh", ".c3d", ".amc", ".asf")
TABLES = (".csv", ".tsv", ".txt")


def import_(
    files: Annotated[
        list[File],
        typer.Argument(
            help="CSV (with a header line), NPZ, XDF, BVH, C3D or AMC (with its ASF) files", metavar="FILE..."
        ),
    ],
    output: Annotated[File, typer.Option("-o", "--out", help="the recording to be made, ending in .mcap")],
    stream: Annotated[
        Many,
        typer.Option(
            metavar="NAME=COLUMNS",
            help="a stream from an array, from columns (a,b,c), or from a stream of an XDF or motion file",
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
    unit: Annotated[Many, typer.Option(metavar="[NAME=]UNIT", help="unit of the samples, e.g. uV")] = None,
    scale: Annotated[Many, typer.Option(metavar="[NAME=]FACTOR", help="multiply the samples")] = None,
    meta: Annotated[Many, typer.Option(metavar="NAME:KEY=VALUE", help="a fact about a stream, e.g. side=right")] = None,
    fact: Annotated[Many, typer.Option(metavar="KEY=VALUE", help="a fact about the session, e.g. subject=S01")] = None,
    start: Annotated[
        str, typer.Option(metavar="ISO", help="when time 0 was, e.g. 2024-05-01T09:30:00+02:00 (UTC without an offset)")
    ] = "",
    chunk_ms: Annotated[
        float, typer.Option(min=1.0, max=1000.0, help="samples arrive in windows of so many ms")
    ] = 20.0,
    repeated: Annotated[bool, typer.Option(help="accept repeated times (a clock coarser than the rate)")] = False,
    text_width: Annotated[
        int, typer.Option(min=1, max=4096, help="characters that a marker of an XDF file may have")
    ] = 64,
    dejitter: Annotated[bool, typer.Option(help="XDF: remove the jitter of regular streams' times")] = True,
    kinect: Annotated[bool, typer.Option(help="CSV: x, y and z of a skeleton's joints, as points")] = False,
    clock_sync: Annotated[bool, typer.Option(help="XDF: apply the clock offsets that were measured")] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a recording that is there already")] = False,
) -> None:
    """Turn CSV, NPZ, XDF, BVH, C3D or AMC files into one recording.

    kinegraph import emg.csv -o emg.mcap --stream board.emg=TA,GM --time time --unit uV
    """
    from devices.files.column_table import Wishes
    from stream.commands import logs
    from stream.progress import bar
    from stream.recording import versions
    from stream.recording.series import write_recording

    if output.suffix != ".mcap":
        raise RecordingError(f"--out {output}: the recording's name must end in .mcap")
    logs.set_up()
    begin = _moment(start)
    wishes = Wishes(
        streams={name: _list(value) for name, value in _pairs("stream", stream, named=True).items()},
        events=_pairs("events", events, named=True),
        rate=_pairs("rate", rate),
        time=_pairs("time", time),
        time_unit=_pairs("time-unit", time_unit),
        counter=_pairs("counter", counter),
        names=_pairs("names", names),
        unit=_pairs("unit", unit),
        scale=_pairs("scale", scale),
        meta=_meta(meta),
        repeated=repeated,
        start_ns=begin or 0,
    )
    xdf = {"width": text_width, "begin": begin, "dejitter": dejitter, "synchronize": clock_sync}
    series = _read(files, wishes, xdf, kinect=kinect)
    _check_names(series)
    if not any(len(one.time) for one in series):
        raise RecordingError(f"{', '.join(map(str, files))}: there are no samples to record")
    header = {
        "graph": "",
        "session": {key: _value(value) for key, value in _pairs("fact", fact, named=True).items()},
        "imported": {"files": [file.name for file in files], "at": datetime.now(UTC).isoformat(timespec="seconds")},
        "versions": versions(),
    }
    with bar(f"importing {', '.join(file.name for file in files)}") as progress:
        write_recording(output, series, header, chunk_s=chunk_ms / 1000, overwrite=overwrite, progress=progress)
    for one in series:
        say(f"{one.name}: {len(one.time)} samples, {one.spec.describe()}")


def _read(files: Sequence[File], wishes: Wishes, xdf: dict[str, Any], *, kinect: bool) -> list[Series]:
    """The streams of all files, each kind by its own reader; `xdf` is what the reader of XDF is told besides."""
    motion = [file for file in files if file.suffix.lower() in MOTION or (kinect and file.suffix.lower() in TABLES)]
    others = [file for file in files if file not in motion]
    tables = [file for file in others if file.suffix.lower() not in (".xdf", ".xdfz")]
    series: list[Series] = []
    if motion:
        from devices.files.motion import read_motion

        series, wishes = read_motion(motion, wishes, alone=not others)
    for file in others:
        if file not in tables:
            series += _from_xdf(file, wishes, **xdf, alone=not tables)
    return series + (_from_tables(tables, wishes) if tables else [])


def _from_xdf(
    file: File, wishes: Wishes, width: int, begin: int | None, *, dejitter: bool, synchronize: bool, alone: bool
) -> list[Series]:
    from devices.files.xdf_read import read_xdf

    chosen = {name: ",".join(parts) for name, parts in wishes.streams.items()} if alone else {}
    made = read_xdf(file, streams=chosen, text_width=width, start_ns=begin, dejitter=dejitter, synchronize=synchronize)
    for one in made:
        if facts := wishes.meta.get(one.name):
            one.spec = one.spec.derive(meta={**one.spec.meta, **facts})
    return made


def _from_tables(files: Sequence[File], wishes: Wishes) -> list[Series]:
    from devices.files.column_table import ColumnTable, make
    from stream.bounded import reading
    from stream.tables import read_csv, read_npz

    table = ColumnTable()
    for file in files:
        if not file.exists():
            raise RecordingError(f"{file}: there is no such file")
        if file.suffix.lower() == ".npz":
            table.put(file, read_npz(file))
        elif file.suffix.lower() in TABLES:
            with reading(file, "CSV"):
                table.put(file, read_csv(file))
        else:
            raise RecordingError(
                f"{file}: what kind of file this is cannot be told; its name must end in .csv, .tsv, .txt, .npz, .xdf, .bvh, .c3d or .amc"
            )
    if not wishes.streams and not wishes.events:
        _by_default(files, table, wishes)
    return make(table, wishes)


def _by_default(files: Sequence[File], table: ColumnTable, wishes: Wishes) -> None:
    """One stream for each CSV file, named like it, of all columns but the time."""
    for file in files:
        mine = [n for n in table.columns if n.startswith(f"{file.stem}:")]
        if file.suffix.lower() == ".npz":
            listed = ", ".join(f"{n.partition(':')[2]} {table.columns[n].data.shape}" for n in mine)
            raise RecordingError(f"{file}: say which arrays are streams, with --stream NAME=ARRAY; there are {listed}")
        time = wishes.of(wishes.time, file.stem) or next((n for n in mine if n.partition(":")[2].lower() in TIMES), "")
        if time and not wishes.of(wishes.time, file.stem):
            wishes.time[file.stem] = time
        taken = {time, f"{file.stem}:{time}", f"{file.stem}:lost"}
        wishes.streams[file.stem] = [
            n for n in mine if n not in taken and n.partition(":")[2] not in wishes.counter.values()
        ]


def _check_names(series: Sequence[Series]) -> None:
    for one in series:
        if sum(one.name == other.name for other in series) > 1:
            raise RecordingError(f"two streams are named {one.name!r}; name them with --stream")


def _pairs(option: str, given: Many, *, named: bool = False) -> dict[str, str]:
    """["a=x", "y"] as {"a": "x", "": "y"}: what is said of one stream, and of all others."""
    made: dict[str, str] = {}
    for text in given or ():
        name, equals, value = text.partition("=")
        if not equals:
            name, value = "", text
        if not value or (named and not name):
            raise RecordingError(f"--{option} {text}: must be NAME=VALUE")
        if name in made:
            raise RecordingError(f"--{option}: given twice{f' for {name}' if name else ''}")
        made[name] = value
    return made


def _list(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _meta(given: Many) -> dict[str, dict[str, Any]]:
    made: dict[str, dict[str, Any]] = {}
    for text in given or ():
        key, equals, value = text.partition("=")
        name, colon, fact = key.rpartition(":")
        if not (equals and colon and name and fact):
            raise RecordingError(f"--meta {text}: must be STREAM:KEY=VALUE")
        made.setdefault(name, {})[fact] = _value(value)
    return made


def _value(text: str) -> str | int | float:
    """A finite number where it is one, else the text."""
    for kind in (int, float):
        try:
            number: int | float = kind(text)
        except ValueError:
            continue
        return number if isfinite(number) else text
    return text


def _moment(text: str) -> int | None:
    """ns UTC of an ISO time; one without a zone is UTC."""
    if not text:
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise RecordingError(f"--start {text}: must be a time like 2024-05-01T09:30:00+02:00") from None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    if not 1900 <= moment.year <= 2100:
        raise RecordingError(f"--start {text}: must lie between 1900 and 2100")
    whole = moment.replace(microsecond=0)
    return round(whole.timestamp()) * 1_000_000_000 + moment.microsecond * 1000
