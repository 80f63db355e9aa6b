"""Up is up and forward is forward, from every source of points into everything that takes points."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from kinegraph.devices.formats.bvh.reader import read_bvh
from kinegraph.devices.formats.c3d.reader import read_c3d
from kinegraph.devices.formats.table.kinect import ONE, read_kinect
from kinegraph.devices.natnet.source import NatNet
from kinegraph.devices.oak.source import Oak
from kinegraph.devices.osc.points import OscPoints
from kinegraph.devices.osc.vmc_inlet import Vmc
from kinegraph.devices.page.transfer.catalogue import described
from kinegraph.devices.people.before_camera import BeforeCamera
from kinegraph.devices.people.exerciser import Exerciser
from kinegraph.devices.people.performer import MARKERS, Performer, true_pose
from kinegraph.devices.people.quadruped import Quadruped, TwoActors, marked, topology, walking
from kinegraph.devices.people.walkway import Walkway
from kinegraph.devices.qualisys.source import Qualisys
from kinegraph.operators.body.names import markers_specs
from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.operators.features.normalised_pose import NormalisedPose
from kinegraph.operators.features.pose import Pose
from kinegraph.operators.filters.scale import Scale
from kinegraph.operators.filters.turn_axes import TurnAxes
from kinegraph.operators.maps.pose_map.commands.gather import PoseReading
from kinegraph.operators.pose.operator import WholePose
from kinegraph.operators.steering.actors import Actors
from kinegraph.operators.steering.operator import SteerMesh
from kinegraph.operators.timing.align import Align
from kinegraph.stream.chunk import Array, Chunk, Samples, StreamSpec
from kinegraph.stream.domain.axes import BODY, CAMERA, WAYS, Axes, describe_axes, in_axes
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Operator, grid
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.command_line import Command, refused

RATE = 30.0
SHAPES = {"camera": {"fx": 200.0, "fy": 200.0, "cx": 160.0, "cy": 100.0}}
DEPTH = StreamSpec((200, 320), np.dtype(np.uint16), RATE, units=("mm",), meta=SHAPES)
Turned = Callable[[Samples, Samples, Samples], tuple[Samples, Samples, Samples]]


def same(left: Samples, up: Samples, front: Samples) -> tuple[Samples, Samples, Samples]:
    return left, up, front


def before_a_camera(left: Samples, up: Samples, front: Samples) -> tuple[Samples, Samples, Samples]:
    """x to the right in the image, where a person who faces the camera has the left hand; y down, z away."""
    return left, -up, -front


SOURCES: dict[str, tuple[StreamSpec, Turned]] = {
    "Performer": (Performer().specs()["markers"], same),
    "TwoActors": (TwoActors().specs()["out"], same),
    "Quadruped": (Quadruped().specs()["markers"], same),
    "Oak with a network": (Oak(network=Path("pose.tar.xz")).specs()["markers"], before_a_camera),
    "Extrema and PoseMarkers": (markers_specs(DEPTH)["out"], before_a_camera),
    "BeforeCamera": (BeforeCamera().specs()["joints"], before_a_camera),
    "Exerciser": (Exerciser().specs()["joints"], lambda left, up, front: (-left, up, -front)),
    "Walkway": (Walkway().specs()["markers"], lambda left, up, front: (-left, front, up)),
    "NatNet": (NatNet(markers=("a:1",)).specs()["markers"], same),
    "NatNet, z up": (NatNet(markers=("a:1",), up="z").specs()["markers"], lambda left, up, front: (left, -front, up)),
    "Qualisys": (Qualisys(markers=("a",)).specs()["markers"], lambda left, up, front: (left, -front, up)),
    "left-handed": (
        StreamSpec((1, 3), units=("cm",), meta={"axes": Axes("y", "z", left_handed=True).facts()}),
        lambda left, up, front: (-left, up, front),
    ),
    "not declared": (StreamSpec((1, 3), units=("m",)), same),
    "recorded by an earlier version": (StreamSpec((1, 3), units=("m",), meta={"axes": "camera"}), before_a_camera),
}
PER_M = {"m": 1.0, "cm": 100.0, "mm": 1000.0}


def performed(name: str, points: Samples, names: tuple[str, ...]) -> tuple[StreamSpec, Samples]:
    """What a source would give of points (n, m, 3) whose coordinates are left, up and front."""
    spec, turned = SOURCES[name]
    data = np.stack(turned(*np.moveaxis(points, -1, 0)), axis=-1) * PER_M[spec.units[0]]
    meta = {key: value for key, value in spec.meta.items() if key == "axes"}
    return StreamSpec((len(names), 3), rate_hz=RATE, channels=names, units=spec.units, meta=meta), data


def moves() -> Samples:
    """Markers (180, 13, 3) of the performer: standing, the right hand raised, walking on the spot."""
    performer = Performer(noise_mm=0.0, hides=False)
    return np.array([performer.markers(k, true_pose(k / RATE)) for k in range(180)])


MOVES = moves()
RIGHT_HAND, HIP, LEFT_FOOT = (MARKERS.index(n) for n in ("wrist_r", "hip_l", "ankle_l"))
RAISED, STEPS = 90, slice(120, 180)
"""The frame in which the hand is highest, and those of walking."""


def through(
    operator: Operator[object], spec: StreamSpec, data: Samples
) -> tuple[dict[str, StreamSpec], dict[str, Array]]:
    """The specs and samples of an operator's outputs."""
    specs = operator.open({"in": spec})
    rows = data.reshape(len(data), -1)
    made = operator.process("in", Chunk(grid(RATE, len(data)), rows, 10**12))
    chunks = [("out", made)] if isinstance(made, Chunk) else made or []
    return specs, {port: chunk.data for port, chunk in chunks}


def rises(hand: Samples, other: Samples) -> float:
    """By how much the hand is higher over the other point than at the beginning, when it is raised."""
    return float((hand - other)[RAISED] - (hand - other)[30])


@pytest.mark.parametrize("source", SOURCES)
def test_a_raised_hand_moves_up_in_the_whole_pose(source: str) -> None:
    specs, out = through(WholePose(), *performed(source, MOVES, MARKERS))
    hand, hips = (out["joints"][:, BONES.index(bone)] for bone in ("RightHand", "Hips"))
    assert rises(hand[:, 1], hips[:, 1]) > 0.4
    left_of = out["joints"][:, BONES.index("LeftFoot"), 0] - out["joints"][:, BONES.index("RightFoot"), 0]
    assert left_of[30] > 0.1, "the left foot is to the left of a body that faces z"
    assert Axes.of(specs["joints"]) == Axes.of(specs["pose"]) == BODY


@pytest.mark.parametrize("source", [name for name in SOURCES if name != "left-handed"])
def test_a_raised_hand_moves_up_in_normalised_poses(source: str) -> None:
    spec, data = performed(source, MOVES, MARKERS)
    root = {"root": ("hip_l", "hip_r")}
    specs, out = through(Pose(joints=root), spec, data)
    at = list(specs["out"].channels)
    assert rises(out["out"][:, at.index("wrist_r.y")], out["out"][:, at.index("ankle_r.y")]) > 40.0
    assert np.median(out["out"][:, at.index("wrist_l.x")]) > 0 and Axes.of(specs["out"]) == BODY
    specs, out = through(NormalisedPose("hip_l", "hip_r"), spec, data)
    at = list(specs["out"].channels)
    rise = rises(out["out"][:, at.index("wrist_r.y")], out["out"][:, at.index("hip_r.y")])
    assert rise > 0.4 * PER_M[spec.units[0]]


@pytest.mark.parametrize("source", SOURCES)
def test_who_lifts_a_foot_and_puts_it_forward_moves_the_hoof_so(source: str) -> None:
    limbs = {"hoof_fl": ("ankle_l", "hip_l"), "hoof_fr": ("ankle_r", "hip_r")}
    actors = Actors(limbs=limbs, learn_s=1.0)
    specs, out = through(actors, *performed(source, np.concatenate([MOVES[STEPS]] * 3), MARKERS))
    hoof = out["out"][:, specs["out"].channels.index("hoof_fl")][60:120]
    foot = (MOVES[:, LEFT_FOOT] - MOVES[:, HIP])[STEPS]
    for axis, what in ((1, "height"), (2, "forward")):
        assert np.corrcoef(hoof[:, axis], foot[:, axis])[0, 1] > 0.6, what
    specs, out = through(SteerMesh(), specs["out"], out["out"])
    mesh = out["mesh"][60:120, marked()["hoof_fl"]]
    assert np.corrcoef(mesh[:, 1], foot[:, 1])[0, 1] > 0.5, "the depth camera's mesh was upside down: -.83"
    assert Axes.of(specs["mesh"]) == BODY


@pytest.mark.parametrize("source", SOURCES)
def test_a_mesh_is_the_same_whatever_the_axes_of_its_markers(source: str) -> None:
    stride = np.array([walking(k / 12) for k in range(12)])
    names = tuple(marked())
    _, out = through(SteerMesh(), *performed(source, stride[:, list(marked().values())], names))
    assert np.linalg.norm(out["mesh"] - stride, axis=-1).mean() < 0.02


@pytest.mark.parametrize("source", [name for name in SOURCES if name != "left-handed"])
def test_a_raised_hand_moves_up_in_a_map_of_poses(source: str, tmp_path: Path) -> None:
    spec, data = performed(source, MOVES, MARKERS)
    write_recording(tmp_path / "m.mcap", [Series("m", spec, grid(RATE, len(data)), data)], {"graph": "", "session": {}})
    (made,) = PoseReading(RATE, None, "hip_l", "hip_r").read(tmp_path / "m.mcap")
    poses = made.poses.reshape(len(made.poses), -1, 3)
    assert rises(poses[:, RIGHT_HAND, 1], poses[:, HIP, 1]) > 0.4


@pytest.mark.parametrize("source", ["Walkway", "NatNet", "Qualisys"])
def test_contacts_are_the_same_whichever_axis_points_up(source: str) -> None:
    walk = np.array([0.1 * np.sin(2 * np.pi * k / RATE) for k in range(300)])
    foot = np.stack([0 * walk, 0.1 + 0.5 * np.abs(walk), 4 * walk], axis=-1)
    hip = np.stack([0 * walk, 0.9 + 0 * walk, 0 * walk], axis=-1)
    spec, data = performed(source, np.stack([foot, hip], axis=1), ("foot", "hip"))
    operator = MarkerContacts(marker="foot", reference="hip")
    operator.open({"in": spec})
    made = operator.process("in", Chunk(grid(RATE, len(data)), data, 10**12))
    found = {port: len(chunk) for port, chunk in made}  # type: ignore[union-attr]
    assert found["touchdown"] >= 7 and found["liftoff"] >= 7


@pytest.mark.parametrize("source", [name for name in SOURCES if name != "not declared"])
def test_turned_points_have_y_up_and_z_forward(source: str) -> None:
    specs, out = through(TurnAxes(), *performed(source, MOVES, MARKERS))
    unit = PER_M[specs["out"].units[0]]
    height, front = (out["out"].reshape(len(MOVES), -1, 3)[..., axis] / unit for axis in (1, 2))
    np.testing.assert_allclose(height, MOVES[..., 1], atol=1e-12)
    declared = Axes.of(specs["out"])
    assert declared and declared.up == "y" and not declared.left_handed
    np.testing.assert_allclose(front, MOVES[..., 2], atol=1e-12)


def test_turning_needs_axes_that_are_declared_or_said_once() -> None:
    plain = StreamSpec((2, 3), rate_hz=RATE, units=("m",))
    with pytest.raises(ParameterError, match=r"from_up is empty; .*the input does not declare its axes"):
        TurnAxes().open({"in": plain})
    assert describe_axes(TurnAxes(from_up="z").open({"in": plain})["out"]) == "y up"
    assert describe_axes(TurnAxes(from_up="z", from_forward="x").open({"in": plain})["out"]) == "y up, z forward"
    with pytest.raises(ParameterError, match=r"left out: the input declares -y up, -z forward"):
        TurnAxes(from_up="z").open({"in": plain.derive(meta=in_axes(plain, CAMERA))})
    with pytest.raises(ParameterError, match="along another axis than y"):
        TurnAxes(forward="-y").open({"in": plain.derive(meta=in_axes(plain, CAMERA))})
    with pytest.raises(InputError, match=r"points \(points, 3\)"):
        TurnAxes().open({"in": NatNet(bodies=("a",)).specs()["rotations"]})


@pytest.mark.parametrize("up", WAYS)
@pytest.mark.parametrize("forward", ["", *WAYS])
@pytest.mark.parametrize("left_handed", [False, True])
def test_axes_turned_there_and_back_are_as_before(up: str, forward: str, left_handed: bool) -> None:
    if forward[-1:] == up[-1:]:
        return
    axes, points = Axes(up, forward, left_handed), np.arange(3.0) + 1.0
    (columns, signs), (back, its_signs) = axes.to(BODY), BODY.to(axes)
    there = points[list(columns)] * signs
    np.testing.assert_array_equal(there[list(back)] * its_signs, points)
    turn = np.eye(3)[list(columns)] * np.array(signs)[:, None]
    assert np.linalg.det(turn) == pytest.approx(-1.0 if left_handed else 1.0)
    height = points["xyz".index(up[-1])] * (-1.0 if up[0] == "-" else 1.0)
    assert there[1] == height
    assert Axes.from_facts(json.loads(json.dumps(axes.facts()))) == axes


@pytest.mark.parametrize(
    "facts", ["gravity", {}, {"up": 5}, {"up": "y", "forward": "-y", "handed": "right"}, [1], None]
)
def test_what_declares_no_axes_is_not_declared(facts: object) -> None:
    assert Axes.from_facts(facts) is None
    described("a", StreamSpec((2, 3), rate_hz=RATE, units=("m",), meta={"axes": facts}))


def test_an_axis_that_contradicts_the_stream_is_refused() -> None:
    spec, _ = performed("Oak with a network", MOVES, MARKERS)
    WholePose(up="-y").open({"in": spec})
    for operator in (
        WholePose(up="y"),
        Pose(up="z", joints={"root": ("hip_l", "hip_r")}),
        NormalisedPose("hip_l", "hip_r", up="y"),
    ):
        with pytest.raises(
            ParameterError, match=r"up is '.'; it must be left out: the input declares -y up, -z forward"
        ):
            operator.open({"in": spec})
    mirrored, _ = performed("left-handed", MOVES, MARKERS)
    with pytest.raises(InputError, match=r"y up, z forward, left-handed; .*TurnAxes"):
        NormalisedPose("hip_l", "hip_r").open({"in": mirrored})


def test_points_scaled_along_each_axis_declare_the_axes_that_come_out() -> None:
    spec, data = performed("Oak with a network", MOVES, MARKERS)
    specs, out = through(Scale(gain=(1.0, -1.0, -1.0)), spec, data)
    np.testing.assert_array_equal(out["out"].reshape(MOVES.shape), data * [1.0, -1.0, -1.0])
    assert Axes.of(specs["out"]) == BODY
    specs, out = through(Scale(gain=100.0, offset=(0.0, 1.0, 2.0), unit="cm"), spec, data)
    np.testing.assert_array_equal(out["out"].reshape(MOVES.shape), data * 100.0 + [0.0, 1.0, 2.0])
    assert Axes.of(specs["out"]) == CAMERA and specs["out"].units == ("cm",)
    assert Axes.of(Scale(gain=(-1.0, 1.0, 1.0)).open({"in": spec})["out"]) == Axes("-y", "-z", left_handed=True)
    with pytest.raises(ParameterError, match="one number, or 3: one each for x, y and z"):
        Scale(gain=(1.0, 2.0)).open({"in": spec})
    with pytest.raises(InputError, match="a signal or points"):
        Scale(gain=(1.0, 2.0)).open({"in": DEPTH})


def test_markers_of_two_people_become_one_stream_in_the_first_ones_axes_and_unit() -> None:
    one, his = performed("Oak with a network", MOVES, MARKERS)
    other, hers = performed("Walkway", MOVES + 1.0, MARKERS)
    operator = Align()
    spec = operator.open({"him": one, "her": other})["out"]
    assert spec.shape == (26, 3) and spec.channels[:1] + spec.channels[-1:] == ("him.hip_l", "her.head")
    assert spec.units == ("m",) and Axes.of(spec) == CAMERA
    time = grid(RATE, len(MOVES))
    made = [
        operator.process(port, Chunk(time, data, until))
        for port, data, until in (("her", hers, 0), ("him", his, 10**12))
    ]
    rows = np.concatenate([chunk.data for chunk in [*made, operator.close()] if isinstance(chunk, Chunk)])
    np.testing.assert_array_equal(rows[:, :13], his)
    np.testing.assert_allclose(rows[:, 13:], performed("Oak with a network", MOVES + 1.0, MARKERS)[1], atol=1e-12)
    with pytest.raises(InputError, match=r"in: .*axes not declared|axes not declared.*-y up"):
        Align().open({"in": one, "plain": performed("not declared", MOVES, MARKERS)[0]})
    with pytest.raises(InputError, match=r"points \(points, 3\), as the first input"):
        Align().open({"in": one, "plain": StreamSpec((2,), rate_hz=RATE)})


@pytest.mark.parametrize("kind", [".c3d", ".trc"])
@pytest.mark.parametrize("source", ["Oak with a network", "Walkway", "Performer", "left-handed"])
def test_exported_markers_have_up_where_the_file_says_it(
    source: str, kind: str, kinegraph: Command, tmp_path: Path
) -> None:
    spec, data = performed(source, MOVES, MARKERS)
    write_recording(tmp_path / "m.mcap", [Series("m", spec, grid(RATE, len(data)), data)], {"graph": "", "session": {}})
    kinegraph("files", "export", tmp_path / "m.mcap", "-o", tmp_path / f"m{kind}")
    if kind == ".trc":
        rows = np.loadtxt((tmp_path / "m.trc").read_text().splitlines()[6:], delimiter="\t")
        up = rows[:, 2:].reshape(len(rows), -1, 3)[..., 1]
    else:
        written = ezc3d.c3d(str(tmp_path / "m.c3d"))
        axis = written["parameters"]["POINT"]["Y_SCREEN"]["value"][0]
        up = (-1.0 if axis[0] == "-" else 1.0) * written["data"]["points"]["XYZ".index(axis[-1])].T
        (series,) = read_c3d(tmp_path / "m.c3d")
        declared = Axes.of(series.spec)
        assert declared and declared.up == axis.lower().lstrip("+")
    np.testing.assert_allclose(up / PER_M[spec.units[0]], MOVES[..., 1], atol=1e-5)


def test_importers_declare_what_files_say_and_what_they_are_told(kinegraph: Command, tmp_path: Path) -> None:
    rows = np.column_stack([np.arange(40) / RATE, np.ones((40, 60))])
    np.savetxt(tmp_path / "k.csv", rows, delimiter=",")
    (series,) = read_kinect(tmp_path / "k.csv")
    assert series.spec.channels == ONE and describe_axes(series.spec) == "y up, -z forward"
    assert describe_axes(Vmc().specs()["out"]) == "y up, z forward"
    (tmp_path / "b.bvh").write_text(
        "HIERARCHY\nROOT hip\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\nEnd Site\n{\nOFFSET 0 9 0\n}\n}\n"
        "MOTION\nFrames: 2\nFrame Time: .05\n0 90 0\n0 91 0\n"
    )
    assert next(describe_axes(one.spec) for one in read_bvh(tmp_path / "b.bvh", "cm")) == "axes not declared"
    kinegraph(
        "files", "import", tmp_path / "b.bvh", "--unit", "cm", "--up", "y", "--forward", "z", "-o", tmp_path / "b.mcap"
    )
    with Recording.open(tmp_path / "b.mcap") as recording:
        assert {describe_axes(one.spec) for one in recording.streams.values()} <= {"y up, z forward", ""}
    refused(
        kinegraph("files", "import", tmp_path / "b.bvh", "--unit", "cm", "--up", "up", "--preview"),
        "--up up",
        "x, y, z",
    )
    refused(kinegraph("files", "import", tmp_path / "b.bvh", "--unit", "cm", "--up", "c=y", "--preview"), "--up c=")
    refused(
        kinegraph("files", "import", tmp_path / "k.csv", "--kinect", "--up", "z", "--preview"),
        "declares its axes itself (y up, -z forward)",
    )


def test_check_prints_the_axes_of_points(kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(
        "nodes:\n  people: {use: devices.people.performer.Performer}\n"
        "  pose: {use: operators.pose.WholePose, from: people.markers}\n"
    )
    output = kinegraph("check", tmp_path / "g.yaml")
    assert "13 x 3 float64 at 30 Hz in m; y up, z forward" in " ".join(output[1].split())
    plain = StreamSpec((2, 3), rate_hz=RATE, units=("mm",))
    assert describe_axes(plain) == "axes not declared"
    assert describe_axes(StreamSpec((2,), rate_hz=RATE, units=("uV",))) == ""


def test_a_recording_of_positions_and_their_poses_is_one_sequence_of_a_map(tmp_path: Path) -> None:
    spec, data = performed("Performer", MOVES, MARKERS)
    poses = np.array([true_pose(k / RATE) for k in range(len(MOVES))])
    time = grid(RATE, len(MOVES))
    made = [Series("one.markers", spec, time, data), Series("one.pose", Performer().specs()["pose"], time, poses)]
    write_recording(tmp_path / "m.mcap", made, {"graph": "", "session": {}})
    assert [one.name for one in PoseReading(RATE, None, "hip_l", "hip_r").read(tmp_path / "m.mcap")] == ["m"]


def test_a_model_is_trained_in_the_axes_of_its_recording(kinegraph: Command, tmp_path: Path) -> None:
    stride = np.array([walking(k / 12) for k in range(12)])
    low = stride[..., [0, 2, 1]] * [1.0, -1.0, 1.0]  # z up
    names = tuple(marked())
    (tmp_path / "markers.yaml").write_text(json.dumps({"markers": marked(), "reference": ["withers", "croup"]}))
    for name, axes, mesh in (("body", BODY, stride), ("lab", Axes("z", "-y"), low), ("none", None, low)):
        spec = topology().spec(12.0, meta={"axes": axes.facts()} if axes else {})
        write_recording(
            tmp_path / f"{name}.mcap", [Series("mesh", spec, grid(12.0, 12), mesh)], {"graph": "", "session": {}}
        )
        model = tmp_path / f"{name}.npz"
        kinegraph(
            "motion",
            "train",
            "steering",
            tmp_path / f"{name}.mcap",
            "--markers",
            tmp_path / "markers.yaml",
            "-o",
            model,
        )
        specs, out = through(SteerMesh(model=model), *performed("Qualisys", stride[:, list(marked().values())], names))
        assert Axes.of(specs["mesh"]) == axes
        assert np.linalg.norm(out["mesh"] - mesh, axis=-1).mean() < 0.02, name
    output = kinegraph("motion", "train", "steering", tmp_path / "body.mcap", tmp_path / "lab.mcap", "--markers", tmp_path / "markers.yaml",
                     "-o", tmp_path / "x.npz")  # fmt: skip
    refused(output, "has other axes than the one before", code=2)


def test_points_go_out_by_osc_as_they_are() -> None:
    spec, _ = performed("Oak with a network", MOVES, MARKERS)
    OscPoints().open({"in": spec})
    assert described("m", spec)["down"] and not described("m", performed("Performer", MOVES, MARKERS)[0])["down"]
