"""The live segmentation against its plain definition (reference.py), event by event; and what it promises about them."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from kinegraph.devices.people.exerciser import JOINTS, Exerciser, Routine
from kinegraph.devices.people.walking_limb import Limb
from kinegraph.operators.features.mirror import Mirror
from kinegraph.operators.features.pose import Pose
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.filters.iir import Lowpass
from kinegraph.operators.filters.resample import Resample
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.kernels.excursions import excursions
from kinegraph.operators.segmentation.operator import REACH
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.data.rows import taking
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Operator, grid
from tests.motion.reference import Event, Reference
from tests.support.real import needs_data

RATE = 30.0
QUICK: dict[str, Any] = {"cycle_s": 2.8, "learn_s": 3.0, "window_s": 12.0, "firm_s": 4.0}
FIELDS = {
    "activity": ("onset", "end", "activity", "repetitions", "cluster", "forced", "symmetry"),
    "primitive": ("onset", "end", "activity", "repetition", "cluster", "forced", "side"),
    "bout": ("onset", "end", "activity", "bout", "repetitions", "cluster"),
    "begin": ("onset", "activity"),
    "count": ("activity", "count"),
    "merge": ("cluster", "into"),
    "rest": ("onset", "end"),
    "resting": ("onset",),
    "provisional": ("onset", "end", "activity", "repetition"),
    "radius": (),
}
FINAL = ("activity", "primitive", "bout", "begin", "merge", "rest")


def played(
    operator: Operator[Any], x: Any, pieces: int = 1, mirror: Mirror | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The events and their stamps, by output, of a recording (n, features) at 30 Hz that comes in so many pieces, or with a mirror."""
    operator = operator.unopened()
    spec = StreamSpec(x.shape[1:], rate_hz=RATE)
    specs = operator.open({"in": spec} | ({"mirrored": mirror.open({"in": spec})["out"]} if mirror else {}))
    time, found = (
        grid(RATE, len(x)),
        {name: ([np.empty(0, spec.dtype)], [np.empty(0, np.int64)]) for name, spec in specs.items()},
    )
    emitted = []
    for part in np.array_split(np.arange(len(x)), len(x) if mirror else pieces):
        if mirror:
            emitted += operator.process(
                "mirrored", mirror.process("in", Chunk(time[part], x[part], int(time[part][-1])))
            )
        emitted += operator.process("in", Chunk(time[part], x[part], int(time[part][-1])))
    for name, chunk in [*emitted, *(operator.close() or [])]:
        found[name][0].append(chunk.data)
        found[name][1].append(chunk.time)
    return {name: np.concatenate(e) for name, (e, _) in found.items()}, {
        name: np.concatenate(t) for name, (_, t) in found.items()
    }


def as_frames(x: Any, events: dict[str, Any], stamps: dict[str, Any]) -> dict[str, list[Event]]:
    """Events as the reference tells them: stamps as frame numbers."""
    time = grid(RATE, len(x))
    found = {}
    for name, fields in FIELDS.items():
        columns = [np.searchsorted(time, events[name][f]) if f in ("onset", "end") else events[name][f] for f in fields]
        rows = [np.searchsorted(time, stamps[name]), *columns]
        found[name] = [tuple(int(v) for v in row) for row in zip(*rows, strict=True)]
    return found


def frames_of(operator: Segment) -> dict[str, int]:
    seconds = {
        "max_lag": REACH * operator.cycle_s, "window": operator.window_s, "learn": operator.learn_s, "quiet": operator.quiet_s,
        "mass": operator.mass_s, "settle": operator.settle_s, "firm": operator.firm_s, "min_band": operator.band_s[0],
        "max_band": operator.band_s[1], "every": 0.5, "rest": operator.rest_s,
    }  # fmt: skip
    frames = {name: round(value * RATE) for name, value in seconds.items()}
    frames["transition"] = min(round(operator.transition_s * RATE), frames["max_lag"])
    return frames | {"firm": max(frames["firm"], 2 * frames["max_lag"])}


def in_events(reference: list[Event]) -> dict[str, list[Event]]:
    """The reference's events by output."""
    found: dict[str, list[Event]] = {name: [] for name in FIELDS}
    for kind, *rest in reference:
        found[kind].append(tuple(rest))
    return found


def motion(seed: int, bad: bool = False, rests: bool = False) -> Any:
    """Cycles of three kinds at changing pace in random turn, with wandering between them, or rests: (n, 6)."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(6):
        n, pace = int(rng.integers(40, 220)), rng.uniform(0.08, 0.35)
        turn = np.cumsum(pace * (1 + 0.2 * np.sin(np.arange(n) * 0.05)))
        kind = int(rng.integers(0, 4))
        if kind < 3:
            mix = np.random.default_rng(kind).normal(size=(4, 6))
            made.append(np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)], 1) @ mix)
        else:
            made.append(np.cumsum(rng.normal(size=(n, 6)) * 0.15, 0))
        if rests:
            made.append(np.repeat(made[-1][-1:], int(rng.integers(20, 160)), 0))
    x = np.concatenate(made)
    x += 0.05 * rng.normal(size=x.shape)
    if bad:
        x[rng.integers(0, len(x), 5), rng.integers(0, 6, 5)] = np.nan
        x[rng.integers(0, len(x), 12)] = np.nan
        x[len(x) // 2 : len(x) // 2 + 90, 1] = np.inf
        x[rng.random(x.shape) < 0.1] = np.nan
    return x


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


def chunks_of(emitted: Any) -> list[Chunk]:
    if emitted is None:
        return []
    return [emitted] if isinstance(emitted, Chunk) else [chunk for _, chunk in emitted]


def recording(name: str) -> Any:
    folder = os.environ.get("KINEGRAPH_DATA")
    path = Path(folder or "") / "segmentation" / f"{name}.npz"
    if not folder or not path.exists():
        pytest.skip(f"KINEGRAPH_DATA names no folder that holds segmentation/{name}.npz")
    with np.load(path) as archive:
        return {key: archive[key] for key in archive.files}


def stacked(x: Any) -> Any:
    operator = Stack()
    operator.open({"in": StreamSpec(x.shape[1:], rate_hz=RATE)})
    time = grid(RATE, len(x))
    made = operator.process("in", Chunk(time, np.ascontiguousarray(x, np.float64), int(time[-1])))
    return np.concatenate([chunk.data for chunk in chunks_of(made)])


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


SHUFFLED = [f"cmu86_4ch/86_{n}" for n in ("01", "03", "07", "09", "11")]
SHUFFLED += ["cmu86_full/86_01", "cmu86_full/86_09", "mocap6/13_29", "mocap6/13_31"]


@needs_data
@pytest.mark.parametrize("name", SHUFFLED)
def test_a_recording_whose_frames_are_shuffled_is_not_cut(name: str) -> None:
    found = recording(name)
    x = found["e15_cm"] if "e15_cm" in found else np.unwrap(found["angles_deg"], period=360.0, axis=0)[::4]
    events, _ = played(Segment(), stacked(x))
    assert events["activity"]["repeats"].any()
    for seed in range(3):
        assert_not_cut(stacked(np.random.default_rng(seed).permutation(x)))


def lifts(seed: int, repetitions: int, length: int, pause: int, still: int = 60) -> Any:
    """Something raised and put down again, at changing tempo, with so many frames of rest after each, and `still` ones before: (n, 8)."""
    rng = np.random.default_rng(seed)
    mix, made = rng.normal(size=(4, 8)), [np.zeros((still, 8))]
    for _ in range(repetitions):
        n = round(length * rng.uniform(0.9, 1.1))
        turn = np.arange(n) / n * 2 * np.pi
        parts = np.stack([1 - np.cos(turn), np.sin(turn), 1 - np.cos(2 * turn), 0.5 * np.sin(2 * turn)], 1)
        made += [10.0 * parts @ mix, np.zeros((pause, 8))]
    x = np.concatenate([*made, np.zeros((60, 8))])
    noisy: Any = x + 0.3 * rng.normal(size=x.shape)
    return noisy


@pytest.mark.parametrize("seed", range(4))
def test_a_pause_is_rest_and_no_repetition(seed: int) -> None:
    events, _ = played(Segment(), stacked(lifts(seed, 10, 60, 120)))
    assert (events["primitive"]["repetition"] > 0).sum() == 10
    assert len(events["rest"]) >= 9
    rests = (events["rest"]["end"] - events["rest"]["onset"]) / 1e9
    assert (rests > 2.5).sum() >= 9 and (rests[:9] < 5.0).all()


@pytest.mark.parametrize(
    ("exercise", "noise_mm", "pause_s"), [("squat", 6.0, 20.0), ("knees", 6.0, 8.0), ("squat", 10.0, 20.0)]
)
def test_who_stands_before_a_noisy_camera_rests(exercise: str, noise_mm: float, pause_s: float) -> None:
    """From one frame to the next noise moves more than squats or knees do: no rest was found, and standing was counted (3 to 5 of ten)."""
    routine = Routine(Exerciser(exercises=(exercise,), noise_mm=noise_mm, pause_s=pause_s, jitter_ms=0.0, seed=1))
    sets = [routine.starts(k)[[0, -1]] for k in range(3)]
    events, _ = played(Segment(), seen(routine, float(sets[-1][1]) + 3.0))
    found, rest = events["primitive"][events["primitive"]["repetition"] > 0], events["rest"]
    middle = (found["onset"] + found["end"]) / 2e9 - grid(RATE, 1)[0] / 1e9 + 1 / 3
    assert len(found) == 18 and all(((middle > begin) & (middle < end)).sum() == 6 for begin, end in sets)
    assert (rest["end"] - rest["onset"] > 0.75e9 * pause_s).sum() == 3 and len(rest) <= 8
    assert (rest["onset"][1:] > rest["end"][:-1]).all()


@pytest.mark.parametrize(("exercise", "noise_mm"), [("squat", 1.0), ("squat", 6.0), ("arms", 6.0)])
def test_a_repetition_ends_where_a_short_rest_begins(exercise: str, noise_mm: float) -> None:
    """Between sets 4 s apart the last squat took 6.1 s instead of 2.1: a rest too short to end the activity lay within it, and
    all three sets were one bout."""
    routine = Routine(Exerciser(exercises=(exercise,), noise_mm=noise_mm, pause_s=4.0, jitter_ms=0.0, seed=3))
    events, _ = played(Segment(), seen(routine, float(routine.starts(2)[-1]) + 3.0))
    parts, rests = events["primitive"], events["rest"][1:]
    found = parts[parts["repetition"] > 0]
    took = found["end"] - found["onset"]
    assert len(found) == 18 and len(rests) >= 3 and took.max() <= 1.25 * np.median(took)
    for rest in rests:
        assert not ((found["onset"] <= rest["end"]) & (found["end"] >= rest["onset"])).any()
    holes = found["onset"][1:] - found["end"][:-1]
    assert (holes > 3 * NS).sum() == 2
    assert events["bout"]["repetitions"].tolist() == [6, 6, 6]


@pytest.mark.parametrize("still_s", [2, 20, 60])
def test_stillness_before_the_motion_does_not_change_what_is_found(still_s: int) -> None:
    events, _ = played(Segment(), stacked(lifts(2, 9, 50, 0, still=round(still_s * RATE))))
    (action,) = events["activity"][events["activity"]["repeats"]]
    assert action["repetitions"] == 9
    assert (events["primitive"]["repetition"] > 0).sum() == 9


@pytest.mark.parametrize("still_s", [2, 20, 75])
@pytest.mark.nightly
def test_stillness_before_the_motion_is_told_as_rest(still_s: int) -> None:
    """As soon as the motion is known, and of more than the window what the window holds; before a gap and behind it."""
    operator, x = Segment(), stacked(lifts(2, 5, 50, 0, still=round(still_s * RATE)))
    events, stamps = played(operator, x)
    first = events["rest"][0]
    assert (first["end"] - first["onset"]) / 1e9 == pytest.approx(
        min(still_s, operator.window_s), abs=2.5 if still_s > 60 else 0.7
    )
    assert 0 <= (stamps["rest"][0] - first["end"]) / 1e9 <= 3.0 and first["end"] / 1e9 == pytest.approx(
        still_s, abs=1.0
    )
    reference = Reference(x, frames_of(operator), operator.radius_share)
    assert as_frames(x, events, stamps) == in_events(reference.run())


def test_all_of_the_stillness_before_the_motion_is_told_though_the_motion_begins_slowly() -> None:
    """By its first frames alone a single one of those before it, a little noisier, looked like motion: of 18 s 4 were reported."""
    operator = Segment()
    x = seen(Routine(Exerciser(noise_mm=1.0, jitter_ms=0.0, seed=3, pause_s=18.0)), 23.0)
    events, stamps = played(operator, x)
    first = events["rest"][0]
    assert first["onset"] < 1.5 * NS and first["end"] / 1e9 == pytest.approx(18.0, abs=0.7)
    assert stamps["rest"][0] - first["end"] <= 3 * NS
    assert as_frames(x, events, stamps) == in_events(Reference(x, frames_of(operator), operator.radius_share).run())


def test_stillness_behind_a_gap_is_told_as_rest_too() -> None:
    operator, x = Segment(), stacked(lifts(2, 5, 50, 0, still=300))
    operator.open({"in": StreamSpec(x.shape[1:], rate_hz=RATE)})
    time, rests = grid(RATE, len(x)), []
    for start in (0, 600 * NS):
        chunk = Chunk(start + time, x, int(start + time[-1]), lost=-1 if start else 0)
        rests += [r for name, made in operator.process("in", chunk) if name == "rest" for r in made.data]
    long = [(r["end"] - r["onset"]) / 1e9 for r in rests if r["end"] - r["onset"] > 5 * NS]
    assert long == pytest.approx([10.0, 10.0], abs=0.7)


@pytest.mark.parametrize("cycle_s", [4.0, 7.0, 10.0])
@pytest.mark.parametrize("seed", range(4))
def test_slow_cycles_up_to_the_longest_are_counted_though_their_tempo_changes(seed: int, cycle_s: float) -> None:
    rng = np.random.default_rng(seed)
    mix, made = rng.normal(size=(4, 8)), [np.zeros((150, 8))]
    for _ in range(8):
        turn = np.linspace(0.0, 2 * np.pi, round(RATE * cycle_s * rng.uniform(0.85, 1.15)), endpoint=False)
        made.append(np.stack([1 - np.cos(turn), np.sin(turn), 1 - np.cos(2 * turn), 0.5 * np.sin(2 * turn)], 1) @ mix)
    x = 10.0 * np.concatenate([*made, made[0]])
    events, _ = played(Segment(cycle_s=max(7.0, cycle_s)), stacked(x + 0.3 * rng.normal(size=x.shape)))
    assert (events["primitive"]["repetition"] > 0).sum() == 8


def believed_late(events: dict[str, Any], stamps: dict[str, Any]) -> list[float]:
    """How many cycles after its end each repetition was first believed, from the second one of an activity on."""
    found, when = events["provisional"], stamps["provisional"]
    late = []
    for event in events["primitive"][events["primitive"]["repetition"] > 1]:
        length = event["end"] - event["onset"]
        same = (found["repetition"] > 0) & (np.abs(found["onset"] - event["onset"]) < length / 2)
        late.append(float((when[same].min() - event["end"]) / length) if same.any() else np.inf)
    return late


@pytest.mark.parametrize("length", [24, 30, 45, 60, 90])
@pytest.mark.parametrize("seed", range(2))
def test_a_repetition_is_believed_within_half_a_cycle_of_its_end(seed: int, length: int) -> None:
    events, stamps = played(Segment(), stacked(lifts(seed, 7, length, 0, still=240)))
    late = believed_late(events, stamps)
    assert len(late) == 6 and max(late) <= 0.5
    assert events["count"]["count"].tolist() == list(range(1, 8))
    assert events["activity"]["repetitions"].max() == 7


@pytest.mark.parametrize("length", [24, 30, 36, 45])
@pytest.mark.parametrize("seed", range(2))
def test_who_begins_at_once_is_believed_before_enough_has_been_seen_for_a_decision(seed: int, length: int) -> None:
    events, stamps = played(Segment(), stacked(lifts(seed, 7, length, 0)))
    assert max(believed_late(events, stamps)) <= 0.5
    assert events["begin"]["onset"].max() > 0 and stamps["begin"].min() >= round(5.0 * 1e9)
    assert events["count"]["count"][-1] == events["activity"]["repetitions"].max() == 7


@needs_data
@pytest.mark.parametrize("name", ["03", "07", "09", "11"])
def test_a_real_walk_that_begins_at_once_is_believed_from_its_second_cycle_on(name: str) -> None:
    x = np.unwrap(recording(f"cmu86_4ch/86_{name}")["angles_deg"].astype(np.float64), period=360.0, axis=0)[:2400:4]
    assert believed_late(*played(Segment(), stacked(x)))[0] <= 0.5


@pytest.mark.parametrize("goes_on", [True, False])
def test_what_was_believed_too_early_is_withdrawn(goes_on: bool) -> None:
    """Two short cycles, and then something else, or nothing: too little for an activity."""
    turn = np.arange(60) * (2 * np.pi / 24)
    body = np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), 0.5 * np.cos(2 * turn)], 1)
    away = body[-1] + 0.5 * np.arange(1, 200)[:, None] * np.array([1.0, -1.0, 0.5, 1.0])
    x = np.concatenate([body, away]) if goes_on else body
    events, _ = played(Segment(radius=0.3, mass_s=1.4), x + 0.01 * np.random.default_rng(0).normal(size=x.shape))
    assert events["count"]["count"].tolist() == [1, 2, 0]
    assert not events["activity"]["repeats"].any()


def test_a_count_that_was_too_high_is_corrected() -> None:
    for seed in range(8):
        events, _ = played(Segment(**QUICK), motion(seed))
        last = {int(event["activity"]): int(event["count"]) for event in events["count"]}
        made = {int(event["activity"]): int(event["repetitions"]) for event in events["activity"]}
        assert {number: count for number, count in last.items() if count} == {n: c for n, c in made.items() if c}


@pytest.mark.parametrize("seed", range(8))
def test_what_is_merely_believed_of_an_activity_is_not_as_certain_as_the_one_before_it(seed: int) -> None:
    """A count carries the certainty of its final repetitions; it carried that of the activity before."""
    events, stamps = played(Segment(**QUICK), motion(seed))
    final = events["primitive"]
    for at, event in zip(stamps["count"], events["count"], strict=True):
        mine = (final["activity"] == event["activity"]) & (final["repetition"] > 0) & (stamps["primitive"] <= at)
        assert len(set(final["repetition"][mine])) > 1 or event["certainty"] == 0.0
    assert (events["count"]["certainty"] > 0.0).any()


def restless(seed: int) -> Any:
    """Cycles of one kind, then long motion of the same size that hardly repeats, then cycles of another: (n, 6)."""
    rng = np.random.default_rng(seed)
    made = []
    for kind, length in ((0, 36), (1, 30)):
        turn = np.arange(8 * length) * 2 * np.pi / length
        mix = np.random.default_rng(kind).normal(size=(4, 6))
        made.append(np.stack([np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)], 1) @ mix)
    smooth = np.apply_along_axis(np.convolve, 0, rng.normal(size=(900 + seed * 150, 2)), np.hanning(15), "same")
    between = smooth @ rng.normal(size=(2, 6)) / 2
    noisy: Any = np.concatenate([made[0], between, made[1]])
    return noisy + 0.03 * rng.normal(size=noisy.shape)


@pytest.mark.parametrize("make", [motion, restless])
@pytest.mark.parametrize("seed", range(4))
def test_no_event_comes_later_than_declared(make: Any, seed: int) -> None:
    operator, x = Segment(**QUICK), make(seed)
    events, stamps = played(operator, x)
    fresh = operator.unopened()
    fresh.open({"in": StreamSpec(x.shape[1:], rate_hz=RATE)})
    assert {"activity", "primitive", "bout", "begin", "provisional", "rest", "resting"} == set(fresh.decision_s)
    for name, bound_s in fresh.decision_s.items():
        what = "end" if "end" in (events[name].dtype.names or ()) else "onset"
        late = (stamps[name] - events[name][what]) / 1e9
        assert not len(late) or late.max() <= bound_s + 1e-9, (name, late.max(), bound_s)


def random_phases(x: Any, seed: int) -> Any:
    """The spectrum of every channel, each of its frequencies at a random phase (n, c)."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft(x - x.mean(0), axis=0)
    return np.fft.irfft(spectrum * np.exp(2j * np.pi * rng.random(spectrum.shape)), len(x), axis=0) + x.mean(0)


@needs_data
@pytest.mark.parametrize("name", ["01", "07", "11"])
def test_most_of_what_repeats_by_chance_in_four_channels_is_not_sure(name: str) -> None:
    x = np.unwrap(recording(f"cmu86_4ch/86_{name}")["angles_deg"].astype(np.float64), period=360.0, axis=0)[::4]

    def repetitions(x: Any) -> tuple[int, int]:
        """All, and those of activities that are certain."""
        found = played(Segment(), stacked(x))[0]["activity"]
        found = found[found["repeats"]]
        return int(found["repetitions"].sum()), int(found["repetitions"][found["certainty"] > 0.0].sum())

    real, certain = repetitions(x)
    by_chance = np.sum([repetitions(random_phases(x, seed))[1] for seed in range(2)])
    assert certain >= 0.5 * real
    assert by_chance / 2 <= 0.25 * real


def two_exercises(seed: int, noise_mm: float = 6.0) -> tuple[Routine, Any]:
    """What somebody does, arms, squats and knees raised, with rests of 1.5 s between them, and the features of it (n, 75)."""
    routine = Routine(Exerciser(noise_mm=noise_mm, jitter_ms=0.0, seed=seed))
    return routine, seen(routine, routine.starts(2)[-1] + 2.0)


def seen(routine: Routine, seconds: float) -> Any:
    """The features (n, 75) of what somebody does in this time."""
    x = np.array([routine.joints(i) for i in range(round(RATE * seconds))])
    pose = Pose()
    spec = StreamSpec(x.shape[1:], rate_hz=RATE, channels=JOINTS, units=("m",))
    (port,) = pose.inputs
    pose.open({port: spec})
    time = grid(RATE, len(x))
    take = taking(pose, {port: spec})
    (made,) = chunks_of(pose.process(port, take(port, Chunk(time, x, int(time[-1])))))
    return stacked(made.data)


def test_half_of_the_next_exercise_is_no_repetition_of_the_last_one_though_stillness_comes_before_it() -> None:
    """Squats, a rest of 1.5 s, knees raised: the stillness with half a knee raise after it passed for a seventh squat."""
    routine, x = two_exercises(0)
    begins = routine.starts(1)
    events, _ = played(Segment(), x)
    found = events["primitive"][events["primitive"]["repetition"] > 0]
    middle = (found["onset"] + found["end"]) / 2e9 + 1 / 3
    assert ((middle > begins[0] - 0.5) & (middle < routine.starts(2)[0])).sum() == 6
    for rest in events["rest"]:
        assert not ((found["onset"] > rest["onset"]) & (found["onset"] < rest["end"])).any()


@pytest.mark.parametrize(("seed", "noise_mm"), [(7, 6.0), (10, 6.0), (13, 1.0)])
def test_an_exercise_is_cut_at_its_start_though_it_follows_a_known_one_in_the_same_activity(
    seed: int, noise_mm: float
) -> None:
    """Its cycle was cut at whatever phase it had been found at: six times both knees were five, and half of one on both sides."""
    routine, x = two_exercises(seed, noise_mm)
    events, _ = played(Segment(), x)
    starts = routine.starts(2)
    found = events["primitive"][events["primitive"]["repetition"] > 0]
    onset = (found["onset"] - grid(RATE, 1)[0]) / 1e9 + 1 / 3
    mine = onset[(onset > starts[0] - 0.5) & (onset < starts[-1])]
    assert len(mine) == 6 and np.abs(mine - starts[:-1]).max() < 0.25


def gestures() -> Any:
    """From one pose out and back at once, six times, each in a tempo of its own, with pauses too short to be a rest: (n, 6).

    What goes up first and what follows changes places from one to the next, so that no gesture comes near another but at its ends.
    """
    rng, made = np.random.default_rng(8), []
    for k in range(6):
        n = int(rng.integers(30, 70))
        up = np.sin(np.pi * np.arange(n) / n) ** 2
        side = np.sin(2 * np.pi * np.arange(n) / n)
        lead = 3.0 if k % 2 else -3.0
        made.append(np.stack([6 * up, 4 * up, lead * side, -lead * side, 2 * up, lead * side], 1))
        made.append(np.zeros((int(rng.integers(14, 26)), 6)))
    x = np.concatenate(made)
    noisy: Any = x + 0.05 * rng.normal(size=x.shape)
    return noisy


def test_gestures_from_a_resting_pose_count_though_no_cycle_brings_them_back() -> None:
    x = gestures()
    operator = Segment(**QUICK)
    events, stamps = played(operator, x)
    counted = events["primitive"][events["primitive"]["repetition"] > 0]
    assert len(counted) == 6 and set(counted["cluster"]) == {-1}
    assert events["activity"]["repetitions"].sum() == 6
    assert as_frames(x, events, stamps) == in_events(Reference(x, frames_of(operator), operator.radius_share).run())


@pytest.mark.parametrize(("every", "counts"), [(12, True), (5, False)])
def test_what_trembles_is_no_gesture(every: int, counts: bool) -> None:
    """A table that one frame's events do not fit into is memory that is overwritten: excursions beyond a number do not count."""
    x = 0.01 * np.random.default_rng(4).normal(size=(1500, 3))
    x[::every] += 1.0
    operator = Segment(
        cycle_s=10.0, rest_s=60.0
    )  # what comes back from one frame to the next would be noise, and no motion
    operator.open({"in": StreamSpec((3,), rate_hz=RATE)})
    operator.process("in", Chunk(grid(RATE, len(x)), x, int(grid(RATE, len(x))[-1])))
    memory = operator.state.memory.with_room(1)
    last = int(memory.next_frame) - 1
    found = excursions(memory, last - 800, last, 0.3)
    assert (len(found) > 40) if counts else not len(found)
