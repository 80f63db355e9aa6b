"""The shipped config `avatar` with a rendered performer in the camera's place, as fast as it goes, nothing dropped; and its datagrams."""

from __future__ import annotations

import re
import socket
import subprocess
from pathlib import Path

import numpy as np

from kinegraph.devices.osc.protocol import read_osc
from kinegraph.devices.osc.vmc_frames import VmcFrames
from kinegraph.stream.chunk import Samples
from kinegraph.stream.domain.humanoid import usual_body
from tests.support.command_line import KINEGRAPH

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "avatar.yaml"
CAMERA = (
    "  camera:\n    use: devices.people.before_camera.BeforeCamera\n    realtime: false\n    duration_s: {seconds}\n\n"
)


def rendered_config(folder: Path, seconds: float, *, network: bool = False) -> Path:
    """The config in `folder`, its camera exchanged; without `network` depth alone is what it has."""
    text = CONFIG.read_text(encoding="utf-8")
    made, count = re.subn(r"  camera:\n(?:    .*\n)+\n", CAMERA.format(seconds=seconds), text)
    assert count == 1, "configs/avatar.yaml has no camera of the form that this test knows"
    made = made.replace("policy: drop_oldest", "policy: block")
    if not network:
        made = made.replace("needed: false", "needed: false\n    model: no_such_network.tflite")
    path = folder / "avatar_rendered.yaml"
    path.write_text(made, encoding="utf-8")
    return path


def run_and_hear(config: Path, folder: Path, *settings: str) -> tuple[str, Samples, Samples]:
    """Run it to its end: what it said, when the poses that came as datagrams were (s), and the poses (n, 91)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        port.bind(("127.0.0.1", 0))
        port.settimeout(0.2)
        chosen = [w for one in (f"vmc.port={port.getsockname()[1]}", *settings) for w in ("--set", one)]
        command = [str(KINEGRAPH), "run", str(config), "-o", str(folder / "run"), "--view", "lines", *chosen]
        session = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        frames, times, poses, seconds = VmcFrames(usual_body().offsets[0]), list[float](), list[Samples](), 0.0
        try:
            while True:
                try:
                    messages = read_osc(port.recv(65536))
                except TimeoutError:
                    if session.poll() is not None:
                        break
                    continue
                before = seconds
                seconds = next((float(a[0]) for address, a in messages if address == "/VMC/Ext/T"), seconds)  # type: ignore[arg-type]
                for pose in frames.feed(messages):  # a pose is whole when the next one begins
                    times.append(before)
                    poses.append(pose)
            reported = session.communicate(timeout=60)[0]
        finally:
            session.kill()
            session.wait(30)
    assert session.returncode == 0, reported
    return reported, np.array(times), np.array(poses)
