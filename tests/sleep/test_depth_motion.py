"""N(t), D(p) and the night's map, against plain loops over the frames; what is no movement; what was not seen."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.bed.activity import EPOCH_SEEN
from kinegraph.operators.bed.bed import BedRegion
from kinegraph.operators.bed.frames.simplify import SCENE
from kinegraph.operators.bed.motion import LONGEST_EPOCH, Motion, map_of
from kinegraph.operators.bed.night_map import NightMap
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import grid
from tests.sleep.depth_frames import META, blocks_spec, frames_spec, play, regions

SPEC = frames_spec(24, 32, 10.0)


def noisy(count: int, seed: int = 0) -> Array:
    random = np.random.default_rng(seed)
    frames = random.integers(1, 65536, (count, 24, 32))
    frames[random.random(frames.shape) < 0.2] = 0
    return frames.astype(np.uint16)


def naive(frames: Array) -> tuple[Array, Array]:
    """|p(t) - p(t + 1)| of pixels that are valid in both frames, and which those are: (n - 1, h, w)."""
    valid = (frames[1:] > 0) & (frames[:-1] > 0)
    return np.where(valid, np.abs(np.diff(frames.astype(np.int64), axis=0)), 0), valid


def test_n_and_d_are_those_of_the_thesis_on_valid_pixels() -> None:
    frames, time = noisy(90), grid(10.0, 90, 100 * NS)
    both = {"left": (0, 0, 24, 13), "right": (3, 9, 16, 23)}
    made = play(Motion(epoch_s=2.0, step_s=0.0), frames=(SPEC, time, frames), regions=regions(int(time[0]), **both))
    moved, valid = naive(frames)
    for k, (row, column, rows, columns) in enumerate(both.values()):
        part = np.s_[:, row : row + rows, column : column + columns]
        expected = moved[part].sum(axis=(1, 2)) / valid[part].sum(axis=(1, 2))
        assert np.isnan(made["out"][0, k]) and np.array_equal(made["out"][1:, k], expected)
    maps = made["map"]
    assert (maps["onset"] // NS).tolist() == [100, 102, 104, 106, 108] and maps["frames"].tolist() == [
        19,
        20,
        20,
        20,
        10,
    ]
    with np.errstate(invalid="ignore"):
        pixels = moved[19:39].sum(axis=0) / valid[19:39].sum(axis=0)
    expected = pixels.reshape(3, 8, 4, 8).mean(axis=(1, 3))
    assert np.allclose(maps["map"][1], expected, rtol=1e-6)


def test_frames_half_a_second_apart_are_compared_at_any_rate() -> None:
    """At 30 fps the same as at 2; a few frames that are missing move a look, and many cost looks."""
    frames, spec = noisy(300), frames_spec(24, 32, 30.0)
    moved, valid = naive(frames[::15])
    with np.errstate(invalid="ignore"):
        expected = moved.sum(axis=(1, 2)) / valid.sum(axis=(1, 2))
    time = grid(30.0, 300, 100 * NS)
    operator = Motion(epoch_s=2.0)
    assert operator.open({"frames": spec})["out"].rate_hz == 2.0
    made = play(operator, frames=(spec, time, frames))
    assert np.array_equal(made["out"][1:, 0], expected) and made["map"]["frames"].tolist() == [3, 4, 4, 4, 4]
    there = np.ones(300, np.bool_)
    there[[45, 100]] = there[180:230] = False
    gaps = play(operator, frames=(spec, time[there], frames[there]))["out"][:, 0]
    assert np.array_equal(gaps[1:3], expected[:2]) and np.isnan(gaps).sum() == 2, "the first, and the one after 1.7 s"
    assert len(gaps) == 17


def lost_looks(looks: list[int], step_ns: int, gone_before: int, *, every: int) -> int:
    """How many looks are lost between two: those that were due more than half a step before the second; by counting."""
    if every == 1:
        return gone_before
    due, count = looks[0] + step_ns, 0
    while due + step_ns // 2 < looks[1]:
        due, count = due + step_ns, count + 1
    late = looks[1] - looks[0] - step_ns > step_ns // (2 * every)
    return count or -int(late)


@pytest.mark.parametrize("step_s", [0.0, 0.5])
@pytest.mark.parametrize("gone", [1, 2, 3, 6, 12, 23])
@pytest.mark.parametrize("known", [True, False])
def test_after_a_gap_the_looks_that_are_lost_are_told(step_s: float, gone: int, known: bool) -> None:
    operator = Motion(step_s=step_s, longest_gap_s=0.1)
    operator.open({"frames": SPEC})
    there = np.r_[0:13, 13 + gone : 60]
    frames, time, gone_before = noisy(60)[there], grid(10.0, 60)[there], gone if known else -1
    made = []
    for part, lost in ((slice(0, 13), 0), (slice(13, None), gone_before)):
        emitted = operator.process("frames", Chunk(time[part], frames[part], int(time[part][-1]), lost))
        made.append(next(chunk for port, chunk in emitted if port == "out"))
    looks = [int(made[0].time[-1]), int(made[1].time[0])]
    every = 5 if step_s else 1
    assert made[0].lost == 0 and made[1].lost == lost_looks(looks, every * NS // 10, gone_before, every=every)


def test_flickering_pixels_are_no_movement() -> None:
    random = np.random.default_rng(1)
    frames = np.full((50, 24, 32), 2000) + random.integers(0, 2, (50, 24, 32))
    frames[random.random(frames.shape) < 0.1] = 0
    frames = frames.astype(np.uint16)
    made = play(Motion(step_s=0.0), frames=(SPEC, grid(10.0, 50), frames))["out"][1:, 0]
    unmasked = np.abs(np.diff(frames.astype(int), axis=0)).mean(axis=(1, 2))
    assert made.max() < 0.6 and unmasked.min() > 250


def test_no_number_stands_where_nothing_was_seen() -> None:
    frames, time = noisy(60), grid(10.0, 60)
    frames[10:15] = frames[9]  # frozen
    frames[20:22] = 0  # blind
    frames[30][:, 5:] = 0  # mostly blind
    time[40:] += 5 * NS
    made = play(Motion(epoch_s=1.0, step_s=0.0), frames=(SPEC, time, frames))
    unseen = np.flatnonzero(np.isnan(made["out"][:, 0])).tolist()
    assert unseen == [0, *range(10, 15), 20, 21, 22, 30, 31, 40]
    frozen = play(
        Motion(epoch_s=1.0, step_s=0.0), frames=(SPEC, grid(10.0, 40, 100 * NS), frames[9:10].repeat(40, axis=0))
    )["map"]
    assert len(frozen) == 4 and not frozen["frames"].any() and np.isnan(frozen["map"]).all()


def test_another_basis_is_no_movement() -> None:
    frames, time = noisy(30), grid(10.0, 30)
    scene = np.array([(time[12], "learned", 1.0)], SCENE)
    made = play(
        Motion(step_s=0.0), frames=(SPEC, time, frames), scene=(StreamSpec((), SCENE), scene["onset"].copy(), scene)
    )
    assert np.flatnonzero(np.isnan(made["out"][:, 0])).tolist() == [0, 12]


def test_the_greatest_changes_for_the_longest_epoch_do_not_overflow() -> None:
    rate = 2000.0
    spec = frames_spec(8, 8, rate)
    frames = np.where(np.arange(2000)[:, None, None] % 2, 65535, 1).astype(np.uint16) * np.ones((1, 8, 8), np.uint16)
    operator = Motion(epoch_s=LONGEST_EPOCH / rate, step_s=0.0, longest_gap_s=40.0)
    operator.open({"frames": spec})
    maps = []
    for k in range(30):
        time = grid(rate, 2000, k * NS)
        emitted = operator.process("frames", Chunk(time, frames, int(time[-1])))
        maps += [chunk.data for port, chunk in emitted if port == "map"]
    maps.append(operator.close()[0][1].data)
    made = np.concatenate(maps)
    assert made["frames"].tolist() == [59_999] and made["map"].tolist() == [[[65534.0]]]
    with pytest.raises(ParameterError, match="at most 30"):
        Motion(epoch_s=31.0, step_s=0.0).open({"frames": spec})


def test_raw_frames_are_taken_only_if_that_is_said() -> None:
    raw = frames_spec(24, 32, simplified=False)
    with pytest.raises(InputError, match=r"not simplified.*raw: true"):
        Motion().open({"frames": raw})
    assert Motion(raw=True).open({"frames": raw})["map"].dtype["map"].shape == (24, 32)
    with pytest.raises(InputError, match="depth frames"):
        Motion().open({"frames": blocks_spec(3, 4)})


def test_the_night_map_is_the_mean_over_its_frames_and_begins_again() -> None:
    frames, time = noisy(90), grid(10.0, 90, 100 * NS)
    maps = play(Motion(epoch_s=2.0, step_s=0.0), frames=(SPEC, time, frames))["map"]
    spec = Motion(epoch_s=2.0, step_s=0.0).open({"frames": SPEC})["map"]
    ends = np.array([(105 * NS,), (111 * NS,)], [("onset", "<i8")])
    nights = (StreamSpec((), ends.dtype, units=("ns",)), ends["onset"].copy(), ends)
    made = play(NightMap(), map=(spec, maps["end"] - 1, maps), nights=nights)["out"]
    assert made["onset"].tolist() == [100 * NS, 104 * NS] and made["end"].tolist() == [104 * NS, 110 * NS]
    weights = maps["frames"][2:].astype(float)
    expected = (maps["map"][2:] * weights[:, None, None]).sum(axis=0) / weights.sum()
    assert np.allclose(made["map"][1], expected, rtol=1e-6) and made["frames"].tolist() == [39, 50]


def epochs_of_a_bed(count: int = 400) -> tuple[Array, Array]:
    """Maps in which the bed's edge (column 2) trembles all night and a body moves in every fourth epoch, and what `seen` says."""
    random = np.random.default_rng(3)
    noise = np.full((6, 8), 0.6)
    noise[:, 2] = 15.0
    maps, epochs = np.zeros(count, map_of((6, 8))), np.zeros(count, EPOCH_SEEN)
    maps["end"] = epochs["end"] = grid(1 / 30, count, 900 * NS) + 30 * NS
    maps["onset"] = maps["end"] - 30 * NS
    maps["frames"] = 60
    maps["map"] = noise * random.normal(1, 0.05, (count, 6, 8))
    maps["map"][::4, 2:4, 4:6] += 0.8
    epochs["moved_s"][::4] = 5.0
    return maps, epochs


def night_map(maps: Array, epochs: Array | None = None, epoch_s: float = 30.0) -> Array:
    """The one map of a night that ends with the last epoch."""
    end = np.array([(int(maps["end"][-1]),)], [("onset", "<i8")])
    inputs = {
        "map": (StreamSpec((), maps.dtype, meta={"epoch_s": 30.0}), maps["end"] - 1, maps),
        "nights": (StreamSpec((), end.dtype), end["onset"].copy(), end),
    }
    if epochs is not None:
        inputs["seen"] = (StreamSpec((), EPOCH_SEEN, meta={"epoch_s": epoch_s}), epochs["end"] - 1, epochs)
    made: Array = play(NightMap(), **inputs)["out"]["map"][0]
    return made


def test_the_noise_of_still_epochs_is_taken_off_the_nights_map() -> None:
    maps, epochs = epochs_of_a_bed()
    assert (night_map(maps)[:, 2] > 14).all(), "or else the edge outshines the sleeper"
    made = night_map(maps, epochs)
    body = np.zeros((6, 8), np.bool_)
    body[2:4, 4:6] = True
    assert np.allclose(made[body], 0.2, atol=0.02) and np.abs(made[~body]).max() < 0.1
    assert np.abs(made[~body & (np.arange(8) != 2)]).max() < 0.01


def test_where_no_epoch_was_still_nothing_is_known_of_the_noise() -> None:
    maps, epochs = epochs_of_a_bed(40)
    epochs["moved_s"] = np.where(np.arange(40) % 2, 0.5, np.nan)
    assert np.isnan(night_map(maps, epochs)).all()
    with pytest.raises(InputError, match=r"epochs of 60.*epoch_s 30"):
        night_map(maps, epochs, epoch_s=60.0)


# the bed -------------------------------------------------------------------------------------------------------------


def room(bed: tuple[slice, slice]) -> Array:
    random = np.random.default_rng(2)
    depth = np.full((20, 30), 2600.0)
    depth[bed] = 2050.0
    depth[8:12, 14:17] -= 200.0
    frames = depth + random.normal(0, 1.0, (30, 20, 30))
    frames[random.random(frames.shape) < 0.05] = np.nan
    return frames


@pytest.mark.parametrize(
    ("bed", "expected"),
    [
        (np.s_[2:18, 8:22], [(16, 64, 128, 56), (16, 120, 128, 56)]),
        (np.s_[4:14, 3:28], [(32, 32, 40, 184), (72, 32, 40, 184)]),
        (np.s_[3:17, 6:24], [(24, 48, 112, 72), (24, 120, 112, 72)]),
    ],
)
def test_the_bed_is_found_and_shared_by_who_lies_side_by_side(
    bed: tuple[slice, slice], expected: list[tuple[int, ...]]
) -> None:
    made = play(BedRegion(("a", "b"), learn_s=4.0), **{"in": (blocks_spec(20, 30), grid(5.0, 30), room(bed))})["out"]
    assert [tuple(event)[2:6] for event in made] == expected and made["found"].all()
    assert made["sleeper"].tolist() == ["a", "b"]


@pytest.mark.parametrize("seen", [1.0, np.nan])
def test_where_there_is_no_bed_a_region_without_rows_is_reported_after_four_attempts(seen: float) -> None:
    nothing = seen * room(np.s_[0:0, 0:0])
    made = play(BedRegion(learn_s=1.0), **{"in": (blocks_spec(20, 30), grid(5.0, 30), nothing)})["out"]
    assert made[["rows", "columns", "found"]].tolist() == [(0, 0, True)]
    assert made["onset"][0] < grid(5.0, 30)[-1]


def test_a_region_that_is_set_lies_in_the_frame() -> None:
    spec = blocks_spec(20, 30)
    with pytest.raises(ParameterError, match="within 160 rows and 240 columns"):
        BedRegion(regions=((0, 200, 10, 41),)).open({"in": spec})
    with pytest.raises(ParameterError, match="one for each of a, b"):
        BedRegion(("a", "b"), ((0, 0, 8, 8),)).open({"in": spec})
    with pytest.raises(ParameterError, match="different names"):
        BedRegion(("a", "a")).open({"in": spec})
    made = play(BedRegion(regions=((0, 200, 10, 40),)), **{"in": (spec, grid(5.0, 30), room(np.s_[0:0, 0:0]))})["out"]
    assert [tuple(event)[2:] for event in made] == [(0, 200, 10, 40, False)]
    assert BedRegion().open({"in": spec})["out"].meta["simplified"] == META["simplified"]
