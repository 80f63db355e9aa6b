"""The main job: a real treadmill recording, imported and replayed through the treadmill graph, against a plain offline computation."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.recording import Recording
from tests.gait import naive_emg
from tests.support.emg_run import recording
from tests.support.real import real_file

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "treadmill_emg.yaml"
CLOSE = {"rtol": 0, "atol": 1e-9}


def kinegraph(*arguments):
    done = subprocess.run(
        [Path(sys.executable).parent / "kinegraph", *arguments], capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """The replay's recording, and the numbers of the file that went in."""
    z = recording("emg_santuz_tw12")
    folder = tmp_path_factory.mktemp("treadmill")
    file = real_file("emg/emg_santuz_tw12.npz")
    names = ("--names", "treadmill.emg=names", "--unit", "treadmill.emg=uV")
    emg = ("--stream", "treadmill.emg=emg_uV", "--time", "treadmill.emg=t_s", *names)
    events = ("--events", "treadmill.touchdown=touchdown_s", "--events", "treadmill.liftoff=liftoff_s")
    facts = ("--meta", "treadmill.touchdown:side=right", "--fact", "subject=TW12")
    kinegraph("files", "import", file, "-o", folder / "walk.mcap", *emg, *events, *facts)
    kinegraph("replay", CONFIG, folder / "walk.mcap", "-o", folder / "out", "-q")
    with Recording.open(folder / "out") as opened:
        yield opened, z


@pytest.fixture(scope="module")
def plain(replayed):
    """The curves (5, 100, 13) from the raw samples on, by numpy and scipy alone."""
    z = replayed[1]
    x = naive_emg.zero_phase_envelope(z["emg_uV"].astype(float), 1000.0)
    start = round(float(z["t_s"][0]) * 1e9)
    time = (start + np.round(np.arange(len(x)) * 25e6 / 3)) / 1e9
    return naive_emg.cycles(time, x, z["touchdown_s"])


def test_every_curve_agrees(replayed, plain):
    opened, z = replayed
    spec = opened.stream("cycles.cycles").spec
    assert spec.channels == tuple(map(str, z["names"]))
    assert spec.meta["side"] == "right"
    np.testing.assert_allclose(opened.read("cycles.cycles")[1], plain, **CLOSE)


def test_every_statistic_agrees(replayed, plain):
    opened, z = replayed
    rows = opened.read("statistics")[1].reshape(5, 13)
    expected = naive_emg.statistics(plain, z["touchdown_s"], z["liftoff_s"])
    for name, values in expected.items():
        np.testing.assert_allclose(rows[name], values, **CLOSE, err_msg=name)


def test_the_ensemble_agrees(replayed, plain):
    opened, z = replayed
    np.testing.assert_allclose(opened.read("ensemble.mean")[1][-1], plain.mean(axis=0), **CLOSE)
    np.testing.assert_allclose(opened.read("ensemble.sd")[1][-1], plain.std(axis=0, ddof=1), **CLOSE)
    rows = opened.read("ensemble.muscles")[1][-13:]
    np.testing.assert_allclose(rows["cv_pct"], naive_emg.variation(plain), **CLOSE)
    deviation, mad = naive_emg.deviations(plain)
    np.testing.assert_allclose(rows["deviation"], deviation, **CLOSE)
    np.testing.assert_allclose(rows["mad"], mad, **CLOSE)
    session = opened.read("ensemble.session")[1][-1]
    assert (session["accepted"], session["rejected"]) == (5, 0)
    assert session["cadence"] == pytest.approx(60 / np.diff(z["touchdown_s"]).mean(), abs=1e-9)


def test_every_muscle_is_of_good_quality(replayed):
    assert set(replayed[0].read("quality")[1]["session_flag"]) == {"good"}
