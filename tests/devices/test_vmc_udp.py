"""Poses over the VMC protocol: to python-osc by UDP, from python-osc by UDP, and from one of ours to the other."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinegraph.devices.osc.protocol import OscError, read_osc
from kinegraph.devices.osc.vmc_frames import VmcFrames
from kinegraph.devices.osc.vmc_inlet import Vmc
from kinegraph.devices.osc.vmc_outlet import VmcOutlet
from kinegraph.devices.people.performer import true_pose
from kinegraph.stream.chunk import Chunk, Samples, StreamSpec
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.errors import InputError, KinegraphError, ParameterError
from tests.support.convert_run import DATA
from tests.support.real import needs_data

osc_bundle = pytest.importorskip("pythonosc.osc_bundle", reason="python-osc is not installed")
TREE = usual_body()
POSES = np.array([true_pose(0.3 * k) for k in range(20)])


@pytest.fixture
def receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        port.settimeout(5.0)
        yield port


def sent(
    receiver: socket.socket, poses: Samples, tree: JointTree = TREE, **parameters: object
) -> list[list[tuple[str, list[object]]]]:
    """The messages of every datagram that an outlet sends of some poses, as python-osc reads them."""
    outlet = VmcOutlet(port=receiver.getsockname()[1], **parameters)  # type: ignore[arg-type]
    outlet.open({"pose": tree.spec(30.0)})
    outlet.begin()
    found = []
    for i, pose in enumerate(poses):
        outlet.process("pose", Chunk(np.array([i * 10**9 // 30 + 1]), pose[None], 0))
        receiver.settimeout(0.5)
        while True:
            try:
                data = receiver.recv(65536)
            except TimeoutError:
                break
            found.append([(m.address, list(m.params)) for m in osc_bundle.OscBundle(data)])
            bones = sum(a == "/VMC/Ext/Bone/Pos" for one in found for a, _ in one)
            if bones == len(BONES) * (i + 1):
                break
    outlet.close()
    return found


@pytest.mark.parametrize("most", [1300, 65000])
def test_python_osc_receives_what_was_posed(receiver: socket.socket, most: int) -> None:
    datagrams = sent(receiver, POSES[:4], max_bytes=most)
    assert (len(datagrams) > 4) == (most == 1300)
    bones = [p for one in datagrams for a, p in one if a == "/VMC/Ext/Bone/Pos"]
    assert [p[0] for p in bones] == [*BONES] * 4
    for i, pose in enumerate(POSES[:4]):
        for b, (_, x, y, z, *turn) in enumerate(bones[22 * i : 22 * i + 22]):
            w, qx, qy, qz = pose[3 + 4 * b : 7 + 4 * b]
            assert np.allclose(turn, [qx, -qy, -qz, w], atol=1e-6)
            place = pose[:3] if b == 0 else TREE.offsets[b]
            assert np.allclose((x, y, z), place * [-1, 1, 1], atol=1e-6)
    times = [p[0] for one in datagrams for a, p in one if a == "/VMC/Ext/T"]
    assert np.allclose(times, np.arange(4) / 30, atol=1e-6)


def test_what_is_not_finite_is_not_sent(receiver: socket.socket) -> None:
    broken = POSES[:3].copy()
    broken[1, 7] = np.nan
    assert len([1 for one in sent(receiver, broken[1:2], max_bytes=65000) for _ in one]) == 0


def test_blend_shapes_go_with_the_next_pose(receiver: socket.socket) -> None:
    outlet = VmcOutlet(port=receiver.getsockname()[1], max_bytes=65000)
    outlet.open({"pose": TREE.spec(30.0), "blends": StreamSpec((2,), channels=("Joy", "A"))})
    outlet.begin()
    outlet.process("blends", Chunk(np.array([1]), np.array([[0.25, np.nan]]), 1))
    outlet.process("pose", Chunk(np.array([2]), POSES[:1], 2))
    messages = [(m.address, list(m.params)) for m in osc_bundle.OscBundle(receiver.recv(65536))]
    assert messages[-3:] == [
        ("/VMC/Ext/Blend/Val", ["Joy", 0.25]),
        ("/VMC/Ext/Blend/Val", ["A", 0.0]),
        ("/VMC/Ext/Blend/Apply", []),
    ]
    outlet.close()


def test_another_skeleton_is_turned_into_vrms(receiver: socket.socket) -> None:
    names = {"UpperArm": "Arm", "LowerArm": "ForeArm", "UpperLeg": "UpLeg", "LowerLeg": "Leg"}
    joints = tuple(next((b.replace(k, v) for k, v in names.items() if k in b), b) for b in BONES)
    hanging = TREE.offsets.copy()  # at rest its arms hang: a quarter turn from the T-pose
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        for bone in ("LowerArm", "Hand"):
            b = BONES.index(f"{side}{bone}")
            hanging[b] = [0.0, -sign * TREE.offsets[b, 0], 0.0]
    other = JointTree(joints, TREE.parents, hanging)
    rest = np.concatenate([TREE.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))])
    (message,) = sent(receiver, rest[None], other, max_bytes=65000)
    turns = {p[0]: p[4:] for a, p in message if a == "/VMC/Ext/Bone/Pos"}
    left = Rotation.from_quat(
        [turns["LeftUpperArm"][0], -turns["LeftUpperArm"][1], -turns["LeftUpperArm"][2], turns["LeftUpperArm"][3]]
    )
    assert np.allclose(left.apply([1, 0, 0]), [0, -1, 0], atol=1e-6)
    assert np.allclose(turns["LeftLowerArm"], [0, 0, 0, 1], atol=1e-6)


def test_what_cannot_be_sent_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a stream of poses"):
        VmcOutlet().open({"pose": StreamSpec((3,))})
    with pytest.raises(ParameterError, match="no Hips"):
        VmcOutlet().open({"pose": JointTree(("a", "b"), np.array([-1, 0]), np.zeros((2, 3))).spec(30.0)})
    (tmp_path / "a.vrm").write_bytes(b"glTF" + bytes(30))
    with pytest.raises(KinegraphError, match="is not a VRM avatar"):
        VmcOutlet(avatar=tmp_path / "a.vrm").open({"pose": TREE.spec(30.0)})


@needs_data
def test_an_avatar_gives_the_lengths_that_are_sent(receiver: socket.socket) -> None:
    assert DATA is not None
    avatar = DATA / "body" / "human_female.vrm"
    (message,) = sent(receiver, POSES[:1], avatar=avatar, max_bytes=65000)
    bones = {p[0]: p[1:4] for a, p in message if a == "/VMC/Ext/Bone/Pos"}
    body = np.load(DATA / "body" / "human_female.npz")
    names = body["joint_names"].tolist()
    shank = np.linalg.norm(body["head"][names.index("LeftFoot")] - body["head"][names.index("LeftLeg")])
    assert np.linalg.norm(bones["LeftFoot"]) == pytest.approx(shank, rel=0.02)
    assert bones["Hips"][1] < POSES[0, 1]


class Heard:
    """A feed that keeps what comes, and stops after so many poses."""

    def __init__(self, most: int) -> None:
        self.rows: list[Samples] = []
        self.problems: list[str] = []
        self.most, self.begun = most, threading.Event()

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        self.rows += list(chunk.data)

    def now(self) -> int:
        return 10**9 + len(self.rows)

    def ready(self) -> None:
        self.begun.set()

    def problem(self, kind: str, count: int = 1) -> None:
        self.problems.append(kind)

    @property
    def stopped(self) -> bool:
        return len(self.rows) >= self.most


def test_a_source_hears_what_an_outlet_says() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        number = free.getsockname()[1]
    feed = Heard(len(POSES) - 1)
    thread = threading.Thread(target=Vmc(port=number).read, args=(feed,))
    thread.start()
    assert feed.begun.wait(100)
    outlet = VmcOutlet(port=number)
    outlet.open({"pose": TREE.spec(30.0)})
    outlet.begin()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stray:
        stray.sendto(b"hello", ("127.0.0.1", number))
    for i, pose in enumerate(POSES):
        outlet.process("pose", Chunk(np.array([i + 1]), pose[None], 0))
    outlet.close()
    thread.join(100)
    assert not thread.is_alive() and feed.problems == ["not OSC"]
    assert np.allclose(feed.rows[0], POSES[0], atol=1e-6) and np.allclose(
        feed.rows[-1], POSES[len(feed.rows) - 1], atol=1e-6
    )


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"x",
        b"/a",
        b"/a\x00\x00,q\x00\x00",
        b"/a\x00\x00,f\x00\x00\x00",
        b"#bundle\x00" + bytes(8) + struct.pack(">i", 400) + b"/a\x00\x00",
    ],
)
def test_what_is_no_osc_is_refused(data: bytes) -> None:
    with pytest.raises(OscError):
        read_osc(data)


def test_hostile_messages_give_no_pose_that_is_none() -> None:
    frames = VmcFrames(TREE.offsets[0])
    bone = "/VMC/Ext/Bone/Pos"
    made = frames.feed(
        [(bone, ["Hips", 0.0, 1.0, 0.0, float("nan"), 0.0, 0.0, 1.0]), (bone, ["Hips", *[0.0] * 7]), (bone, ["Hips"])]
    )
    made += frames.feed([(bone, ["Tail", *[0.5] * 7]), (bone, [7, *[0.5] * 7]), ("/VMC/Ext/T", [1.0])])
    made += frames.feed([(bone, ["Hips", *[0.5] * 7]), ("/VMC/Ext/T", [2.0])])
    assert len(made) == 1 and np.isfinite(made[0]).all()


def test_random_bytes_are_refused_or_read_but_never_more() -> None:
    rng = np.random.default_rng(9)
    whole = b"#bundle\x00" + bytes(8) + struct.pack(">i", 12) + b"/a\x00\x00,f\x00\x00" + bytes(4)
    for _ in range(2000):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 3):
            data[at] = rng.integers(0, 256)
        with suppress(OscError):
            read_osc(bytes(data[: rng.integers(0, len(data) + 1)]))
