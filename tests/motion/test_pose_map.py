"""Maps of recorded motion: the grid learns and is frozen, what is nearest is found, marker sets meet, what is bad is refused."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.page.map import picture
from kinegraph.devices.page.transfer.wire import decode
from kinegraph.operators.maps.pose_map.commands import build
from kinegraph.operators.maps.pose_map.commands.gather import GatheredPoses, PoseReading, as_points, pieces
from kinegraph.operators.maps.pose_map.commands.marker_table import read_table
from kinegraph.operators.maps.pose_map.retrieve import ANSWER, EXAMPLE, QUERY, PoseSearch, Retrieve
from kinegraph.operators.maps.pose_map.som import PoseGrid
from kinegraph.operators.maps.pose_map.warp_kernel import warp_all
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, StreamSpec, grid
from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.domain.pose_map import KIND, MISSING, MotionIndex
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import KinegraphError
from tests.support.command_line import Command, kinegraph, refused
from tests.support.horses_made import NAMES, TABLE, YAML, horse, index_of, record

__all__ = ["kinegraph"]

SPEC = StreamSpec((3,), rate_hz=50.0, channels=("a", "b", "c"), units=("cm",))


@pytest.fixture(scope="module")
def index() -> MotionIndex:
    horses = {"walk": horse("walk", 12), "trot": horse("trot", 12, seed=1), "lame": horse("trot", 12, seed=2, lame=0.5)}
    return index_of(horses)


@pytest.fixture(scope="module")
def search(index: MotionIndex) -> PoseSearch:
    return PoseSearch(index)


def ring(n: int) -> Array:
    phase = np.arange(n) * 0.11
    rng = np.random.default_rng(3)
    return np.stack([5 * np.sin(phase), 5 * np.cos(phase), np.sin(2 * phase)], 1) + 0.05 * rng.normal(size=(n, 3))


def through(operator: PoseGrid, data: Array, spec: StreamSpec = SPEC) -> dict[str, Array]:
    operator.open({"in": spec})
    return {p: c.data for p, c in operator.process("in", Chunk(grid(50.0, len(data)), data, 10**18))}  # type: ignore[union-attr]


@pytest.mark.parametrize("n", [1, 7, 20_000])
def test_a_skeleton_becomes_points_frame_by_frame(n: int) -> None:
    """However many frames there are: two bones that turn about the x axis, by sine and cosine."""
    tree = JointTree(
        ("hip", "knee", "foot"), np.array([-1, 0, 1]), np.array([[0, 0, 0], [0, -0.5, 0], [0, -0.25, 0]], float)
    )
    angle, poses = np.linspace(-1.0, 2.0, n), np.zeros((n, 15))
    poses[:, 0] = np.arange(n)
    poses[:, 3::4] = 1.0
    poses[:, 3], poses[:, 4] = np.cos(angle / 2), np.sin(angle / 2)
    spec, joints, parents = as_points("here", tree.spec(50.0), poses)
    assert (spec.shape, spec.rate_hz, spec.channels, spec.units) == ((3, 3), 50.0, tree.joints, ("m",)) and parents == [
        -1,
        0,
        1,
    ]
    for k, far in enumerate((0.0, 0.5, 0.75)):
        wanted = np.stack([np.arange(n), -far * np.cos(angle), -far * np.sin(angle)], axis=1)
        assert np.allclose(joints[:, k], wanted, atol=1e-6, rtol=1e-6), k


def test_a_long_take_is_normalised_as_its_pieces_are() -> None:
    """However many poses are normalised at once: every pose is placed and turned by itself."""
    spec = StreamSpec((len(NAMES), 3), rate_hz=60.0, channels=NAMES, units=("m",))
    data = horse("walk", 20_000 / 60.0)[:20_000]
    whole = PoseReading._normalised("here", TABLE, spec, data)
    pieces = [PoseReading._normalised("here", TABLE, spec, data[i : i + 1000]) for i in range(0, len(data), 1000)]
    assert np.array_equal(whole, np.concatenate(pieces), equal_nan=True)


@pytest.mark.parametrize("block", [7, 50, 16_384])
def test_poses_are_kept_in_steps_that_reach_the_largest(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is done at once: each number to half a step, and a gap where a number is not known."""
    monkeypatch.setattr(build, "BLOCK", block)
    rng = np.random.default_rng(5)
    parts = [rng.normal(size=(n, 6)).astype(np.float32) for n in (1, 23, 50, 40)]
    parts[2][::3, 4] = np.nan
    made, step = build.quantised([GatheredPoses(str(k), one, 0.0, 30.0, {}, ()) for k, one in enumerate(parts)])
    whole = np.concatenate(parts)
    assert made.shape == whole.shape and ((made == MISSING) == np.isnan(whole)).all()
    assert np.nanmax(np.abs(made.astype(float) * step - whole)[~np.isnan(whole)]) <= 0.5001 * step
    assert np.abs(made[made != MISSING]).max() == 32767


@pytest.mark.parametrize("block", [7, 50, 16_384])
def test_the_principal_plane_is_numpys(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "BLOCK", block)
    rng, step = np.random.default_rng(6), 0.001
    poses = np.round(rng.normal(size=(120, 9)) * [900, 500, 300, 100, 50, 20, 10, 5, 1]).astype(np.int16)
    poses[5::11, 3] = MISSING
    features = np.array([0, 1, 2, 3, 4, 5])
    whole = poses[(poses[:, :6] != MISSING).all(axis=1)][:, :6] * step
    mean, axes, spread, explained = build.principal_plane(poses, features, step)
    _, deviations, wanted = np.linalg.svd(whole - whole.mean(axis=0), full_matrices=False)
    assert np.allclose(mean, whole.mean(axis=0)) and np.allclose(np.abs((axes * wanted[:2]).sum(axis=1)), 1.0)
    assert (axes[np.arange(2), np.abs(axes).argmax(axis=1)] > 0).all()
    assert np.allclose(spread, deviations[:2] / np.sqrt(len(whole)))
    assert np.allclose(explained, deviations[:2] ** 2 / (deviations**2).sum())


@pytest.mark.parametrize(("known", "used"), [(0.49, [0]), (0.5, [0, 1]), (1.0, [0, 1])])
def test_a_marker_counts_that_half_of_every_sequence_knows(known: float, used: list[int]) -> None:
    rare = np.ones((100, 6), np.float32)
    rare[round(100 * known) :, 4] = np.nan
    gathered = [
        GatheredPoses("a", np.ones((10, 6), np.float32), 0.0, 30.0, {}, ()),
        GatheredPoses("b", rare, 0.0, 30.0, {}, ()),
    ]
    assert build.used_markers(("x", "y"), gathered).tolist() == used


def test_the_grid_learns_live_and_is_frozen_while_it_is_shown() -> None:
    operator = PoseGrid(rows=6, columns=6, learn_s=4.0)
    found = through(operator, ring(1000))
    assert np.isnan(found["place"][:200]).all() and np.isfinite(found["place"][200:]).all()
    assert found["cells"]["map"].tolist() == [1, 2, 3, 4, 5]
    assert found["cells"]["quantisation"][-1] < 1.5, "of a ring of radius 5"
    assert found["cells"]["topographic"][-1] < 0.2
    assert (found["cells"]["count"].sum(axis=1) == found["cells"]["tried"]).all()
    shown = found["cells"]["pose"]
    again = np.linalg.norm(found["place"][200:399] - found["place"][257:456], axis=1)
    assert np.median(again) < 1.0, "one round later a pose has about the same place, a new map in between"
    best = np.linalg.norm(shown[1][None] - ring(1000)[400:600, None], axis=2)
    np.testing.assert_allclose(found["error"][400:600, 0], best.min(axis=1))


def test_after_so_many_maps_nothing_changes_and_outliers_rank_high() -> None:
    data = ring(900)
    data[800] *= 3.0
    data[810, 1] = np.nan
    found = through(PoseGrid(rows=6, columns=6, learn_s=4.0, maps=2), data)
    assert found["cells"]["map"].tolist() == [1, 2]
    assert found["error"][800, 1] == 1.0
    assert np.mean(np.delete(found["error"][400:, 1], [400, 410]) > 0.95) < 0.2
    assert np.isnan(found["place"][810]).all() and np.isnan(found["error"][810]).all()


def test_a_trained_map_places_a_live_pose_as_it_did_its_own(index: MotionIndex, tmp_path: Path) -> None:
    index.write(tmp_path / "m.npz", {})
    spec = StreamSpec((21,), rate_hz=60.0, channels=tuple(f"{n}.{a}" for n in NAMES for a in "xyz"), units=("m",))
    frames = index.frames(slice(100, 300)).reshape(200, 21).astype(float)
    found = through(PoseGrid(model=tmp_path / "m.npz"), frames, spec)
    np.testing.assert_allclose(found["place"], index.som[100:300], atol=1e-4)
    assert len(found["cells"]) == 0
    np.testing.assert_array_equal(found["poses"], index.codes[None])
    with pytest.raises(KinegraphError, match=r"withers\.x"):
        PoseGrid(model=tmp_path / "m.npz").open({"in": SPEC})
    with pytest.raises(KinegraphError, match="trained on"):
        PoseGrid(model=tmp_path / "m.npz").open({"in": spec.derive(units=("deg",))})
    in_cm = through(PoseGrid(model=tmp_path / "m.npz"), 100 * frames, spec.derive(units=("cm",)))
    np.testing.assert_allclose(in_cm["place"], found["place"], atol=1e-6)
    np.testing.assert_allclose(in_cm["error"], found["error"] * [100.0, 1.0], rtol=1e-6, atol=2e-3)


def test_the_index_is_read_as_it_was_written(index: MotionIndex, tmp_path: Path) -> None:
    index.write(tmp_path / "m.npz", {})
    back = MotionIndex.read(tmp_path / "m.npz")
    assert back.sequences == index.sequences and back.markers == index.markers
    for name in ("poses", "pca", "codes", "cell", "rank"):
        np.testing.assert_array_equal(getattr(back, name), getattr(index, name))


@pytest.mark.parametrize("wrong", ["sequences", "cell", "rate_hz", "markers"])
def test_an_index_that_does_not_hang_together_is_refused(index: MotionIndex, tmp_path: Path, wrong: str) -> None:
    index.write(tmp_path / "m.npz", {})
    model = read_model(tmp_path / "m.npz", KIND)
    header, arrays = dict(model.header), dict(model.arrays)
    if wrong == "cell":
        arrays["cell"] = arrays["cell"] + 99
    else:
        header[wrong] = {"sequences": [], "rate_hz": -1.0, "markers": ["a"] * 7}[wrong]
    for key in ("kinegraph", "version", "kind", "made"):
        header.pop(key)
    write_model(tmp_path / "bad.npz", KIND, header, arrays)
    with pytest.raises(ModelError, match=r"bad\.npz: .*; train it again"):
        MotionIndex.read(tmp_path / "bad.npz")


def test_the_grid_separates_gaits_and_the_lame_trot(index: MotionIndex) -> None:
    def apart(a: Array, b: Array) -> float:
        return float(np.abs(np.bincount(a, minlength=36) / len(a) - np.bincount(b, minlength=36) / len(b)).sum() / 2)

    walk, trot, lame = (index.cell[s.first : s.last] for s in index.sequences)
    same = apart(trot[:360], trot[360:])
    assert apart(trot, lame) > 2 * same and apart(walk, trot) > 2 * same, "they lie in other cells"
    assert index.topographic < 0.3 and 0.0 < index.quantisation < 0.2
    assert index.explained.sum() > 0.8


def ask(search: PoseSearch, first: int, last: int, count: int, band_s: float = 0.5, markers: int = 0) -> Array:
    query = np.array([(7, first, last, count, band_s, markers)], QUERY)[0]
    found = search.answer(query)
    assert (found["query"] == 7).all() and found["place"][-1] == -1
    return np.asarray(found[:-1])


@pytest.mark.parametrize("markers", [0, 0b11000])
def test_the_nearest_poses_are_those_of_a_plain_search(index: MotionIndex, search: PoseSearch, markers: int) -> None:
    frames = index.frames(slice(None)).astype(float)
    chosen = [m for m in range(7) if not markers or markers >> m & 1]
    for frame in (5, 800, 1500):
        found = ask(search, frame, frame, 12, markers=markers)
        apart = np.sqrt(((frames[:, chosen] - frames[frame, chosen]) ** 2).sum(axis=2).mean(axis=1))
        near = np.abs(np.arange(len(frames)) - frame) <= 30
        apart[near & (np.arange(len(frames)) // 720 == frame // 720)] = np.inf
        np.testing.assert_allclose(found["distance"], np.sort(apart)[:12], rtol=1e-4)
        assert set(found["first"]) == set(np.argsort(apart)[:12].tolist())
        assert (found["sequence"] == found["first"] // 720).all()


def test_stretches_are_found_at_another_pace_and_not_in_the_band(index: MotionIndex, search: PoseSearch) -> None:
    found = ask(search, 750, 793, 8)
    assert len(found) == 8 and (np.diff(found["distance"]) >= 0).all()
    assert (found["sequence"] == 1).sum() >= 6, "a trot looks like itself"
    mine = found[found["sequence"] == 1]
    assert ((mine["last"] < 720 + 1) | (mine["first"] > 793 + 29) | (mine["last"] <= 750)).all()
    period = 60.0 / 1.4
    off = (mine["first"] - 750) / period
    assert np.abs(off - np.round(off)).max() < 0.15, "whole strides away"
    lengths = found["last"] - found["first"] + 1
    assert (lengths >= 22).all() and (lengths <= 88).all()
    spans = sorted(zip(found["first"].tolist(), found["last"].tolist(), strict=True))
    assert all(a[1] < b[0] for a, b in pairwise(spans))


def plainly_warped(query: Samples, there: Samples, weights: Samples) -> tuple[int, int, float]:
    """First and last row of `there` where `query` is found, and the distance, cell by cell."""
    apart = (weights * (query[:, None] - there) ** 2).sum(axis=2)
    apart[np.isnan(apart)] = np.inf
    cost = [[(float(a), j) for j, a in enumerate(apart[0])]]
    for i in range(1, len(query)):
        row = []
        for j in range(len(there)):
            ways = [(cost[i - 1][j - k][0], cost[i - 1][j - k][1]) for k in (1, 2) if j >= k]
            if i >= 2 and j >= 1:
                ways.append((cost[i - 2][j - 1][0] + float(apart[i, j]), cost[i - 2][j - 1][1]))
            best = min(ways, default=(np.inf, -1), key=lambda way: way[0])
            row.append((best[0] + float(apart[i, j]), best[1]))
        cost.append(row)
    last = int(np.argmin([c for c, _ in cost[-1]]))
    return cost[-1][last][1], last, float(np.sqrt(cost[-1][last][0] / len(query)))


@pytest.mark.parametrize("step", [1, 3])
def test_stretches_are_warped_as_a_plain_search_does(step: int) -> None:
    rng = np.random.default_rng(6)
    poses = (300 * rng.normal(size=(260, 8)).cumsum(axis=0)).astype(np.int16)
    poses[40, 3] = poses[120:122] = MISSING
    columns, weights = np.array([0, 2, 3, 4, 7]), rng.uniform(size=5)
    rows = np.where(poses[:, columns] == MISSING, np.nan, poses[:, columns] * 0.01)
    begins, ends = np.array([0, 30, 100, 132, 200]), np.array([60, 91, 160, 200, 230])
    query, room, out = np.ascontiguousarray(rows[150:180:step]), 80, np.empty((5, 3))
    warp_all(
        poses, columns, 0.01, step, begins, ends, query, weights, np.empty((5, room)), np.empty((4, room)),
        np.empty((3, room), np.int64), out,
    )  # fmt: skip
    for begin, end, found in zip(begins, ends, out, strict=True):
        np.testing.assert_allclose(found, plainly_warped(query, rows[begin:end:step], weights), rtol=1e-12)
    assert out[3, 2] == 0.0, "the query itself is in that region"


@pytest.mark.parametrize("first, last, count", [(-1, 3, 2), (5, 4, 2), (700, 730, 2), (0, 10**9, 2), (3, 3, 0)])
def test_a_query_of_nothing_has_no_answer(search: PoseSearch, first: int, last: int, count: int) -> None:
    assert len(ask(search, first, last, count)) == 0


def test_retrieval_is_an_operator() -> None:
    operator = Retrieve(EXAMPLE)
    out = operator.open({"in": StreamSpec((), QUERY)})["out"]
    assert out.dtype == ANSWER and out.units[-1] == "m"
    with pytest.raises(KinegraphError, match="queries"):
        operator.open({"in": SPEC})


def test_runs_are_even_and_do_not_reach_across_gaps() -> None:
    time = np.r_[np.arange(0, 1000, 33), np.arange(2000, 3000, 33)] * 1_000_000
    data = (time / NS)[:, None].astype(np.float32)
    found = list(pieces(time, data, 60.0))
    assert [begin for begin, _ in found] == [0, 2000 * 1_000_000] and [len(run) for _, run in found] == [60, 60]
    for begin, run in found:
        np.testing.assert_allclose(run[:, 0], begin / NS + np.arange(len(run)) / 60.0, atol=1e-5)


def test_marker_sets_meet_and_what_is_missing_is_said(kinegraph: Command, tmp_path: Path) -> None:
    data = horse("walk", 4)
    record(tmp_path / "a.mcap", data, gait="walk")
    other = np.concatenate([data * 1000, data[:, 1:2] * 1000 + [5, 0, 0], data[:, 1:2] * 1000 - [5, 0, 0]], 1)[
        :, [0, 7, 8, 3, 4, 5, 6]
    ]
    record(
        tmp_path / "b.mcap", other[::2], 30.0, ("T6", "S1", "S2", *NAMES[3:]), "mm", gait="<script>alert(1)</script>"
    )
    (tmp_path / "m.yaml").write_text(YAML)
    code, out, _ = kinegraph(
        "motion", "train", "map", "a.mcap", "b.mcap", "--markers", "m.yaml", "-o", "x.npz", "--rows", "4"
    )
    assert code == 0
    assert "b: lacks poll" in out and "not all sequences have them: poll" in out and "4 x 12 cells" in out
    made = MotionIndex.read(tmp_path / "x.npz")
    a, b = made.sequences
    assert b.missing == ("poll",) and b.rate_hz == 30.0 and b.facts == {"gait": "<script>alert(1)</script>"}
    first, second = made.frames(slice(a.first, a.last)), made.frames(slice(b.first, b.last))
    assert np.isnan(second[:, 2]).all()
    apart = np.delete(first[: len(second)] - second, 2, axis=1)
    assert np.abs(apart).max() < 0.03, "half the rate, another unit, other names: the same poses"
    refused(kinegraph("motion", "train", "map", "a.mcap", "--markers", "m.yaml", "-o", "x.npz"), "exists")


BAD = {
    "origin: poll\nahead: sacrum\nmarkers: {withers: , sacrum: }": "origin is 'poll'",
    "origin: withers\nahead: withers\nmarkers: {withers: }": "another marker",
    "origin: withers\nahead: sacrum\nup: north\nmarkers: {withers: , sacrum: }": "up is 'north'",
    "origin: withers\nahead: sacrum\nmarkers: {withers: , sacrum: []}": "markers.sacrum",
    "origin: withers\nahead: sacrum\nmarkers: {withers: , sacrum: }\nbones: [[withers, nose]]": "not a pair",
    "origin: withers\nahaed: sacrum\nmarkers: {withers: }": "'ahaed' is not known",
    "markers: 5": "must hold `markers:`",
}


@pytest.mark.parametrize("text", list(BAD))
def test_a_bad_table_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(KinegraphError, match=r"m\.yaml: .*") as error:
        read_table(tmp_path / "m.yaml")
    assert BAD[text] in str(error.value)


def test_recordings_that_cannot_be_mapped_are_refused(kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(YAML)
    record(tmp_path / "still.mcap", np.repeat(horse("walk", 1)[:1], 100, axis=0))
    record(tmp_path / "one.mcap", horse("walk", 1)[:1])
    record(tmp_path / "other.mcap", horse("walk", 1)[:, :3], names=("a", "b", "c"))
    record(tmp_path / "volts.mcap", horse("walk", 1), unit="V")
    for name, why in {
        "still": "are the same", "one": "two poses or more", "other": "no 'withers'", "volts": "its unit is 'V'",
    }.items():  # fmt: skip
        refused(kinegraph("motion", "train", "map", f"{name}.mcap", "--markers", "m.yaml", "-o", "x.npz"), why)
        assert not (tmp_path / "x.npz").exists()
    refused(kinegraph("motion", "train", "map", "other.mcap", "-o", "x.npz"), "--origin is needed")


def test_of_many_poses_some_are_drawn_and_the_rest_is_density(
    index: MotionIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture, "MAX_DRAWN", 500)
    header, numbers = decode(picture.points(index))
    n, bins = header["n"], header["bins"]
    assert 400 <= n <= 500 < len(index.poses)
    frames = np.frombuffer(numbers, "<i4", n)
    assert (np.diff(frames) == np.diff(frames)[0]).all()
    density = np.frombuffer(numbers, "<f4", bins * bins, offset=n * 20)
    assert density.sum() == (index.cell >= 0).sum(), "all poses count"
