"""Sessions without recorded images: nothing of a frame is on the disk, replay and resume work from the recorded edges."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import GraphError, KinegraphError
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording import Recording
from tests.engine import test_crash as crash
from tests.support import SUPPORT

GRAPH = """
checkpoint_s: 0.3
record: [level, sum]
recording: {flush_s: 0.2}
nodes:
  camera: {use: camera_part.Camera}
  level: {use: operators.bed.frames.region.RegionDepth, from: camera.depth}
  sum: {use: parts.RunningSum, from: level}
  other: {use: operators.bed.frames.region.RegionDepth, from: camera.depth, rows: 5}
  othersum: {use: parts.RunningSum, from: other}
  board: {use: parts.Counting, samples: 2000}
  boardsum: {use: parts.RunningSum, from: board}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "graph.yaml"
    path.write_text(GRAPH)
    for part in ("parts.py", "camera_part.py"):
        (tmp_path / part).symlink_to(SUPPORT / part)
    return path


def run(config: Path, folder: Path) -> None:
    outcome = Session(load(config), folder).run()
    assert outcome.error is None and not outcome.compiled


def replayed(config: Path, folder: Path, **how: object) -> Replay:
    with Recording.open(folder) as recording:
        graph = load(config, recorded={name: s.spec for name, s in recording.streams.items()})
        replay = Replay(graph, recording, **how)  # type: ignore[arg-type]
        result = replay.run()
        assert result.differing == [] and not result.compiled
    return replay


@pytest.mark.parametrize("speed", [None, 1000.0])
def test_replay_without_images_begins_at_the_recorded_edges(speed: float | None, config: Path, tmp_path: Path) -> None:
    run(config, tmp_path / "s")
    with Recording.open(tmp_path / "s") as recording:
        assert recording.streams["camera.depth"].kept == "outline"
        assert recording.streams["camera.depth"].samples == 300 and recording.streams["camera.depth"].lost == 84
        assert recording.streams["sum"].samples == 300
    replay = replayed(config, tmp_path / "s", speed=speed, output=tmp_path / "again")
    assert (replay.substitutes.missing, replay.substitutes.taken) == (["camera.depth"], ["level"])
    assert replay.substitutes.silent == ["other", "othersum"]
    assert replay.pipeline.edges["sum"].samples == 300 and replay.pipeline.edges["boardsum"].samples == 2000
    with Recording.open(tmp_path / "s") as first, Recording.open(tmp_path / "again") as again:
        assert again.streams["camera.depth"].kept == "outline" and again.streams["level"].role == "edge"
        for name in ("level", "sum", "board"):
            assert all(np.array_equal(a, b) for a, b in zip(first.read(name), again.read(name), strict=True))
    assert replayed(config, tmp_path / "again").substitutes.taken == ["level"]
    command = [sys.executable, "-m", "kinegraph", "replay", str(config), str(tmp_path / "s"), "--verify"]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout
    assert "the images of camera.depth were not recorded" in output and "taken from the recording: level" in output
    assert "not computed: other, othersum" in output and "sum: identical" in output and "level: identical" not in output


@pytest.mark.parametrize("frames", ["packed", "image"])
def test_images_are_kept_where_the_graph_names_them(frames: str, config: Path, tmp_path: Path) -> None:
    text = config.read_text().replace("record: [level", "record: [camera.depth, level")
    config.write_text(text.replace("flush_s: 0.2", f"flush_s: 0.2, frames: {frames}"))
    run(config, tmp_path / "s")
    with Recording.open(tmp_path / "s") as recording:
        assert recording.streams["camera.depth"].kept == frames
        frame = recording.read("camera.depth")[1]
        assert frame.shape == (300, 48, 64) and (frame == np.arange(1, 301)[:, None, None]).all()
    replay = replayed(config, tmp_path / "s", output=tmp_path / "again")
    assert not replay.substitutes.missing and replay.pipeline.edges["othersum"].samples == 300
    replayed(config, tmp_path / "again")


def test_record_names_an_edge_that_exists(config: Path) -> None:
    config.write_text(config.read_text().replace("record: [level", "record: [camera.dept, level"))
    with pytest.raises(GraphError, match="has no output 'dept'"):
        load(config)


def test_killed_and_resumed_without_images(config: Path, tmp_path: Path) -> None:
    """What was made of the frames goes on without a sample twice or out of order; the frames since the checkpoint show as lost."""
    text = config.read_text().replace("Camera}", "Camera, realtime: true, frames: 100000}")
    config.write_text(text.replace("samples: 2000", "samples: 1000000, realtime: true"))
    folder = tmp_path / "s"
    for again in range(3):
        process = crash.live(config, folder, *(["--resume"] if again else []))
        wait_for_samples(folder, 200 * (again + 1))
        crash.kill(process)
    with Recording.open(folder) as recording:
        stream = recording.streams["camera.depth"]
        assert stream.kept == "outline"
        times, level = recording.read("level")
        sum_times, total = recording.read("sum")
        assert len(level) > 500 and (np.diff(times) > 0).all() and np.array_equal(times, sum_times[: len(times)])
        np.testing.assert_array_equal(np.cumsum(level[:, 0])[: len(total)], total[: len(level), 0])
        unknown = [chunk.lost for chunk in recording.chunks("level") if chunk.lost < 0]
        assert unknown == [-1, -1]
        assert abs(len(level) - stream.samples) < 40, "what was made of nearly every frame is there"
    replayed(config, folder)


def wait_for_samples(folder: Path, samples: int) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            with Recording.open(folder) as recording:
                if recording.last_samples("sum") >= samples:
                    return
        except KinegraphError:
            pass
        time.sleep(0.1)
    raise AssertionError("nothing was recorded within a minute")
