"""Golden answers of graphs: what the two EMG graphs say of a simulated walk with a fixed seed; tests/golden.py compares."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from kinegraph.devices.people.walkway import Walkway, WalkwayTrial
from kinegraph.stream.chunk import NS
from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load, load_text
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from kinegraph.stream.text.short_names import whole_name
from tests.golden import ANSWERS, evenly, table

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
START = 1_700_000_000 * NS
"""The first sample's stamp: a resampled stream's grid depends on it."""
SECONDS = 18


def _treadmill(folder: Path) -> Path:
    """A session on the simulated treadmill, recorded; as fast as it goes."""
    graph = load_text(
        f"""
nodes:
  treadmill:
    use: devices.people.treadmill.Treadmill
    realtime: false
    duration_s: {SECONDS}
    seed: 5
    muscles: [TA, SO, RF]
    start: 2023-11-14T22:13:20Z
    faults: [{{kind: lost, from_s: 9.3, for_s: 0.2}}, {{kind: hum, muscle: RF, from_s: 15}}]
"""
    )
    outcome = Session(graph, folder / "s").run()
    assert outcome.exit_code == 0, outcome.error
    return folder / "s"


def _overground(folder: Path) -> Path:
    """A simulated walk through the laboratory, imported."""
    lab = Walkway(seed=5)
    trial, specs = WalkwayTrial(lab), lab.specs()
    emg = np.arange(SECONDS * 1000)
    markers = emg[::10]
    parts = {"emg": (emg, trial.emg(emg)), "markers": (markers, trial.markers(markers))}
    series = [Series(f"lab.{name}", specs[name], START + at * 1_000_000, data) for name, (at, data) in parts.items()]
    write_recording(folder / "walk.mcap", series, {})
    return folder / "walk.mcap"


MADE = {"treadmill_emg": _treadmill, "overground_emg": _overground}
SHOWN = {
    "treadmill_emg": {"cycles.closed": 6, "statistics": 9, "quality": 6},
    "overground_emg": {"cycles.closed": 6, "statistics": 9, "symmetry": 6},
}
"""Streams of which samples are shown, and how many; of all others the number is given."""


def graphs() -> dict[str, Path]:
    """By graph, the file of its golden answer."""
    return {name: ANSWERS / "graphs" / f"{name}.txt" for name in MADE}


def answer(name: str) -> str:
    """How many samples each recorded stream has, and some of those that people read."""
    with tempfile.TemporaryDirectory(prefix="golden-") as folder, Recording.open(MADE[name](Path(folder))) as recording:
        specs = {stream: found.spec for stream, found in recording.streams.items()}
        settings = {} if name == "overground_emg" else {"report.path": f"{folder}/again.html"}
        graph = load(CONFIGS / f"{name}.yaml", recorded=specs, overrides=settings)
        Replay(graph, recording, output=Path(folder, "out")).run()
        with Recording.open(Path(folder, "out")) as made:
            read = {str(edge): made.read(str(edge)) for edge in graph.record}
            lines = [f"{name}, {SECONDS} s simulated; samples of each stream:"]
            counts = [f"{edge} {len(time)}" for edge, (time, _) in read.items()]
            lines += [", ".join(counts[k : k + 9]) for k in range(0, len(counts), 9)]
            for edge, most in SHOWN[name].items():
                whole = whole_name(edge, read)
                time, data = read[whole]
                rows = evenly(len(time), most)
                lines += ["", *table(edge, made.streams[whole].spec, time, data, rows, START, mean=True)]
    return "".join(f"{line.rstrip()}\n" for line in lines)
