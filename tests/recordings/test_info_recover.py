"""What `kinegraph info` tells, and what `kinegraph recover` makes of a damaged recording."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rich.console import Console

from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.cli import main as cli
from kinegraph.stream.cli.commands.info import _show
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recorder, Recording
from tests.recordings.test_recording import assert_recorded, killed
from tests.support.convert_run import kinegraph


def test_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    header = {"graph": "nodes: {}\n", "name": "walk", "session": {"subject": "S01"}, "versions": {"numpy": "2"}}
    with Recorder(tmp_path / "s", header, RecordingOptions(), wait=True) as recorder:
        recorder.add_stream("annotations", StreamSpec((), np.dtype([("onset", "<i8"), ("text", "<U64")])), "input")
        recorder.add_stream("emg", StreamSpec((1,), rate_hz=100.0, units=("uV",)), "input")
        times = grid(100.0, 300, 1_700_000_000 * NS)
        recorder.write(3, Chunk(times[:100], np.zeros((100, 1)), int(times[99])), int(times[99]), 0)
        recorder.write(3, Chunk(times[150:], np.zeros((150, 1)), int(times[-1]), 50), int(times[-1]), 1)
        mark = np.array([(int(times[7]), "stumbled")], [("onset", "<i8"), ("text", "<U64")])
        recorder.write(2, Chunk(times[9:10], mark, int(times[9])), int(times[9]), 2)
        for i in range(30):
            recorder.log("dropped", int(times[i]), source="emg", chunks=i, level="warning")
    kinegraph("info", tmp_path / "s")
    shown = capsys.readouterr().out
    for words in (
        "2.99 s",
        "subject S01",
        "graph: walk",
        "1 channels float64 at 100 Hz in µV",
        "stumbled",
        "and 10 more",
        "dropped 30",
        "2023-11-14 22:13:20",
    ):
        assert words.replace("1 channels", "1 channel") in shown
    assert any(line.startswith("emg ") for line in shown.splitlines()), "names on the left, numbers on the right"
    kinegraph("info", tmp_path / "s", "--json")
    facts = json.loads(capsys.readouterr().out)
    assert facts["streams"]["emg"]["lost"] == 50 and facts["streams"]["emg"]["gaps"] == 1 and len(facts["log"]) == 30
    assert facts["annotations"] == [{"time": int(times[9]), "onset": int(times[7]), "text": "stumbled"}]
    kinegraph("info", tmp_path / "s", "--graph")
    assert capsys.readouterr().out == "nodes: {}\n"


def test_info_fits_a_narrow_terminal(tmp_path: Path) -> None:
    name, fields = "ensemble.muscles", [(f"field_{i}", "<f8") for i in range(12)]
    with Recorder(tmp_path / "s", {}, RecordingOptions(), wait=True) as recorder:
        recorder.add_stream(name, StreamSpec((), np.dtype(fields)), "edge")
        recorder.add_stream("emg", StreamSpec((1,), rate_hz=100.0, units=("uV",)), "input")
    shown = io.StringIO()
    with Recording.open(tmp_path / "s") as recording:
        _show(Console(file=shown, width=80, highlight=False), recording, None)
    lines = shown.getvalue().splitlines()
    assert [
        line for line in lines if line.startswith(f"{name}  ")
    ] and "emg: 1 channel float64 at 100 Hz in uV" in lines
    assert f"{name}: events (field_0, field_1, " in shown.getvalue() and max(map(len, lines)) <= 80


def test_recover(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = killed(tmp_path / "s")
    part = tmp_path / "s" / "session.0000.mcap"
    whole = part.read_bytes()
    kinegraph("recover", tmp_path / "s", "-o", tmp_path / "out.mcap")
    assert_recorded(tmp_path / "out.mcap", made)
    assert part.read_bytes() == whole
    with (tmp_path / "out.mcap").open("rb") as file:
        assert make_reader(file, validate_crcs=True).get_summary() is not None
    kinegraph("recover", tmp_path / "s")
    assert_recorded(tmp_path / "s", made)
    with Recording.open(tmp_path / "s") as recording:
        assert recording.finished
    assert (tmp_path / "s" / "session.0000.mcap.unfinished").read_bytes() == whole
    capsys.readouterr()
    kinegraph("recover", tmp_path / "s")
    assert "nothing to do" in capsys.readouterr().out
    with pytest.raises(RecordingError, match="already holds a recording"):
        cli.call("recover", [str(tmp_path / "s"), "-o", str(tmp_path / "out.mcap")])


def test_recover_leaves_out_what_is_damaged_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = killed(tmp_path / "s")
    part = tmp_path / "s" / "session.0000.mcap"
    broken = bytearray(part.read_bytes())
    broken[len(broken) // 2] ^= 0xFF
    part.write_bytes(broken)
    kinegraph("recover", tmp_path / "s", "-o", tmp_path / "out.mcap")
    assert "1 damaged places were skipped" in capsys.readouterr().out
    with Recording.open(tmp_path / "out.mcap") as recording:
        assert recording.finished and 0 < recording.streams["board.emg"].dropped < 1000
        found = {sequence: chunk for sequence, _, chunk, _ in recording.inputs()}
    assert 0.5 * len(made) < len(found) < len(made)
    assert all(np.array_equal(chunk.data, made[sequence][1].data) for sequence, chunk in found.items())


def test_recover_keeps_its_hands_off_a_running_session(tmp_path: Path) -> None:
    with Recorder(tmp_path / "s", {}, RecordingOptions()) as recorder:
        recorder.log("started", 0)
        recorder.flush()
        with pytest.raises(RecordingError, match="is being recorded now"):
            cli.call("recover", [str(tmp_path / "s")])
    with pytest.raises(RecordingError, match="there is no such recording"):
        cli.call("recover", [str(tmp_path / "none.mcap")])
