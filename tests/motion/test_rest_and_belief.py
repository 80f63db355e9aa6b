"""Rest between repetitions, what is believed before a decision, and what is taken back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph.devices.people.exerciser import Exerciser, Routine
from kinegraph.operators.segmentation import Segment
from kinegraph.operators.segmentation.kernels.excursions import excursions
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.operator import grid
from tests.motion.reference import Reference
from tests.motion.segmentation_runs import (
    QUICK,
    RATE,
    as_frames,
    frames_of,
    in_events,
    motion,
    played,
    recording,
    seen,
    stacked,
)
from tests.support.real import needs_data


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
