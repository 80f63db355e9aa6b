"""NPZ files, real ones among them, become recordings without a bit changed; what cannot be made of them is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.formats.timing import lost_by_counter, regular
from kinegraph.stream.cli import main as cli
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.operator import grid
from tests.support.convert_run import DATA, arrays, assert_live_like, imported, refused
from tests.support.real import needs_data, real_file


def test_the_real_treadmill_recording(tmp_path: Path) -> None:
    file = real_file("emg/emg_santuz_tw12.npz")
    events = ["--events", "treadmill.touchdown=touchdown_s", "--events", "treadmill.liftoff=liftoff_s"]
    lines = ["--meta", "treadmill.touchdown:side=right", "--fact", "subject=TW12", "--fact", "speed_kmh=5"]
    signal = ["--stream", "treadmill.emg=emg_uV", "--time", "t_s", "--names", "names", "--unit", "uV"]
    with imported(tmp_path, file, *signal, *events, *lines) as recording:
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


def test_an_inertial_sensors_channels_have_a_unit_each(tmp_path: Path) -> None:
    file = tmp_path / "a.npz"
    np.savez(file, imu=np.zeros((10, 4)), t_s=np.arange(10) / 100)
    signal = ["--stream", "s.imu=imu", "--time", "t_s", "--names", "ax,ay,gx,gy", "--unit", "m/s2, m/s2,rad/s,rad/s"]
    with imported(tmp_path, file, *signal) as recording:
        assert recording.streams["s.imu"].spec.units == ("m/s2", "m/s2", "rad/s", "rad/s")
    with imported(tmp_path, file, *signal[:-1], "µV,uV,uV,uV", "--overwrite") as recording:
        assert recording.streams["s.imu"].spec.units == ("uV",), "one unit is given once"


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


def test_bursty_stamps_stay_as_they_are(tmp_path: Path) -> None:
    file = real_file("steps/imu_geotec_s01.npz")
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
    refused(tmp_path, "'fast' is not a number", file, "--stream", "s=emg", "--rate", "fast")
    refused(tmp_path, "3 names .* for 2 channels", file, "--stream", "s=emg", "--rate", "10", "--names", "a,b,c")
    one = "--stream", "s=emg", "--rate", "10"
    refused(tmp_path, "unit s=V,V,m: 3 units for 2 named channels", file, *one, "--names", "a,b", "--unit", "V,V,m")
    refused(tmp_path, "2 units for channels without names; --names says what", file, *one, "--unit", "s=V,m")
    refused(tmp_path, "unit s=V,: 2 units for 2 named", file, *one, "--names", "a,b", "--unit", "V,")
    refused(tmp_path, "holds no numbers", file, "--stream", "s=word", "--rate", "10")
    refused(tmp_path, "rate x=...: no such stream is made; valid are 's'", file, "--stream", "s=emg", "--rate", "x=10")
    refused(
        tmp_path,
        "time-unit s: 'h' is not a unit of time",
        file,
        "--stream",
        "s=emg",
        "--time",
        "t_s",
        "--time-unit",
        "h",
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
        cli.call("files import", [str(file), "-o", str(tmp_path / "a.csv")])
    with imported(tmp_path, file, "--stream", "s=emg", "--time", "t_s"):
        pass
    with pytest.raises(RecordingError, match="already holds a recording"):
        cli.call("files import", [str(file), "--stream", "s=emg", "--time", "t_s", "-o", str(tmp_path / "made.mcap")])


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
    assert lost_by_counter(np.array([253, 254, 255, 0, 2, 3]), "row")[1].tolist() == [0, 0, 0, 0, 1, 0]
    with pytest.raises(RecordingError, match="row 3: the counter runs backwards, from 9 to 4"):
        lost_by_counter(np.array([1, 2, 9, 4]), "row")


def test_a_repeated_counter_leaves_out_that_row_with_its_time(tmp_path: Path) -> None:
    counter = np.array([7, 8, 8, 9, 11])
    arrays = {"x": np.arange(5.0), "count": counter, "t_s": counter / 10}
    np.savez(tmp_path / "a.npz", **arrays)
    for timing in (("--rate", "10"), ("--time", "t_s")):
        with imported(
            tmp_path / timing[0][2:], tmp_path / "a.npz", "--stream", "s=x", "--counter", "count", *timing
        ) as made:
            time, data = made.read("s")
            assert data.ravel().tolist() == [0, 1, 3, 4] and np.round(time / 1e8).tolist() == [7, 8, 9, 11]
            assert "1 of 5 packets" in made.header["imported"]["doubts"][0]
