"""The index of a folder of sessions; two recordings' clocks by the pulses in both."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.contacts.pulse_match import match_pulses
from kinegraph.stream.errors import KinegraphError


def kinegraph(*arguments: str | Path, code: int = 0) -> str:
    command = [str(Path(sys.executable).parent / "kinegraph"), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == code, done.stderr
    return done.stdout + done.stderr


def pulses(seed: int, n: int = 40) -> np.ndarray:
    return np.cumsum(0.5 + np.random.default_rng(seed).random(n))


def test_offset_and_drift_are_found_with_pulses_missing_and_extra() -> None:
    rng, true = np.random.default_rng(1), pulses(2)
    second = np.delete((true - 12.345) / (1 + 40e-6), [3, 17]) + 0.0002 * rng.standard_normal(38)
    first = np.sort(np.append(np.delete(true, [8, 9]), [5.0, 20.2]))
    found = match_pulses(first, second)
    assert abs(found.drift_ppm - 40) < 10 and found.matched == 36 and found.residual_ms < 0.4 and found.worst_ms < 1.0
    assert np.abs(found.place(second) - np.delete(true, [3, 17])).max() < 0.001


def test_pulses_that_say_nothing_are_refused() -> None:
    even = np.arange(30.0)
    with pytest.raises(KinegraphError, match="even intervals"):
        match_pulses(even, even + 3.2)
    with pytest.raises(KinegraphError, match="three in each"):
        match_pulses(even, even[:2])
    with pytest.raises(KinegraphError, match=r"same pulses|even intervals"):
        match_pulses(pulses(3, 5), pulses(4, 5) + 1000)


def test_recordings_of_a_folder_are_listed_and_their_clocks_compared(tmp_path: Path) -> None:
    sync = pulses(5)
    for name, times in (("a", sync), ("b", sync - 7.5)):
        (tmp_path / f"{name}.csv").write_text("sync_s\n" + "".join(f"{t:.6f}\n" for t in times if t > 0))
        stream = [
            "--events",
            "box.sync=sync_s",
            "--fact",
            f"subject=S0{1 if name == 'a' else 2}",
            "--fact",
            "speed_m_s=1.2",
        ]
        kinegraph("files", "import", tmp_path / f"{name}.csv", "-o", tmp_path / f"{name}.mcap", *stream)
    (tmp_path / "broken.mcap").write_bytes(b"no recording")
    kinegraph("emg", "sessions", tmp_path, "-o", tmp_path / "index.csv")
    with (tmp_path / "index.csv").open(newline="") as file:
        rows = {row["session"]: row for row in csv.DictReader(file)}
    assert rows["a.mcap"]["subject"] == "S01" and "speed_m_s 1.2" in rows["a.mcap"]["facts"]
    assert float(rows["a.mcap"]["length (s)"]) > 10 and "cannot be read" in rows["broken.mcap"]["facts"]
    assert "b.mcap" not in kinegraph("emg", "sessions", tmp_path, "--subject", "S01")
    output = kinegraph("files", "compare-clocks", tmp_path / "a.mcap", tmp_path / "b.mcap", "--stream", "box.sync")
    compared = ("files", "compare-clocks", tmp_path / "a.mcap", tmp_path / "b.mcap", "--stream", "box.sync", "--json")
    assert json.loads(kinegraph(*compared))["offset_s"] == pytest.approx(7.5)
    assert "+ 7.500000 s" in output and "ppm" in output and "residual 0.00 ms" in output
