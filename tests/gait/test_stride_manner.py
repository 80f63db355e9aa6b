"""Strides that are not straight walking are named, and those of turning are left out of statistics unless asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph.operators import CycleReview, StrideManner
from kinegraph.operators.cycles.cycle import CLOSED, some_cycles
from kinegraph.operators.strides.stride_manner import MANNER
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec, grid

RATE, SECONDS = 100.0, 40.0


def walked(
    signal: StreamSpec | None, data: Array | None, onsets_s: list[float], stance: float = 62.0, **given: Any
) -> list[str]:
    """How the strides between these touch-downs were walked, by their names."""
    closed = np.zeros(len(onsets_s) - 1, CLOSED)
    closed["onset"], closed["end"] = (np.round(np.array(part) * NS) + NS for part in (onsets_s[:-1], onsets_s[1:]))
    closed["number"], closed["stance_pct"] = np.arange(1, len(closed) + 1), stance
    operator = StrideManner(**given)
    spec = StreamSpec((), CLOSED)
    operator.open({"closed": spec} | ({"signal": signal} if signal else {}))
    manners, at = [], 0
    for k, end in enumerate(closed["end"] + 10**7):
        if signal is not None and data is not None:
            time = grid(RATE, len(data))
            until = int(np.searchsorted(time, end))
            operator.process("signal", Chunk(time[at:until], data[at:until], int(end)))
            at = until
        [(_, chunk)] = operator.process("closed", Chunk(np.array([end]), closed[k : k + 1], int(end)))
        manners += [str(name) for name in chunk.data["manner"]]
    return manners


def heading() -> Array:
    """Straight on for 15 s, half a turn in 3 s, straight back."""
    return np.clip((np.arange(RATE * SECONDS) / RATE - 15.0) / 3.0, 0.0, 1.0) * np.pi


def hips(axis: int) -> tuple[StreamSpec, Array]:
    angle = heading()
    left = np.zeros((len(angle), 3))
    left[:, (axis + 1) % 3], left[:, (axis + 2) % 3] = 0.1 * np.cos(angle), 0.1 * np.sin(angle)
    meta = {"axes": {"up": "xyz"[axis], "forward": "", "handed": "right"}}
    spec = StreamSpec((2, 3), rate_hz=RATE, channels=("L", "R"), units=("m",), meta=meta)
    return spec, np.stack([left, -left], axis=1) + np.array([3.0, 2.0, 1.0])


def sensor(unit: str, tilt: float) -> tuple[StreamSpec, Array]:
    """Worn with a tilt about its x axis; it pitches to and fro, too."""
    speed = np.gradient(heading(), 1 / RATE) * (180 / np.pi if unit == "deg/s" else 1.0)
    up = np.array([0.0, np.sin(tilt), np.cos(tilt)])
    data = np.zeros((len(speed), 6))
    data[:, :3], data[:, 3:] = speed[:, None] * up, 9.81 * up
    data[:, 0] += 3 * np.sin(2 * np.pi * np.arange(len(speed)) / RATE)
    spec = StreamSpec(
        (6,), rate_hz=RATE, channels=("gx", "gy", "gz", "ax", "ay", "az"), units=(unit,) * 3 + ("m/s2",) * 3
    )
    return spec, data


@pytest.mark.parametrize(
    ("signal", "given"),
    [(hips(1), {"hips": ("L", "R")}), (hips(2), {"hips": ("L", "R")}), (sensor("deg/s", 0.0), {}), (sensor("rad/s", 1.2), {})],
)  # fmt: skip
def test_strides_of_turning_are_named(signal: tuple[StreamSpec, Array], given: dict[str, Any]) -> None:
    manners = walked(*signal, [1.0 + 1.1 * k for k in range(33)], **given)
    starts = np.array([1.0 + 1.1 * k for k in range(32)])
    inside = (starts < 18) & (starts + 1.1 > 15)
    assert {m for m, turns in zip(manners, inside, strict=True) if not turns} == {"walking"}
    assert manners.count("turning") >= inside.sum() - 1


@pytest.mark.parametrize(
    ("stance", "name"), [(40.0, "running"), (62.0, "walking"), (80.0, "shuffling"), (np.nan, "walking")]
)
def test_running_and_shuffling_are_named(stance: float, name: str) -> None:
    assert set(walked(None, None, [float(k) for k in range(8)], stance)) == {name}


def test_the_last_long_stride_before_standing_is_stopping() -> None:
    assert walked(None, None, [*map(float, range(8)), 8.5])[-2:] == ["walking", "stopping"]


@pytest.mark.parametrize("count_turns", [False, True])
def test_turns_leave_the_statistics_unless_asked_for(count_turns: bool) -> None:
    made = some_cycles(12, 2, 1)
    manner = np.zeros(1, MANNER)
    closed = made["closed"][2]
    manner["number"], manner["manner"] = 6, "turning"
    stamps = {port: stamp for port, (_, stamp, _) in made.items()}
    for late in (False, True):  # before the stride itself, or after it
        review = CycleReview(count_turns=count_turns)
        review.open({**{port: spec for port, (spec, _, _) in made.items()}, "manner": StreamSpec((), MANNER)})
        came = [(int(s), port, i) for port in ("closed", "cycles") for i, s in enumerate(stamps[port])]
        at = int(stamps["closed"][closed["number"] == 6][0])
        came.append((at + 10**6 if late else at, "manner" if late else "a manner", 0))
        last: dict[int, str] = {}
        for stamp, port, i in sorted(came):
            name = port.removeprefix("a ")
            data = manner if name == "manner" else made[name][2][i : i + 1]
            for output, chunk in review.process(name, Chunk(np.array([stamp]), data, stamp)):
                for row in chunk.data if output == "closed" else ():
                    last[int(row["number"])] = str(row["rejected"])
        assert last[6] == ("" if count_turns else "turning") and last[7] == ""
