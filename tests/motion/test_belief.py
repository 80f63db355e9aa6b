"""A repetition is believed within half its length of its end, from the second one of an activity on, and little of it is withdrawn."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.motion import kinect, poses
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation import Segment
from tests.motion.segmentation_runs import QUICK, motion, played
from tests.motion.test_rest_and_belief import believed_late
from tests.motion.test_rest_and_belief import gestures as from_rest
from tests.support.real import needs_data
from tests.support.tiers import rest_nightly

LATE = {"13_31": 1, "13_29_12ch_10hz": 1, "13_31_12ch_10hz": 2, "P3_2_11_p29": 1}
"""Repetitions that are believed too late: of 4 to 16 frames, found when the activity's cycle was, of motion that hardly repeats."""


def annotated() -> Iterator[tuple[str, Any]]:
    folder = recordings()
    for _, name, pose, _ in poses(folder):
        yield name, pose.through(Stack()).data


TWELVE = """P1_1_2_p21 P1_1_3_p19 P1_1_5_p21 P1_1_6_p19 P1_1_9_p19 P2_1_8_p07
    P2_2_12_p05 P2_2_4_p09 P3_1_1_p23 P3_2_10_p17 P3_2_11_p29 P3_2_7_p17"""
"""One Kinect sequence of each gesture."""


def gestures() -> Iterator[tuple[str, Any]]:
    for path in (recordings() / "msrc12" / f"{name}.npz" for name in TWELVE.split()):
        yield path.stem, kinect(path).through(Stack()).data


def recordings() -> Path:
    folder = Path(os.environ.get("KINEGRAPH_DATA", "")) / "segmentation"
    if not os.environ.get("KINEGRAPH_DATA") or not folder.is_dir():
        pytest.skip("KINEGRAPH_DATA names no folder that holds `segmentation`")
    return folder


def withdrawn(events: dict[str, Any]) -> int:
    """How many repetitions were counted that were taken back, those counted again for another activity included."""
    counts: dict[int, int] = {}
    taken = 0
    for event in events["count"]:
        number, count = int(event["activity"]), int(event["count"])
        taken += max(0, counts.get(number, 0) - count)
        counts[number] = count
    return taken


def assert_corrected(events: dict[str, Any]) -> None:
    """The last provisional report of every activity and repetition equals the final one."""
    last = {int(event["activity"]): int(event["count"]) for event in events["count"]}
    made = {int(event["activity"]): int(event["repetitions"]) for event in events["activity"]}
    assert {number: count for number, count in last.items() if count} == {n: c for n, c in made.items() if c}
    believed, final = ({}, {})
    for event in events["provisional"][events["provisional"]["repetition"] > 0]:
        believed[int(event["activity"]), int(event["repetition"])] = int(event["onset"]), int(event["end"])
    for event in events["primitive"][events["primitive"]["repetition"] > 0]:
        key, onset = (int(event["activity"]), int(event["repetition"])), int(event["onset"])
        final[key] = final.get(key, (onset,))[0], int(event["end"])
    assert {key: believed[key] for key in final} == final


@pytest.mark.parametrize("seed", rest_nightly(*range(6)))
def test_what_is_believed_is_corrected_where_it_differs_from_what_is_final(seed: int) -> None:
    assert_corrected(played(Segment(**QUICK), motion(seed, rests=bool(seed % 2)))[0])


def test_gestures_from_a_resting_pose_are_believed_as_they_come_back_to_it() -> None:
    """Each from the second one on, within half of its length; the first one with the second."""
    events, stamps = played(Segment(**QUICK), from_rest())
    counts = [(int(event["activity"]), int(event["count"])) for event in events["count"]]
    assert counts == [(0, 1), (0, 2), (1, 1), (1, 2), (1, 3), (1, 4)]
    found, when = events["provisional"], stamps["provisional"]
    waits = {}
    for event, stamp in zip(found[::-1], when[::-1], strict=True):
        waits[int(event["activity"]), int(event["repetition"])] = (stamp - event["end"]) / (
            event["end"] - event["onset"]
        )
    assert waits.pop((0, 1)) < 1.5
    assert max(wait for (_, number), wait in waits.items() if number) <= 0.5
    assert_corrected(events)


@needs_data
@pytest.mark.parametrize(("recorded", "repetitions", "most"), [(annotated, 148, 23), (gestures, 148, 7)])
def test_recorded_repetitions_are_believed_within_half_their_length(recorded: Any, repetitions: int, most: int) -> None:
    late, seen, taken = {}, 0, 0
    for name, x in recorded():
        events, stamps = played(Segment(), x)
        waits = believed_late(events, stamps)
        late[name] = sum(wait > 0.5 for wait in waits)
        seen += len(waits)
        taken += withdrawn(events)
        assert_corrected(events)
    assert {name: n for name, n in late.items() if n > LATE.get(name, 0)} == {}
    assert seen == repetitions
    assert taken <= most


def cycles(kind: int, length: int, times: int) -> Any:
    turn = np.arange(times * length) * 2 * np.pi / length
    mix = np.random.default_rng(kind).normal(size=(4, 6))
    return np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)], 1) @ mix


def shaken(x: Any) -> Any:
    return x + 0.03 * np.random.default_rng(7).normal(size=x.shape)


@pytest.mark.parametrize("length", [26, 32, 40])
def test_who_goes_over_to_another_exercise_is_believed_before_the_first_is_given_up(length: int) -> None:
    x = shaken(np.concatenate([cycles(0, 50, 6), cycles(1, length, 7)]))
    events, stamps = played(Segment(), x)
    assert events["activity"]["repetitions"].max() >= 6
    assert max(believed_late(events, stamps)) <= 0.5
    last = {int(event["activity"]): int(event["count"]) for event in events["count"]}
    made = {int(event["activity"]): int(event["repetitions"]) for event in events["activity"]}
    assert {number: count for number, count in last.items() if count} == {n: c for n, c in made.items() if c}


def test_who_goes_on_with_an_exercise_after_other_motion_is_believed_at_the_first_repetition() -> None:
    rng = np.random.default_rng(3)
    body = cycles(0, 30, 6)
    wander = np.cumsum(rng.normal(size=(110, 6)), 0) * 0.3
    away = body[0] + wander - np.linspace(0.0, 1.0, 110)[:, None] * wander[-1]
    x = shaken(np.concatenate([body, away, cycles(0, 30, 6)]))
    events, stamps = played(Segment(quiet_s=5.0), x)
    assert max(believed_late(events, stamps)) <= 0.6
