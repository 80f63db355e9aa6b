"""Steering beyond the frames of a mesh: headings, other performers, straight to the vertices, and meshes that are in bad order."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinegraph.devices.people.quadruped import LEGS, marked, topology, walking
from kinegraph.operators.steering.commands import report
from kinegraph.operators.steering.model.adapt import _ahead, _change, adapt, limb_frames, matched, nearest_frames
from kinegraph.operators.steering.model.choose import Method, best_of, choose, regression_of
from kinegraph.operators.steering.model.fit import Steering, fit_steering, fit_straight
from kinegraph.operators.steering.model.graph_ranges import graph_matched
from kinegraph.operators.steering.model.marker_frame import MarkerFrame, _largest, see_from
from kinegraph.operators.steering.model.pose_parameters import MarkerGraph
from kinegraph.operators.steering.model.regions import Regions
from kinegraph.operators.steering.model.regression import learn
from kinegraph.operators.steering.model.soft import faded
from kinegraph.operators.steering.model.stored import KIND, from_model, to_arrays
from kinegraph.operators.steering.operator import SteerMesh
from kinegraph.operators.steering.swapped_markers import ExchangedNames
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.cli import main as cli
from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.operator import grid
from kinegraph.stream.recording.series import Series, write_recording
from tests.quadruped_model import LIMBS
from tests.support.command_line import call_command, succeeding
from tests.support.tiers import rest_nightly

NAMES, AT = tuple(marked()), np.array(list(marked().values()))
FACES = topology().faces
STRIDE = np.array([walking(k / 24) for k in range(24)])
REFERENCE, HEADING = ("withers", "croup"), ("croup", "withers")


def steered(path: Path, marks: Samples) -> Samples:
    operator = SteerMesh(model=path)
    operator.open({"in": StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=NAMES, units=("m",))})
    chunks = operator.process("in", Chunk(grid(30.0, len(marks)), marks.reshape(len(marks), -1), 0))
    return next(chunk.data for port, chunk in chunks if port == "mesh")


def rotated(points: Samples, angle: float) -> Samples:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])


def pacing(phases: Samples) -> Samples:
    """Markers of a quadruped that moves both legs of a side together, as the model never did."""
    marks = np.array([walking(p)[AT] for p in phases])
    for leg, late in (("fl", 0.0), ("hl", 0.0), ("fr", 0.5), ("hr", 0.5)):
        hoof = marked()[f"hoof_{leg}"]
        foremost = STRIDE[:, hoof, 2].argmax() / len(STRIDE)
        marks[:, NAMES.index(f"hoof_{leg}")] = [walking(p - late + foremost)[hoof] for p in phases]
    return marks


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


def kinegraph(*arguments: object) -> None:
    with succeeding():
        call_command(*arguments)


def test_a_report_shows_parts_errors_and_modes(tmp_path: Path) -> None:
    write_recording(tmp_path / "mesh.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\nreference: [withers, croup]\n"
    (tmp_path / "m.yaml").write_text(f"{text}limbs: [{', '.join(LIMBS)}]\n")
    files = (tmp_path / "mesh.mcap", "-o", tmp_path / "m.npz", "--markers", tmp_path / "m.yaml")
    kinegraph("motion", "train", "steering", *files, "--report", tmp_path / "m.html")
    page = (tmp_path / "m.html").read_text()
    assert page.count("<img") == 3 and "hoof_fl" in page
    reported = float(page.split("vertices are off by ")[1].split(" %")[0])
    rest = [f for f in range(24) if f % 4]
    made = fit_steering(STRIDE[rest], FACES, marked(), REFERENCE, LIMBS)(STRIDE[::4, AT], 432)
    off = 100 * np.linalg.norm(made - STRIDE[::4], axis=-1).mean() / np.linalg.norm(np.ptp(STRIDE[0], axis=0))
    assert reported == pytest.approx(off, abs=0.002)
    kept = (tmp_path / "m.html").stat().st_mtime_ns
    with pytest.raises(KinegraphError, match=r"m\.html: exists"):
        cli.call(
            "motion train steering",
            [*map(str, files), "-o", str(tmp_path / "n.npz"), "--report", str(tmp_path / "m.html")],
        )
    assert (tmp_path / "m.html").stat().st_mtime_ns == kept


def test_more_parts_than_colours_begin_with_the_first_colour_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = fit_steering(STRIDE, FACES, marked(), REFERENCE, LIMBS)
    one, mine = model.parts[0], np.arange(len(model.parts[0].vertices))
    parts = tuple(replace(one, weights=np.where(mine == k, 2.0, 0.5)) for k in range(22))
    shown: list[Samples] = []
    monkeypatch.setattr(report, "picture", lambda points, faces, colours: shown.append(colours) or "")
    report.write_report(
        tmp_path / "m.html", "m", replace(model, parts=parts), "parts", {}, STRIDE[:3], FACES, lambda _: model
    )
    colours = shown[0][one.vertices]
    assert np.array_equal(colours[20:22], colours[:2]) and len(np.unique(colours[:20], axis=0)) == 20


@pytest.mark.parametrize("changes, missing", [(_ahead, -1), (_change, 0)])
def test_the_change_that_no_frame_tells_is_that_beside_it(changes: Callable[[Samples], Samples], missing: int) -> None:
    assert changes(np.array([1.0])).tolist() == [0.0]
    for angles in ([1.0, 3.0], [1.0, 3.0, 4.0], [0.0, 1.0, 3.0, 6.0]):
        rows = list(np.diff(angles))
        rows.insert(missing % len(angles), rows[missing])
        assert changes(np.array(angles)).tolist() == rows


def test_the_command_takes_a_performer_and_says_what_is_wrong(tmp_path: Path) -> None:
    write_recording(tmp_path / "mesh.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    marks = pacing(np.arange(60) / 30)
    spec = StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=NAMES, units=("cm",))
    write_recording(tmp_path / "walk.mcap", [Series("walk", spec, grid(30.0, 60), 40.0 * marks)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\nreference: [withers, croup]\n"
    (tmp_path / "m.yaml").write_text(f"{text}limbs: [{', '.join(LIMBS)}]\nheading: [croup, withers]\n")
    files = (tmp_path / "mesh.mcap", "-o", tmp_path / "m.npz", "--markers", tmp_path / "m.yaml")
    kinegraph("motion", "train", "steering", *files, "--performer", tmp_path / "walk.mcap")
    assert read_model(tmp_path / "m.npz", KIND).header["performer"] == "walk.mcap"
    kinegraph(
        "motion",
        "train",
        "steering",
        *files,
        "--performer",
        tmp_path / "walk.mcap",
        "--ranges",
        "graph",
        "--pairing",
        "swing",
        "--overwrite",
    )
    header = read_model(tmp_path / "m.npz", KIND).header
    assert (header["ranges"], header["pairing"]) == ("graph", "swing")
    kinegraph("motion", "train", "steering", *files, "--performer", tmp_path / "walk.mcap", "--overwrite")
    made = steered(tmp_path / "m.npz", 0.4 * marks)
    assert np.isfinite(made).all() and np.ptp(made[:, AT[0], 2]) > 0.1
    for more, why in (
        (("--performer", tmp_path / "mesh.mcap"), "no stream holds all markers"),
        (("--method", "strait"), "did you mean 'straight'|straight"),
        (("--method", "straight"), "limbs move by themselves"),
        (("--ranges", "graph"), "--ranges graph: only for a performer"),
        (("--pairing", "swing"), "--pairing swing: only for a performer"),
        (("--ranges", "graphs"), "did you mean 'graph'|graph"),
        (("--method", "local", "--performer", tmp_path / "walk.mcap"), "limbs move by themselves"),
    ):
        with pytest.raises(KinegraphError, match=why):
            cli.call("motion train steering", [str(a) for a in (*files, "--overwrite", *more)])
    (tmp_path / "m.yaml").write_text(text)
    for more in (("--performer", tmp_path / "walk.mcap"), ("--pose", "angles"), ("--regression", "linear")):
        with pytest.raises(KinegraphError, match="move with the markers that lie on them"):
            cli.call("motion train steering", [str(a) for a in (*files, "--overwrite", "--method", "local", *more)])
    (tmp_path / "m.yaml").write_text(f"{text}heading: [croup]\n")
    with pytest.raises(KinegraphError, match="two markers"):
        cli.call("motion train steering", [str(a) for a in (*files, "--overwrite")])


def test_the_limbs_of_a_performer_are_called_as_the_file_of_markers_says(tmp_path: Path) -> None:
    """The hind hooves are led by the performer's hands: as with one whose points bear the markers' names."""
    write_recording(tmp_path / "mesh.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 24), STRIDE)], {})
    called = {"hoof_hl": "LWRA", "hoof_hr": "RWRA", "hoof_fl": "LTOE"}
    marks = pacing(np.arange(60) / 30)
    for name, channels in (("own", NAMES), ("other", tuple(called.get(name, name) for name in NAMES))):
        spec = StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=channels, units=("m",))
        write_recording(tmp_path / f"{name}.mcap", [Series("walk", spec, grid(30.0, 60), 0.4 * marks)], {})
    text = "markers: {" + ", ".join(f"{n}: {v}" for n, v in marked().items()) + "}\nreference: [withers, croup]\n"
    mapped = f"{text}limbs: [{', '.join(LIMBS)}]\nperformer: {{{', '.join(f'{a}: {b}' for a, b in called.items())}}}\n"
    (tmp_path / "own.yaml").write_text(f"{text}limbs: [{', '.join(LIMBS)}]\n")
    (tmp_path / "other.yaml").write_text(mapped)
    for name in ("own", "other"):
        kinegraph(
            "motion", "train", "steering", tmp_path / "mesh.mcap", "--markers", tmp_path / f"{name}.yaml", "-o", tmp_path / f"{name}.npz",
            "--performer", tmp_path / f"{name}.mcap",
        )  # fmt: skip
    own, other = (read_model(tmp_path / f"{name}.npz", KIND).arrays for name in ("own", "other"))
    assert set(own) == set(other) and all(np.array_equal(own[key], other[key]) for key in own)
    for wrong, why in (
        (
            mapped.replace("hoof_hl: LWRA", "hof_hl: LWRA"),
            "performer: there is no marker 'hof_hl'; did you mean 'hoof_hl'",
        ),
        (mapped.replace("LWRA", "LWRB"), "'LWRB': did you mean '.WRA'.*`performer:` in the file of markers"),
        (f"{text}performer: LTOE\n", "must be a mapping of markers"),
    ):
        (tmp_path / "wrong.yaml").write_text(wrong)
        with pytest.raises(KinegraphError, match=why):
            given = (tmp_path / "mesh.mcap", "--markers", tmp_path / "wrong.yaml", "-o", tmp_path / "x.npz")
            cli.call("motion train steering", [*map(str, given), "--performer", str(tmp_path / "other.mcap")])


def test_a_mesh_with_holes_in_several_pieces_is_steered_all_the_same() -> None:
    """Two walkers in one mesh, a third of the triangles missing: pieces that no edge joins are parts of their own."""
    both = np.concatenate([STRIDE, STRIDE + np.array([2.0, 0.0, 0.0])], axis=1)
    faces = np.concatenate([FACES, FACES + 432])[np.arange(2 * len(FACES)) % 3 > 0]
    model = fit_steering(both[::2], faces, marked(), REFERENCE, count=20)
    made = model(both[1::2, AT], 864)
    assert np.isfinite(made).all() and np.linalg.norm(made - both[1::2], axis=-1).mean() < 0.02


def test_markers_that_are_exchanged_are_far_from_the_training() -> None:
    operator = SteerMesh()
    operator.open({"in": StreamSpec((len(NAMES), 3), rate_hz=30.0, channels=NAMES, units=("m",))})
    marks = STRIDE[:, AT]
    swapped = marks[:, [1, 0, 2, 3, 5, 4]]
    rows = np.concatenate([marks, swapped]).reshape(48, -1)
    made = operator.process("in", Chunk(grid(30.0, 48), rows, 0))
    mesh, quality = (chunk.data for port, chunk in made if port != "names")
    assert np.isfinite(mesh).all() and 10 * quality[:24].max() < quality[24:].min()


@pytest.mark.parametrize("pair", [(0, 1), (2, 5), (1, 3)])
@pytest.mark.parametrize("way", ["parts", "local"])
def test_two_markers_that_bear_each_others_names_are_named_once_and_again_when_cured(
    pair: tuple[int, int], way: Method, tmp_path: Path
) -> None:
    model = choose(STRIDE[::2], FACES, marked(), REFERENCE, method=way)[0]
    write_model(tmp_path / "m.npz", KIND, *to_arrays(model, topology(), ()))
    order = np.arange(6)
    order[list(pair)] = pair[::-1]
    marks = STRIDE[np.arange(240) % 24][:, AT]
    marks[30:150] = marks[30:150][:, order]
    marks[50] = np.nan
    for size in (1, 240):
        operator = SteerMesh(model=tmp_path / "m.npz")
        operator.open({"in": StreamSpec((6, 3), rate_hz=30.0, channels=NAMES, units=("m",))})
        rows = []
        for begin in range(0, 240, size):
            chunk = Chunk(grid(30.0, 240)[begin : begin + size], marks[begin : begin + size].reshape(size, -1), 0)
            rows += [
                row for port, made in operator.process("in", chunk) if port == "names" for row in made.data.tolist()
            ]
        times = [int(grid(30.0, 240).searchsorted(row[0])) for row in rows]
        assert [row[1:] for row in rows] == [(what, NAMES[pair[0]], NAMES[pair[1]]) for what in ("exchanged", "cured")]
        assert 30 + 9 <= times[0] < 110 and 150 < times[1] <= 181


class ModelOfDistances:
    """Four markers; how far they are from the training with two of them exchanged is as given."""

    markers = ("a", "b", "c", "d")

    def __init__(self, left: dict[tuple[int, int], float]) -> None:
        self.left = left

    def outside(self, marks: Samples, enough: float = np.inf) -> float:
        one, other = np.flatnonzero(marks[0, :, 0] != np.arange(4))
        return self.left.get((int(one), int(other)), 1.0)


@pytest.mark.parametrize(("rival", "named"), [(0.1, ("c", "d")), (0.39, None), (0.9, ("a", "b"))])
def test_a_pair_is_held_against_all_others_and_none_is_named_where_two_are_alike(
    rival: float, named: tuple[str, str] | None
) -> None:
    model = ModelOfDistances({(0, 1): 0.4, (2, 3): rival})
    marks, names = np.repeat(np.arange(4.0)[:, None], 3, axis=1), ExchangedNames.empty()
    rows = [row for k in range(120) if (row := names.see(model, marks, 1.0, k))]  # type: ignore[arg-type]
    assert [row[1:] for row in rows] == ([("exchanged", *named)] if named else [])


def test_one_frame_is_too_few_to_learn_from(tmp_path: Path) -> None:
    write_recording(tmp_path / "one.mcap", [Series("mesh", topology().spec(24.0), grid(24.0, 1), STRIDE[:1])], {})
    (tmp_path / "m.yaml").write_text("markers: {a: 1}\n")
    with pytest.raises(KinegraphError, match="at least 2"):
        cli.call(
            "motion train steering", [str(tmp_path / "one.mcap"), "--markers", str(tmp_path / "m.yaml"), "-o", "x.npz"]
        )


def test_markers_pull_wholly_up_to_one_kernels_width_and_less_beyond() -> None:
    assert [faded(outside) for outside in (0.0, 1.0)] == [1.0, 1.0]
    assert faded(2.0) == pytest.approx(math.exp(-1.0)) and faded(3.0) == pytest.approx(math.exp(-2.0))


@pytest.mark.parametrize("seed", range(5))
def test_eigenvectors_are_numpys(seed: int) -> None:
    made = np.random.default_rng(seed).normal(size=(4, 4))
    given, vectors = made + made.T, np.empty((4, 4))
    turned = given.copy()
    _largest(turned, vectors)
    order = np.argsort(np.diag(turned))
    values, expected = np.linalg.eigh(given)
    assert np.allclose(np.diag(turned)[order], values, atol=1e-12)
    assert np.allclose(np.abs((vectors[:, order] * expected).sum(axis=0)), 1.0, atol=1e-12)
