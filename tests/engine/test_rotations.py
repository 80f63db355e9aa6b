"""q and -q are one rotation: signs are continuous where a stream enters, and operators for plain numbers refuse rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.operators import Decimate, Lowpass, MovingMean, OneEuro, Resample, Select
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.domain.rotation import RotationSigns, rotations, with_rotations
from kinegraph.stream.errors import InputError

QUATERNION = StreamSpec((4,), rate_hz=100.0, channels=("qw", "qx", "qy", "qz"))


@pytest.mark.parametrize(
    ("names", "starts"),
    [
        (("qw", "qx", "qy", "qz"), (0,)),
        (("x", "y", "z", "Quat_X", "Quat_Y", "Quat_Z", "Quat_W"), (3,)),
        (("w", "x", "y", "z"), (0,)),
        (("q0", "q1", "q2", "q3"), (0,)),
        (("emg0", "emg1", "emg2", "emg3"), ()),
        (("acc_x", "acc_y", "acc_z", "gyr_x"), ()),
        (("a.w", "a.x", "a.y", "a.z", "b.w", "b.x", "b.y", "b.z"), (0, 4)),
    ],
)
def test_quaternions_are_known_by_their_channels(names: tuple[str, ...], starts: tuple[int, ...]) -> None:
    assert rotations(StreamSpec((len(names),), channels=names)) == starts


def test_a_spec_can_declare_them_or_deny_them() -> None:
    assert rotations(StreamSpec((7,), meta=with_rotations({}, 3))) == (3,)
    assert rotations(QUATERNION.derive(meta=with_rotations({}))) == ()


@pytest.mark.parametrize(
    "operator", [OneEuro(), Lowpass(cutoff_hz=5.0), MovingMean(window_s=0.1), Resample(rate_hz=50.0)]
)
def test_operators_for_plain_numbers_refuse_rotations(operator: OneEuro) -> None:
    with pytest.raises(InputError, match="qw, qx, qy, qz are a rotation"):
        operator.open({"in": QUATERNION})


@pytest.mark.parametrize("operator", [Decimate(every=2), Select(channels=("qw",))])
def test_what_picks_samples_or_channels_takes_them(operator: Decimate) -> None:
    operator.open({"in": QUATERNION})


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), cuts=st.lists(st.integers(1, 199), max_size=5), holes=st.booleans())
def test_signs_become_continuous_however_samples_are_cut(seed: int, cuts: list[int], holes: bool) -> None:
    rng = np.random.default_rng(seed)
    turn = np.cumsum(rng.normal(0, 0.05, 200))
    smooth = np.stack([np.cos(turn), np.sin(turn) * 0.6, np.sin(turn) * 0.8, 0 * turn], axis=1)
    given_ = smooth * rng.choice([-1.0, 1.0], 200)[:, None]
    if holes:
        given_[rng.integers(1, 200, 10)] = np.nan
    kept = given_.copy()
    whole = RotationSigns((0,)).of(given_)
    parts, one = [], RotationSigns((0,))
    for start, stop in zip([0, *sorted(set(cuts))], [*sorted(set(cuts)), 200], strict=True):
        parts.append(one.of(given_[start:stop]))
    assert np.array_equal(np.concatenate(parts), whole, equal_nan=True)
    good = whole[np.isfinite(whole).all(axis=1)]
    assert (np.einsum("nk,nk->n", good[1:], good[:-1]) > 0).all()
    assert np.array_equal(np.abs(whole), np.abs(kept), equal_nan=True) and np.array_equal(given_, kept, equal_nan=True)


def test_continuous_signs_are_left_as_they_are() -> None:
    data = np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))
    assert RotationSigns((0,)).of(data) is data
