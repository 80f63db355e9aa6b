"""The importers that come with kinegraph: tables, XDF, motion capture. Each loads its reader when it reads."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from kinegraph.devices.formats.importer import Importer
from kinegraph.stream.errors import RecordingError

if TYPE_CHECKING:
    from kinegraph.devices.formats.column_table import ColumnTable, ImportOptions
    from kinegraph.stream.recording.series import Series

TIMES = ("time", "t", "timestamp", "time_s", "t_s", "time_ms", "t_ms", "time_us", "time_ns")
"""Column names that are taken for the time by default."""


def _motion(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
    from kinegraph.devices.conversion.motion_import import read_motion

    return read_motion(files, options, alone=last)


def _mesh(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
    from kinegraph.devices.formats.gltf.obj_reader import read_obj

    try:
        rate = float(rate_text) if (rate_text := options.rate.get("")) else None
        scale = float(options.scale.get("", 1.0))
    except ValueError:
        raise RecordingError(
            "--rate and --scale of a mesh are numbers: frames per second, and metres per unit"
        ) from None
    if (rate is not None and not 0.0 < rate < inf) or not 0.0 < scale < inf:
        raise RecordingError("--rate and --scale of a mesh must be positive")
    return read_obj(files, rate, scale, options.start_ns), options


def _xdf(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
    from kinegraph.devices.formats.xdf.reader import read_xdf

    chosen = {name: ",".join(parts) for name, parts in options.streams.items()} if last else {}
    series: list[Series] = []
    for file in files:
        made = read_xdf(
            file,
            streams=chosen,
            text_width=options.text_width,
            start_ns=options.begin,
            dejitter=options.dejitter,
            synchronize=options.clock_sync,
            claims=options.claims,
            findings=options.findings,
        )
        for one in made:
            if facts := options.meta.get(one.name):
                one.spec = one.spec.derive(meta={**one.spec.meta, **facts})
        series += made
    return series, options


def _tables(files: Sequence[Path], options: ImportOptions, last: bool) -> tuple[list[Series], ImportOptions]:
    from kinegraph.devices.formats.column_table import ColumnTable, make
    from kinegraph.stream.data.bounded import reading
    from kinegraph.stream.data.tables import read_csv, read_npz

    table = ColumnTable()
    for file in files:
        if not file.exists():
            raise RecordingError(f"{file}: there is no such file")
        if file.suffix.lower() == ".npz":
            table.put(file, read_npz(file))
        else:
            with reading(file, "CSV"):
                table.put(file, read_csv(file, options.skip_rows))
    if not options.streams and not options.events:
        _by_default(files, table, options)
    return make(table, options), options


def _by_default(files: Sequence[Path], table: ColumnTable, options: ImportOptions) -> None:
    """One stream for each CSV file, named like it, of all columns but the time."""
    for file in files:

        def own(name: str, prefix: str = f"{file.stem}:") -> str:
            return name.removeprefix(prefix)

        mine = [n for n in table.columns if n.startswith(f"{file.stem}:")]
        if file.suffix.lower() == ".npz":
            listed = ", ".join(f"{own(n)} {table.columns[n].data.shape}" for n in mine)
            raise RecordingError(f"{file}: say which arrays are streams, with --stream NAME=ARRAY; there are {listed}")
        time = options.of(options.time, file.stem) or next((n for n in mine if own(n).lower() in TIMES), "")
        if time and not options.of(options.time, file.stem):
            options.time[file.stem] = time
        text = [n for n in mine if table.columns[n].is_text and n != time]
        if len(text) + bool(time) >= len(mine):
            text = []  # its own message says what is wrong
        if text:
            left = ", ".join(repr(own(n)) for n in text)
            options.findings.doubts.append(f"{file.name}: {left}: text, not read")
        taken = {time, f"{file.stem}:{time}", f"{file.stem}:lost", *text}
        options.streams[file.stem] = [n for n in mine if n not in taken and own(n) not in options.counter.values()]


def _is_xdf(path: Path, head: bytes) -> bool:
    return head.startswith(b"XDF:")


def _is_motion(path: Path, head: bytes) -> bool:
    from kinegraph.devices.conversion.motion_import import claims

    return claims(path, head)


TABLE = Importer("tables (with a header line) and arrays", (".csv", ".tsv", ".txt", ".npz"), _tables, order=100)
XDF = Importer("XDF", (".xdf", ".xdfz"), _xdf, order=10, claims=_is_xdf)
MOTION = Importer(
    "motion capture (AMC with its ASF)", (".bvh", ".c3d", ".amc", ".asf"), _motion, order=0, claims=_is_motion
)
MESH = Importer("meshes, a file a frame, and animations of glTF", (".obj", ".ply", ".glb", ".gltf"), _mesh, order=20)
