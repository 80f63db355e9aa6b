"""What the tests of batch share."""

from __future__ import annotations

from pathlib import Path

import pytest

import kinegraph as kg
from kinegraph.stream.batch.work import Common

GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 6}
  smooth: {use: operators.filters.iir.Lowpass, from: board.emg, cutoff_hz: 6}
  active: {use: operators.filters.threshold.Threshold, from: smooth, channel: TA, level: 20}
record: [smooth, active.interval]
session: {subject: S01, speed: 1.2}
"""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a graph and two recordings of its source."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "graph.yaml").write_text(GRAPH)
    for name in ("s1", "s2"):
        graph = kg.load(folder / "graph.yaml", {"session.subject": name.upper(), "board.seed": int(name[1])})
        kg.run(graph, folder / name)
    return folder


@pytest.fixture
def folder(recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with the graph, and the recordings under their names."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "graph.yaml").write_text(GRAPH)
    for name in ("s1", "s2"):
        (tmp_path / name).symlink_to(recordings / name, target_is_directory=True)
    return tmp_path


def common(**changed: bool) -> Common:
    return Common(GRAPH, "graph", str(Path("graph.yaml").absolute()), **changed)


def out_with(kept: Common) -> Path:
    out = Path("out").absolute()
    out.mkdir(exist_ok=True)
    kept.save(out)
    return out
