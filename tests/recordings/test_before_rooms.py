"""Sessions of format 1 that were recorded before outlets, files and simulators had rooms of their own (November 2026): they are read, and
replayed bit for bit with the graph that configs/rename_graph.py makes of theirs; one that was killed then cannot be resumed now.
"""

from __future__ import annotations

import importlib
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from kinegraph.operators.emg.quality import SignalQuality
from kinegraph.stream.graph.components import catalogue, find
from kinegraph.stream.graph.moved import MOVED, PARAMETERS, parameter_today
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording import Recording
from tests.support.command_line import Command, kinegraph, refused

__all__ = ["kinegraph"]

ROOT = Path(__file__).resolve().parents[2]
OLD = Path(__file__).with_name("before_rooms")
SCRIPT = ROOT / "configs" / "rename_graph.py"


def renamed(graph: Path) -> str:
    return subprocess.run([sys.executable, SCRIPT, graph], check=True, capture_output=True, text=True).stdout


def test_it_is_replayed_bit_for_bit_with_the_renamed_graph(kinegraph: Command) -> None:
    session = OLD / "session.0000.mcap"
    refused(kinegraph("replay", OLD / "graph.yaml", session), "devices.treadmill", "devices.outlets.csv_file.CsvFile")
    Path("new.yaml").write_text(renamed(OLD / "graph.yaml"))
    code, output, _ = kinegraph("replay", "new.yaml", session, "--verify")
    assert code == 0 and output.count("identical to the recording") == 3
    with Recording.open(session) as recording:
        assert recording.streams["board.emg"].samples == 900 and recording.streams["board.emg"].gaps == 1


def test_what_was_killed_then_is_not_resumed_across_the_change(kinegraph: Command) -> None:
    Path("new.yaml").write_text(renamed(OLD / "killed" / "graph.yaml"))
    shutil.copytree(OLD / "killed", "session")
    output = kinegraph("run", "new.yaml", "--resume", "-o", "session", "--view", "none")
    refused(output, "another version of kinegraph", "cannot be resumed", "can be replayed")
    assert kinegraph("replay", "new.yaml", "session", "--verify")[0] == 6, "as far as it goes, and equal that far"


def test_every_new_name_is_one_of_today() -> None:
    spec = importlib.util.spec_from_file_location("rename_graph", SCRIPT)
    assert spec and spec.loader
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    every = {*MOVED, *catalogue()[0]}
    for old, new in script.RENAMED.items():
        assert [path for path in every if path.startswith(new) or path == new], f"{old} -> {new}"
    for path in MOVED.values():
        assert find(path)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("use: devices.treadmill.Treadmill", "use: devices.people.treadmill.Treadmill"),
        ("use: devices.people.treadmill.Treadmill", "use: devices.people.treadmill.Treadmill"),
        ("{use: devices.lsl.LslOutlet, from: a}", "{use: devices.lsl.LslOutlet, from: a}"),
        ("use: my.devices.report.Mine", "use: my.devices.report.Mine"),
        ("least_seen: 0.5", "min_seen: 0.5"),
        ("at_least_seen: 0.5", "at_least_seen: 0.5"),
    ],
)
def test_names_of_today_and_names_of_others_stay(before: str, after: str, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(before)
    assert renamed(tmp_path / "g.yaml") == after


def test_a_graph_with_old_names_of_parameters_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert parameter_today(SignalQuality, "most_noise") == "max_noise"
    assert parameter_today(SignalQuality, "most_kmh") == "most_kmh", "it has no such parameter"
    assert all(old != new for old, new in PARAMETERS.items())
    Path("g.yaml").write_text("""
name: old
nodes:
  board: {use: devices.people.treadmill.Treadmill}
  quality: {use: operators.emg.quality.SignalQuality, from: board.emg, most_noise: 5.0}
""")
    assert load(Path("g.yaml")).nodes["quality"].part.max_noise == 5.0
