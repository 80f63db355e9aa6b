"""A recording that keeps only what a resumed session needs: bounded, and enough."""

from __future__ import annotations

import csv
from pathlib import Path

from kinegraph.stream.recording.format.paths import parts_of
from tests.engine.test_crash import GRAPH, SUPPORT, end, kill, live
from tests.support.mosquitto import eventually


def parts(folder: Path) -> list[int]:
    return [int(path.stem.rpartition(".")[2]) for path in parts_of(folder)]


def test_old_parts_go_and_a_killed_session_is_resumed(tmp_path: Path) -> None:
    config, folder = tmp_path / "graph.yaml", tmp_path / "session"
    graph = GRAPH.replace("PATH", str(tmp_path / "table.csv"))
    config.write_text(graph.replace("{flush_s: 0.2}", "{flush_s: 0.2, rolling: true, rotate_mb: 0.004}"))
    (tmp_path / "parts.py").symlink_to(SUPPORT / "parts.py")

    process = live(config, folder)
    eventually(lambda: parts(folder)[:1] > [1])
    kill(process)
    left = parts(folder)
    assert left and left[0] > 1 and (folder / "checkpoint.npz").exists()
    with (tmp_path / "table.csv").open() as file:
        before = len(list(csv.reader(file)))

    process = live(config, folder, "--resume")
    eventually(lambda: parts(folder)[:1] > left[-1:])
    end(process)
    assert parts(folder) == [] and not (folder / "checkpoint.npz").exists()
    with (tmp_path / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > before
    times = [row["time (UTC)"] for row in rows]
    assert times == sorted(set(times)) and sum(row["lost"] != "0" for row in rows) <= 1
