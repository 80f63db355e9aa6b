"""Recovery: what can be read of an unfinished or damaged recording, rewritten as finished files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.writer import CompressionType

from kinegraph.stream.errors import NothingRecorded, RecordingError
from kinegraph.stream.recording.format.layout import LOG, METRICS, encode_log, table
from kinegraph.stream.recording.format.overview import overview_of
from kinegraph.stream.recording.format.paths import is_running, part_path, parts_of
from kinegraph.stream.recording.format.recorded_stream import RecordedStream
from kinegraph.stream.recording.read.missing import Missing, missing_after
from kinegraph.stream.recording.read.recorded_file import RecordedFile
from kinegraph.stream.recording.read.records import messages
from kinegraph.stream.recording.write.file_segment import FileSegment
from kinegraph.stream.system.atomic_file import private_folder


@dataclass(frozen=True, slots=True)
class Recovered:
    """A part that was rewritten: how much it holds, how many damaged places were left out (each shows as lost samples), and what
    could not be saved at its end.
    """

    path: Path
    messages: int
    samples: int
    damaged: int
    missing: Missing | None = None


def rewrite(path: Path, output: Path | None, progress: Callable[[int, int], None] | None = None) -> list[Recovered]:
    """Rewrite the recording at `path`: whole to `output`, or only the unfinished parts in their place (kept as *.unfinished).

    Raises RecordingError if nothing can be read, if the recording is running, or if `output` already exists.
    """
    if not path.exists():
        raise RecordingError(f"{path}: there is no such recording")
    if is_running(path):
        raise RecordingError(f"{path}: is being recorded now; stop that session first")
    if output is not None and parts_of(output):
        raise RecordingError(f"{output}: already holds a recording; name another place")
    done = []
    paths = parts_of(path)
    if not paths:
        raise RecordingError(f"{path}: the folder holds no recording (session.0000.mcap is missing)")
    for number, part in enumerate(paths):
        try:
            opened = RecordedFile(part, forgiving=True)
        except NothingRecorded:
            if len(paths) == 1:
                raise
            continue
        missing = missing_after(opened, last=part == paths[-1])
        try:
            if output is not None:
                private_folder(output.parent if output.suffix == ".mcap" else output)
                done.append(_rewrite(opened, part_path(output, number), number, missing, progress))
            elif not opened.finished or opened.damaged:
                done.append(_replace(opened, number, missing, progress))
        except OSError as error:
            raise RecordingError(f"{output or part}: cannot be written ({error.strerror or error})") from None
        finally:
            opened.file.close()
    return done


def _replace(
    old: RecordedFile, number: int, missing: Missing | None, progress: Callable[[int, int], None] | None
) -> Recovered:
    path = old.file.path
    fresh = path.with_name(f".{path.name}.recovering")
    fresh.unlink(missing_ok=True)
    made = _rewrite(old, fresh, number, missing, progress)
    path.replace(path.with_name(path.name + ".unfinished"))
    fresh.replace(path)
    return replace(made, path=path)


def _rewrite(
    old: RecordedFile, path: Path, number: int, missing: Missing | None, progress: Callable[[int, int], None] | None
) -> Recovered:
    """Copy every message that can be read to a new file at `path`, say in its log what is `missing`, and end it."""
    part = FileSegment(path, number, old.header, CompressionType.LZ4 if old.images else CompressionType.ZSTD)
    try:
        overviews = {name: made for name, s in old.streams.items() if (made := overview_of(s.spec, s.kept))}
        tallies = {name: RecordedStream(s.spec, s.role, s.kept) for name, s in old.streams.items()}
        channels = {name: part.declare(name, s.spec, s.role, s.kept) for name, s in old.streams.items()}
        channels |= {topic: part.channel_of(topic) for topic in (LOG, METRICS)}
        images = {name: part.declare_frames(name, old.streams[name].kept) for name in old.images.values()}
        frames: Counter[tuple[str, int]] = Counter()
        count = newest = 0
        for i, record in enumerate(old.chunks):
            for message in messages(old.file.unpack(record)):
                if image := old.images.get(message.channel):
                    frames[image, message.batch] += 1
                    channel = images[image]
                elif name := old.topics.get(message.channel):
                    if name in images and frames.pop((name, message.batch), 0) != len(table(message.body).times):
                        continue
                    channel = channels[name]
                    if name in tallies:
                        tallies[name].count(table(message.body))
                    if name in overviews:
                        overviews[name].add(message.body)
                else:
                    continue
                part.add(channel, message.log_time, message.publish_time, message.batch, bytes(message.body))
                count += 1
                newest = max(newest, message.log_time)
            part.save()
            if progress:
                progress(i + 1, len(old.chunks))
        if missing and missing != Missing():
            line = encode_log("recovered", newest, {"level": "warning", **missing.to_json()})
            part.add(part.channel_of(LOG), newest, newest, 0, line)
        packed = {name: body for name, overview in overviews.items() if (body := overview.pack())}
        part.finish({name: tally.to_json() for name, tally in tallies.items()}, packed)
    except BaseException:
        part.abandon()
        path.unlink(missing_ok=True)
        raise
    return Recovered(path, count, sum(tally.samples for tally in tallies.values()), old.damaged, missing)
