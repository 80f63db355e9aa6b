"""A recording that broke off or was cut: replay says how much is missing, `recover` how much could not be saved."""

from __future__ import annotations

import re
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format.checkpoint import Checkpoint
from kinegraph.stream.recording.read.missing import Missing
from kinegraph.stream.recording.read.records import RecordFile
from tests.recordings.test_recording import START, killed, record, session
from tests.support.command_line import Command, refused

GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 60}
  rect: {use: operators.filters.rectify.Rectify, from: board.emg}
record: [rect]
recording: {flush_s: 0.1}
"""
INCOMPLETE = 6


@pytest.fixture
def cut(kinegraph: Command, tmp_path: Path) -> Path:
    """A recording of a graph, and of it a copy that ends in the middle of a record, in which the session was further on than before."""
    (tmp_path / "graph.yaml").write_text(GRAPH)
    assert kinegraph("run", "graph.yaml", "-o", "s", "--view", "none")[0] == 0
    whole = tmp_path / "s" / "session.0000.mcap"
    file = RecordFile(whole)
    spans = [struct.unpack("<QQ", file.content(record)[:16]) for record in file.chunks]
    later = [at for at in range(1, len(spans)) if spans[at][1] > max(end for _, end in spans[:at])]
    torn = file.chunks[later[len(later) // 2]]
    file.close()
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole.read_bytes()[: torn.offset + torn.length // 2])
    return path


def test_replay_of_a_cut_recording_says_what_is_missing(kinegraph: Command, cut: Path) -> None:
    output = kinegraph("replay", "graph.yaml", cut, "-q")
    refused(output, str(cut), "was not closed cleanly", "not a complete record", code=INCOMPLETE)
    seconds = re.search(r"at least ([\d.]+) s", output[2])
    with Recording.open(cut) as recording:
        assert recording.missing and recording.missing.bytes > 0
        assert seconds and float(seconds[1]) == pytest.approx(recording.missing.seconds, abs=0.05)
        assert recording.missing.seconds > 0
    assert kinegraph("replay", "graph.yaml", "s", "-q")[0] == 0
    assert "not a complete record" in kinegraph("info", cut)[1]


def test_recover_says_what_could_not_be_saved(kinegraph: Command, cut: Path) -> None:
    code, shown, _ = kinegraph("recover", cut)
    assert code == 0 and re.search(r"\d+ bytes at its end .* could not be recovered: at least [\d.]+ s", shown), shown
    with Recording.open(cut) as recording:
        assert recording.finished and recording.missing is None
        line = next(line for line in recording.log if line["kind"] == "recovered")
        assert line["bytes"] > 0 and line["seconds"] > 0


def test_the_checkpoint_tells_of_what_a_cut_folder_held(tmp_path: Path) -> None:
    made = killed(tmp_path / "s")
    with Recording.open(tmp_path / "s") as recording:
        assert recording.missing and recording.missing.seconds == 0.0
        end = recording.end_of_inputs
    for sequence, seconds in ((len(made) + 9, 7.0), (len(made) - 1, 0.0)):  # of a silent source nothing is missing
        Checkpoint(sequence, end + 7_000_000_000, "", {}, arrays={"x": np.zeros(3)}).save(tmp_path / "s")
        with Recording.open(tmp_path / "s") as recording:
            assert recording.missing and recording.missing.seconds == pytest.approx(seconds)


def test_a_session_that_was_resumed_and_ended_well_is_closed_in_order(tmp_path: Path) -> None:
    made = killed(tmp_path / "s")
    with Recording.open(tmp_path / "s") as recording:
        ends = {name: stream.end for name, stream in recording.streams.items()}
    resume(tmp_path / "s", ends, len(made))
    with Recording.open(tmp_path / "s") as recording:
        assert len(recording.parts) == 2 and not recording.parts[0].finished
        assert recording.finished and recording.missing is None


def test_a_part_that_was_cut_after_the_session_went_on_is_noticed(tmp_path: Path) -> None:
    made = killed(tmp_path / "s")
    part = tmp_path / "s" / "session.0000.mcap"
    with Recording.open(tmp_path / "s") as recording:
        ends = {name: stream.end for name, stream in recording.streams.items()}
    resume(tmp_path / "s", ends, len(made))
    part.write_bytes(part.read_bytes()[: part.stat().st_size // 2])
    with Recording.open(tmp_path / "s") as recording:
        held = recording.parts[0].streams["board.emg"].end
        assert not recording.finished and recording.missing
        assert recording.missing.samples >= ends["board.emg"] - held > 0


def test_a_last_file_into_which_nothing_was_written_is_no_end(tmp_path: Path) -> None:
    record(tmp_path / "s", session()).close()
    shutil.copy(tmp_path / "s" / "session.0000.mcap", tmp_path / "one.mcap")
    (tmp_path / "s" / "session.0001.mcap").touch()
    with Recording.open(tmp_path / "one.mcap") as whole, Recording.open(tmp_path / "s") as recording:
        assert whole.finished and whole.missing is None
        assert not recording.finished and recording.missing


BEGUN = [0, 3, 8, 20]
"""How many bytes of a file had been written when the session was killed; its header has more."""


@pytest.mark.parametrize("held", BEGUN)
def test_a_file_that_was_only_begun_does_not_cost_those_around_it(
    held: int, kinegraph: Command, tmp_path: Path
) -> None:
    """Resumed while the disk is full, killed, and resumed again."""
    made = killed(tmp_path / "s")
    begun = tmp_path / "s" / "session.0001.mcap"
    begun.write_bytes((tmp_path / "s" / "session.0000.mcap").read_bytes()[:held])
    with Recording.open(tmp_path / "s") as recording:
        assert recording.missing and not recording.finished
        ends = {name: stream.end for name, stream in recording.streams.items()}
    resume(tmp_path / "s", ends, len(made))
    with Recording.open(tmp_path / "s") as recording:
        assert [part.file.path.name for part in recording.parts] == ["session.0000.mcap", "session.0002.mcap"]
        assert recording.finished and recording.missing is None
        assert recording.streams["board.emg"].end == ends["board.emg"] + 1
    assert kinegraph("recover", tmp_path / "s")[0] == 0
    assert kinegraph("info", tmp_path / "s")[0] == 0


@pytest.mark.parametrize("held", BEGUN)
def test_a_first_file_that_was_only_begun_does_not_cost_the_next(held: int, tmp_path: Path) -> None:
    record(tmp_path / "s", session()).close()
    first = tmp_path / "s" / "session.0000.mcap"
    first.rename(tmp_path / "s" / "session.0001.mcap")
    first.write_bytes((tmp_path / "s" / "session.0001.mcap").read_bytes()[:held])
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished and recording.streams["board.emg"].samples


@pytest.mark.parametrize("held", BEGUN)
def test_nothing_but_files_that_were_begun_is_said(held: int, kinegraph: Command, tmp_path: Path) -> None:
    killed(tmp_path / "s")
    first = tmp_path / "s" / "session.0000.mcap"
    first.write_bytes(first.read_bytes()[:held])
    (tmp_path / "s" / "session.0001.mcap").touch()
    refused(kinegraph("info", tmp_path / "s"), "nothing")


def resume(folder: Path, ends: dict[str, int], sequence: int) -> None:
    """A further part, which goes on where the first one ends, as a resumed session writes it."""
    from kinegraph.stream.chunk import Chunk
    from kinegraph.stream.graph import RecordingOptions
    from kinegraph.stream.recording import Recorder
    from tests.recordings.test_recording import SPECS

    with Recorder(folder, {}, RecordingOptions(), wait=True, resume=True) as recorder:
        numbers = {n: recorder.add_stream(n, spec, "input", ends.get(n, 0)) for n, spec in SPECS.items()}
        later = START + 60_000_000_000
        chunk = Chunk(np.array([later]), np.ones((1, 3), np.float32), later, -1)
        recorder.write(numbers["board.emg"], chunk, later, sequence)


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        (Missing(), "what was recorded after the last whole record, if anything"),
        (
            Missing(bytes=12),
            "what was recorded after the last whole record, if anything (12 bytes at its end are not a complete record)",
        ),
        (Missing(seconds=2.04), "at least 2.0 s"),
        (Missing(bytes=3, samples=7), "7 samples between its files (3 bytes at its end are not a complete record)"),
        (Missing(0, 1.5, 7), "at least 1.5 s, 7 samples between its files"),
    ],
)
def test_what_is_missing_is_said_as_far_as_it_is_known(missing: Missing, words: str) -> None:
    assert missing.words == words
