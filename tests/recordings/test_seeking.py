"""Where a reader begins in a file: in every place the same as by looking at all of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder, Recording
from kinegraph.stream.recording.format.layout import table
from kinegraph.stream.recording.read.recorded_file import RecordedFile
from kinegraph.stream.recording.read.seeking import chunk_at, chunk_before

PER, STEP_NS = 5, 10**7


@pytest.fixture
def file(tmp_path: Path) -> RecordedFile:
    """Nine chunks of records, each with a message of five samples of `x`; `y` has one in every third."""
    spec = StreamSpec((1,), rate_hz=100.0)
    with Recorder(tmp_path / "s", {"graph": ""}, RecordingOptions(gather_s=0.0), wait=True) as recorder:
        numbers = [recorder.add_stream(name, spec, "input") for name in ("x", "y")]
        for k in range(9):
            time = (np.arange(PER) + PER * k) * STEP_NS + 1
            for number in numbers if k % 3 == 0 else numbers[:1]:
                recorder.write(number, Chunk(time, np.ones((PER, 1)), int(time[-1])), int(time[-1]), 2 * k + number)
            assert recorder.flush()
    with Recording.open(tmp_path / "s") as recording:
        (found,) = recording.parts
        assert len(found.chunks) >= 9
        yield found  # type: ignore[misc]


@pytest.mark.parametrize("topic", ["x", "y"])
def test_no_sample_at_or_after_a_time_lies_before_where_reading_begins(file: RecordedFile, topic: str) -> None:
    firsts = [
        [int(table(body).times[0]) for _, _, body, _ in file.messages({topic}, at)][:1]
        for at in range(len(file.chunks))
    ]
    for time in range(0, PER * 9 * STEP_NS, STEP_NS // 2):
        start = chunk_at(file, time, topic)
        later = [at for at, first in enumerate(firsts) if not first or first[0] >= time]
        assert start == max(min(later, default=len(firsts)) - 1, 0)


def test_no_input_after_a_sequence_lies_before_where_reading_begins(file: RecordedFile) -> None:
    firsts = [
        [int(table(body).rows[0, 4]) for _, _, body, _ in file.messages({"x", "y"}, at)][:1]
        for at in range(len(file.chunks))
    ]
    for sequence in range(-1, 30):
        start = chunk_before(file, sequence, {"x", "y"})
        later = [at for at, first in enumerate(firsts) if not first or first[0] > sequence]
        assert start <= max(min(later, default=len(firsts)) - 1, 0)
        assert all(first[0] <= sequence for first in firsts[: start + 1] if first and start)
