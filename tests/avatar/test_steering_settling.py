"""Parts that come to fit one another as in the thesis: greedy alignment (9.4.1), shapes (9.14), shared clusters (9.16)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.people.quadruped import marked, topology, walking
from kinegraph.operators.steering.model.adapt import adapt
from kinegraph.operators.steering.model.choose import choose
from kinegraph.operators.steering.model.fit import Layout, PoseRegression, Steering, fit_steering
from kinegraph.operators.steering.model.limb_paths import blended, limb_paths, shared_weights
from kinegraph.operators.steering.model.parts import edges_of
from kinegraph.operators.steering.model.settling import ROUNDS, STIFF, Settling, SoftShapes
from kinegraph.operators.steering.model.stored import KIND, from_model, to_arrays
from kinegraph.operators.steering.model.turns import matrix, rigid
from kinegraph.stream.chunk import Samples
from kinegraph.stream.cli import main as cli
from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.operator import grid
from kinegraph.stream.recording.series import Series, write_recording
from tests.quadruped_model import LIMBS
from tests.support.command_line import succeeding
from tests.support.steered_mesh import steered

NAMES, AT = tuple(marked()), np.array(list(marked().values()))
FACES = topology().faces
STRIDE = np.array([walking(k / 24) for k in range(24)])
REFERENCE = ("withers", "croup")
DIAGONAL = float(np.linalg.norm(np.ptp(STRIDE[0], axis=0)))


@cache
def layout() -> Layout:
    return Layout.of(STRIDE, FACES, AT, 8)


SOFT = SoftShapes(0.01, 3.0)


def trained(how: PoseRegression, limbs: tuple[str, ...] = LIMBS, frames: Samples = STRIDE) -> Steering:
    return fit_steering(frames, FACES, marked(), REFERENCE, limbs, 8, 3, layout=layout(), how=how)


BAR = np.array([(31 * r + c, 31 * r + c + 1, 31 * r + c + 31) for r in range(2) for c in range(30)])


def bent(left: float, right: float) -> Samples:
    """A bar of 31 by 3 vertices whose ends are bent upwards, each by itself."""
    x, y = np.meshgrid(np.arange(31.0) - 15.0, np.arange(3.0))
    up = np.where(x < 0, left, right) * np.maximum(np.abs(x) - 4.0, 0.0) ** 2
    return np.stack([x.ravel(), y.ravel(), up.ravel()], axis=1)


def points(moves: Samples, shape: Samples) -> Samples:
    return np.asarray(moves[:, 0] + np.einsum("k,nki->ni", shape, moves[:, 1:]))


def plain(held: Settling, y: Samples, marks: Samples) -> Samples:
    """9.4.1 and 9.14 as they are written, part after part."""
    y, predicted = y.copy(), y[:, 9:].copy()

    def there(row: int) -> Samples:
        if held.others[row] < 0:
            return np.asarray(marks[-1 - held.others[row]])
        other = y[held.others[row]]
        return np.asarray(matrix(other[:6]) @ points(held.theirs[row][None], other[9:])[0] + other[6:9])

    def align() -> None:
        for a in range(1, len(y) if held.greedy else 0):
            rows = [r for r in range(held.begins[a], held.begins[a + 1]) if 0 <= held.others[r] < a]
            if rows:
                mine, wanted = points(held.own[rows], y[a, 9:]), np.array([there(r) for r in rows])
                turn = rigid(mine, wanted)[0] if held.turns[a] else matrix(y[a, :6])
                y[a, :9] = *turn[:, 0], *turn[:, 1], *(wanted.mean(axis=0) - turn @ mine.mean(axis=0))

    for _ in range(ROUNDS if held.shapes else 0):
        align()
        for a in range(len(y)):
            rows, turn = list(range(held.begins[a], held.begins[a + 1])), matrix(y[a, :6])
            has = np.flatnonzero(held.spread[a] > (STIFF * DIAGONAL) ** 2)
            if not rows:
                continue
            stays = np.where(np.isin(np.arange(y.shape[1] - 9), has), 0.0, predicted[a])
            wanted = np.array([turn.T @ (there(r) - y[a, 6:9]) for r in rows]) - points(held.own[rows], stays)
            root = np.sqrt(held.weights[rows])[:, None]
            left = (root[..., None] * held.own[rows][:, 1 + has]).transpose(0, 2, 1).reshape(-1, len(has))
            prior = held.shapes.beta * DIAGONAL / np.sqrt(held.spread[a, has])  # type: ignore[union-attr]
            both = np.concatenate([left, np.diag(prior)])
            y[a, 9 + has] = np.linalg.lstsq(
                both, np.concatenate([(root * wanted).ravel(), prior * predicted[a, has]]), rcond=None
            )[0]
    align()
    return y


@pytest.mark.parametrize(
    "how",
    [
        PoseRegression(greedy=True),
        PoseRegression(shapes=SOFT),
        PoseRegression(greedy=True, shapes=SOFT),
    ],
)
def test_places_and_shapes_are_those_of_the_equations(how: PoseRegression) -> None:
    held = trained(how).settling
    assert held and (held.turns.any() and not held.turns.all())
    rng, k = np.random.default_rng(6), held.spread.shape[1]
    points_of = trained(how)
    x = points_of.features(STRIDE[:4, AT])[0]
    for row in x:
        ys = [part.learned(row[None, part.features])[0] for part in points_of.parts]
        together = np.zeros((len(ys), 9 + k))
        for a, one in enumerate(ys):
            together[a, : len(one)] = one + 0.003 * rng.normal(size=len(one))
        marks = row.reshape(-1, 3)
        made = held([y[: 9 + k] for y in together], marks, 1.0)
        wanted = plain(held, together, marks)
        for a, one in enumerate(made):
            assert np.allclose(one[6:], wanted[a, 6:], atol=1e-9), a
            assert np.allclose(matrix(one[:6]), matrix(wanted[a, :6]), atol=1e-9), a


@pytest.mark.parametrize("greedy", [False, True])
@pytest.mark.parametrize("shapes", [None, SOFT])
@pytest.mark.parametrize("limbs", [(), LIMBS])
def test_the_operator_gives_what_the_model_gives(
    greedy: bool, shapes: SoftShapes | None, limbs: tuple[str, ...], tmp_path: Path
) -> None:
    model = trained(PoseRegression(greedy=greedy, shapes=shapes), limbs)
    write_model(tmp_path / "m.npz", KIND, *to_arrays(model, topology(), limbs))
    marks = STRIDE[::2, AT] * 1.02 + [0.3, 0.0, 0.1]
    assert np.allclose(steered(tmp_path / "m.npz", marks), model(marks, 432), atol=1e-9)
    assert np.linalg.norm(model(STRIDE[:, AT], 432) - STRIDE, axis=-1).mean() / DIAGONAL < 0.03
    far = model(STRIDE[:2, AT] * 30.0, 432)
    assert np.isfinite(far).all() and np.ptp(far[1], axis=0).max() < 3.0 * np.ptp(STRIDE[0], axis=0).max()


def test_a_border_that_is_torn_is_closed_by_the_alignment() -> None:
    """A part whose place was predicted wrongly lies where its border does."""
    model = trained(PoseRegression(greedy=True), ())
    x = model.features(STRIDE[:1, AT])[0][0]
    ys = [part.learned(x[None])[0] for part in model.parts]
    torn = [y + (k == len(ys) - 1) * np.repeat([0.0, 1.0, 0.0], [6, 3, len(y) - 9]) for k, y in enumerate(ys)]
    assert model.settling
    together, apart = (model.settling(one, x.reshape(-1, 3), 1.0) for one in (ys, torn))
    assert all(np.allclose(a, b) for a, b in zip(together, apart, strict=True))


def test_markers_draw_shapes() -> None:
    """The more a marker counts, the nearer its vertex comes to it."""
    off = []
    for counts in (0.0, 1.0, 100.0):
        model = trained(PoseRegression(shapes=SoftShapes(0.01, counts)), (), STRIDE[::3])
        off.append(np.linalg.norm(model(STRIDE[1::3, AT], 432)[:, AT] - STRIDE[1::3, AT], axis=-1).mean())
    assert off[2] < off[1] < off[0]


def test_how_shapes_are_moved_is_chosen_in_frames_left_out(tmp_path: Path) -> None:
    how = PoseRegression(shapes=SoftShapes())
    model, way, off, pull = choose(STRIDE[::2], FACES, marked(), REFERENCE, (), 8, 3, how=how)
    assert way == "parts" and list(off) == ["parts"] and pull is None and not len(model.soft)
    assert model.settling and model.settling.shapes and model.settling.shapes != SoftShapes()
    usual = choose(STRIDE[::2], FACES, marked(), REFERENCE, (), 8, 3, method="parts")[0]
    errors = [
        np.linalg.norm(one(STRIDE[1::2, AT], 432) - STRIDE[1::2], axis=-1).mean()
        for one in (model, replace(usual, soft=np.zeros((0, 0))))
    ]
    assert errors[0] < errors[1]


def test_blending_is_that_of_9_16() -> None:
    d = np.array([[0.0, 1.0, 3.0, 2.0], [4.0, 1.0, 1.0, 0.0]])
    assert np.allclose(blended(d), (d.sum(axis=0) - d) / d.sum(axis=0))
    three = np.random.default_rng(1).uniform(0.1, 1.0, (3, 9))
    three[:, :3] += 1.0
    three[[0, 1, 2], [0, 1, 2]] = 0.0
    weights = blended(three)
    assert np.allclose(weights.sum(axis=0), 1.0) and np.allclose(weights[:, :3], np.eye(3), atol=1e-6)
    printed = (three.sum(axis=0) - three) / three.sum(axis=0)
    assert np.allclose(printed.sum(axis=0), 2.0)  # of three limbs, what the thesis prints is no partition of unity


def test_a_cluster_that_two_limbs_share_follows_each_at_its_border() -> None:
    """A bar: a limb to the left and one to the right, and the body's marker in the middle one of three clusters."""
    x, y = np.meshgrid(np.arange(31), np.arange(3))
    rest = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype(float)
    part = np.digitize(rest[:, 0], [10.0, 20.0])
    ends = [0, 30]
    paths = limb_paths(part, edges_of(BAR), rest, ends, [15])
    assert paths == [[0, 1], [2, 1]]
    left, right = shared_weights(part, 1, edges_of(BAR), rest, paths, ends)
    row = slice(10, 20)
    assert np.allclose(left[row], 1.0 - np.arange(10) / 9.0, atol=1e-6) and np.allclose(left + right, 1.0)


@pytest.mark.parametrize("how", [PoseRegression(shared=True), PoseRegression(greedy=True, shapes=SOFT, shared=True)])
def test_a_bar_whose_middle_two_limbs_share(how: PoseRegression, tmp_path: Path) -> None:
    frames = np.array([bent(0.02 * np.sin(k), 0.02 * np.cos(1.7 * k)) for k in range(16)])
    markers = {"left": 0, "right": 30, "mid": 15, "middle": 46}
    layout = Layout.of(frames, BAR, np.array(list(markers.values())), 3)
    part = np.digitize(frames[0, :, 0], [-5.0, 5.0])
    layout = replace(layout, part=part, parts=np.stack([part, part], axis=1), weights=np.tile([1.0, 0.0], (93, 1)))
    model = fit_steering(frames, BAR, markers, ("mid", "middle"), ("left", "right"), 3, 3, layout=layout, how=how)
    alone = [model.alone(part) for part in model.parts]
    assert sorted(map(str, alone)) == ["left", "left", "right", "right"]
    shares = np.zeros(93)
    for one in model.parts:
        shares[one.vertices] += one.weights
    assert np.allclose(shares, 1.0)
    mesh = Topology(93, BAR.astype(np.int32), "bar")
    write_model(tmp_path / "m.npz", KIND, *to_arrays(model, mesh, ("left", "right")))
    marks = np.array([bent(0.01, 0.015), bent(-0.02, 0.0)])[:, list(markers.values())]
    made = steered(tmp_path / "m.npz", marks, tuple(markers))
    assert np.allclose(made, model(marks, 93), atol=1e-9)
    moved = bent(0.0, 0.02)[None, list(markers.values())], bent(0.0, -0.02)[None, list(markers.values())]
    still, goes = (np.linalg.norm(model(moved[0], 93) - model(moved[1], 93), axis=-1)[0, at] for at in (0, 30))
    assert goes > 1.0 and still < 0.05 * goes


def test_a_performer_is_not_drawn_to_by_his_markers() -> None:
    model = trained(PoseRegression(greedy=True, shapes=SOFT))
    adapted = adapt(model, STRIDE[:, AT], 0.5 * STRIDE[:, AT])
    assert adapted.settling and adapted.settling.shapes == SoftShapes(SOFT.beta, 0.0)
    assert np.linalg.norm(adapted(0.5 * STRIDE[4:, AT], 432) - STRIDE[4:], axis=-1).mean() < 0.15


def test_the_command_takes_the_options_and_says_what_is_wrong(tmp_path: Path) -> None:
    write_recording(tmp_path / "mesh.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\nreference: [withers, croup]\n"
    (tmp_path / "m.yaml").write_text(f"{text}limbs: [{', '.join(LIMBS)}]\n")
    files = [tmp_path / "mesh.mcap", "-o", tmp_path / "m.npz", "--markers", tmp_path / "m.yaml"]
    train = [*map(str, files)]
    options = ["--alignment", "greedy", "--shapes", "optimised", "--blend", "shared", "--parts", "8"]
    with succeeding():
        cli.call("motion train steering", [*train, *options, "--report", str(tmp_path / "m.html")])
    model = read_model(tmp_path / "m.npz", KIND)
    assert [model.header[name] for name in ("alignment", "shapes", "blend")] == ["greedy", "optimised", "shared"]
    assert set(model.header["softly"]) == {"beta", "marked"} and model.header["left_out"]["parts"] > 0.0
    assert "optimised" in (tmp_path / "m.html").read_text()
    assert np.isfinite(steered(tmp_path / "m.npz", STRIDE[:, AT])).all()
    for more, why in (
        (["--alignment", "greed"], "did you mean 'greedy'|greedy"),
        (["--shapes", "round"], "no shapes 'round'"),
        (["--alignment", "greedy", "--method", "both"], "say how parts come to fit"),
        (["--blend", "shared", "--skeleton"], "leave out --skeleton"),
    ):
        with pytest.raises(KinegraphError, match=why):
            cli.call("motion train steering", [*train, "--overwrite", *more])
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(KinegraphError, match="names no limbs"):
        cli.call("motion train steering", [*train, "--overwrite", "--blend", "shared"])


def test_models_whose_parts_are_held_by_what_is_not_there_are_refused(tmp_path: Path) -> None:
    header, arrays = to_arrays(trained(PoseRegression(greedy=True, shapes=SOFT)), topology(), LIMBS)
    for name, value in (
        ("settling.others", arrays["settling.others"] + 40),
        ("settling.begins", arrays["settling.begins"][::-1].copy()),
        ("settling.own", arrays["settling.own"][:5]),
        ("settling.solve", arrays["settling.solve"][:2]),
    ):
        write_model(tmp_path / "bad.npz", KIND, header, {**arrays, name: value})
        with pytest.raises(ModelError):
            from_model(read_model(tmp_path / "bad.npz", KIND))


@pytest.mark.parametrize("limbs", [(), LIMBS], ids=["by all markers", "limbs alone"])
@pytest.mark.parametrize(("greedy", "soft"), [(True, None), (False, SOFT), (True, SOFT)])
def test_a_virtual_skeleton_can_be_settled_too(
    greedy: bool, soft: SoftShapes | None, limbs: tuple[str, ...], tmp_path: Path
) -> None:
    model = trained(PoseRegression(skeleton=True, greedy=greedy, shapes=soft), limbs)
    assert model.settling and any(part.parent >= 0 for part in model.parts)
    write_model(tmp_path / "m.npz", KIND, *to_arrays(model, topology(), limbs))
    made = model(STRIDE[:, AT], 432)
    assert np.allclose(steered(tmp_path / "m.npz", STRIDE[:, AT]), made, atol=1e-9)
    assert np.linalg.norm(made - STRIDE, axis=-1).mean() < 0.01 * DIAGONAL
