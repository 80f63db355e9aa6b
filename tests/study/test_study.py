"""A lab's study in one command: many recordings with every cut-off, killed half way, run again, read as one data frame."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.stream.batch.manifest import JOBS
from kinegraph.stream.chunk import NS, grid
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.command_line import KINEGRAPH

RECORDINGS = int(os.environ.get("KINEGRAPH_STUDY_RECORDINGS", "6"))
"""Six in a minute; KINEGRAPH_STUDY_RECORDINGS=200 is the whole study."""
CUTOFFS = (4.0, 6.0, 10.0)
GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill}
  smooth: {use: operators.filters.iir.Lowpass, from: board.emg, cutoff_hz: 6}
record: [smooth]
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """The folder of a lab: a graph, and a recording of each subject, each of a number of its own."""
    (tmp_path / "graph.yaml").write_text(GRAPH)
    source = load(tmp_path / "graph.yaml").nodes["board"]
    specs = {f"board.{name}": spec for name, spec in source.specs.items()}
    for k in range(RECORDINGS):
        series = []
        for name, spec in specs.items():
            n = 400 if spec.is_signal else 0
            data = np.zeros((n, *spec.shape), spec.dtype)
            if n:
                data[:] = k + 1
            series.append(Series(name, spec, grid(spec.rate_hz or 1.0, n, NS), data))
        write_recording(tmp_path / f"S{k:03}.mcap", series, {"graph": "", "session": {"subject": f"S{k:03}"}})
    return tmp_path


@pytest.mark.timeout(600 if RECORDINGS < 50 else 3600)
@pytest.mark.nightly
def test_a_study_is_killed_half_way_run_again_and_read_as_one_frame(study: Path) -> None:
    names = sorted(path.name for path in study.glob("*.mcap"))
    setting = f"smooth.cutoff_hz={','.join(map(str, CUTOFFS))}"
    command = [str(KINEGRAPH), "batch", "graph.yaml", *names, "--set", setting, "-o", "results", "-q"]
    whole = RECORDINGS * len(CUTOFFS)
    first = subprocess.Popen(
        command, cwd=study, start_new_session=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    end = time.monotonic() + 500
    while len([*(study / "results" / JOBS).glob("*.json")]) < whole // 2 and first.poll() is None:
        assert time.monotonic() < end
        time.sleep(0.02)
    with_all = len([*(study / "results" / JOBS).glob("*.json")]) == whole
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    done = subprocess.run(command, cwd=study, capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stderr
    made, kept = (int(done.stdout.split(word)[0].split()[-1]) for word in (" jobs done", " unchanged"))
    assert made + kept == whole and kept >= whole // 2 and (made > 0 or with_all)
    frame = kg.BatchResults(study / "results").to_pandas("smooth")
    assert len(frame) == whole * 400 and set(frame["smooth.cutoff_hz"]) == set(CUTOFFS)
    last = frame.groupby(["subject", "smooth.cutoff_hz"], observed=True)["TA"].last()
    assert len(last) == whole
    for subject, of in last.groupby("subject", observed=True):
        assert np.allclose(of, int(str(subject)[1:]) + 1, rtol=0.1), "each row is of the recording that it names"
