"""The shipped graph on a walk in which a muscle weakens: reported on the screen and in the report within ten cycles, and nothing before."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.recording import Recording

pytestmark = pytest.mark.nightly

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "treadmill_emg.yaml"
SINCE_S = 80


def test_a_muscle_that_weakens_is_told_within_ten_cycles(tmp_path: Path) -> None:
    settings = [
        "treadmill.realtime=false", "treadmill.duration_s=100", "treadmill.muscles=[TA, GM]", f"report.path={tmp_path / 'r.html'}",
        f"treadmill.faults=[{{kind: weak, muscle: GM, from_s: {SINCE_S}, share: 0.3}}]",
    ]  # fmt: skip
    sets = [part for setting in settings for part in ("--set", setting)]
    command = [
        str(Path(sys.executable).parent / "kinegraph"),
        "run",
        str(CONFIG),
        *sets,
        "-o",
        str(tmp_path / "w"),
        "--view",
        "lines",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    assert "ALARM GM: moved from its first 60 cycles" in done.stdout + done.stderr
    assert "moved from its first 60 cycles" in (tmp_path / "r.html").read_text()
    with Recording.open(tmp_path / "w") as recording:
        _, closed = recording.read("cycles.closed")
        stamps, changes = recording.read("drift.change")
        _, modes = recording.read("mixtures.modes")
        start = int(recording.read("treadmill.emg")[0][0])
    assert [str(name) for name in changes["subject"]] == ["GM"], "nothing before, and of no other muscle"
    between = (closed["end"] > start + SINCE_S * 10**9) & (closed["end"] <= stamps[0])
    assert 0 < between.sum() <= 10
    assert {"TA", "GM"} == set(modes["name"].tolist()) and (np.abs(modes["place_pct"] - 50) <= 50).all()
