"""An avatar follows what others see: skeletons of a real Kinect, imported and replayed, and poses that another program sends by VMC."""

from __future__ import annotations

import os
import socket
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.osc.protocol import read_osc
from kinegraph.devices.osc.vmc_frames import VmcFrames
from kinegraph.devices.osc.vmc_outlet import VmcOutlet
from kinegraph.devices.people.performer import true_pose
from kinegraph.stream.chunk import Chunk, Samples
from kinegraph.stream.domain.axes import BODY, FACED
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.recording import Recording
from tests.support.command_line import KINEGRAPH
from tests.support.real import needs_data

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
LIMBS = {
    "LeftUpperArm": ("shoulder_l", "elbow_l"), "RightUpperArm": ("shoulder_r", "elbow_r"),
    "LeftLowerArm": ("elbow_l", "wrist_l"), "RightLowerArm": ("elbow_r", "wrist_r"),
    "LeftUpperLeg": ("hip_l", "knee_l"), "RightUpperLeg": ("hip_r", "knee_r"),
    "LeftLowerLeg": ("knee_l", "ankle_l"), "RightLowerLeg": ("knee_r", "ankle_r"),
}  # fmt: skip
ENDS = {"UpperArm": "LowerArm", "LowerArm": "Hand", "UpperLeg": "LowerLeg", "LowerLeg": "Foot"}
RELAY = """
nodes:
  tracker: {use: devices.osc.vmc_inlet.Vmc, port: %d}
  vmc: {use: devices.osc.vmc_outlet.VmcOutlet, from: {pose: tracker}, port: %d}
record: [tracker]
"""


def command(folder: Path, *arguments: object) -> str:
    done = subprocess.run([KINEGRAPH, *map(str, arguments)], cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def towards(a: Samples, b: Samples) -> Samples:
    return np.asarray((b - a) / np.linalg.norm(b - a, axis=-1, keepdims=True))


@needs_data
@pytest.mark.parametrize("name", ["P1_1_2_p21", "P3_1_1_p23"])
def test_limbs_point_where_a_real_kinects_do(name: str, tmp_path: Path) -> None:
    z = np.load(Path(os.environ["KINEGRAPH_DATA"]) / "segmentation" / "msrc12" / f"{name}.npz")
    rows = np.column_stack([z["t_us"] / 1e3, z["joints_m"].reshape(len(z["t_us"]), -1)])[:600]
    np.savetxt(tmp_path / "gesture.csv", rows, delimiter=",", fmt="%.6f")
    names = ("--kinect", "-o", "gesture.mcap", "--stream", "performer.markers=gesture")
    command(tmp_path, "files", "import", "gesture.csv", *names)
    command(tmp_path, "replay", CONFIGS / "avatar_markers.yaml", "gesture.mcap", "-o", "run")
    with Recording.open(tmp_path / "run") as recording:
        markers, poses = (recording.read(stream)[1] for stream in ("performer.markers", "body.pose"))
        marks = recording.streams["performer.markers"].spec.channels
        tree = JointTree.of(recording.streams["body.pose"].spec)
        columns, signs = FACED.to(BODY)  # a Kinect sees people who face it
    assert len(poses) == 600 and np.isfinite(poses).all()
    joints = joints_of(tree, poses)[1]
    off = []
    for bone, (a, b) in LIMBS.items():
        end = next(bone.replace(k, v) for k, v in ENDS.items() if k in bone)
        mine = towards(*(joints[:, BONES.index(joint)] for joint in (bone, end)))
        seen = towards(*(markers[:, marks.index(mark)][:, columns] * signs for mark in (a, b)))
        off.append(np.degrees(np.arccos((mine * seen).sum(axis=1).clip(-1.0, 1.0))))
    print({bone: round(float(np.median(angle)), 1) for bone, angle in zip(LIMBS, off, strict=True)})
    assert np.median(off) < 8.0 and np.quantile(off, 0.9) < 25.0


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        return int(port.getsockname()[1])


def _send(port: int, poses: Samples, ended: threading.Event) -> None:
    """Poses over and over, 30 a second, as another program would."""
    outlet = VmcOutlet(port=port)
    outlet.open({"pose": usual_body().spec(30.0)})
    outlet.begin()
    k = 0
    while not ended.is_set():
        outlet.process("pose", Chunk(np.array([k * 10**9 // 30 + 1]), poses[k % len(poses)][None], 0))
        k += 1
        time.sleep(1 / 30)
    outlet.close()


def test_poses_of_another_program_reach_an_avatar_and_the_recording(tmp_path: Path) -> None:
    poses = np.array([true_pose(0.1 * k) for k in range(60)])
    into, ended = _free_port(), threading.Event()
    came: list[Samples] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(30.0)
        (tmp_path / "relay.yaml").write_text(RELAY % (into, receiver.getsockname()[1]), encoding="utf-8")
        sender = threading.Thread(target=_send, args=(into, poses, ended))
        run = subprocess.Popen(
            [KINEGRAPH, "run", "relay.yaml", "--for", "3", "-o", "run", "--view", "lines"], cwd=tmp_path
        )
        sender.start()
        try:
            frames = VmcFrames(usual_body().offsets[0])
            while len(came) < 20:
                came += list(frames.feed(read_osc(receiver.recv(65536))))
            assert run.wait(60) == 0
        finally:
            ended.set()
            sender.join()
            run.kill()
    with Recording.open(tmp_path / "run") as recording:
        kept = recording.read("tracker")[1]
    for made in (np.array(came), kept):
        apart = np.abs(made[:, None] - poses[None]).max(axis=2).min(axis=1)
        assert len(made) >= 20 and np.isfinite(made).all() and apart.max() < 1e-3, "a pose that nobody sent"
