"""Length, height and arch of strides: of paths that are known, of a slow computation, and of a real dog."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.operators.contacts.limb_contacts import LIMB_CONTACT, LimbContacts
from kinegraph.operators.strides.stride_shape import StrideShape
from kinegraph.stream.chunk import NS, StreamSpec, grid
from kinegraph.stream.errors import InputError, ParameterError
from tests.support.emg_run import drive
from tests.support.real import needs_data

DATA = os.environ.get("KINEGRAPH_DATA", "")
DOG = {"left hind": 19, "right hind": 23, "left fore": 10, "right fore": 15}
RATE_HZ, STANCE, LENGTH_M, LIFT_M = 200.0, 0.6, 1.5, 0.2
FOOT = {"foot": "hoof"}


def hoof(belt: bool = False, unit: str = "m") -> dict[str, Any]:
    """A hoof that strides every second, stands for 0.6 s, and swings in half an ellipse 1.5 m long and 0.2 m high."""
    n = 2000
    time = grid(RATE_HZ, n)
    whole, phase = np.divmod((time - NS) / NS, 1.0)
    swing = np.clip((phase - STANCE) / (1 - STANCE), 0.0, 1.0)
    place = np.zeros((n, 1, 3))
    place[:, 0, 0] = LENGTH_M * (whole + (1 - np.cos(np.pi * swing)) / 2) - (
        LENGTH_M * (time - NS) / NS if belt else 0.0
    )
    place[:, 0, 1], place[:, 0, 2] = 7.0, 0.05 + LIFT_M * np.sin(np.pi * swing)
    given: dict[str, Any] = {
        "in": (StreamSpec((1, 3), rate_hz=RATE_HZ, channels=("hoof",), units=(unit,)), time, place)
    }
    spec = StreamSpec((), LIMB_CONTACT, units=("ns", ""), meta={"limb_names": ["foot"]})
    for port, after in (("touchdown", 0.0), ("liftoff", STANCE)):
        rows = np.zeros(9, LIMB_CONTACT)
        rows["onset"], rows["limb"] = NS + np.round((np.arange(9) + after) * NS).astype(np.int64), "foot"
        given[port] = (spec, rows["onset"] + 100_000_000, rows)
    return given


def slow(joints: np.ndarray, time: np.ndarray, down: int, up: int, end: int) -> tuple[float, float, float]:
    """The three measures by their definition, computed another way (y is up)."""

    def at(when: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(when, time, joints[:, c]) for c in range(3)], axis=1)

    start, last = at(np.array([down, end]))
    swing = at(np.array([up, *time[(time > up) & (time < end)], end]))
    inside = time[(time > down + (up - down) / 4) & (time < down + 3 * (up - down) / 4)]
    stance = at(np.array([down + (up - down) // 4, *inside, down + 3 * (up - down) // 4]))
    chord = swing[-1] - swing[0]
    one = chord / np.linalg.norm(chord)
    upright = np.array([0.0, 1.0, 0.0]) - one[1] * one
    rise = (swing - swing[0]) @ (upright / np.linalg.norm(upright))
    length = np.linalg.norm((last - start)[[0, 2]])
    return length, swing[:, 1].max() - np.median(stance[:, 1]), 100 * rise.max() / np.linalg.norm(chord)


@pytest.mark.parametrize("belt", [False, True], ids=["ground", "belt"])
def test_a_known_stride_is_measured(belt: bool) -> None:
    spec, time, rows = drive(StrideShape(FOOT, belt=belt), hoof(belt), 37)["out"]
    assert rows["number"].tolist() == list(range(1, 9)) and set(rows["limb"]) == {"foot"}
    assert np.array_equal(time, rows["end"] + 600_000_000) and spec.meta["limb_names"] == ["foot"]
    assert np.abs(rows["length_m"] - LENGTH_M).max() < 1e-6
    assert np.abs(rows["height_m"] - LIFT_M).max() < 1e-3
    assert np.abs(rows["arch_pct"] - 100 * LIFT_M / LENGTH_M).max() < 0.1


def test_units_are_converted_and_must_be_known() -> None:
    given = hoof(unit="mm")
    spec, time, place = given["in"]
    rows = drive(StrideShape(FOOT), {**given, "in": (spec, time, 1000 * place)}, 50)["out"][2]
    assert np.abs(rows["length_m"] - LENGTH_M).max() < 1e-6
    specs = {port: each[0] for port, each in given.items()}
    with pytest.raises(InputError, match="unit must say it"):
        StrideShape(FOOT).open({**specs, "in": spec.derive(units=("",))})
    with pytest.raises(ParameterError, match="limbs of the contacts"):
        StrideShape({"left": "hoof"}).open(specs)
    with pytest.raises(ParameterError, match="a marker of the input"):
        StrideShape({"foot": "huf"}).open(specs)


def test_what_is_not_known_is_nan() -> None:
    """A long gap spoils its stride, a short one does not; a stride without its lift-off has a length only; a late touch-down spoils two."""
    given = hoof()
    place = given["in"][2]
    place[440:460] = np.nan
    place[640:645] = 0.0
    lift, stamp, rows = given["liftoff"]
    given["liftoff"] = lift, np.delete(stamp, 4), np.delete(rows, 4)
    touch, stamp, rows = given["touchdown"]
    given["touchdown"] = touch, np.concatenate([stamp[:-1], stamp[-1:] + NS]), rows
    found = drive(StrideShape(FOOT), given, 50)["out"][2]
    assert np.isnan(found["length_m"]).tolist() == [i in (2, 7) for i in range(8)]
    for name in ("height_m", "arch_pct"):
        assert np.isnan(found[name]).tolist() == [i in (2, 4, 7) for i in range(8)], name


@needs_data
def test_a_real_dog_strides_as_far_as_it_goes() -> None:
    """Every stride agrees with the slow computation, and is as long as the way of the hips meanwhile, which it knows nothing of."""
    joints = np.load(Path(DATA) / "steering" / "dog_mocap_joints.npz")["dog_walk00"].astype(float)
    spec = StreamSpec((27, 3), rate_hz=60.0, channels=tuple(f"j{i}" for i in range(27)), units=("m",))
    time = grid(60.0, len(joints))
    paws = {limb: {"marker": f"j{i}"} for limb, i in DOG.items()}
    feet = drive(LimbContacts("marker", paws, {"up": "y", "reference": "j0"}), {"in": (spec, time, joints)}, 50)
    shape = StrideShape({limb: f"j{i}" for limb, i in DOG.items()}, up="y")
    rows = drive(shape, {"in": (spec, time, joints), **feet}, 20)["out"][2]
    lifts, off = feet["liftoff"][2], []
    for row in rows:
        inside = [t for t in lifts["onset"][lifts["limb"] == row["limb"]] if row["onset"] < t < row["end"]]
        expected = slow(joints[:, DOG[str(row["limb"])]], time, int(row["onset"]), int(inside[0]), int(row["end"]))
        got = [float(row[name]) for name in ("length_m", "height_m", "arch_pct")]
        assert len(inside) == 1 and np.abs(np.array(got) - expected).max() < 1e-6
        hips = [[np.interp(row[name], time, joints[:, 0, c]) for c in (0, 2)] for name in ("onset", "end")]
        off.append(abs(got[0] / np.hypot(*np.subtract(hips[1], hips[0])) - 1))
    assert len(rows) == 48 and max(off) < 0.1, max(off)
    assert rows["height_m"].min() > 0.03 and rows["height_m"].max() < 0.15
