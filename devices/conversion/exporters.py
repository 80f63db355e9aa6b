"""The exporters that come with kinegraph: CSV tables, XDF, and what Foxglove plots. Each loads its writer when it writes."""

from __future__ import annotations

from pathlib import Path

from kinegraph.devices.formats.exporter import FILE_NAME, Export, Exporter, Written, titled
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.system.atomic_file import complete, private_folder


def _csv(wanted: Export) -> list[Written]:
    from kinegraph.devices.formats.table.csv_writer import write_csv

    folder = wanted.place
    if folder.suffix.lower() == ".csv" and not folder.is_dir():
        raise RecordingError(
            f"--out {folder}: each stream becomes a table of its own; name a folder, as in -o {folder.stem}"
        )
    written = []
    paths = _tables(wanted)
    private_folder(folder)
    for name, path in paths.items():
        spec, chunks = wanted.recording.streams[name].spec, wanted.recording.chunks(name)
        with complete(path) as draft:
            rows = write_csv(draft, spec, chunks, clock=wanted.clock, origin=wanted.origin, progress=wanted.progress)
        written.append((name, path, rows))
    return written


def _tables(wanted: Export) -> dict[str, Path]:
    """The file of each stream. Raises RecordingError where one would be lost."""
    folder = wanted.place
    if folder.exists() and not folder.is_dir():
        raise RecordingError(f"--out {folder}: is a file; name a folder for the tables")
    titles = titled(wanted.names, FILE_NAME, r"[^A-Za-z0-9._-]")
    paths = {name: folder / f"{title}.csv" for name, title in zip(wanted.names, titles, strict=True)}
    for path in paths.values():
        wanted.refuse_existing(path)
    return paths


def _xdf(wanted: Export) -> list[Written]:
    from kinegraph.devices.formats.xdf.writer import XdfWriter

    path, recording = wanted.place, wanted.recording
    if path.is_dir():
        raise RecordingError(f"--out {path}: is a folder; name the XDF file")
    wanted.refuse_existing(path)
    private_folder(path.parent)
    with complete(path) as draft, draft.open("wb") as file:
        writer = XdfWriter(file, wanted.origin)
        numbers = {name: writer.add_stream(name, recording.streams[name].spec) for name in wanted.names}
        for name, number in numbers.items():
            for chunk in recording.chunks(name):
                writer.write(number, chunk)
                wanted.progress(len(chunk))
        writer.close()
    return [(name, path, recording.streams[name].samples) for name in wanted.names]


def _foxglove(wanted: Export) -> list[Written]:
    from kinegraph.devices.formats.table.foxglove_writer import FoxgloveWriter

    path, recording = wanted.place, wanted.recording
    wanted.refuse_existing(path)
    private_folder(path.parent)
    with complete(path) as draft:
        writer = FoxgloveWriter(draft)
        counts = {
            name: writer.write(name, recording.streams[name].spec, recording.chunks(name), wanted.progress)
            for name in wanted.names
        }
        writer.close()
    return [(name, path, count) for name, count in counts.items()]


CSV = Exporter("a folder with one table per stream", "_csv", _csv)
XDF = Exporter("all streams in one file", ".xdf", _xdf)
FOXGLOVE = Exporter("all streams in one MCAP file of JSON messages, for Foxglove", ".foxglove.mcap", _foxglove)
