"""What tells a pose (table 9.1 of the thesis), linear regression, and parts that hang from one another."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.people.quadruped import marked, topology, walking
from kinegraph.operators.steering.model.adapt import adapt
from kinegraph.operators.steering.model.choose import regression_of
from kinegraph.operators.steering.model.fit import Layout, Steering, fit_steering
from kinegraph.operators.steering.model.pose_parameters import MarkerGraph, PoseKind, backward
from kinegraph.operators.steering.model.regression import FAR, Regression, learn
from kinegraph.operators.steering.model.skeleton import joint_of, quaternions, tree_of, turn_of
from kinegraph.operators.steering.model.stored import KIND, from_model, to_arrays
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


WIDE = np.arange(24) / 8
STRIP = (np.arange(23)[:, None] * 4 + np.arange(3)).ravel()[:, None] + np.array([0, 1, 4])
"""The triangles of a strip of 24 by 4 vertices, one to a square."""


def curled(bend: float) -> Samples:
    """The strip, 2.9 m long, rolled by `bend` rad a metre, and narrower where it is (96, 3)."""
    angle = bend * WIDE
    spine = np.cumsum(np.stack([np.cos(angle), np.sin(angle)], axis=1), axis=0) / 8
    across = 0.1 * np.arange(4) * (1.0 + 0.1 * bend)
    return np.concatenate([np.repeat(spine, 4, axis=0), np.tile(across, 24)[:, None]], axis=1)


CURLS = np.array([curled(bend) for bend in np.linspace(-1.0, 1.0, 12)])
TIPS = {"withers": 1, "croup": 14, "half": 48, "tip": 95}


def trained(
    pose: PoseKind, regression: Regression = "kernel", skeleton: bool = False, limbs: tuple[str, ...] = ()
) -> Steering:
    how = regression_of(STRIDE, FACES, marked(), REFERENCE, limbs, (), pose, regression, skeleton)
    return fit_steering(STRIDE, FACES, marked(), REFERENCE, limbs, 8, 2, layout=layout(), how=how)


def arm(turn: float, bend: float) -> Samples:
    """A back of 1 m along x, and from its end an upper and a lower arm of 2 and 1 m."""
    upper = np.array([np.cos(turn), 0.0, np.sin(turn)])
    lower = np.array([np.cos(turn + bend), 0.0, np.sin(turn + bend)])
    elbow = np.array([1.0, 0.0, 0.0]) + 2 * upper
    return np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], elbow, elbow + lower])


def test_angles_and_lengths_are_those_of_table_9_1() -> None:
    edges, still = np.array([[1, 2], [2, 3]]), np.full(2, 1e-9)
    graph = MarkerGraph(np.array([0, 1]), edges, np.array([-1, 0]), np.ones(2), np.zeros(2), still)
    marks = np.array([arm(0.3, 0.5), arm(-1.2, 2.0)])
    assert np.allclose(graph(marks, marks), [[0.3, 2.0, 0.5, 1.0], [1.2, 2.0, 2.0, 1.0]])
    assert graph.limb(3).tolist() == [0, 1, 2, 3] and graph.limb(2).tolist() == [0, 1] and not len(graph.limb(0))
    directed = MarkerGraph(np.array([0, 1]), edges, np.array([-1, 0]), np.ones(2), np.ones(2), still)
    moved = marks + np.array([[0, 0, 0], [0, 0, 0], [0, 0.2, 0], [0.0, -0.1, 0]])
    reported = directed(moved, marks).reshape(2, 2, 5)[..., 2:]
    assert np.allclose(reported, [[[0, 1, 0], [0, -1, 0]]] * 2)
    assert np.allclose(backward(marks), [2 * marks[0] - marks[1], marks[0]])


@pytest.mark.parametrize("pose", ["positions", "angles", "directions"])
@pytest.mark.parametrize("regression", ["kernel", "linear"])
def test_the_operator_gives_what_the_slow_reference_gives(
    pose: PoseKind, regression: Regression, tmp_path: Path
) -> None:
    model = trained(pose, regression)
    header, arrays = to_arrays(model, topology(), ())
    write_model(tmp_path / "m.npz", KIND, header, arrays)
    marks = STRIDE[::2, AT] * 1.02 + [0.3, 0.0, 0.1]
    made = steered(tmp_path / "m.npz", marks)
    wanted = model(marks, 432, np.concatenate([marks[:1], marks[:-1]]))
    assert np.allclose(made, wanted, atol=1e-9)
    error = np.linalg.norm(model(STRIDE[:, AT], 432) - STRIDE, axis=-1).mean() / DIAGONAL
    assert error < (0.03 if regression == "linear" else 0.01)


def test_limbs_follow_their_own_angles_alone() -> None:
    model = trained("angles", limbs=LIMBS)
    assert {model.alone(part) for part in model.parts} >= {"hoof_fl", "hoof_fr"}
    marks = np.repeat(STRIDE[:1, AT], 2, axis=0)
    marks[1, NAMES.index("hoof_fl")] += [0.0, 0.1, 0.1]
    moved = np.linalg.norm(np.diff(model(marks, 432), axis=0)[0], axis=-1)
    assert moved[marked()["hoof_fl"]] > 0.02
    assert max(moved[marked()[name]] for name in LIMBS[1:]) < 1e-9
    adapted = adapt(model, STRIDE[:, AT], 0.5 * STRIDE[:, AT])
    assert np.linalg.norm(adapted(0.5 * STRIDE[4:, AT], 432) - STRIDE[4:], axis=-1).mean() < 0.15


def test_parts_hang_from_their_parents_by_joints_that_stay_whole(tmp_path: Path) -> None:
    how = regression_of(CURLS, STRIP, TIPS, REFERENCE, skeleton=True)
    model = fit_steering(CURLS, STRIP, TIPS, REFERENCE, (), 5, 2, how=how)
    assert [part.parent for part in model.parts].count(-1) == 1 < len(model.parts)
    mesh = Topology(96, STRIP.astype(np.int32), "strip")
    write_model(tmp_path / "m.npz", KIND, *to_arrays(model, mesh, ()))
    marks = np.array([curled(bend) for bend in (-0.7, 0.1, 0.4)])[:, list(TIPS.values())]
    made = steered(tmp_path / "m.npz", marks, tuple(TIPS))
    assert np.allclose(made, model(marks, 96), atol=1e-9)
    assert np.linalg.norm(made - [curled(bend) for bend in (-0.7, 0.1, 0.4)], axis=-1).max() < 0.03


def test_a_tree_of_parts_and_quaternions() -> None:
    shared = np.array([[0, 5, 1, 0], [5, 0, 9, 0], [1, 9, 0, 0], [0, 0, 0, 0]])
    assert tree_of(shared, 0) == ([0, 1, 2, 3], [-1, 0, 1, -1])
    rng = np.random.default_rng(2)
    q = rng.normal(size=(20, 4))
    turns = np.array([turn_of(one) for one in q])
    back = quaternions(turns)
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3)) and np.allclose([turn_of(b) for b in back], turns)


def test_linear_regression_leaves_out_as_it_says_and_never_explodes() -> None:
    rng = np.random.default_rng(5)
    x = rng.normal(size=(15, 4))
    y = x @ rng.normal(size=(4, 2)) + 3.0 + 0.01 * rng.normal(size=(15, 2))
    found = learn(x, y, "linear")
    assert np.abs(found(x) - y).max() < 0.05
    share, errors = found.ridge * ((x - x.mean(axis=0)) ** 2).sum() / 15, []
    for i in range(15):
        a, b = np.delete(x, i, 0), np.delete(y, i, 0)
        c = a - a.mean(axis=0)
        weights = np.linalg.solve(c.T @ c + share * np.eye(4), c.T @ (b - b.mean(axis=0)))
        errors.append(y[i] - b.mean(axis=0) - (x[i] - a.mean(axis=0)) @ weights)
    assert found.error == pytest.approx(float((np.array(errors) ** 2).mean()), rel=1e-6)
    far = found(1e6 * x[:1])[0] - found.mean
    near = np.linalg.norm(found.weights, 2) * (FAR + 3.0) * np.sqrt(-0.5 / found.scale) * 3
    assert np.linalg.norm(far) < near


def test_the_command_takes_the_options_and_says_what_is_wrong(tmp_path: Path) -> None:
    write_recording(tmp_path / "mesh.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\n"
    (tmp_path / "m.yaml").write_text(text + "reference: [withers, croup]\n")
    files = [tmp_path / "mesh.mcap", "-o", tmp_path / "m.npz", "--markers", tmp_path / "m.yaml"]
    train = [*map(str, files)]
    options = ["--pose", "directions", "--regression", "linear", "--skeleton"]
    with succeeding():
        cli.call("motion train steering", [*train, *options, "--overwrite"])
    header = read_model(tmp_path / "m.npz", KIND).header
    assert (header["pose"], header["regression"], header["skeleton"]) == ("directions", "linear", True)
    assert np.isfinite(steered(tmp_path / "m.npz", STRIDE[:, AT])).all()
    for more, why in (
        (["--pose", "angle"], "did you mean 'angles'|angles"),
        (["--regression", "cubic"], "no regression 'cubic'"),
        (["--skeleton", "--method", "both"], "hang from one another"),
    ):
        with pytest.raises(KinegraphError, match=why):
            cli.call("motion train steering", [*train, "--overwrite", *more])
    (tmp_path / "m.yaml").write_text(text + "reference: [withers]\n")
    with pytest.raises(KinegraphError, match="two reference markers"):
        cli.call("motion train steering", [*train, "--overwrite", "--pose", "angles"])


def test_models_whose_graph_or_tree_does_not_fit_are_refused(tmp_path: Path) -> None:
    how = regression_of(CURLS, STRIP, TIPS, REFERENCE, pose="angles", skeleton=True)
    model = fit_steering(CURLS, STRIP, TIPS, REFERENCE, (), 5, 2, how=how)
    header, arrays = to_arrays(model, Topology(96, STRIP.astype(np.int32), "strip"), ())
    hanging = next(name for name in arrays if name.endswith(".parent"))
    for name, value in (
        ("graph.edges", arrays["graph.edges"] + 9),
        ("graph.before", np.full(len(arrays["graph.edges"]), 7)),
        (hanging, np.array([40])),
        (hanging.replace("parent", "above"), np.zeros((1, 3))),
    ):
        write_model(tmp_path / "bad.npz", KIND, header, {**arrays, name: value})
        with pytest.raises(ModelError):
            from_model(read_model(tmp_path / "bad.npz", KIND))


def test_a_joint_is_where_it_is_in_its_part_and_moves_with_the_modes() -> None:
    rng, vertices = np.random.default_rng(4), 9
    turns = np.array([turn_of(one) for one in quaternions(np.linalg.qr(rng.normal(size=(12, 3, 3)))[0])])
    poses = rng.normal(size=(12, 11))
    there, moves = np.array([0.3, -0.2, 0.5]), rng.normal(size=(2, 3))
    local = there + np.sqrt(vertices) * poses[:, 9:] @ moves
    joint = np.einsum("fij,fj->fi", turns, local) + poses[:, 6:9]
    np.testing.assert_allclose(joint_of(joint, turns, poses, vertices), [there, *moves], atol=1e-5)
