"""The live segmentation against its plain definition (reference.py), event by event; and what it promises about them."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from kinegraph.devices.people.walking_limb import Limb
from kinegraph.operators.features.mirror import Mirror
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.filters.iir import Lowpass
from kinegraph.operators.filters.resample import Resample
from kinegraph.operators.segmentation import Segment
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Operator, grid
from tests.motion.reference import Reference
from tests.motion.segmentation_runs import (
    QUICK,
    RATE,
    SHUFFLED,
    as_frames,
    chunks_of,
    frames_of,
    in_events,
    motion,
    played,
    recording,
    stacked,
)
from tests.support.real import needs_data

FINAL = ("activity", "primitive", "bout", "begin", "merge", "rest")


def lossy(x: Any, kind: str) -> Any:
    """The recording with values that are not known."""
    rng, x = np.random.default_rng(3), x.copy()
    if kind == "one throughout":
        x[:, 1] = np.nan
    elif kind == "one in the middle":
        x[len(x) // 3 : 2 * len(x) // 3, 1] = np.nan
    elif kind == "frames":
        x[rng.random(len(x)) < 0.2] = np.nan
    elif kind == "values":
        x[rng.random(x.shape) < 0.2] = np.nan
    return x


@pytest.mark.parametrize("kind", ["none", "one throughout", "one in the middle", "frames", "values"])
@pytest.mark.parametrize("stacks", [True, False])
def test_repetitions_are_counted_though_values_are_missing(kind: str, stacks: bool) -> None:
    x = lossy(walking(16, seed=2), kind)
    events, _ = played(Segment(**QUICK), stacked(x) if stacks else x)
    assert abs(int(events["activity"]["repetitions"].max()) - (15 if stacks else 16)) <= 1


def test_a_feature_that_never_comes_is_said(capture: list[dict[str, Any]]) -> None:
    for x in (walking(9), walking(9)[:20]):
        capture.clear()
        played(Segment(**QUICK), lossy(x, "one throughout"))
        (warning,) = capture
        assert warning["features"] == "1" and (warning["left"], warning["of"]) == (5, 6)
    capture.clear()
    played(Segment(**QUICK), lossy(walking(9), "values"))
    assert not capture


def test_who_is_out_of_sight_does_nothing() -> None:
    """All values missing for long: 20 s of that were reported as an activity."""
    operator, x = Segment(**QUICK), walking(9)
    for blind in (40, 120, 400):
        gone = np.full((blind, x.shape[1]), np.nan)
        seen = np.concatenate([gone, x, gone, x, gone])
        events, stamps = played(operator, seen)
        assert as_frames(seen, events, stamps) == in_events(
            Reference(seen, frames_of(operator), operator.radius_share).run()
        )
        counted = events["primitive"][events["primitive"]["repetition"] > 0]
        assert abs(len(counted) - 18) <= 2 and not len(events["rest"])
        if blind == 400:
            seconds = (events["activity"]["end"] - events["activity"]["onset"]) / 1e9
            assert seconds.sum() < 2 * len(x) / RATE + 4.0


def test_nothing_that_is_ever_seen_is_no_activity_and_said_at_once(capture: list[dict[str, Any]]) -> None:
    """A skeleton without hips has no pose: such a session was reported as one activity."""
    operator = Segment(**QUICK)
    operator.open({"in": StreamSpec((6,), rate_hz=RATE)})
    time = grid(RATE, 600)
    for part in np.array_split(np.arange(600), 20):
        operator.process("in", Chunk(time[part], np.full((30, 6), np.nan), int(time[part][-1])))
        assert bool(capture) == (part[-1] + 1 >= QUICK["learn_s"] * RATE)
    assert "nothing can be compared" in capture[0]["event"] and len(capture) == 1
    assert not any(len(chunk) for _, chunk in operator.close())


@pytest.fixture
def capture() -> Any:
    with capture_logs() as logs:
        yield logs


def circling(cycles: int, length: int = 36, seed: int = 1) -> Any:
    """A cycle of `length` frames, so many times, between two stretches that do not repeat: (n, 4)."""
    rng = np.random.default_rng(seed)
    turn = np.arange(cycles * length) * (2 * np.pi / length)
    body = np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), 0.5 * np.cos(2 * turn)], 1)
    away = np.linspace(3.0, 12.0, 120)[:, None] * np.array([1.0, -1.0, 0.5, 1.0])
    x = np.concatenate([-away[::-1], body, away])
    noisy: Any = x + 0.03 * rng.normal(size=x.shape)
    return noisy


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(1, 6))])
def test_the_live_events_are_the_references_for_any_length_of_the_recording(seed: int) -> None:
    operator, x = Segment(**QUICK), motion(seed, bad=seed % 3 == 0, rests=seed % 2 == 0)
    for n in (len(x), len(x) * 2 // 3, 100):
        reference = Reference(x[:n], frames_of(operator), operator.radius_share)
        expected = in_events(reference.run())
        events, stamps = played(operator, x[:n], pieces=seed + 1)
        assert as_frames(x[:n], events, stamps) == expected
        assert np.allclose(events["activity"]["certainty"], reference.certain)
        assert reference.back < max(frames_of(operator)["window"], 5 * frames_of(operator)["max_lag"])
    assert any(e[4] > 1 for e in expected["activity"]) or n == 100


def test_a_given_radius_is_kept() -> None:
    operator, x = Segment(radius=0.6, **QUICK), motion(8)
    expected = in_events(Reference(x, frames_of(operator), operator.radius_share, 0.6).run())
    events, stamps = played(operator, x)
    assert as_frames(x, events, stamps) == expected
    assert len(events["radius"]) and set(events["radius"]["radius"]) == {0.6}


@pytest.mark.parametrize("seed", [1, 4])
def test_final_events_of_the_beginning_are_a_prefix_of_the_wholes(seed: int) -> None:
    operator, x = Segment(**QUICK), motion(seed)
    whole = as_frames(x, *played(operator, x))
    for n in range(60, len(x), 97):
        part = as_frames(x[:n], *played(operator, x[:n]))
        for name in FINAL:
            free = [e for e in part[name] if e[0] < n - 1]
            assert free == whole[name][: len(free)]


def test_primitives_and_activities_follow_one_another_without_holes() -> None:
    for seed in range(4):
        x = motion(seed)
        found = as_frames(x, *played(Segment(**QUICK), x))
        for name in ("activity", "primitive"):
            spans = [e[1:3] for e in found[name]]
            assert spans[0][0] == 0 and spans[-1][1] == len(x) - 1
            assert all(first <= last for first, last in spans)
            assert all(a[1] + 1 == b[0] for a, b in pairwise(spans))
        assert [e[3] for e in found["activity"]] == list(range(len(found["activity"])))


def test_a_long_activity_is_counted_long_after_its_first_cycle_has_left_the_window() -> None:
    cycles, length = 100, 36
    x = circling(cycles, length)
    events, stamps = played(Segment(**QUICK), x)
    (action,) = events["activity"][events["activity"]["repeats"]]
    assert abs(int(action["repetitions"]) - cycles) <= 1
    repetitions = events["primitive"]["repetition"] > 0
    found = events["primitive"][repetitions]
    assert set(found["cluster"]) == {0}
    phase = np.searchsorted(grid(RATE, len(x)), found["onset"]) % length
    spread = np.abs(np.exp(2j * np.pi * phase / length).mean())
    assert np.sqrt(-2 * np.log(min(1.0, spread))) / (2 * np.pi) < 0.05
    late = (stamps["primitive"][repetitions] - found["end"])[10:-1]
    assert (late <= 2.75 * (length + 1) / RATE * 1e9).all()
    assert np.array_equal(events["count"]["count"], np.arange(1, len(events["count"]) + 1))
    assert (
        stamps["count"][10:] - events["provisional"]["end"][-len(events["count"]) :][10:] <= 2 * length / RATE * 1e9
    ).all()


def test_an_action_that_is_met_again_is_cut_at_the_same_phase_and_has_the_same_cluster() -> None:
    rng = np.random.default_rng(4)
    turn = np.arange(8 * 40) * (2 * np.pi / 40)
    first = np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn)], 1)
    other = np.stack([3 + np.sin(1.5 * turn), np.sin(3 * turn), np.cos(1.5 * turn) - 3], 1)
    x = np.concatenate([first, other, np.roll(first, 13, axis=0)])
    x += 0.02 * rng.normal(size=x.shape)
    events, _ = played(Segment(**QUICK), x)
    actions = events["activity"][events["activity"]["repeats"]]
    assert len(actions) == 3
    assert actions["cluster"][0] == actions["cluster"][2] != actions["cluster"][1]
    time = grid(RATE, len(x))
    found = events["primitive"][
        (events["primitive"]["repetition"] > 0) & (events["primitive"]["cluster"] == actions["cluster"][0])
    ]
    frames = np.searchsorted(time, found["onset"])
    phases = np.concatenate([frames[frames < 320], frames[frames >= 640] - 13])
    assert len(phases) >= 15
    assert (np.abs((phases - phases[1] + 20) % 40 - 20) <= 6).all()


SIDES = Mirror(swap=(("0", "2"), ("1", "3")), negate=("4",), sides=True)


def walking(strides: int, length: int = 40, seed: int = 0, phase: float = 0.5) -> Any:
    """The two sides do the same (0, 1 and 2, 3), the second one so much of a cycle later; the trunk sways (4) and bobs (5): (n, 6).

    A side swings in the second half of its cycle: there it moves most.
    """
    rng = np.random.default_rng(seed)
    turn = np.cumsum(1.0 + 0.2 * np.sin(np.arange(strides * length) * 0.03)) / length

    def leg(at: Any) -> Any:
        at = at % 1.0
        return np.where(at < 0.5, 1.0 - 2.0 * at, 2.0 * at - 1.0), np.where(
            at < 0.5, 0.0, np.sin(2 * np.pi * (at - 0.5))
        )

    sway = 0.5 * np.cos(2 * np.pi * turn) if phase else np.zeros(len(turn))
    x = np.stack([*leg(turn), *leg(turn + phase), sway, 0.2 * np.cos(4 * np.pi * turn)], 1)
    noisy: Any = x + 0.02 * rng.normal(size=x.shape)
    return noisy


def mirror_images(x: Any) -> tuple[Any, Any]:
    """The mirror images, and which features are the first of a pair."""
    return x[:, [2, 3, 0, 1, 4, 5]] * [1.0, 1.0, 1.0, 1.0, -1.0, 1.0], np.array([1, 1, 0, 0, 0, 0])


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))])
def test_the_live_events_with_a_mirror_are_the_references(seed: int) -> None:
    between = np.cumsum(np.random.default_rng(seed).normal(size=(90, 6)) * 0.15, 0)
    x = np.concatenate([walking(7, seed=seed), between, walking(6, seed=seed, phase=0.0), motion(seed, bad=True)[:200]])
    operator = Segment(**QUICK)
    for n in (len(x), len(x) // 2):
        images, firsts = mirror_images(x[:n])
        reference = Reference(x[:n], frames_of(operator), operator.radius_share, None, images, firsts)
        assert as_frames(x[:n], *played(operator, x[:n], mirror=SIDES)) == in_events(reference.run())


def test_strides_are_refined_into_the_steps_of_both_sides() -> None:
    length = 40
    x = walking(12, length)
    plain, _ = played(Segment(**QUICK), x)
    events, _ = played(Segment(**QUICK), x, mirror=SIDES)
    assert (events["activity"]["symmetry"][events["activity"]["repeats"]] == 2).all()
    assert np.array_equal(events["activity"]["repetitions"], plain["activity"]["repetitions"])
    steps = events["primitive"][events["primitive"]["side"] > 0]
    strides = plain["primitive"][plain["primitive"]["repetition"] > 0]
    assert len(steps) >= 2 * len(strides) - 1 and len(strides) >= 10
    assert np.isin(strides["onset"], steps["onset"]).all() and set(plain["primitive"]["side"]) == {0}
    assert (np.diff(steps["side"]) != 0).all()
    second = steps["side"][1:] == 3 - steps["side"][0]
    share = (steps["onset"][1:][second] - steps["onset"][:-1][second]) / np.median(np.diff(strides["onset"]))
    assert np.median(np.abs(share - 0.5)) < 0.08
    first, last = (np.searchsorted(grid(RATE, len(x)), steps[name]) for name in ("onset", "end"))
    moved = np.cumsum(np.append(0.0, (np.diff(x[:, :2], axis=0) ** 2 - np.diff(x[:, 2:4], axis=0) ** 2).sum(1)))
    assert (((moved[last] - moved[first]) > 0) == (steps["side"] == 1)).mean() > 0.9


@pytest.mark.parametrize(("phase", "symmetry"), [(0.0, 1), (0.5, 2), (0.2, 3)])
def test_both_sides_at_once_or_in_turn_or_not_alike(phase: float, symmetry: int) -> None:
    events, _ = played(Segment(**QUICK), walking(8, phase=phase), mirror=SIDES)
    actions = events["activity"][events["activity"]["repeats"]]
    assert len(actions) == 1 and actions["symmetry"][0] == symmetry
    assert (events["primitive"]["side"] > 0).any() == (symmetry == 2)


def test_final_events_with_a_mirror_are_a_prefix_and_late_by_the_stated_bound() -> None:
    x = walking(9)
    whole, stamps = played(Segment(**QUICK), x, mirror=SIDES)
    for n in range(100, len(x), 61):
        part, when = played(Segment(**QUICK), x[:n], mirror=SIDES)
        for name in FINAL:
            free = part[name][when[name] < grid(RATE, n)[-1]]
            assert np.array_equal(free, whole[name][: len(free)])
    steps = whole["primitive"]["side"] > 0
    late = (stamps["primitive"][steps] - whole["primitive"]["end"][steps])[6:]
    assert (late <= (2.75 + 0.5) * 45 / RATE * 1e9).all()


def test_repetitions_with_pauses_between_them_come_in_bouts() -> None:
    wave = circling(3, 30)[120:-120]
    rest = wave[-1] + np.random.default_rng(2).normal(size=(70, 4)) * 0.03 + np.sin(np.arange(70) * np.pi / 69)[:, None]
    x = np.concatenate([np.concatenate([wave, rest]) for _ in range(5)])
    events, stamps = played(Segment(**QUICK), x)
    bouts = events["bout"][events["bout"]["repetitions"] > 1]
    assert len(bouts) >= 4 and (bouts["end"] - bouts["onset"] <= 100 / RATE * 1e9).all()
    assert (stamps["bout"] - events["bout"]["end"] <= 3.0 * 34 / RATE * 1e9)[1:].all()
    for action in events["activity"][events["activity"]["repeats"]]:
        mine = events["bout"][events["bout"]["activity"] == action["activity"]]
        assert mine["bout"].tolist() == list(range(1, len(mine) + 1))
        assert mine["repetitions"].sum() == action["repetitions"]


@pytest.mark.parametrize("kind", ["walk", "noise", "still"])
def test_motion_that_does_not_repeat_is_not_cut(kind: str) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        x = {
            "walk": np.cumsum(rng.normal(size=(900, 8)), 0),
            "noise": rng.normal(size=(900, 8)),
            "still": np.ones((900, 8)),
        }[kind]
        events, _ = played(Segment(), x)
        assert len(events["activity"]) == len(events["primitive"]) == 1
        assert not events["activity"]["repeats"][0] and events["primitive"]["repetition"][0] == 0


def assert_not_cut(x: Any) -> None:
    """One activity, which says that it does not repeat, one primitive, and nothing counted."""
    events, _ = played(Segment(), x)
    assert len(events["activity"]) == len(events["primitive"]) == 1
    assert not events["activity"]["repeats"][0] and events["primitive"]["repetition"][0] == 0
    assert not len(events["begin"]) and not len(events["count"])


@pytest.mark.parametrize("seed", range(3))
def test_motion_whose_frames_are_shuffled_is_not_cut(seed: int) -> None:
    x = np.concatenate([walking(9, seed=seed), np.ones((90, 6)), 2.0 - walking(7, 30, seed=seed)])
    events, _ = played(Segment(), stacked(x))
    assert events["activity"]["repeats"].any()
    assert_not_cut(stacked(np.random.default_rng(seed).permutation(x)))


def test_a_gap_ends_what_is_open_and_exemplars_outlive_it() -> None:
    x = np.concatenate([circling(12)[:520], circling(12)[120:]])
    operator = Segment(**QUICK)
    operator.open({"in": StreamSpec((4,), rate_hz=RATE)})
    time = grid(RATE, len(x))
    time[520:] += 20_000_000_000
    made = [
        *operator.process("in", Chunk(time[:520], x[:520], int(time[519]))),
        *operator.process("in", Chunk(time[520:], x[520:], int(time[-1]), lost=-1)),
        *operator.close(),
    ]
    activities = np.concatenate([chunk.data for name, chunk in made if name == "activity"])
    stamps = np.concatenate([chunk.time for name, chunk in made if name == "activity"])
    actions = activities[activities["repeats"]]
    assert len(actions) == 2 and actions["forced"][0] and set(actions["cluster"]) == {0}
    assert actions["end"][0] <= time[519] < actions["onset"][1]
    assert stamps[activities["activity"] == actions["activity"][0]][0] == time[520]


def test_memory_does_not_grow() -> None:
    operator = Segment(**QUICK)
    operator.open({"in": StreamSpec((4,), rate_hz=RATE)})
    before, x = operator.memory_bytes, circling(40)
    time = grid(RATE, len(x))
    operator.process("in", Chunk(time, x, int(time[-1])))
    assert operator.memory_bytes == before


@pytest.mark.parametrize(
    ("changes", "rate_hz", "error", "says"),
    [
        ({}, None, InputError, "regular"),
        ({}, 500.0, InputError, "at most 199.8 Hz"),
        ({"settle_s": 9.0}, 30.0, ParameterError, "at most firm_s"),
        ({"mass_s": 11.0}, 30.0, ParameterError, r"at most cycle_s \(7\)"),
        ({"band_s": (0.5, 0.3)}, 30.0, ParameterError, "below half of cycle_s"),
    ],
)
def test_what_cannot_be_is_said_before_it_begins(
    changes: dict[str, Any], rate_hz: float | None, error: type[Exception], says: str
) -> None:
    with pytest.raises(error, match=says):
        Segment(**changes).open({"in": StreamSpec((4,), rate_hz=rate_hz)})


def test_a_mirror_image_must_be_one_of_these_features() -> None:
    spec = StreamSpec((6,), rate_hz=RATE)
    image = SIDES.unopened().open({"in": spec})["out"]
    Segment().open({"in": spec, "mirrored": image})
    for other in (spec, image.derive(rate_hz=2 * RATE), image.derive(shape=(3,))):
        with pytest.raises(InputError, match="through operators"):
            Segment().open({"in": spec, "mirrored": other})


def test_steps_whose_mirror_image_is_missing_have_no_side() -> None:
    x = walking(9)
    bad = np.full(x.shape, np.nan)
    spec, time, operator = StreamSpec((6,), rate_hz=RATE), grid(RATE, len(x)), Segment(**QUICK)
    operator.open({"in": spec, "mirrored": SIDES.open({"in": spec})["out"]})
    made = []
    for i in range(len(x)):
        part = Chunk(time[i : i + 1], bad[i : i + 1], int(time[i]))
        operator.process("mirrored", SIDES.process("in", part))
        made += operator.process("in", Chunk(time[i : i + 1], x[i : i + 1], int(time[i])))
    told_parts = np.concatenate([chunk.data for name, chunk in [*made, *operator.close()] if name == "primitive"])
    assert (told_parts["repetition"] > 0).sum() > 5 and set(told_parts["side"]) == {0}


def test_the_counter_of_the_configuration_counts_strides_from_one_accelerometer() -> None:
    limb, n = Limb("foot", 100.0), 6000
    spec, time = StreamSpec((3,), rate_hz=100.0), grid(100.0, n)
    x: Any = limb.measure(np.arange(n))["acceleration"]
    steps: tuple[Operator[Any], ...] = (Lowpass(cutoff_hz=3.0), Resample(rate_hz=RATE), Stack())
    for operator in steps:
        spec = operator.open({"in": spec})["out"]
        parts = [
            flat
            for made in (operator.process("in", Chunk(time, x, int(time[-1]))), operator.close())
            for flat in chunks_of(made)
        ]
        time, x = np.concatenate([part.time for part in parts]), np.concatenate([part.data for part in parts])
    events, _ = played(Segment(), x)
    assert abs(int(events["activity"]["repetitions"].sum()) - len(limb.gait.touchdowns(0, n))) <= 1


@needs_data
def test_the_three_walks_of_a_recording_are_one_cluster_that_holds_nothing_else() -> None:
    found = recording("cmu86_full/86_01")
    x = stacked(found["e15_cm"])
    operator = Segment()
    events, stamps = played(operator, x)
    assert as_frames(x, events, stamps) == in_events(Reference(x, frames_of(operator), operator.radius_share).run())
    walk = int(np.flatnonzero(found["label_names"] == "walk")[0])
    labels = found["label"][10 : 10 + len(x)]
    time = grid(RATE, len(x))
    clusters: dict[int, set[int]] = {}
    for event in events["primitive"][events["primitive"]["repetition"] > 0]:
        first, last = np.searchsorted(time, [event["onset"], event["end"]])
        label = int(np.bincount(labels[first : last + 1] + 1).argmax()) - 1
        if label >= 0:
            clusters.setdefault(label, set()).add(int(event["cluster"]))
    (mine,) = clusters[walk]
    assert all(mine not in others for label, others in clusters.items() if label != walk)


@needs_data
@pytest.mark.parametrize("name", SHUFFLED)
def test_a_recording_whose_frames_are_shuffled_is_not_cut(name: str) -> None:
    found = recording(name)
    x = found["e15_cm"] if "e15_cm" in found else np.unwrap(found["angles_deg"], period=360.0, axis=0)[::4]
    events, _ = played(Segment(), stacked(x))
    assert events["activity"]["repeats"].any()
    for seed in range(3):
        assert_not_cut(stacked(np.random.default_rng(seed).permutation(x)))
