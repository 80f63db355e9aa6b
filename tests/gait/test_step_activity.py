"""Tells walking, turning and standing apart, and makes nothing up where nothing was measured."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.steps.activity import StepActivity
from kinegraph.operators.steps.steps import Steps, some_walk
from kinegraph.stream.chunk import NS, Chunk
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import grid
from tests.gait.test_step_biometrics import CHANNELS, UNITS, StreamSpec, walk
from tests.support.emg_run import drive
from tests.support.real import needs_data


def activities(given, size=None, **settings):
    steps = drive(Steps(), {"in": given})["steps"]
    _, stamps, rows = drive(StepActivity(**settings), {"steps": steps, "signal": given}, size)["activity"]
    return stamps, rows


def at(rows, given, second):
    """What is done at this second, as known in the end."""
    before = rows[rows["onset"] <= given[1][0] + second * NS]
    return str(before["activity"][-1])


def test_whoever_stands_walks_and_turns_is_told_to_do_so():
    given = walk("brisk", 101, 60)
    stamps, rows = activities(given)
    assert set(rows["activity"]) == {"walking", "turning", "standing"}
    assert [at(rows, given, second) for second in (5.0, 28.0, 35.0, 58.0)] == ["walking", "standing"] * 2
    assert (stamps >= rows["onset"]).all() and (np.diff(rows["onset"]) > 0).all()
    assert 1 <= (rows["activity"] == "turning").sum() <= 6
    later = rows[1:]
    assert (later["before"] == rows["activity"][:-1]).all()
    np.testing.assert_allclose(later["lasted_s"], np.diff(rows["onset"]) / NS)
    assert np.isnan(rows["lasted_s"][0]) and rows["before"][0] == "unknown"


def test_standing_is_told_when_no_step_has_come_for_long_enough():
    given = some_walk(24.0, 100.0, 6)
    stamps, rows = activities(given, still_s=1.0)
    steps = drive(Steps(), {"in": given})["steps"]
    for stamp, row in zip(stamps, rows, strict=True):
        if row["activity"] == "standing" and row["before"] != "unknown":
            last = steps[1][steps[1] <= stamp][-1]
            assert NS < stamp - last <= 1.01 * NS and row["onset"] == steps[2]["end"][steps[1] <= stamp][-1]


def test_single_movements_of_somebody_who_stands_are_no_walking():
    n = 1000
    data = np.tile([9.81, 0, 0, 0, 0, 0], (n, 1)).astype(float)
    for first in (300, 500, 700):
        data[first : first + 40, 0] += 4 * np.sin(np.linspace(0, 2 * np.pi, 40))
    given = StreamSpec((6,), rate_hz=100.0, channels=CHANNELS, units=UNITS), grid(100.0, n), data
    assert len(drive(Steps(), {"in": given})["steps"][2]) >= 2, "they are taken for steps"
    assert activities(given)[1]["activity"].tolist() == ["standing"]


@pytest.mark.parametrize("how", ["missing", "nan"])
def test_where_nothing_was_measured_it_is_not_known_what_somebody_does(how):
    spec, time, data = walk("brisk", 101, 20)
    hole = slice(1000, 1300)
    if how == "nan":
        data[hole] = np.nan
    else:
        keep = np.ones(len(time), bool)
        keep[hole] = False
        time, data = time[keep], data[keep]
    given = spec, time, data
    stamps, rows = activities(given)
    (unknown,) = np.flatnonzero(rows["activity"] == "unknown")
    assert rows["onset"][unknown] == grid(100.0, 1000)[-1] and rows["before"][unknown] == "walking"
    assert stamps[unknown] == grid(100.0, 1301)[-1]
    assert rows["activity"][unknown + 1] == "walking" and rows["onset"][unknown + 1] >= grid(100.0, 1301)[-1] - 0.1 * NS
    assert not (rows["activity"] == "standing").any(), "three seconds without samples are no standing"


@pytest.mark.parametrize("size", [1, 7, 300])
def test_the_cut_of_the_signal_changes_nothing(size):
    given = walk("shuffling", 160, 40)
    whole, cut = activities(given), activities(given, size)
    assert (whole[0] == cut[0]).all() and whole[1].tobytes() == cut[1].tobytes()


def test_what_is_no_step_or_no_acceleration_is_refused():
    given = some_walk(4.0, 100.0, 6)
    steps = drive(Steps(), {"in": given})["steps"][0]
    for specs in ({"steps": given[0], "signal": given[0]}, {"steps": steps, "signal": StreamSpec((1,), units=("uV",))}):
        with pytest.raises(InputError):
            StepActivity().open(specs)


@needs_data
def test_on_real_walks_standing_and_turns_are_told():
    from bench.step_walks import evaluate as on_walks

    found = on_walks()
    assert found.stood[0] / found.stood[1] > 0.95 and found.turns[0] == found.turns[1]
    right = np.diag(found.onsets) / found.onsets.sum(axis=1)
    assert (right > [0.95, 0.9, 0.85]).all(), right
    assert np.median(found.after) < 1.2


def test_an_empty_signal_tells_nothing():
    spec, time, data = some_walk(4.0, 100.0, 6)
    operator = StepActivity()
    operator.open({"steps": drive(Steps(), {"in": (spec, time, data)})["steps"][0], "signal": spec})
    assert not len(operator.process("signal", Chunk(time[:0], data[:0], 5 * NS)))
