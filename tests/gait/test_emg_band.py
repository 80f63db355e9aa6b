"""Where two sets of cycles differ: our bootstrap band, beside spm1d's random fields, which run in an environment of their own (GPL).

pip install --target FOLDER --no-deps spm1d; KINEGRAPH_SPM1D=FOLDER pytest tests/gait/test_emg_band.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.emg.commands.comparison import _band
from kinegraph.stream.chunk import Samples

SPM1D = os.environ.get("KINEGRAPH_SPM1D", "")
THEIRS = """
import json, sys
import numpy as np
sys.path.insert(0, sys.argv[2])
import spm1d
given = np.load(sys.argv[1])
found = []
for before, after in zip(given["before"], given["after"]):
    t = spm1d.stats.ttest2(after, before, equal_var=True).inference(0.05, two_tailed=True)
    found.append(np.flatnonzero(np.abs(t.z) > t.zstar).tolist())
print(json.dumps(found))
"""


def walks(rng: np.random.Generator, count: int, by: float = 0.0) -> Samples:
    """Curves (count, 100) with smooth noise; from 40 to 60 % higher by so many standard deviations."""
    place = np.arange(100)
    kernel = np.exp(-0.5 * (np.arange(-15, 16) / 5.0) ** 2)
    noise = np.stack([np.convolve(row, kernel, "valid") for row in rng.standard_normal((count, 130))])
    curves = 5.0 + noise / np.sqrt((kernel**2).sum())
    return np.asarray(curves + by * np.exp(-0.5 * ((place - 50) / 6.0) ** 4))


def test_a_difference_is_found_where_it_is_and_seldom_where_there_is_none() -> None:
    rng = np.random.default_rng(7)
    (before, after), alike = (
        (walks(rng, 30), walks(rng, 30, 2.0)),
        [(walks(rng, 30), walks(rng, 30)) for _ in range(40)],
    )
    places = _band("TA", before, after, 0.0).places
    assert {46, 48, 50, 52, 54} <= set(places) and all(40 <= p <= 60 for p in places)
    assert sum(bool(_band("TA", a, b, 0.0).places) for a, b in alike) <= 6, "at most 5 % of them, in the long run"


@pytest.mark.skipif(not SPM1D, reason="KINEGRAPH_SPM1D names no folder with spm1d, which is GPL and kept apart")
def test_it_is_where_spm1d_finds_one(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    before = np.array([walks(rng, 30) for _ in range(20)])
    after = np.array([walks(rng, 30, by) for by in np.repeat([0.0, 1.0, 2.0, 3.0], 5)])
    np.savez(tmp_path / "sets.npz", before=before, after=after)
    done = subprocess.run(
        [sys.executable, "-c", THEIRS, tmp_path / "sets.npz", SPM1D], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    pairs = list(zip(json.loads(done.stdout), before, after, strict=True))
    apart = [set(theirs) ^ set(_band("TA", a, b, 0.0).places) for theirs, a, b in pairs]
    assert max(map(len, apart)) <= 6, "of 100 points, at the edges of what both find"
