"""The running mean of the stage under way: of its own cycles only, with what was taken back taken out."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.cycles.cycle import some_cycles
from kinegraph.operators.cycles.statistics.stage_curves import StageCurves
from kinegraph.stream.errors import InputError
from tests.support.emg_run import drive


def test_each_stage_has_the_mean_of_its_own_cycles() -> None:
    given = StageCurves.cases()[0].inputs
    found = drive(StageCurves(), given)
    _, closed_at, closed = given["closed"]
    _, _, curves = given["cycles"]
    rows = found["sofar"][2]
    assert list(dict.fromkeys(rows["stage"])) == ["slow", "fast"] and rows["stage"][-1] == "slow"
    assert not (rows["number"] == 9).any(), "a cycle in no stage gives nothing"
    taken = [(t, row) for t, row in zip(closed_at.tolist(), closed, strict=True) if not row["rejected"]]
    for stage, least, most in (("slow", 1, 8), ("fast", 10, 19), ("slow", 20, 24)):
        mine = {}
        for (t, row), curve in zip(taken, curves, strict=True):
            if least <= row["number"] <= most:
                mine[int(row["number"])] = (t, curve)
        if least == 1:
            mine.pop(2)  # taken back with the fourth
        last = max(t for t, _ in mine.values())
        every = np.array([curve for _, curve in mine.values()])
        k = int(np.flatnonzero(found["mean"][1] == last)[-1])
        assert rows[k]["stage"] == stage and rows[k]["cycles"] == len(every)
        np.testing.assert_allclose(found["mean"][2][k], np.nanmean(every, axis=0), rtol=1e-12)
        np.testing.assert_allclose(found["sd"][2][k], np.nanstd(every, axis=0, ddof=1), rtol=1e-9)


def test_cycles_without_stages_are_refused() -> None:
    with pytest.raises(InputError, match=r"operators\.cycles\.stages"):
        StageCurves().open({port: one[0] for port, one in some_cycles(12, 2, 1).items()})
