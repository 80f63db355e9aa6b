"""Steering beyond the frames of a mesh: headings, other performers, straight to the vertices, and meshes that are in bad order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinegraph.devices.people.quadruped import LEGS, marked, topology
from kinegraph.operators.steering.model.adapt import adapt, limb_frames, matched, nearest_frames
from kinegraph.operators.steering.model.choose import best_of, choose, regression_of
from kinegraph.operators.steering.model.fit import Steering, fit_steering, fit_straight
from kinegraph.operators.steering.model.graph_ranges import graph_matched
from kinegraph.operators.steering.model.marker_frame import MarkerFrame, see_from
from kinegraph.operators.steering.model.pose_parameters import MarkerGraph
from kinegraph.operators.steering.model.regions import Regions
from kinegraph.operators.steering.model.regression import learn
from kinegraph.operators.steering.model.stored import KIND, from_model, to_arrays
from kinegraph.operators.steering.operator import SteerMesh
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.operator import grid
from tests.avatar.adapt_runs import AT, FACES, HEADING, NAMES, REFERENCE, STRIDE, pacing, steered
from tests.quadruped_model import LIMBS
from tests.support.tiers import rest_nightly


def rotated(points: Samples, angle: float) -> Samples:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


def test_the_mesh_turns_with_its_heading(tmp_path: Path) -> None:
    model = fit_steering(STRIDE[::2], FACES, marked(), REFERENCE, heading=HEADING)
    header, arrays = to_arrays(model, topology(), ())
    write_model(tmp_path / "m.npz", KIND, header, arrays)
    straight = steered(tmp_path / "m.npz", STRIDE[1::2, AT])
    assert np.abs(straight - STRIDE[1::2]).mean() < 0.01
    there = np.array([3.0, 0.0, 1.0])
    for angle in (0.5, 2.0, -3.0):
        marks = rotated(STRIDE[1::2, AT], angle) + there
        made = steered(tmp_path / "m.npz", marks)
        assert np.allclose(made, rotated(straight, angle) + there, atol=1e-9)
        assert np.allclose(made, model(marks, 432), atol=1e-9)


def test_straight_to_the_vertices_is_one_part_and_agrees_with_the_reference(tmp_path: Path) -> None:
    model = fit_straight(STRIDE[::2], marked(), REFERENCE)
    header, arrays = to_arrays(model, topology(), ())
    write_model(tmp_path / "m.npz", KIND, header, arrays)
    made = steered(tmp_path / "m.npz", STRIDE[:, AT])
    assert len(model.parts) == 1 and np.allclose(made, model(STRIDE[:, AT], 432), atol=1e-9)
    assert np.linalg.norm(made - STRIDE, axis=-1).mean() < 0.01


def test_the_way_is_chosen_by_frames_left_out() -> None:
    """A sheet that waves has no rigid parts; a walker whose limbs are named cannot do without."""
    x, y = np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20))
    sheet = np.array(
        [np.stack([x, y, 0.2 * np.sin(3 * x + p) * np.cos(2 * y)], -1).reshape(-1, 3) for p in 0.25 * np.arange(24)]
    )
    faces = np.array([(20 * r + c, 20 * r + c + 1, 20 * r + c + 20) for r in range(19) for c in range(19)])
    marks = {"a": 0, "b": 19, "c": 380, "d": 399, "e": 190, "f": 210}
    _, way, off, pull = choose(sheet, faces, marks, tuple(marks), count=5)
    assert way != "parts" and off["local"] < off["straight"] < off["parts"]
    model, way, off, pull = choose(STRIDE, FACES, marked(), REFERENCE, LIMBS)
    assert way == "parts" and not off and pull is None and len(model.parts) > 5


def test_both_is_the_mean_and_taken_where_it_is_not_clearly_worse(tmp_path: Path) -> None:
    done: list[tuple[int, int]] = []
    both, way, off, _ = choose(
        STRIDE[::2], FACES, marked(), REFERENCE, method="both", progress=lambda *expected: done.append(expected)
    )
    assert done == [
        (k, 9) for k in range(9)
    ]  # four times without a quarter of the frames, two models each, and the last of all
    ways = [choose(STRIDE[::2], FACES, marked(), REFERENCE, method=one)[0] for one in ("parts", "straight")]
    assert way == "both" and list(off) == ["both"] and len(both.parts) == sum(len(one.parts) for one in ways)
    header, arrays = to_arrays(unconstrained(both), topology(), ())
    write_model(tmp_path / "m.npz", KIND, header, arrays)
    wanted = sum(unconstrained(one)(STRIDE[:, AT], 432) for one in ways) / 2
    assert np.allclose(steered(tmp_path / "m.npz", STRIDE[:, AT]), wanted, atol=1e-9)
    frames = np.ones(8)
    alike = {"parts": frames, "straight": frames + np.linspace(-0.1, 0.08, 8), "both": frames}
    assert best_of(alike) == "both" and best_of({**alike, "straight": frames - 0.1}) == "straight"


def test_regions_see_their_markers_and_the_operator_does_as_the_reference(tmp_path: Path) -> None:
    model, way, off, _ = choose(STRIDE[::2], FACES, marked(), REFERENCE, method="local")
    assert way == "local" and list(off) == ["local"] and len(AT) < len(model.parts) <= 26
    shares = np.zeros(432)
    for part in model.parts:
        shares[part.vertices] += part.weights
    assert np.allclose(shares, 1.0)
    header, arrays = to_arrays(model, topology(), ())
    write_model(tmp_path / "m.npz", KIND, header, arrays)
    for name, value in (("0.frame.weights", None), ("3.frame.usual", np.zeros((5, 3))), ("0.features", np.arange(17))):
        damaged = {k: v for k, v in {**arrays, name: value}.items() if v is not None}
        write_model(tmp_path / "bad.npz", KIND, header, damaged)
        with pytest.raises(ModelError):
            from_model(read_model(tmp_path / "bad.npz", KIND))
    regions = Regions.of(model.parts)
    for frame in model.features(STRIDE[:, AT] * 1.3)[0]:
        far = max(part.learned.outside(model._seen(part, frame[None], frame[None])[0][0]) for part in model.parts)
        assert regions and np.isclose(regions.outside(frame.reshape(-1, 3), np.inf), far)
        assert regions.outside(frame.reshape(-1, 3), far / 2) > far / 2
    stored, wanted = from_model(read_model(tmp_path / "m.npz", KIND))[0], model.parts[0].frame
    assert wanted and stored.parts[0].frame and np.array_equal(stored.parts[0].frame.shares, wanted.shares)
    assert np.allclose(steered(tmp_path / "m.npz", STRIDE[:, AT]), model(STRIDE[:, AT], 432), atol=1e-6)
    assert np.linalg.norm(model(STRIDE[1::2, AT], 432) - STRIDE[1::2], axis=-1).mean() < 0.01


def test_regions_far_beyond_the_training_stay_where_their_markers_are_and_say_so(tmp_path: Path) -> None:
    model = choose(STRIDE[::2], FACES, marked(), REFERENCE, method="local")[0]
    write_model(tmp_path / "m.npz", KIND, *to_arrays(model, topology(), ()))
    marks = STRIDE[:20, AT] * np.linspace(1.0, 10.0, 20)[:, None, None]
    operator = SteerMesh(model=tmp_path / "m.npz")
    operator.open({"in": StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=NAMES, units=("m",))})
    made = {port: one.data for port, one in operator.process("in", Chunk(grid(30.0, 20), marks.reshape(20, -1), 0))}
    low, high = marks.min(axis=1, keepdims=True) - 1.0, marks.max(axis=1, keepdims=True) + 1.0
    assert ((made["mesh"] >= low) & (made["mesh"] <= high)).all() and made["quality"][-1, 0] > 3.0


def test_a_region_is_known_again_however_the_whole_body_is_turned() -> None:
    """Without a heading, and turned about an axis that no training frame was turned about."""
    model = choose(STRIDE[::2], FACES, marked(), REFERENCE, method="local", pull=None)[0]
    tilt, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    tilt *= np.sign(np.linalg.det(tilt))
    about = STRIDE - STRIDE[:, AT][:, model.reference].mean(axis=1, keepdims=True)
    made, usual = unconstrained(model)((about @ tilt)[:, AT], 432), unconstrained(model)(about[:, AT], 432)
    assert np.allclose(made, usual @ tilt, atol=1e-9)


def test_a_frame_of_markers_is_the_motion_that_brings_their_usual_places_nearest() -> None:
    rng = np.random.default_rng(2)
    seen, weights = rng.normal(size=(5, 6, 3)), rng.uniform(0.1, 1.0, 6)
    frame = MarkerFrame.of(seen, weights, np.ones(6))
    turns, middles, reported = frame(seen)
    for f in range(5):
        fitted, _ = Rotation.align_vectors(seen[f] - middles[f], frame.usual, weights)
        assert np.allclose(turns[f], fitted.as_matrix())
        pose, own = np.zeros(9), np.zeros(18)
        see_from(seen[f], frame.weights, frame.usual, frame.shares, pose, own, np.zeros((11, 4)))
        assert np.allclose(pose, [*turns[f, :, 0], *turns[f, :, 1], *middles[f]]) and np.allclose(own, reported[f])


def unconstrained(model: Steering) -> Steering:
    return replace(model, soft=np.zeros((0, 0)), most=0.0)


@pytest.mark.parametrize("heading", [(), HEADING])
def test_markers_pull_the_mesh_and_the_operator_does_as_the_reference(heading: tuple[str, ...], tmp_path: Path) -> None:
    """Every third frame of a stride is trained, so that the regression alone leaves the hooves off."""
    free = choose(STRIDE[::3], FACES, marked(), REFERENCE, heading=heading)[0]
    assert free.soft.shape == (432, len(AT)) and free.most > 0.0
    header, arrays = to_arrays(free, topology(), ())
    write_model(tmp_path / "m.npz", KIND, header, arrays)
    there = np.array([2.0, 0.0, -1.0])
    marks = rotated(STRIDE[:, AT], 0.7 if heading else 0.0) + there
    made = steered(tmp_path / "m.npz", marks)
    assert np.allclose(made, free(marks, 432), atol=1e-9)
    off = [np.linalg.norm(one(STRIDE[:, AT], 432) - STRIDE, axis=-1).mean() for one in (unconstrained(free), free)]
    assert off[1] < off[0]


def test_a_marker_far_off_pulls_no_farther_than_it_was_off_in_training(tmp_path: Path) -> None:
    model = choose(STRIDE[::3], FACES, marked(), REFERENCE)[0]
    marks = STRIDE[:1, AT].repeat(2, axis=0)
    marks[1, 0] += [0.0, 3.0, 0.0]
    moved = np.linalg.norm(model(marks, 432) - unconstrained(model)(marks, 432), axis=-1)[1]
    assert moved.max() <= model.most * (1.0 + 1e-9)


def test_frames_are_paired_as_the_equations_say() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=15), rng.normal(size=9)
    da, db = np.append(np.diff(a), a[-1] - a[-2]), np.append(np.diff(b), b[-1] - b[-2])
    cost = [[abs(m - v) + a.std() / 2 * (1 - np.sign(m * v)) for v in db] for m in da]
    assert limb_frames(a, b).tolist() == np.argmin(cost, axis=1).tolist()
    p, v = rng.normal(size=(6, 4, 3)), rng.normal(size=(5, 4, 3))
    wanted = [int(np.argmin([((one - other) ** 2).sum() for other in v])) for one in p]
    assert nearest_frames(p, v).tolist() == wanted


def test_ranges_of_motion_get_the_meshs_means_and_variances() -> None:
    rng = np.random.default_rng(4)
    performed, mesh = rng.normal(2.0, 0.1, (400, 3, 3)).clip(1.75, 2.25), rng.normal(-1.0, [0.5, 1.0, 2.0], (300, 3, 3))
    made = matched(performed, mesh)
    assert np.allclose(made.mean(axis=0), mesh.mean(axis=0)) and np.allclose(made.std(axis=0), mesh.std(axis=0))


def graph_of(names: tuple[str, ...]) -> MarkerGraph:
    graph = regression_of(STRIDE, FACES, marked(), REFERENCE, names, pose="angles").graph
    assert graph
    return graph


@pytest.mark.parametrize("names", [LIMBS, ()], ids=["limbs from the body", "limbs that go on from one another"])
def test_angles_and_lengths_get_the_meshs_means_and_variances_and_places_meet_them(names: tuple[str, ...]) -> None:
    """In plain trigonometry: every edge's angle to the one before it and its length, of the markers that came out."""
    graph, reference = graph_of(names), np.array([NAMES.index(n) for n in REFERENCE])
    performed = np.random.default_rng(5).normal(0.0, 0.02, (60, 6, 3)) + 0.4 * STRIDE[0, AT] * [1.0, 0.8, 1.2]
    made = graph_matched(graph, performed, STRIDE[:, AT], reference)
    assert np.allclose(made[:, reference].mean(axis=1), 0.0)

    def reported(marks: Samples) -> Samples:
        rows = []
        for frame in marks:
            lead = frame[graph.lead[1]] - frame[graph.lead[0]]
            edges = [frame[j] - frame[i] for i, j in graph.edges]
            befores = [lead if b < 0 else edges[b] for b in graph.before]
            turns = [
                np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))
                for a, b in zip(edges, befores, strict=True)
            ]
            rows.append([*turns, *(np.linalg.norm(edge) for edge in edges), np.linalg.norm(lead)])
        return np.array(rows)

    a, b, c = reported(performed), reported(STRIDE[:, AT]), reported(made)
    wanted = b.mean(axis=0) + np.clip((a - a.mean(axis=0)) / a.std(axis=0), -3, 3) * b.std(axis=0)
    k = len(graph.edges)
    wanted[:, :k] = np.clip(wanted[:, :k], 0.0, np.pi)
    wanted[:, k:] = np.maximum(wanted[:, k:], b[:, k:].min(axis=0))
    assert np.allclose(c, wanted, atol=1e-7)
    same = graph_matched(graph, STRIDE[:, AT], STRIDE[:, AT], reference)
    assert np.allclose(same, STRIDE[:, AT] - STRIDE[:, AT][:, reference].mean(axis=1, keepdims=True), atol=1e-9)


def test_by_the_swing_alone_a_limbs_frames_are_those_of_the_equation() -> None:
    model, graph = fit_steering(STRIDE, FACES, marked(), REFERENCE, LIMBS), graph_of(LIMBS)
    performed = 0.4 * pacing(np.arange(50) / 30)
    adapted = adapt(model, STRIDE[:, AT], performed, ranges="graph", pairing="swing", graph=graph)
    reference = np.array([NAMES.index(n) for n in REFERENCE])
    ranged = graph_matched(graph, performed, STRIDE[:, AT], reference)
    part, made = next((a, b) for a, b in zip(model.parts, adapted.parts, strict=True) if model.alone(a) == "hoof_hl")
    end, start = NAMES.index("hoof_hl"), int(graph.edges[graph.path(NAMES.index("hoof_hl"))[0], 0])

    def theta(marks: Samples) -> Samples:
        first, limb = marks[:, graph.lead[1]] - marks[:, graph.lead[0]], marks[:, end] - marks[:, start]
        return np.arccos((first * limb).sum(-1) / np.linalg.norm(first, axis=-1) / np.linalg.norm(limb, axis=-1))

    m, v = theta(ranged), theta(STRIDE[:, AT])
    ahead = [np.append(np.diff(one), one[-1] - one[-2]) for one in (m, v)]
    frames = [
        min(range(24), key=lambda i: abs(d - ahead[1][i]) + m.std() / 2 * (1 - np.sign(d * ahead[1][i])))
        for d in ahead[0]
    ]
    x_mesh, x = model.features(STRIDE[:, AT])[0], model.features(performed)[0]
    wanted = learn(x[:, part.features], part.learned(x_mesh[frames][:, part.features]))
    assert np.allclose(made.learned.weights, wanted.weights)


@pytest.mark.parametrize("size", rest_nightly(0.4, 1.0, 2.5))
def test_another_gait_of_another_body_moves_the_mesh_in_its_own_time(size: float) -> None:
    model = fit_steering(STRIDE, FACES, marked(), REFERENCE, LIMBS)
    marks = pacing(np.arange(90) / 30)
    performed = rotated(size * marks * [1.0, 0.8, 1.2], 0.7)
    adapted = adapt(model, STRIDE[:, AT], performed[:60], HEADING)
    made = adapted(performed[60:], 432)
    mesh = rotated(made - made[:, AT[[NAMES.index(n) for n in REFERENCE]]].mean(axis=1, keepdims=True), -0.7)
    assert np.isfinite(mesh).all()
    for leg in LEGS:
        hoof = mesh[:, marked()[f"hoof_{leg}"], 2]
        foot = marks[60:, NAMES.index(f"hoof_{leg}"), 2]
        assert np.corrcoef(hoof, foot)[0, 1] >= 0.9
        assert 0.7 < np.ptp(hoof) / np.ptp(STRIDE[:, marked()[f"hoof_{leg}"], 2]) < 1.3
