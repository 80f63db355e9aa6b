"""q and -q are one rotation: signs are continuous where a stream enters, and operators for plain numbers refuse rotations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinegraph.operators import Decimate, FillGaps, Lowpass, MovingMean, OneEuro, Resample, Scale, Select
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec, grid
from kinegraph.stream.domain.rotation import RotationSigns, rotations, with_rotations
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import GraphError, InputError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from kinegraph.stream.source import Feed, Source

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
    "operator",
    [
        OneEuro(), Lowpass(cutoff_hz=5.0), MovingMean(window_s=0.1), Resample(rate_hz=50.0), FillGaps(), Scale(offset=1.0),
        Scale(gain=(1.0, 2.0, 1.0, 1.0)),
    ],
)  # fmt: skip
def test_operators_for_plain_numbers_refuse_rotations(operator: OneEuro) -> None:
    with pytest.raises(InputError, match="qw, qx, qy, qz are a rotation"):
        operator.open({"in": QUATERNION})


@pytest.mark.parametrize("operator", [FillGaps(method="hold"), Scale(gain=(1.0, -1.0, -1.0, 1.0)), Scale(gain=0.001)])
def test_rotations_may_be_held_turned_over_and_scaled_alike(operator: Scale) -> None:
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


@dataclass(frozen=True, slots=True)
class Flipping(Source):
    """A rotation that hardly turns, with a sign that changes from sample to sample."""

    def specs(self) -> Specs:
        return {"out": QUATERNION}

    def read(self, feed: Feed) -> None:
        data = np.tile([1.0, 0.0, 0.0, 0.0], (200, 1)) * np.where(np.arange(200) % 2, -1.0, 1.0)[:, None]
        time = grid(100.0, 200, feed.now() - 2 * NS)
        for start in range(0, 200, 7):
            part = time[start : start + 7]
            feed.emit(Chunk(part, data[start : start + 7], int(part[-1])))


def test_a_live_stream_enters_with_continuous_signs_and_check_refuses_to_filter_it(tmp_path: Path) -> None:
    source = f"nodes:\n  q: {{use: {__name__}.Flipping}}\n"
    assert Session(load_text(source), tmp_path / "s").run().error is None
    with Recording.open(tmp_path / "s") as recording:
        assert (recording.read("q")[1][:, 0] == 1.0).all()
    with pytest.raises(GraphError, match="are a rotation"):
        load_text(source + "  smooth: {use: operators.filters.one_euro.OneEuro, from: q}\n")
