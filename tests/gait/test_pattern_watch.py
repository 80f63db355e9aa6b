"""What the watch of muscles' patterns reports, and what not, of muscles that begin and end as steeply as real ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph.operators.cycles.review import CycleReview
from kinegraph.operators.emg.quality import SignalQuality
from kinegraph.operators.monitors.pattern_watch import PatternWatch
from kinegraph.operators.monitors.timing_watch import TimingWatch
from kinegraph.stream.chunk import NS
from tests.support.emg_run import drive
from tests.support.steep_walk import cut, steep_walk

Alarm = tuple[str, str, str]


@pytest.fixture(scope="module")
def walk() -> dict[str, Any]:
    return steep_walk(50)


def spoiled(walk: dict[str, Any], muscle: str, from_s: float, to_s: float, change: Any) -> dict[str, Any]:
    """The walk with `change` made to a channel's signal for some time."""
    spec, time, emg = walk["emg"]
    made, i = emg.copy(), spec.channels.index(muscle)
    here = (time >= from_s * NS) & (time < to_s * NS)
    made[here, i] = change(emg[here])
    return {**walk, "emg": (spec, time, made)}


def noticed(operator: Any, walk: dict[str, Any]) -> list[Alarm]:
    """Subject, state and text of each alarm about the walk's cycles, reviewed as in the shipped graphs."""
    quality = drive(SignalQuality(), {"in": walk["emg"]}, 1000)["out"]
    made = cut(walk)
    reviewed = drive(CycleReview(), {"quality": quality, "closed": made["closed"], "cycles": made["cycles"]}, 50)
    rows = drive(operator, {port: reviewed[port] for port in ("closed", "cycles")}, 10)["out"][2]
    return [(str(row["subject"]), str(row["state"]), str(row["what"])) for row in rows]


@pytest.mark.parametrize("operator", [PatternWatch(), TimingWatch()], ids=["patterns", "timing"])
def test_a_sound_walk_with_steep_bursts_gives_no_alarm(operator: Any, walk: dict[str, Any]) -> None:
    assert noticed(operator, walk) == []


def test_noise_between_bursts_is_another_rest(walk: dict[str, Any]) -> None:
    noisy = np.random.default_rng(2)
    alarms = noticed(
        PatternWatch(), spoiled(walk, "L_TA", 25, 99, lambda emg: emg[:, 0] + 8 * noisy.standard_normal(len(emg)))
    )
    assert [(subject, state) for subject, state, _ in alarms] == [("L_TA", "on")]
    assert alarms[0][2].startswith("its rest is")


def test_a_muscle_has_one_alarm_at_a_time_and_the_cause_replaces_the_symptom(walk: dict[str, Any]) -> None:
    so = walk["emg"][0].channels.index("L_SO")
    alarms = noticed(PatternWatch(), spoiled(walk, "L_TA", 25, 99, lambda emg: emg[:, so]))
    mine = [(state, what) for subject, state, what in alarms if subject == "L_TA"]
    assert mine[-1] in [("on", "its curve is that of L_SO"), ("on", "its curve is that of L_GM")]
    assert [state for state, _ in mine] in (["on"], ["on", "over", "on"])
    assert {subject for subject, *_ in alarms} == {"L_TA"}


def test_with_a_fallen_electrode_no_other_muscle_and_no_other_leg_is_blamed(walk: dict[str, Any]) -> None:
    fallen = spoiled(walk, "L_SO", 25, 35, lambda emg: np.zeros(len(emg)))
    assert {subject for subject, *_ in noticed(PatternWatch(), fallen)} <= {"L_SO"}
    assert noticed(TimingWatch(), fallen) == []
