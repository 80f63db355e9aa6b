"""Cycles with contacts known to be wrong enter no number, from the fault's start; a person can take them back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph.operators.cycles.contact_spans import changed_at
from kinegraph.operators.cycles.review import CycleReview
from kinegraph.operators.cycles.statistics.bursts import CycleBursts
from kinegraph.operators.cycles.statistics.ensemble import CycleEnsemble
from kinegraph.operators.monitors.limb_watch import LimbWatch
from kinegraph.operators.monitors.timing_watch import TimingWatch
from kinegraph.stream.chunk import NS, StreamSpec
from tests.support.emg_run import drive
from tests.support.steep_walk import cut, late, limb_contacts, steep_walk, swapped

TEXT = np.dtype([("onset", "<i8"), ("text", "U64")])
FROM_S, TO_S = 28.0, 43.0


@pytest.fixture(scope="module")
def walk() -> dict[str, Any]:
    return steep_walk(70)


@pytest.fixture(scope="module")
def sound(walk: dict[str, Any]) -> dict[str, Any]:
    return watched(walk)


@pytest.fixture(scope="module")
def spoilt(walk: dict[str, Any]) -> dict[str, Any]:
    """The belts are swapped for 15 s."""
    return watched({**walk, **{port: swapped(walk[port], FROM_S, TO_S) for port in ("touchdown", "liftoff")}})


def watched(walk: dict[str, Any]) -> dict[str, Any]:
    """The walk's cycles, and the alarms about their contacts."""
    made = cut(walk)
    signal = walk["emg"][0].derive(rate_hz=20.0), walk["emg"][1][::50], walk["emg"][2][::50]
    both = {port: made[port] for port in ("closed", "cycles")}
    return {
        "contacts": drive(LimbWatch(), {"signal": signal, "closed": made["closed"]}, 50)["out"],
        "timing": drive(TimingWatch(), both, 10)["out"],
        **both,
    }


def reviewed(watched: dict[str, Any], notes: Any = (), **given: Any) -> dict[str, Any]:
    """The cycles as the shipped graphs review them; `notes`: (second, text)."""
    typed = np.array([(0, text) for _, text in notes], TEXT)
    when = np.array([round(at * NS) for at, _ in notes], np.int64)
    return drive(CycleReview(**given), {"annotations": (StreamSpec((), TEXT), when, typed), **watched}, 5)


def final(found: dict[str, Any]) -> dict[int, Any]:
    return {int(row["number"]): row for row in found["closed"][2]}


def numbers(found: dict[str, Any]) -> dict[str, tuple[float, float, float]]:
    """CV, variance ratio and deviation of the burst's onset of each muscle over the session."""
    both = {port: found[port] for port in ("closed", "cycles")}
    muscles, bursts = drive(CycleEnsemble(), both, 50)["muscles"][2], drive(CycleBursts(), both, 50)["session"][2]
    last = {}
    for name in dict.fromkeys(muscles["name"].tolist()):
        row, burst = (rows[rows["name"] == name][-1] for rows in (muscles, bursts))
        last[name] = float(row["cv_pct"]), float(row["variance_ratio"]), float(burst["on_sd_pct"])
    return last


def test_swapped_belts_change_no_number_of_the_session(sound: dict[str, Any], spoilt: dict[str, Any]) -> None:
    found = reviewed(spoilt)
    left = numbers(found)
    for name, (cv, ratio, onset) in numbers(reviewed(sound)).items():
        spoilt_cv, spoilt_ratio, spoilt_onset = left[name]
        assert abs(spoilt_cv / cv - 1) < 0.1 and abs(spoilt_ratio - ratio) < 0.02, name
        assert abs(spoilt_onset - onset) < 1.0, name
    assert numbers(reviewed(spoilt, trust_contacts=True))["L_SO"][1] > 0.15, "with them, the numbers are wrong"
    rejected = [row for row in final(found).values() if row["rejected"] == "contacts"]
    assert 2 * 12 <= len(rejected) <= 2 * 18
    for row in rejected:
        assert row["end"] > (FROM_S - 1.5) * NS and row["onset"] < (TO_S + 1.5) * NS, "only these"
    inside = [row for row in final(found).values() if row["onset"] > FROM_S * NS and row["end"] < TO_S * NS]
    assert len(inside) > 20 and all(row["rejected"] for row in inside)


def test_late_contacts_of_one_leg_are_left_out_and_those_of_the_other_are_not(walk: dict[str, Any]) -> None:
    def late_left(port: str) -> Any:
        _, _, rows = walk[port]
        left = rows["limb"] == "left"
        moved = late(walk[port], FROM_S, TO_S, 0.05)
        at = {
            side: np.where(left, moved[2]["onset"], rows["onset"])[rows["limb"] == side] / NS
            for side in ("left", "right")
        }
        return limb_contacts(at)

    found = reviewed(watched({**walk, **{port: late_left(port) for port in ("touchdown", "liftoff")}}))
    rejected = [row for row in final(found).values() if row["rejected"] == "contacts"]
    assert {str(row["limb"]) for row in rejected} == {"left"} and 11 <= len(rejected) <= 19
    inside = [row for row in final(found).values() if row["onset"] > FROM_S * NS and row["end"] < TO_S * NS]
    assert sum(not row["rejected"] for row in inside if row["limb"] == "left") <= 1


def test_a_person_takes_single_cycles_or_all_of_them_back_in(spoilt: dict[str, Any]) -> None:
    wrong = [number for number, row in final(reviewed(spoilt)).items() if row["rejected"] == "contacts"]
    one = final(reviewed(spoilt, [(TO_S, f"use {wrong[5]}")]))
    assert not one[wrong[5]]["rejected"] and one[wrong[6]]["rejected"] == "contacts"
    judged = reviewed(spoilt)["judged"][2]
    reasons = judged["reason"][judged["number"] == wrong[5]]
    assert reasons.tolist() and set(reasons) <= {"", "contacts"}
    for back in (reviewed(spoilt, [(TO_S + 20, "use contacts")]), reviewed(spoilt, trust_contacts=True)):
        assert not any(row["rejected"] == "contacts" for row in final(back).values())
    kept = final(reviewed(spoilt, kept=(str(wrong[5]),)))
    assert not kept[wrong[5]]["rejected"] and kept[wrong[6]]["rejected"] == "contacts"


def test_a_sound_walk_loses_no_cycle(sound: dict[str, Any]) -> None:
    assert not [row for row in final(reviewed(sound)).values() if row["rejected"]]


@pytest.mark.parametrize(
    ("scores", "first"), [([-1, -1, 1, 1], 2), ([1, 1, 1], 0), ([-1, 2, -0.5, 1, 1], 1), ([-1, -1], 1)]
)
def test_a_change_began_with_the_scores_that_agree_with_it_on_the_whole(scores: list[float], first: int) -> None:
    assert changed_at(np.array(scores)) == first
