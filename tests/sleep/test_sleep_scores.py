"""Scorers against the labels of the makers' own software, and against a slow, plain reading of the formulas."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.sleep.rescoring import rescored, settled
from kinegraph.operators.sleep.scorer import SleepScorer
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.domain.night import SLEEP, UNKNOWN, WAKE
from kinegraph.stream.errors import InputError, KinegraphError, ParameterError
from tests.sleep.depth_frames import play
from tests.sleep.sleep_data import epochs_of, final, run, sleep_file
from tests.support.real import needs_data


@needs_data
@pytest.mark.parametrize("method", ["cole_kripke", "sadeh"])
def test_actilife_labels_every_minute(method: str) -> None:
    data = np.load(sleep_file("gt3x_day_actilife.npz"))
    spec, chunk = epochs_of(data["axis1"], str(data["t0"]), 60.0, "actigraph")
    _, events = run(SleepScorer(f"{method}_actilife"), spec, chunk)  # type: ignore[arg-type]
    truth = np.where(data[f"actilife_{method}_sleep"] == 1, "sleep", "wake")
    assert len(truth) == 1500 and (final(events)["state"] == truth).sum() == 1500


@needs_data
def test_actiware_labels_every_epoch() -> None:
    data = np.load(sleep_file("actiware_rpx_eng_30s.npz"))
    spec, chunk = epochs_of(data["activity"], str(data["t0"]), 30.0, "actiwatch")
    _, events = run(SleepScorer("oakley"), spec, chunk)
    truth = np.array(["sleep", "wake", "unknown"])[np.minimum(data["actiware_wake"], 2)]
    assert len(truth) == 20160 and (final(events)["state"] == truth).sum() == 20160


@needs_data
def test_how_many_provisional_scores_change() -> None:
    """5.1 % (Cole-Kripke) and 1.5 % (Oakley) without look-ahead, and each epoch is reported twice, provisional first."""
    for file, column, epoch_s, device, method, share in (
        ("gt3x_day_actilife.npz", "axis1", 60.0, "actigraph", "cole_kripke_actilife", 0.051),
        ("actiware_rpx_eng_30s.npz", "activity", 30.0, "actiwatch", "oakley", 0.015),
    ):
        data = np.load(sleep_file(file))
        spec, chunk = epochs_of(data[column], str(data["t0"]), epoch_s, device)
        _, events = run(SleepScorer(method), spec, chunk)  # type: ignore[arg-type]
        last, first = final(events), events[~events["final"]]
        assert (first["onset"] == last["onset"]).all() and len(first) == len(chunk.time)
        assert (first["state"] != last["state"]).mean() == pytest.approx(share, abs=0.001)


@needs_data
def test_webster_changes_only_sleep_and_only_where_it_says_so() -> None:
    data = np.load(sleep_file("gt3x_day_actilife.npz"))
    spec, chunk = epochs_of(data["axis1"], str(data["t0"]), 60.0, "actigraph")
    _, plain = run(SleepScorer("cole_kripke_actilife"), spec, chunk)
    _, events = run(SleepScorer("cole_kripke_actilife", rescore=True), spec, chunk)
    before, after = final(plain), final(events)
    changed = before["state"] != after["state"]
    assert (before["state"][changed] == "sleep").all() and (after["rescored"] == changed).all()
    states = np.where(before["state"] == "sleep", SLEEP, WAKE).astype(np.int8)
    assert (after["state"] == np.array(["unknown", "wake", "sleep"])[rescored(states, 1.0)]).all()
    assert 0.05 < changed.mean() < 0.1


def webster_by_hand(states: np.ndarray) -> np.ndarray:
    """The rules at one-minute epochs, read off minute by minute."""
    text = "".join("?WS"[s] for s in states)
    made = list(text)
    for i, state in enumerate(text):
        if state != "S":
            continue
        a = i
        while a > 0 and text[a - 1] == "S":
            a -= 1
        b = i
        while b < len(text) and text[b] == "S":
            b += 1
        before = len(text[:a]) - len(text[:a].rstrip("W"))
        after = len(text[b:]) - len(text[b:].lstrip("W"))
        nth = i - a + 1
        rules = [before >= 4 and nth <= 1, before >= 10 and nth <= 3, before >= 15 and nth <= 4]
        rules += [b - a <= 6 and min(before, after) >= 10, b - a <= 10 and min(before, after) >= 20]
        if any(rules):
            made[i] = "W"
    return np.array(["?WS".index(s) for s in made], np.int8)


@pytest.mark.parametrize("seed", range(20))
def test_webster_against_the_rules_read_minute_by_minute(seed: int) -> None:
    rng = np.random.default_rng(seed)
    states = np.repeat(rng.choice([UNKNOWN, WAKE, SLEEP], 60, p=[0.05, 0.5, 0.45]), rng.integers(1, 25, 60)).astype(
        np.int8
    )
    truth = webster_by_hand(states)
    assert (rescored(states, 1.0) == truth).all()
    for place in range(0, 400, 7):
        for known in range(place + 1, place + 40, 5):
            if settled(states[:known], place, 1.0):
                assert rescored(states[:known], 1.0, ahead=WAKE)[place] == truth[place]
        assert settled(states[: place + 32], place, 1.0), "31 minutes settle everything"


@pytest.mark.parametrize("method", ["oakley", "scripps", "sadeh", "cole_kripke_mean", "cole_kripke_actilife"])
def test_counts_are_refused_where_they_are_not_the_devices_own(method: str) -> None:
    epoch_s = 30.0 if method in ("oakley", "scripps") else 60.0
    depth = StreamSpec((1,), rate_hz=1 / epoch_s, channels=("motion",), units=("mm",))
    with pytest.raises(InputError, match="wrist counts of"):
        SleepScorer(method).open({"in": depth})  # type: ignore[arg-type]
    for meta in ({"device": "fitbit", "site": "wrist"}, {"device": "actiwatch", "site": "ankle"}, {}):
        other = depth.derive(units=("counts",), meta=meta)
        with pytest.raises(InputError, match="name a calibration"):
            SleepScorer(method).open({"in": other})  # type: ignore[arg-type]


def test_a_named_calibration_lets_depth_in_and_is_named_in_the_result(tmp_path: Path) -> None:
    file = tmp_path / "bed.json"
    facts = {"name": "bed 7", "unit": "mm", "device": "actiwatch", "epoch_s": 30, "gain": 50, "source": "ten nights"}
    file.write_text(json.dumps(facts))
    depth = StreamSpec((1,), rate_hz=1 / 30, units=("mm",))
    motion = np.zeros(40)
    motion[20] = 1.0
    chunk = Chunk(np.arange(40) * 30 * NS, motion[:, None], 39 * 30 * NS)
    out, events = run(SleepScorer("oakley", calibration=str(file)), depth, chunk)
    assert out.meta["calibration"] == "bed 7"
    states = final(events)["state"]
    assert (states[4:] == np.where(np.arange(4, 40) == 20, "wake", "sleep")).all() and (states[:4] == "unknown").all()
    with pytest.raises(ParameterError, match="is from mm to actiwatch"):
        SleepScorer("scripps", calibration=str(file)).open({"in": depth.derive(units=("m",))})
    file.write_text(json.dumps({**facts, "gain": "big"}))
    with pytest.raises(KinegraphError, match="gain is 'big'"):
        SleepScorer("oakley", calibration=str(file)).open({"in": depth})


def test_a_sum_of_exactly_40_is_sleep() -> None:
    """0.04 x 9 + 0.2 x 3 ... in binary fractions falls on either side; in whole numbers it does not."""
    counts = np.array([0, 0, 0, 0, 1, 0, 3, 0, 19, 3, 4, 0, 15, 0, 0, 0, 0], float)
    weights = [1, 1, 5, 5, 50, 5, 5, 1, 1]
    sums = np.array(
        [int(sum(w * c for w, c in zip(weights, counts[i - 4 : i + 5], strict=True))) for i in range(4, 13)]
    )
    counts[8] += (1000 - sums[4]) // 50
    sums[4] = int(sum(w * c for w, c in zip(weights, counts[4:13], strict=True)))
    counts[4] += 1000 - sums[4]
    spec, chunk = epochs_of(counts, "2026-01-01T00:00:00", 30.0, "actiwatch")
    _, events = run(SleepScorer("oakley"), spec, chunk)
    middle = final(events)[8]
    assert middle["score"] == 40.0 and middle["state"] == "sleep"


def test_thesis_by_the_formula_and_its_polarity() -> None:
    rng = np.random.default_rng(3)
    motion = (rng.random(400) < 0.25) * rng.random(400)
    spec = StreamSpec((1,), rate_hz=1 / 30, units=("mm",))
    chunk = Chunk(np.arange(400) * 30 * NS, motion[:, None], 399 * 30 * NS)
    _, events = run(SleepScorer(active_above=0.1), spec, chunk)
    bell = np.exp(-0.5 * (np.arange(-10, 4) / 2.0) ** 2)
    active = motion > 0.1
    for t in range(10, 397):
        score = (bell / bell.sum()) @ active[t - 10 : t + 4]
        event = final(events)[t]
        assert event["score"] == pytest.approx(score, abs=1e-12) and event["state"] == (
            "wake" if score >= 0.3 else "sleep"
        )
    _, still = run(SleepScorer(), spec, Chunk(chunk.time, 0 * chunk.data, chunk.until))
    assert (still["state"] == "sleep").all()


def test_missing_epochs_are_unknown_and_nothing_is_invented_beside_them() -> None:
    counts = np.zeros(60)
    counts[30:33] = np.nan
    spec, chunk = epochs_of(counts, "2026-01-01T00:00:00", 30.0, "actiwatch")
    keep = np.r_[0:40, 43:60]
    gappy = Chunk(chunk.time[keep], chunk.data[keep], chunk.until)
    _, events = run(SleepScorer("oakley"), spec, gappy)
    states = final(events)["state"]
    assert len(states) == 60 and (final(events)["onset"] == chunk.time).all()
    assert set(states[[30, 31, 32, 40, 41, 42]]) == {"unknown"} and set(states[4:30]) == {"sleep"}
    assert states[33] == "sleep" and np.isnan(final(events)["score"][31])


@pytest.mark.parametrize(("method", "epoch_s"), [("oakley", 45.0), ("thesis", 60.0), ("sadeh", 30.0)])
def test_an_epoch_length_that_a_method_is_not_made_for(method: str, epoch_s: float) -> None:
    spec = StreamSpec((1,), rate_hz=1 / epoch_s, units=("counts",), meta={"device": "actiwatch", "site": "wrist"})
    with pytest.raises(InputError, match="in epochs of"):
        SleepScorer(method).open({"in": spec})  # type: ignore[arg-type]


def test_movement_just_before_a_second_body_is_withdrawn_before_it_is_final() -> None:
    seen_of = np.dtype([("onset", "<i8"), ("sleeper", "U16"), ("why", "U8")])
    onset = np.arange(60, dtype=np.int64) * 30 * NS
    activity = np.zeros((60, 1))
    activity[[20, 30, 40]] = 0.5
    seen = np.zeros(60, seen_of)
    seen["onset"], seen["sleeper"] = onset, "me"
    seen["why"][[21, 22, 23, 35]] = "body"
    activity[[21, 22, 23, 35]] = np.nan
    spec = StreamSpec((1,), rate_hz=1 / 30, channels=("me",), units=("",))
    inputs = {"in": (spec, onset, activity), "seen": (StreamSpec((), seen_of), onset + 30 * NS - 1, seen)}
    last = final(play(SleepScorer(), **inputs)["out"])
    assert np.flatnonzero(np.isnan(last["activity"])).tolist() == [20, 21, 22, 23, 35], "34 had no movement"
    assert (last["state"][[20, 21, 22, 23, 35]] == "unknown").all()
    assert (np.delete(last["state"], [20, 21, 22, 23, 35]) == "sleep").all()
    others = {**inputs, "seen": (inputs["seen"][0], inputs["seen"][1], seen.copy())}
    others["seen"][2]["sleeper"] = "partner"
    assert np.isnan(final(play(SleepScorer(), **others)["out"])["activity"]).sum() == 4, "of somebody else"
