"""An imported file in a graph: its streams by their names, a first graph from what it holds, and cycles of a real C3D file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.recorded import RecordedStreams
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.gait import naive_emg
from tests.support.command_line import Command, kinegraph  # noqa: F401 - a fixture
from tests.support.real import needs_data

FILES = Path(os.environ.get("KINEGRAPH_DATA", "/nonexistent")) / "files"
MARK = np.dtype([("onset", "<i8")])


def walk(path: Path, **names: str) -> dict[str, Series]:
    """Two seconds of EMG beside a plate's force, and the contacts of one foot, at 1970."""
    rate, n = 1000.0, 2000
    time = np.arange(n) * (NS // 1000) + NS
    random = np.random.default_rng(3)
    data = np.column_stack([random.normal(0, 50, n), random.normal(0, 80, n), np.full(n, 700.0)])
    analog = StreamSpec((3,), rate_hz=rate, channels=("TA", "GM", "Fz"), units=("uV", "uV", "N"))
    strikes = np.array([(NS + k * NS // 2,) for k in range(1, 4)], MARK)
    contact = StreamSpec((), MARK, units=("ns",), meta={"label": "Foot Strike", "side": "right"})
    series = {
        "lab.analog": Series(names.get("analog", "lab.analog"), analog, time, data),
        "lab.right_foot_strike": Series(
            names.get("strike", "lab.right_foot_strike"), contact, strikes["onset"].copy(), strikes
        ),
    }
    write_recording(path, list(series.values()), {"graph": "", "session": {"subject": "S01"}})
    return series


def test_outputs_are_called_as_the_streams_are(tmp_path: Path) -> None:
    walk(tmp_path / "w.mcap")
    source = RecordedStreams(path=str(tmp_path / "w.mcap"))
    assert source.outputs == ("analog", "right_foot_strike") and source.specs()["analog"].units == ("uV", "uV", "N")
    assert RecordedStreams(path=str(tmp_path / "w.mcap"), streams={"emg": "lab.analog"}).outputs == ("emg",)
    with pytest.raises(ParameterError, match=r"what names in .* begin with: lab"):
        RecordedStreams(path=str(tmp_path / "w.mcap"), of="lap")
    with pytest.raises(ParameterError, match=r"did you mean 'lab.analog'"):
        RecordedStreams(path=str(tmp_path / "w.mcap"), streams={"emg": "lab.analogs"})
    with pytest.raises(ParameterError, match=r"there is no such recording"):
        RecordedStreams(path=str(tmp_path / "x.mcap"))
    (tmp_path / "w.c3d").write_bytes(b"x")
    with pytest.raises(ParameterError, match=r"make one of it: kinegraph files import .*w.c3d -o w.mcap"):
        RecordedStreams(path=str(tmp_path / "w.c3d"))


def test_every_sample_comes_moved_as_a_whole(kinegraph: Command, tmp_path: Path) -> None:  # noqa: F811
    series = walk(Path("w.mcap"))
    Path("g.yaml").write_text("nodes:\n  lab: {use: devices.recorded.RecordedStreams, path: w.mcap, speed: 0}\n")
    assert kinegraph("run", "g.yaml", "-o", "out", "--view", "none")[0] == 0
    with Recording.open("out") as opened:
        time, data = opened.read("lab.analog")
        assert data.tobytes() == series["lab.analog"].data.tobytes()
        moved = time - series["lab.analog"].time
        assert len(set(moved.tolist())) == 1 and moved[0] > 10**18, "it is of today"
        time, data = opened.read("lab.right_foot_strike")
        assert np.array_equal(data["onset"], series["lab.right_foot_strike"].data["onset"] + moved[0])
        assert np.array_equal(time, data["onset"])


def test_beside_a_live_device_it_is_of_the_same_time(kinegraph: Command, tmp_path: Path) -> None:  # noqa: F811
    walk(Path("w.mcap"))
    live = "  board: {use: devices.people.treadmill.Treadmill, duration_s: 2}\n"
    Path("g.yaml").write_text("nodes:\n  lab: {use: devices.recorded.RecordedStreams, path: w.mcap}\n" + live)
    assert kinegraph("run", "g.yaml", "-o", "out", "--view", "none")[0] == 0
    with Recording.open("out") as opened:
        assert len(opened.read("lab.analog")[0]) == 2000
        ours, theirs = opened.streams["lab.analog"], opened.streams["board.emg"]
        assert ours.first is not None and theirs.first is not None and ours.last is not None
        assert ours.first < (theirs.last or 0) and theirs.first < ours.last, "they overlap"


def test_a_first_graph_runs_and_replays(kinegraph: Command, tmp_path: Path) -> None:  # noqa: F811
    walk(Path("w.mcap"))
    assert kinegraph("dev", "new", "graph", "w.mcap", "-o", "w.yaml")[0] == 0
    text = Path("w.yaml").read_text()
    assert "channels: [TA, GM]" in text and "touchdown: lab.right_foot_strike" in text and "left" not in text
    assert kinegraph("replay", "w.yaml", "w.mcap", "-o", "out", "-q")[0] == 0
    with Recording.open("out") as opened:
        assert opened.header["session"] == {"subject": "S01"}, "the person's facts come from the recording"
        assert set(opened.read("right_statistics")[1]["name"]) == {"TA", "GM"}
    assert kinegraph("run", "w.yaml", "-o", "live", "--view", "none")[0] == 0
    with Recording.open("live") as opened:
        assert len(opened.read("lab.analog")[0]) == 2000
        assert opened.header["session"] == {"subject": "S01"}, "in a session, too"
    Path("s.yaml").write_text("session: {subject: simulated, speed_m_s: 1.2}\n" + Path("w.yaml").read_text())
    assert kinegraph("run", "s.yaml", "-o", "mine", "--view", "none")[0] == 0
    with Recording.open("mine") as opened:
        assert opened.header["session"] == {"subject": "S01", "speed_m_s": 1.2}
    assert kinegraph("dev", "new", "graph", "w.yaml")[0] == 2


def test_a_first_graph_of_names_that_are_no_identifiers(kinegraph: Command, tmp_path: Path) -> None:  # noqa: F811
    walk(Path("w.mcap"), analog="MT 01.raw EMG", strike="1st trial")
    assert kinegraph("dev", "new", "graph", "w.mcap", "-o", "w.yaml")[0] == 0
    text = Path("w.yaml").read_text()
    assert "raw_EMG: MT 01.raw EMG" in text and "file_1st_trial" in text
    assert kinegraph("run", "w.yaml", "-o", "live", "--view", "none")[0] == 0


def test_a_first_graph_of_two_legs_has_limbs_as_a_dimension_and_one_report(kinegraph: Command, tmp_path: Path) -> None:  # noqa: F811
    """As a C3D file gives it: voltages that name their side, four streams of events."""
    rng, n = np.random.default_rng(5), 12_000
    time = np.arange(n) * (NS // 1000) + NS
    names = ("L_TA", "L_SO", "R_TA", "R_SO")
    phase = (time[:, None] / NS - np.array([0.0, 0.0, 0.5, 0.5])) % 1.0
    working = np.abs((phase - np.array([0.8, 0.3, 0.8, 0.3]) + 0.5) % 1.0 - 0.5) < 0.15
    spec = StreamSpec((4,), rate_hz=1000.0, channels=names, units=("uV",))
    series = [Series("lab.analog", spec, time, rng.normal(0, 1, (n, 4)) * np.where(working, 90.0, 3.0))]
    for side, begin in (("left", 2.0), ("right", 2.5)):
        for label, after in (("Foot Strike", 0.0), ("Foot Off", 0.6)):
            onset = np.array([(round((begin + after + k) * NS),) for k in range(10)], MARK)
            contact = StreamSpec((), MARK, units=("ns",), meta={"label": label, "side": side})
            name = f"lab.{side}_{label.lower().replace(' ', '_')}"
            series.append(Series(name, contact, onset["onset"].copy(), onset))
    write_recording(Path("w.mcap"), series, {"graph": "", "session": {"subject": "S01"}})
    assert kinegraph("dev", "new", "graph", "w.mcap", "-o", "w.yaml")[0] == 0
    text = Path("w.yaml").read_text()
    assert (
        "limbs: {left: L_*, right: R_*}" in text
        and text.count("LimbCycles") == 1
        and "operators.cycles.cycles" not in text
    )
    assert kinegraph("run", "w.yaml", "-o", "live", "--view", "none", "--set", "lab.speed=0")[0] == 0
    with Recording.open("live") as opened:
        closed = opened.read("cycles.closed")[1]
        rows = opened.read("statistics")[1]
    for side in ("left", "right"):
        mine = closed[closed["limb"] == side]
        assert len(mine) == 9 and (mine["rejected"] == "").all() and np.allclose(mine["stance_pct"], 60, atol=0.5)
        places = {m: rows["peak_pct"][rows["name"] == f"{side[0].upper()}_{m}"].mean() for m in ("TA", "SO")}
        assert abs(places["TA"] - 80) < 10 and abs(places["SO"] - 30) < 10, places
    page = Path("live/report.html").read_text()
    assert "Symmetry" in page and "Footfalls" in page and "accepted cycles of left and right" in page


@needs_data
def test_a_real_c3d_from_import_to_the_statistics_of_its_cycles(kinegraph: Command, tmp_path: Path) -> None:  # noqa: F811
    Path("lab.c3d").write_bytes((FILES / "c3d" / "events_8plates.c3d").read_bytes())
    assert kinegraph("files", "import", "lab.c3d", "-o", "lab.mcap")[0] == 0
    assert kinegraph("dev", "new", "graph", "lab.mcap", "-o", "lab.yaml")[0] == 0
    assert kinegraph("replay", "lab.yaml", "lab.mcap", "-o", "out", "-q")[0] == 0
    with Recording.open("out") as opened:
        analog = opened.streams["lab.analog"].spec
        volts = [k for k, unit in enumerate(analog.units) if unit == "V"]
        time, data = opened.read("lab.analog")
        for side, strikes in (("right", (3.68, 4.14)), ("left", (3.908, 4.364))):
            closed = opened.read(f"{side}_cycles.closed")[1]
            assert closed["rejected"].tolist() == [""] and closed["onset"][0] / NS == pytest.approx(strikes[0])
            assert closed["end"][0] / NS == pytest.approx(strikes[1])
            rows = opened.read(f"{side}_statistics")[1][:12]
            assert rows["name"].tolist() == [analog.channels[k] for k in volts]
            envelope = naive_emg.zero_phase_envelope(data[:, volts], 1500.0, up=2, down=25)
            grid = (time[0] + np.round(np.arange(len(envelope)) * 25e6 / 3)) / NS
            (plain,) = naive_emg.cycles(grid, envelope, np.array(strikes))
            peaks = plain.max(axis=0)
            used = np.isfinite(rows["peak"])  # of a bad electrode nothing is used
            assert used.sum() >= 11
            np.testing.assert_allclose(rows["peak"][used], peaks[used], rtol=1e-6)
            np.testing.assert_allclose(rows["mean"][used], plain.mean(axis=0)[used], rtol=1e-6)
