"""A marker that has taken another's label, in made-up and real walks: noticed within a second, and sound walks are left alone."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.emg_session import drive
from kinegraph.operators.monitors.marker_watch import MarkerWatch
from kinegraph.stream.chunk import NS, Samples, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from tests.support.real import needs_data

NAMES = ("LHIP", "LKNE", "LANK", "LTOE", "RHIP", "RKNE", "RANK", "RTOE")
LANK, LTOE, RTOE = 2, 3, 7
BONES = (("LANK", "LTOE"), ("RANK", "RTOE"))
HERE = needs_data
LOOSE = {"S1_FLOAT/T_02", "S2_NO_FLOAT/T_02", "S3_FLOAT/T_02", "S4_FLOAT/T_02"}
"""Trials in which a toe's marker is 1.4 to 1.8 times as far from its ankle as at first, or leaps, as they were recorded."""


def alarms(path: Samples, /, **parameters: Any) -> list[tuple[float, str, str, str]]:
    """Seconds, who, on or over, what; of markers' paths (n, 8, 3) in mm at 100 Hz."""
    spec = StreamSpec((8, 3), rate_hz=100.0, channels=NAMES, units=("mm",))
    watch = MarkerWatch(**{"segments": BONES, **parameters})
    _, time, rows = drive(watch, {"in": (spec, grid(100.0, len(path)), path)})["out"]
    began = int(grid(100.0, 1)[0])
    return [
        ((t - began) / NS, str(r["subject"]), str(r["state"]), str(r["what"]))
        for t, r in zip(time.tolist(), rows, strict=True)
    ]


def walk(seconds: float = 12.0) -> Samples:
    from kinegraph.devices.people.walkway import Walkway, WalkwayTrial

    return WalkwayTrial(Walkway()).markers(np.arange(0, round(seconds * 1000), 10))


def real() -> dict[str, Samples]:
    found = {}
    for file in sorted((Path(os.environ["KINEGRAPH_DATA"]) / "emg").glob("emg_epfl_S*.npz")):
        with np.load(file) as arrays:
            for trial in ("T_01", "T_02", "T_03"):
                name = f"{file.stem.removeprefix('emg_epfl_')}/{trial}"
                found[name] = arrays[f"{trial}_kin"].astype(float)
    return found


def test_a_sound_walk_raises_no_alarm() -> None:
    assert alarms(walk()) == []


def test_a_swap_names_both_markers_and_is_over_when_it_is_mended() -> None:
    x = walk()
    x[500:800, [LTOE, RTOE]] = x[500:800, [RTOE, LTOE]]
    reported = alarms(x)
    leaps = [
        (who, what.partition(" m, ")[2])
        for at, who, state, what in reported
        if state == "on" and what.startswith("leapt")
    ]
    assert leaps == [("LTOE", "to where RTOE was"), ("RTOE", "to where LTOE was")]
    bones = [(who, at) for at, who, state, what in reported if state == "on" and "as long as" in what]
    assert {who for who, _ in bones} == {"LANK-LTOE", "RANK-RTOE"} and max(at for _, at in bones) < 5.5
    over = {who: at for at, who, state, _ in reported if state == "over"}
    assert set(over) == {"LTOE", "RTOE", "LANK-LTOE", "RANK-RTOE"} and all(10.0 <= at < 10.1 for at in over.values())


def test_labels_swapped_from_the_start_or_during_a_pause_are_seen_by_the_foots_length() -> None:
    x = walk()
    x[:, [LTOE, RTOE]] = x[:, [RTOE, LTOE]]
    assert [who for at, who, *_ in alarms(x) if at < 3.0]
    y = walk()
    y[400:450, LTOE] = np.nan
    y[450:, LTOE] = y[450:, RTOE]
    (at, who, *_), *_ = alarms(y)
    assert who == "LANK-LTOE" and 4.5 < at < 5.2


def test_a_ghost_of_a_few_frames_a_gap_and_a_trembling_marker_are_no_swap() -> None:
    x = walk()
    x[300, LTOE] += 1000.0
    x[500:503, RTOE] += 400.0
    x[600:640, LTOE] = 0.0
    x[:, LANK] += np.random.default_rng(1).normal(0.0, 5.0, x[:, LANK].shape)
    assert alarms(x) == []


def test_without_segments_a_leap_lasts_as_nobody_knows_of_its_end() -> None:
    x = walk()
    x[500:800, LTOE] = x[500:800, RTOE]
    assert [state for _, _, state, _ in alarms(x, segments=())] == ["on"]
    assert alarms(x, segments=(), markers=("RTOE",)) == []


def test_what_is_wrong_is_said() -> None:
    with pytest.raises(ParameterError, match="segments"):
        alarms(walk(1.0), segments=(("LANK", "LTOO"),))
    with pytest.raises(ParameterError, match="two different markers"):
        alarms(walk(1.0), segments=(("LANK", "LANK"),))
    bare = StreamSpec((8, 3), rate_hz=100.0, units=("mm",))
    with pytest.raises(ParameterError, match="have no names"):
        MarkerWatch().open({"in": bare})
    with pytest.raises(InputError, match="in no unit"):
        MarkerWatch().open({"in": StreamSpec((8, 3), rate_hz=100.0, channels=NAMES)})


@HERE
def test_in_eighteen_real_walks_a_toe_taken_for_the_other_is_told_within_a_second() -> None:
    walks = real()
    assert len(walks) == 18
    assert {name for name, x in walks.items() if alarms(x)} == LOOSE
    for name, x in walks.items():
        middle = len(x) // 2
        for seen_until in (middle, middle - 20):
            taken = x.copy()
            taken[seen_until:middle, LTOE] = np.nan
            taken[middle:, LTOE] = x[middle:, RTOE]
            new = [at for at, who, state, _ in alarms(taken) if at >= middle / 100 and state == "on" and "TOE" in who]
            assert new and new[0] <= middle / 100 + 1.0, (name, seen_until)
        swapped = x.copy()
        swapped[:, [LTOE, RTOE]] = x[:, [RTOE, LTOE]]
        assert [at for at, who, *_ in alarms(swapped) if at < 3.0], name
