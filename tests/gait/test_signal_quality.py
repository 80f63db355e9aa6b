"""The quality of raw channels: made-up faults of known size, and real recordings with known faulty channels."""

from __future__ import annotations

import json

import numpy as np
import pytest

from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.cycles.statistics.ensemble import CycleEnsemble
from kinegraph.operators.emg.amplitude_reference import AmplitudeReference
from kinegraph.operators.emg.quality import SignalQuality
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from tests.support.emg_run import drive, enveloped, recording, stamps, treadmill
from tests.support.real import needs_data

OVERGROUND = {
    "emg_epfl_S1_FLOAT": {"LTA"},
    "emg_epfl_S2_NO_FLOAT": {"LMG"},
    "emg_epfl_S3_FLOAT": set(),
    "emg_epfl_S3_NO_FLOAT": set(),
    "emg_epfl_S4_FLOAT": set(),
    "emg_epfl_S4_NO_FLOAT": set(),
}
"""Recording: its channels that are known to be faulty."""
MOVED = {("emg_epfl_S2_NO_FLOAT", "RMG"), ("emg_epfl_S3_NO_FLOAT", "LMG")}
"""More than 60 % of what these recorded lies below 20 Hz in some trial: called doubtful, and rightly."""


def bursts(seconds=6, rate=1000.0, seed=0):
    """EMG-like noise (20-450 Hz) that is strong half of every second, over a baseline of 3."""
    rng = np.random.default_rng(seed)
    n = int(seconds * rate)
    active = (np.arange(n) / rate) % 1.0 < 0.5
    return np.diff(rng.standard_normal(n + 1)) * np.where(active, 50.0, 3.0)


def judged(columns, channels=None, operator=None, rate=1000.0, **more):
    x = np.stack(columns, axis=1)
    spec = StreamSpec((x.shape[1],), rate_hz=rate, units=("uV",), **({"channels": channels} if channels else {}))
    return drive(operator or SignalQuality(), {"in": (spec, stamps(len(x), rate), x)}, 33)["out"][2].reshape(
        -1, x.shape[1]
    )


def session(rows):
    return [(str(f), str(r)) for f, r in zip(rows[-1]["session_flag"], rows[-1]["session_reason"], strict=True)]


def test_made_up_faults_are_named():
    good = bursts()
    t = np.arange(len(good)) / 1000
    hum = bursts(seed=1) + 60 * np.sin(2 * np.pi * 50 * t) + 20 * np.sin(2 * np.pi * 150 * t)
    clipped = np.clip(bursts(seed=2), -80, 80)
    flat = bursts(seed=3)
    flat[1500:4500] = 7.0
    moving = bursts(seed=4) + 200 * np.sin(2 * np.pi * 3 * t)
    idle = np.random.default_rng(5).standard_normal(len(t)) * 4
    gone = bursts(seed=6)
    gone[2000:4000] = np.nan
    rows = judged([good, hum, clipped, flat, moving, idle, gone])
    assert session(rows) == [
        ("good", ""),
        ("bad", "mains hum"),
        ("bad", "clipping"),
        ("bad", "flat line"),
        ("bad", "artefact"),
        ("doubtful", "baseline noise"),
        ("bad", "missing samples"),
    ]
    assert rows["flat"][:, 3].tolist() == pytest.approx([0, 0.5, 1, 1, 0.5, 0])
    assert rows["missing"][:, 6].tolist() == [0, 0, 1, 1, 0, 0]


def test_a_row_says_which_window_and_channel_it_is_of():
    rows = judged([bursts(4), bursts(4, seed=1)], channels=("TA", "SO"), operator=SignalQuality(window_s=0.5))
    time = stamps(4000, 1000.0).reshape(8, 500)
    assert rows["onset"].tolist() == time[:, [0, 0]].tolist() and rows["end"].tolist() == time[:, [-1, -1]].tolist()
    assert rows["channel"].tolist() == [[0, 1]] * 8 and rows["name"].tolist() == [["TA", "SO"]] * 8


def test_hum_share_is_the_share_of_power():
    rng = np.random.default_rng(7)
    noise = rng.standard_normal(60_000) * 10
    t = np.arange(len(noise)) / 1000
    for mains in (50, 60):
        rows = judged([noise + 5 * np.sqrt(2) * np.sin(2 * np.pi * mains * t)])
        in_band = 100 * (450 - 20) / 500
        assert rows["hum"].mean() == pytest.approx(25 / (25 + in_band), abs=0.03)
    wrong = judged([noise + 5 * np.sqrt(2) * np.sin(2 * np.pi * 60 * t)], operator=SignalQuality(mains_hz=50))
    assert wrong["hum"].mean() < 0.06


def test_full_scale_and_noise_limits():
    x = np.clip(bursts(), -80, 80)
    assert session(judged([x], operator=SignalQuality(full_scale=2000.0))) == [("good", "")]
    assert session(judged([x], operator=SignalQuality(full_scale=80.0))) == [("bad", "clipping")]
    assert session(judged([bursts()], operator=SignalQuality(max_noise=2.0))) == [("doubtful", "baseline noise")]


def test_noise_is_compared_with_rest(tmp_path):
    path = tmp_path / "rest.json"
    AmplitudeReference("rest", {"rest": [2.0, 2.0]}, ["TA", "SO"], "uV", {}, noise=[0.5, 4.0]).write(path)
    rows = judged([bursts(), bursts(seed=1)], ("TA", "SO"), SignalQuality(rest=str(path)))
    assert session(rows) == [("doubtful", "baseline noise"), ("good", "")]
    path.write_text(json.dumps({**json.loads(path.read_text()), "noise": []}))
    with pytest.raises(ParameterError, match="taken at rest"):
        judged([bursts()], ("TA",), SignalQuality(rest=str(path)))


def test_the_treadmill_recording_is_good():
    emg = treadmill()["emg"]
    rows = drive(SignalQuality(), {"in": emg}, 10)["out"][2].reshape(-1, 13)
    assert session(rows) == [("good", "")] * 13
    assert (rows["contrast"].mean(axis=0) > 10).all()


@needs_data
@pytest.mark.parametrize("name", OVERGROUND)
def test_known_faulty_channels_are_bad_and_no_others(name):
    z = recording(name)
    channels = tuple(map(str, z["emg_names"]))
    for trial in ("T_01", "T_02", "T_03"):
        rows = judged(list(z[f"{trial}_emg"].astype(float).T), channels)
        found = dict(zip(channels, session(rows), strict=True))
        assert {c for c, (flag, _) in found.items() if flag == "bad"} == OVERGROUND[name]
        assert all(found[c] == ("bad", "mains hum") for c in OVERGROUND[name])
        doubtful = {(name, c) for c, (flag, _) in found.items() if flag == "doubtful"}
        assert doubtful <= MOVED, (trial, found)


@needs_data
def test_a_faulty_channel_does_not_repeat_and_a_good_one_does():
    """Three overground trials after one another, ten seconds apart; left leg's touch-downs from ankle and hip markers."""
    z = recording("emg_epfl_S2_NO_FLOAT")
    emg, markers, times, kin_times, start = [], [], [], [], 0
    gaps, kin_gaps = {}, {}
    for trial in ("T_01", "T_02", "T_03"):
        x, k = z[f"{trial}_emg"].astype(float), z[f"{trial}_kin"].astype(float)
        if start:
            gaps[sum(map(len, emg))], kin_gaps[sum(map(len, markers))] = -1, -1
        emg.append(x)
        markers.append(k)
        times.append(stamps(len(x), 1000.0, start))
        kin_times.append(stamps(len(k), 100.0, start))
        start = int(times[-1][-1]) + 10_000_000_000
    left = ("LTA", "LMG")
    spec = StreamSpec((2,), rate_hz=1000.0, channels=left, units=("mV",))
    envelope = enveloped((spec, np.concatenate(times), np.concatenate(emg)[:, :2], gaps))
    points = StreamSpec((8, 3), rate_hz=100.0, channels=tuple(map(str, z["kin_names"])), units=("mm",))
    seen = drive(
        MarkerContacts(marker="LANK", reference="LHIP", side="left"),
        {"in": (points, np.concatenate(kin_times), np.concatenate(markers), kin_gaps)},
        10,
    )
    found = drive(Cycles(), {"signal": envelope, "touchdown": seen["touchdown"], "liftoff": seen["liftoff"]}, 20)
    rejected = found["closed"][2]["rejected"]
    assert (rejected == "").sum() >= 10
    assert set(rejected) <= {"", "too long", "gap"}, "only what spans two trials is rejected"
    rows = drive(CycleEnsemble(), {"closed": found["closed"], "cycles": found["cycles"]})["muscles"][2].reshape(-1, 2)[
        -1
    ]
    assert rows["verdict"].tolist() == ["repeatable", "not repeatable"]
    assert rows["variance_ratio"][0] < 0.65 < 0.9 < rows["variance_ratio"][1]


def test_what_cannot_be_is_said():
    with pytest.raises(InputError, match="200 Hz or more"):
        SignalQuality().open({"in": StreamSpec((1,), rate_hz=100.0)})


def test_hum_beneath_strong_bursts_is_baseline_noise_by_default():
    """Eight times the noise of the sound channel, though the hum's share of the power is small."""
    loud, t = bursts(seed=1) * 5, np.arange(6000) / 1000
    noise = np.random.default_rng(3).standard_normal(6000)
    quiet = np.where(t % 1.0 < 0.5, loud, 2 * noise)
    hum = quiet + 20 * np.sin(2 * np.pi * 50 * t)
    assert session(judged([quiet, hum])) == [("good", ""), ("doubtful", "baseline noise")]
    assert session(judged([quiet, hum], operator=SignalQuality(max_noise=100.0))) == [("good", ""), ("good", "")]
