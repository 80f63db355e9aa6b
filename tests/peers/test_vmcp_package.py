"""vmcp (PyPI), a receiver written elsewhere, hears the poses that we send; in a process of its own, for its licence is the AGPL."""

from __future__ import annotations

import importlib.util
import json
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.osc.vmc_outlet import VmcOutlet
from kinegraph.devices.people.performer import true_pose
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.domain.humanoid import BONES, usual_body

RECEIVER = Path(__file__).with_name("vmcp_receiver.py")
TREE = usual_body()
POSES = np.array([true_pose(0.3 * k) for k in range(4)])

pytestmark = pytest.mark.skipif(importlib.util.find_spec("vmcp") is None, reason="vmcp is not installed")


@pytest.mark.timeout(120)
@pytest.mark.parametrize("most", [1300, 65000], ids=["split", "whole"])
def test_vmcp_hears_every_bone_the_time_and_the_face(most: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, str(RECEIVER), str(port), str(3 / 30 - 1e-3)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout and process.stdout.readline() == "ready\n"
        outlet = VmcOutlet(port=port, max_bytes=most)
        outlet.open({"pose": TREE.spec(30.0), "blends": StreamSpec((1,), channels=("Joy",))})
        outlet.begin()
        outlet.process("blends", Chunk(np.array([1]), np.array([[0.25]]), 1))
        broken = POSES[:1].copy()
        broken[0, 7] = np.nan
        outlet.process("pose", Chunk(np.array([1]), broken, 1))
        for k, pose in enumerate(POSES):
            outlet.process("pose", Chunk(np.array([k * 10**9 // 30 + 1]), pose[None], 0))
        record = [json.loads(line) for line in process.communicate(timeout=60)[0].splitlines()]
        outlet.close()
    bones = [(name, row) for kind, name, row in record if kind == "BoneTransformEvent"]
    assert [name for name, _ in bones] == [*BONES] * len(POSES), "the broken pose is not sent, and no bone is missing"
    for k, pose in enumerate(POSES):
        rows = np.array([row for _, row in bones[k * len(BONES) : (k + 1) * len(BONES)]])
        places = np.vstack([pose[:3], TREE.offsets[1:]]) * [-1, 1, 1]
        turns = pose[3:].reshape(-1, 4)[:, [1, 2, 3, 0]] * [1, -1, -1, 1]
        assert np.allclose(rows[:, :3], places, atol=1e-6) and np.allclose(rows[:, 3:], turns, atol=1e-6)
    of = {kind: [row for k, _, row in record if k == kind] for kind, _, _ in record}
    assert np.allclose(np.ravel(of["RelativeTimeEvent"]), np.arange(4) / 30, atol=1e-6)
    assert of["BlendShapeEvent"] == [[0.25]] * 4 and len(of["BlendShapeApplyEvent"]) == len(of["StateEvent"]) == 4
