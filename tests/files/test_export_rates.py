"""Signals of live devices in formats that need a regular rate: at the rate that fits their stamps, or interpolated, and reported."""

from __future__ import annotations

import json
import re
from pathlib import Path

import edfio
import ezc3d
import numpy as np
import pytest

from kinegraph.devices.formats.edf.export import _range
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, Times
from kinegraph.stream.data.series import Series
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import write_recording
from tests.support.convert_run import kinegraph

START = 1_700_000_000 * NS
EMG = StreamSpec((2,), rate_hz=1000.0, channels=("TA", "GM"), units=("uV",))


def stamps(n: int, true_hz: float, jitter: float, seed: int = 1) -> Times:
    """A device with another clock rate than it declares, each up to `jitter` periods off."""
    away = np.random.default_rng(seed).uniform(-jitter, jitter, n)
    return START + np.round((np.arange(n) + away) * NS / true_hz).astype(np.int64)


def recorded(folder: Path, time: Times, data: Samples, lost: Array | None = None) -> Path:
    write_recording(folder / "live.mcap", [Series("emg", EMG, time, data, lost)], {"graph": ""})
    return folder / "live.mcap"


def noise(n: int) -> Samples:
    return np.random.default_rng(3).normal(0.0, 60.0, (n, 2))


@pytest.mark.parametrize("true_hz", [1000.05, 999.95, 1002.0])
def test_stamps_within_half_a_period_are_exported_at_the_rate_that_fits_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], true_hz: float
) -> None:
    n = 20_000
    data = noise(n)
    file = recorded(tmp_path, stamps(n, true_hz, 0.4), data)
    kinegraph("files", "export", file, "-o", tmp_path / "live.edf")
    stderr = " ".join(capsys.readouterr().out.split())
    reported = re.search(
        r"written at (.*) Hz, the rate that fits its stamps \(nominal 1000 Hz\); a stamp is at most 0.4 periods", stderr
    )
    assert reported and float(reported[1]) == pytest.approx(true_hz, abs=0.001)
    edf = edfio.read_edf(tmp_path / "live.edf")
    signal = edf.signals[0]
    assert abs(signal.sampling_frequency / true_hz - 1) * n < 0.5, "no sample is half a period from its stamp"
    assert np.abs(signal.data[:n] - data[:, 0]).max() < 0.02
    assert {note.text for note in edf.annotations if note.onset < n / true_hz - 1e-3} == set(), "nothing is missing"
    kinegraph("files", "export", file, "-o", tmp_path / "live.c3d")
    c3d = ezc3d.c3d(str(tmp_path / "live.c3d"))
    assert c3d["parameters"]["ANALOG"]["RATE"]["value"][0] == pytest.approx(true_hz, rel=1e-6)
    assert np.abs(c3d["data"]["analogs"][0, 0] - data[:, 0]).max() < 0.001
    kinegraph("files", "export", file, "-o", tmp_path / "study", "--format", "bids")
    about = json.loads((tmp_path / "study/sub-01/emg/sub-01_task-recording_emg.json").read_text())
    assert about["SamplingFrequency"] == pytest.approx(true_hz, rel=1e-5)


def test_what_was_lost_stays_a_gap_at_a_fitted_rate(tmp_path: Path) -> None:
    n = 20_000
    keep = np.r_[0:7_000, 7_010:n]
    lost = np.zeros(len(keep), np.int64)
    lost[7_000] = 10
    recorded(tmp_path, stamps(n, 999.95, 0.4)[keep], noise(n)[keep], lost)
    kinegraph("files", "export", tmp_path / "live.mcap", "-o", tmp_path / "live.edf")
    edf = edfio.read_edf(tmp_path / "live.edf")
    missing = [note for note in edf.annotations if note.text == "missing TA"]
    assert missing[0].onset == pytest.approx(7.0, abs=0.002) and missing[0].duration == pytest.approx(0.01, abs=1e-5)
    assert np.abs(edf.signals[0].data[7_010:n] - noise(n)[7_010:, 0]).max() < 0.02


def test_other_stamps_are_refused_with_the_way_out_and_interpolated_on_request(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    n = 8_000
    seconds = np.arange(n) / 1000 + 0.008 * np.sin(np.arange(n) / 1000)  # its clock wanders by 8 periods
    keep = np.r_[0:3_000, 3_020:n]
    seconds = seconds[keep]
    data = np.stack([np.sin(2 * np.pi * 40 * seconds), np.cos(2 * np.pi * 70 * seconds)], axis=1)
    lost = np.zeros(len(keep), np.int64)
    lost[3_000] = 20
    file = recorded(tmp_path, START + np.round(seconds * NS).astype(np.int64), data, lost)
    for name in ("live.edf", "live.c3d", "study"):
        with pytest.raises(
            RecordingError, match=r"periods off those of samples at .* interpolate it at 1000 Hz with --resample"
        ):
            kinegraph(
                "files", "export", file, "-o", tmp_path / name, *(["--format", "bids"] if name == "study" else [])
            )
        kinegraph(
            "files",
            "export",
            file,
            "-o",
            tmp_path / name,
            "--resample",
            *(["--format", "bids"] if name == "study" else []),
        )
        assert "emg: resampled to 1000 Hz; its stamps are up to" in capsys.readouterr().out
    edf = edfio.read_edf(tmp_path / "live.edf")
    found = edf.signals[0].data[: int(seconds[-1] * 1000)]
    truth = np.sin(2 * np.pi * 40 * np.arange(len(found)) / 1000)
    hole = np.arange(len(found))
    hole = (hole > 1000 * seconds[2_999] - 1) & (hole < 1000 * seconds[3_000] + 1)
    assert np.abs(found - truth)[~hole].max() < 0.002, "40 Hz stay 40 Hz"
    assert np.abs(found[hole][2:-2]).max() < 1e-4 and any(note.text == "missing TA" for note in edf.annotations)


def test_two_clocks_in_one_file_are_refused_by_name(tmp_path: Path) -> None:
    one, other = (
        Series(name, EMG, stamps(30_000, hz, 0.1), noise(30_000)) for name, hz in (("a", 1000.1), ("b", 999.9))
    )
    write_recording(tmp_path / "two.mcap", [one, other], {"graph": ""})
    with pytest.raises(RecordingError, match=r"several \(a 1000.1 Hz, b 999.9 Hz\): choose with --stream"):
        kinegraph("files", "export", tmp_path / "two.mcap", "-o", tmp_path / "two.edf")


@pytest.mark.parametrize("peak", [0.35000000000000003, 0.1 + 0.2, 1e-7 / 3, 1234.5, 99999.5, 3.3e-5, 1 / 3, 2**-0.5])
def test_an_edf_range_holds_every_value_in_the_places_it_has(peak: float) -> None:
    low, high = _range(np.array([peak, -peak / 2]))
    assert low <= -peak / 2 and peak <= high <= peak * 1.01 and low == -high
    assert len(str(high)) <= 10
