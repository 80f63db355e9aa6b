"""Where to begin to read a file of a recording: by bisection, for sequences and stamps grow."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

from kinegraph.stream.recording.format.layout import table
from kinegraph.stream.recording.read.recorded_file import RecordedFile


def chunk_before(file: RecordedFile, sequence: int, topics: set[str]) -> int:
    """A chunk of records before which no input comes after `sequence`."""
    low, high = 0, len(file.chunks)
    while low < high:
        middle = (low + high) // 2
        first = next((int(table(body).rows[0, 4]) for _, _, body, _ in file.messages(topics, middle)), None)
        if first is not None and first <= sequence:
            low = middle + 1
        else:
            high = middle
    start = max(low - 1, 0)
    batch = _first_batch(file, start)
    while start > 0 and _first_batch(file, start) == batch:
        start -= 1
    return start


def chunk_at(file: RecordedFile, time: int, topic: str) -> int:
    """A chunk of records before which no sample of `topic` is at or after `time`."""
    low, high = 0, len(file.chunks)
    while low < high:
        middle = (low + high) // 2
        first = next(
            (table(body).times for _, _, body, _ in file.messages({topic}, middle) if len(table(body).times)), None
        )
        if first is not None and int(first[0]) < time:
            low = middle + 1
        else:
            high = middle
    return max(low - 1, 0)


def messages_from(file: RecordedFile, time: int, topic: str) -> Iterator[tuple[str, int, memoryview, list[memoryview]]]:
    """The messages of a stream from the one on that holds `time` (ns), or from a little before, each with all its frames."""
    start = chunk_at(file, time, topic)
    known = 0
    if topic in file.images.values():
        # the frames of a chunk's first message may lie in chunks before: behind an earlier message
        while start > 0 and not known:
            start -= 1
            known = sum(file.topics.get(number) == topic for number, *_ in file.raw_messages(file.chunks[start]))
    return islice(file.messages({topic}, start), known, None)


def _first_batch(file: RecordedFile, start: int) -> int:
    """The batch that a chunk of records begins with; it may have begun before."""
    return next((message.batch for message in file.raw_messages(file.chunks[start])), -1)
