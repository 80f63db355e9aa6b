"""Contacts on recorded walks, beside offline methods."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import structlog

from bench import contacts as bench
from kinegraph.devices.people.treadmill import Treadmill
from kinegraph.operators.contacts.acceleration import AccelerationContacts
from kinegraph.operators.contacts.force import ForceContacts
from kinegraph.operators.contacts.inertial import InertialContacts
from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.errors import ParameterError
from tests.gait.contact_runs import START, cycles_of, feed, onsets
from tests.gait.contact_runs import recordings as recordings
from tests.gait.contact_runs import walks as walks
from tests.support.real import needs_data


@needs_data
def test_steps_of_foot_worn_sensors(walks: dict[str, list[bench.Walk]]) -> None:
    everyone = bench.Score(), bench.Score()
    for name, person in walks.items():
        for k, score in enumerate(zip(*(bench.score(walk, bench.as_recorded) for walk in person), strict=True)):
            total = bench.Score()
            for one in score:
                total.merge(one)
            everyone[k].merge(total)
            assert total.f1 >= 0.95, (name, k)
            assert total.median_ms <= 30.0, (name, k)
            assert min(total.delays_s) >= 0.0
    for total in everyone:
        assert total.f1 >= 0.97
        assert total.median_ms <= 15.0


@needs_data
@pytest.mark.parametrize(
    "variant", ["mounted at random", "all signs reversed", "scale x 0.8", "scale x 1.25", "at 50 Hz"]
)
def test_steps_of_sensors_worn_otherwise(walks: dict[str, list[bench.Walk]], variant: str) -> None:
    total = bench.Score()
    for person in walks.values():
        for walk in person[:4]:
            total.merge(bench.score(walk, bench.VARIANTS[variant])[0])
    assert total.f1 >= 0.965
    assert total.median_ms <= 15.0


@needs_data
def test_steps_of_an_accelerometer_alone(walks: dict[str, list[bench.Walk]]) -> None:
    total = bench.Score()
    for person in walks.values():
        for walk in person:
            total.merge(bench.score(walk, bench.as_recorded, AccelerationContacts)[0])
    assert total.f1 >= 0.95
    assert total.median_ms <= 25.0


@needs_data
def test_cuts_and_snapshots_on_a_real_walk(walks: dict[str, list[bench.Walk]]) -> None:
    walk = next(iter(walks.values()))[0]
    time = START + np.round(walk.seconds * NS).astype(np.int64)
    runs = []
    for size in (1, 7, 100, len(time)):
        operator = InertialContacts()
        reported: list[tuple[str, Chunk]] = []
        operator.open({"in": bench.FOOT})
        for begin in range(0, len(time), size):
            part = slice(begin, begin + size)
            reported += operator.process("in", Chunk(time[part], walk.samples[part], int(time[part][-1])))
            if size == 7:
                snapshot, operator = operator.snapshot(), InertialContacts()
                operator.open({"in": bench.FOOT})
                operator.restore(snapshot)
        runs.append(
            {
                name: b"".join(c.time.tobytes() for port, c in reported if port == name)
                + b"".join(c.data.tobytes() for port, c in reported if port == name)
                for name in operator.outputs
            }
        )
    assert len(runs[0]["touchdown"]) > 16 * 10
    assert all(run == runs[0] for run in runs)


@needs_data
def test_overground_markers_agree_with_an_offline_method(recordings: Path) -> None:
    trials = list(bench.marker_trials(recordings))
    assert trials
    down, up = bench.Score(), bench.Score()
    for name, path, names in trials:
        spec = StreamSpec((8, 3), rate_hz=100.0, channels=names, units=("mm",))
        sides = {}
        for side in "LR":
            operator = MarkerContacts(marker=f"{side}TOE", reference=f"{side}HIP")
            with structlog.testing.capture_logs() as warnings:
                reported = bench.run(operator, spec, np.arange(len(path)) / 100.0, path)
            assert not warnings
            truth = bench.zeni(path, names.index(f"{side}TOE"), names.index(f"{side}HIP"))
            down.add(*reported["touchdown"], truth[0], 0.15)
            up.add(*reported["liftoff"], truth[1], 0.15)
            sides[side] = reported["touchdown"][0]
            speed = np.abs(np.gradient(path[:, names.index(f"{side}TOE"), 1])) / 10.0
            for index in np.round(sides[side] * 100).astype(int):
                assert speed[index : index + 60].min() < 0.15, "a foot that has landed stands still soon after, in m/s"
            cycles = np.diff(sides[side])
            assert ((cycles > 0.9) & (cycles < 3.2)).all(), (name, side)
        for left, right in pairwise(sides["L"]):
            assert ((sides["R"] > left) & (sides["R"] < right)).sum() == 1, name
    for score in (down, up):
        assert score.f1 >= 0.96
        assert score.median_ms <= 10.0


@needs_data
def test_overground_markers_give_cycles(recordings: Path) -> None:
    for name, path, names in bench.marker_trials(recordings):
        spec = StreamSpec((8, 3), rate_hz=100.0, channels=names, units=("mm",))
        operator = MarkerContacts(marker="RTOE", reference="RHIP", side="right")
        reported = feed(operator, spec, path)
        closed = cycles_of(reported, operator.unopened().open({"in": spec}), len(path) / 100.0)
        assert len(closed) == len(onsets(reported, "touchdown")) - 1 >= 2, name
        stance = closed["stance_pct"][closed["rejected"] == ""]
        assert ((stance > 50.0) & (stance < 85.0)).all(), (name, stance)


def _plates(seconds: int = 120) -> tuple[Array, Array, Array]:
    """Force under the right foot of the simulated walk, under the left half a stride later (n,), and the right touch-downs in s."""
    signal, n = Treadmill().signal(), seconds * 1000
    right = signal.read(0, n)[1][:, 0]
    truth = signal.gait.cycles(0, n)[:, 0] / 1000.0
    return right, np.roll(right, round(0.5 * 60 / 57 * 1000)), truth[truth > 0.2]


def _noise(sd: float) -> Array:
    return np.random.default_rng(0).normal(0.0, sd, 120_000)


def _ramp(to: float) -> Array:
    return np.linspace(0.0, to, 120_000)


PLATE_FAULTS: dict[str, tuple[Any, dict[str, Any], float]] = {
    "as it is": (lambda right, left: [right], {}, 5.0),
    "offset +30 N": (lambda right, left: [right + 30], {}, 5.0),
    "offset -30 N": (lambda right, left: [right - 30], {}, 5.0),
    "drift to 60 N": (lambda right, left: [right + _ramp(60)], {}, 5.0),
    "drift to -60 N": (lambda right, left: [right - _ramp(60)], {}, 5.0),
    "5 % of the other belt": (lambda right, left: [right + 0.05 * left], {}, 5.0),
    "5 % of the other belt, which is there": (lambda right, left: [right + 0.05 * left, left], {"other": ("L",)}, 5.0),
    "10 % of the other belt, which is there": (lambda right, left: [right + 0.1 * left, left], {"other": ("L",)}, 5.0),
    "15 N rms of noise": (lambda right, left: [right + _noise(15)], {}, 12.0),
    "25 N rms of noise": (lambda right, left: [right + _noise(25)], {}, 20.0),
    "offset, drift, cross-talk and noise": (
        lambda right, left: [right + 30 + _ramp(60) + 0.05 * left + _noise(10), left],
        {"other": ("L",)},
        10.0,
    ),
}


@pytest.mark.parametrize("fault", PLATE_FAULTS)
def test_every_touchdown_on_a_plate_that_drifts_hums_or_hears_the_other(fault: str) -> None:
    right, left, truth = _plates()
    spoil, given, late_ms = PLATE_FAULTS[fault]
    data = np.stack(spoil(right, left), axis=1)
    spec = StreamSpec((data.shape[1],), rate_hz=1000.0, channels=("R", "L")[: data.shape[1]], units=("N",))
    reported = feed(ForceContacts(**given), spec, data)
    score = bench.Score()
    score.add(onsets(reported, "touchdown"), onsets(reported, "touchdown"), truth, 0.05)
    assert (score.missed, score.extra <= 1) == (0, True), score
    assert np.percentile(np.abs(score.errors_s), 95) * 1000 <= late_ms
    lifted = onsets(reported, "liftoff")
    assert abs(len(lifted) - len(truth)) <= 2


def test_a_plate_that_jumps_in_mid_session_is_found_again_within_three_strides() -> None:
    right, _, truth = _plates()
    jumped = right + np.where(np.arange(len(right)) < 60_000, 0.0, 40.0)
    reported = feed(ForceContacts(), StreamSpec((1,), rate_hz=1000.0, units=("N",)), jumped[:, None])
    score = bench.Score()
    score.add(onsets(reported, "touchdown"), onsets(reported, "touchdown"), truth, 0.05)
    assert score.missed <= 3


def test_channels_of_the_other_belt_are_not_this_ones() -> None:
    spec = StreamSpec((2,), rate_hz=1000.0, channels=("R", "L"), units=("N",))
    for given in ({"other": ("R", "L")}, {"other": ("L",), "channels": ("L",)}):
        with pytest.raises(ParameterError, match="channels of the other belt"):
            ForceContacts(**given).open({"in": spec})  # type: ignore[arg-type]
