"""The contact check: every foot's contacts are good, or the reason is named with what to do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.operators.contacts.acceleration import AccelerationContacts
from kinegraph.operators.contacts.commands.contact_check import (
    FootFinding,
    FootInput,
    judge_foot,
    together,
    why_no_contact,
)
from kinegraph.operators.contacts.force import ForceContacts, SwitchContacts
from kinegraph.operators.contacts.inertial import InertialContacts
from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.stream.chunk import StreamSpec
from tests.support.command_line import Command, kinegraph, refused

__all__ = ["kinegraph"]

NS = 10**9
END = 15 * NS
DOWNS = np.arange(1.0, 14.5, 1.1)


def judged(downs: Any, ups: Any = None, end: int = END) -> FootFinding:
    downs = np.asarray(downs, float)
    ups = downs + 0.68 if ups is None else np.asarray(ups, float)
    return judge_foot("left", np.int64(downs * NS), np.int64(ups * NS), end, None)


def test_a_steady_walk_is_good_and_described() -> None:
    found = judged(DOWNS)
    assert (found.flag, found.reason) == ("good", "13 contacts, a stride in 1.10 s, stance 62 %") and not found.advice


@pytest.mark.parametrize(
    ("downs", "ups", "flag", "reason"),
    [
        ([], None, "bad", "no contact came"),
        ([1.0], None, "doubtful", "only 1 contact"),
        (DOWNS[:7], None, "doubtful", "no contact in the last 7 s"),
        (np.delete(DOWNS, [2, 5, 8]), None, "doubtful", "uneven strides, from 1.1 to 2.2 s"),
        (DOWNS, [], "doubtful", "no lift-offs"),
        (DOWNS, DOWNS + 1.05, "doubtful", "on the ground for 95 % of a stride"),
    ],
)
def test_what_is_wrong_with_a_foot_is_named_with_what_to_do(downs: Any, ups: Any, flag: str, reason: str) -> None:
    found = judged(downs, ups)
    assert (found.flag, found.reason) == (flag, reason) and found.advice


def test_two_feet_that_touch_down_at_once_are_doubtful() -> None:
    times = np.int64(DOWNS * NS)
    one = judged(DOWNS)
    assert [foot.flag for foot in together([one, one], [times, times + NS // 2])] == ["good", "good"]
    assert [foot.reason for foot in together([one, one], [times, times])] == ["both feet touch down at once"] * 2


FORCE = StreamSpec((2,), rate_hz=100.0, channels=("Fz_left", "Fz_right"), units=("N",))
LINE = StreamSpec((1,), rate_hz=100.0, channels=("heel",), units=("V",))
IMU = StreamSpec((6,), rate_hz=100.0, channels=tuple("abcdef"), units=("m/s2",) * 3 + ("rad/s",) * 3)
MARKERS = StreamSpec((2, 3), rate_hz=100.0, channels=("LTOE", "LHIP"), units=("mm",))
STILL = np.tile([0.0, 0.0, 9.81, 0.01, 0.0, 0.0], (900, 1))


@pytest.mark.parametrize(
    ("part", "spec", "data", "reason"),
    [
        (ForceContacts(channels=("Fz_left",)), FORCE, np.ones((900, 2)) * [3.0, 700.0], "the force changes by 0 N only"),
        (ForceContacts(channels=("Fz_left",)), FORCE, np.full((900, 2), np.nan), "its channel has no values"),
        (ForceContacts(), FORCE, np.empty((0, 2)), "nothing came from board"),
        (SwitchContacts(threshold=1.65), LINE, np.zeros((900, 1)), "the switch stays below 1.65 V: 0 to 0"),
        (SwitchContacts(threshold=1.65), LINE, np.full((900, 1), 3.3), "the switch stays above 1.65 V: 3.3 to 3.3"),
        (
            SwitchContacts(threshold=1.65, inverted=True), LINE, np.full((900, 1), 3.3),
            "the switch stays above 1.65 V: 3.3 to 3.3",
        ),
        (InertialContacts(), IMU, STILL, "the sensor hardly turns: 1°/s at most"),
        (AccelerationContacts(), IMU, STILL, "the sensor hardly moves"),
        (MarkerContacts("LTOE"), MARKERS, np.full((900, 2, 3), np.nan), "marker LTOE is missing in 100 % of the frames"),
        (MarkerContacts("LTOE", "LHIP"), MARKERS, np.full((900, 2, 3), 800.0), "marker LTOE moves by 0 cm only"),
    ],
)  # fmt: skip
def test_why_no_contact_was_found_is_named_by_what_finds_them(part: Any, spec: Any, data: Any, reason: str) -> None:
    found, advice = why_no_contact(FootInput("board", part, spec, data))
    assert found.startswith(reason) and advice


WALK = """
nodes:
  belts: {use: devices.people.treadmill.Treadmill, legs: both, realtime: false, duration_s: 7}
  feet:
    use: operators.contacts.limb_contacts.LimbContacts
    from: belts.force
    detector: force
    limbs: {left: {channels: [Fz_left], threshold_n: LEFT}, right: {channels: [Fz_right]}}
  legs:
    use: operators.strides.footfalls.Footfalls
    from: {touchdown: feet.touchdown, liftoff: feet.liftoff}
    reference: left
"""


@pytest.mark.parametrize(("threshold", "code"), [pytest.param(20, 0, marks=pytest.mark.nightly), (5000, 1)])
def test_a_simulated_walk(kinegraph: Command, tmp_path: Path, threshold: int, code: int) -> None:
    (tmp_path / "walk.yaml").write_text(WALK.replace("LEFT", str(threshold)))
    result = kinegraph("emg", "check-contacts", "walk.yaml", "--json")
    assert result[0] == code, result
    left, right = json.loads(result[1])["contacts"]
    assert (right["name"], right["flag"]) == ("right", "good") and 58 < right["stance_pct"] < 68
    assert left["flag"] == ("bad" if code else "good")
    assert not code or "1 of 2 feet need a look: left the force changes by" in result[2]
    assert not [path for path in tmp_path.iterdir() if path.name != "walk.yaml"], "nothing is kept"


def test_a_graph_without_contacts_is_refused(kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "none.yaml").write_text("nodes:\n  board: {use: devices.people.treadmill.Treadmill}\n")
    refused(kinegraph("emg", "check-contacts", "none.yaml"), "no foot contacts to check")
