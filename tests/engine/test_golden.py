"""Golden replays: a seeded simulated walk through each EMG config gives the numbers that are kept in tests/golden, to 1e-9.

What changes a result shows here, wherever in the graph it was made. Where the change is meant, renew the numbers, look at what
`git diff tests/golden` says, and give the reason in the commit:

    python tests/engine/test_golden.py
"""

from __future__ import annotations

import csv
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from devices.simulators.walkway import Walkway, WalkwayTrial
from stream.chunk import NS, StreamSpec
from stream.engine.replay import Replay
from stream.engine.session import Session
from stream.graph.load import load, load_text
from stream.recording import Recording
from stream.recording.series import Series, write_recording

HERE = Path(__file__).parent
CONFIGS = HERE.parents[1] / "configs"
GOLDEN = HERE / "golden"
START = 1_700_000_000 * NS
"""The first sample's stamp: a resampled stream's grid depends on it."""
SECONDS = 18

Row = tuple[str, str, str, float]
"""Stream, which row or channel, which number, and the number."""


def treadmill(folder: Path) -> Path:
    """A session on the simulated treadmill, recorded; as fast as it goes."""
    graph = load_text(
        f"""
nodes:
  treadmill:
    use: devices.simulators.treadmill.Treadmill
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


def overground(folder: Path) -> Path:
    """A simulated walk through the laboratory, imported."""
    lab = Walkway(seed=5)
    trial, specs = WalkwayTrial(lab), lab.specs()
    emg = np.arange(SECONDS * 1000)
    markers = emg[::10]
    parts = {"emg": (emg, trial.emg(emg)), "markers": (markers, trial.markers(markers))}
    series = [Series(f"lab.{name}", specs[name], START + at * 1_000_000, data) for name, (at, data) in parts.items()]
    write_recording(folder / "walk.mcap", series, {})
    return folder / "walk.mcap"


MADE = {"treadmill_emg": treadmill, "overground_emg": overground}
EVENTS, SAMPLES = 60, 8
"""At most so many of a stream's events, or of a channel's samples, are kept, from its first to its last."""


def numbers(config: str, folder: Path) -> list[Row]:
    """Everything that a replay of the config gives, as rows of numbers; times in seconds since the first sample."""
    with Recording.open(MADE[config](folder)) as recording:
        specs = {name: stream.spec for name, stream in recording.streams.items()}
        settings = {} if config == "overground_emg" else {"report.path": str(folder / "again.html")}
        graph = load(CONFIGS / f"{config}.yaml", recorded=specs, overrides=settings)
        Replay(graph, recording, output=folder / "out").run()
        names = [str(edge) for edge in graph.record]
    with Recording.open(folder / "out") as made:
        return [row for name in names for row in _rows(name, made.streams[name].spec, *made.read(name))]


def _rows(name: str, spec: StreamSpec, time: np.ndarray, data: np.ndarray) -> Iterator[Row]:
    yield name, "", "samples", len(time)
    if spec.is_event:
        for i in _spread(len(data), EVENTS):
            yield from _event(name, i, data[i])
        return
    for c, channel in enumerate(spec.channels):
        values = data[..., c] if spec.channel_axis == len(spec.shape) - 1 else data[:, c]
        finite = values[np.isfinite(values)]
        yield name, channel, "finite", len(finite)
        if len(finite):
            yield name, channel, "mean", float(finite.mean())
            yield name, channel, "sd", float(finite.std())
            yield name, channel, "max", float(finite.max())
        for i in _spread(len(values), SAMPLES):
            yield name, channel, f"{i}", float(np.ravel(values[i])[-1])


def _spread(n: int, most: int) -> list[int]:
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int)).tolist()


def _event(name: str, i: int, row: np.void) -> Iterator[Row]:
    which = str(row["name"]) if "name" in (row.dtype.names or ()) else ""
    for field in row.dtype.names or ():
        value = row[field]
        if row.dtype[field].kind == "i" and row.dtype[field].itemsize == 8 and abs(int(value)) > START // 2:
            value = (int(value) - START) / NS
        if row.dtype[field].kind == "U":
            value = sum(ord(letter) << (7 * k) for k, letter in enumerate(str(value)[:7]))
        yield name, f"{i} {which}".strip(), field, float(value)


def kept(config: str) -> dict[tuple[str, str, str], float]:
    with (GOLDEN / f"{config}.csv").open(newline="", encoding="utf-8") as file:
        return {(r["stream"], r["row"], r["what"]): float(r["value"]) for r in csv.DictReader(file)}


@pytest.mark.parametrize("config", MADE)
def test_a_replay_gives_what_it_always_gave(config: str, tmp_path: Path) -> None:
    made = {(stream, row, what): value for stream, row, what, value in numbers(config, tmp_path)}
    expected = kept(config)
    assert made.keys() == expected.keys(), "streams, rows or fields came or went"
    wrong = {
        key: (made[key], value)
        for key, value in expected.items()
        if not np.isclose(made[key], value, rtol=1e-9, atol=1e-9, equal_nan=True)
    }
    assert not wrong, f"{len(wrong)} of {len(expected)} numbers differ (made, kept): {dict(list(wrong.items())[:10])}"


def renew() -> None:
    """Write the numbers as they are now."""
    for config in MADE:
        with tempfile.TemporaryDirectory() as folder:
            rows = numbers(config, Path(folder))
        with (GOLDEN / f"{config}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["stream", "row", "what", "value"])
            writer.writerows((stream, row, what, f"{value:.15g}") for stream, row, what, value in rows)
        print(f"{GOLDEN / f'{config}.csv'}: {len(rows)} numbers", file=sys.stderr)


if __name__ == "__main__":
    renew()
