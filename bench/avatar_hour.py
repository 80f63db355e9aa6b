"""`python -m bench.avatar_hour`: an hour of the shipped `avatar` at 30 frames a second: whether memory grows, and calibration drifts.

The rendered performer stands in the camera's place and is drawn as fast as the graph takes him, so that an hour of frames takes some
minutes; depth alone, or with `--network` the network too. With `--real-time` the frames come at 30 a second, and those for which there is
no time are left out, as before a camera. Every tenth of the hour: resident memory of the session, the mean distance of
its joints from the true ones, by how much the body stands too high and is turned, and how far a bone's length is from that of the first
frame.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.camera_latency import rendered_config
from kinegraph.devices.people.rendered_performer import POINTS
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.domain.humanoid import BONES, NUMBERS
from kinegraph.stream.recording import Recording

PLACES = {
    **{f"{s}_{joint}": f"{s.title()}{bone}" for s in ("left", "right") for joint, bone in (
        ("shoulder", "UpperArm"), ("elbow", "LowerArm"), ("wrist", "Hand"), ("hip", "UpperLeg"), ("knee", "LowerLeg"), ("ankle", "Foot"),
    )},
}  # fmt: skip
FOLLOWED_S = 8.0
PARTS = 10


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.avatar_hour", description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--network", action="store_true", help="with the network, which takes an hour's half or more")
    parser.add_argument("--real-time", action="store_true", help="30 frames a second, as a camera gives them")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        config = rendered_config(Path(name), alone=not given.network)
        text = config.read_text(encoding="utf-8").replace("avatar.prompt]", "avatar.prompt, pose.joints]", 1)
        pace = f"BeforeCamera\n    realtime: {str(given.real_time).lower()}\n    duration_s: {given.seconds:g}\n"
        text = text.replace("BeforeCamera\n", pace, 1)
        config.write_text(text if given.real_time else text.replace("drop_oldest", "block"), encoding="utf-8")
        began = time.monotonic()
        held = watched(config, Path(name) / "run")
        took = time.monotonic() - began
        with Recording.open(Path(name) / "run") as recording:
            stamps, joints = recording.read("pose.joints")
            true_stamps, true = recording.read("camera.joints")
            poses = recording.read("avatar")[1]
    print(
        f"{len(stamps)} poses in {took:.0f} s, of {len(true)} frames; {int((~np.isfinite(poses)).sum())} numbers not finite"
    )
    print("minute | memory, MiB | joints off, cm | too high, cm | turned, deg | bones longer or shorter, mm")
    _, mine, theirs = np.intersect1d(stamps, true_stamps, return_indices=True)
    kept = (stamps[mine] - true_stamps[0]) / NS > FOLLOWED_S
    mine, theirs = mine[kept], theirs[kept]
    made, meant = joints[mine], true[theirs] * [1.0, -1.0, -1.0]
    length = lengths(made)
    for part, rows in enumerate(np.array_split(np.arange(len(made)), PARTS)):
        off, high, turned = drift(made[rows], meant[rows])
        minute = (true_stamps[theirs[rows[-1]]] - true_stamps[0]) / NS / 60
        share = min(len(held) - 1, int((part + 1) / PARTS * len(held)))
        changed = 1e3 * np.abs(length[rows] - length[0]).max()
        print(f"{minute:.0f} | {held[share]:.1f} | {off:.2f} | {high:.2f} | {turned:.2f} | {changed:.3f}")


def watched(config: Path, folder: Path) -> list[float]:
    """Run the session to its end; its resident memory (MiB), workers included, twice a second."""
    words = ("run", str(config), "-o", str(folder), "--view", "lines", "--set", "vmc.port=39571")
    session = subprocess.Popen(
        [sys.executable, "-m", "kinegraph", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    held: list[float] = []
    while session.poll() is None:
        held.append(sum(resident(pid) for pid in (session.pid, *children(session.pid))))
        time.sleep(0.5)
    if session.returncode:
        raise SystemExit(f"the session ended with {session.returncode}")
    return held or [0.0]


def resident(pid: int) -> float:
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024


def children(pid: int) -> list[int]:
    try:
        found = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    except OSError:
        return []
    return [int(one) for one in found]


def drift(made: Samples, meant: Samples) -> tuple[float, float, float]:
    """Mean distance (cm), mean height (cm) and turn about the vertical (deg) of joints (n, 22, 3) against the true ones (n, 13, 3)."""
    mine = np.stack([made[:, BONES.index(bone)] for bone in PLACES.values()], axis=1)
    true = np.stack([meant[:, POINTS.index(point)] for point in PLACES], axis=1)
    off = 100.0 * float(np.linalg.norm(mine - true, axis=-1).mean())
    high = 100.0 * float((mine - true)[..., 1].mean())
    across = [one[:, 0] - one[:, 1] for one in (mine[:, [list(PLACES).index(f"{s}_shoulder") for s in ("left", "right")]],
                                                true[:, [list(PLACES).index(f"{s}_shoulder") for s in ("left", "right")]])]  # fmt: skip
    a, b = (np.arctan2(one[:, 2], one[:, 0]) for one in across)
    return off, high, float(np.degrees(np.angle(np.exp(1j * (a - b)).mean())))


def lengths(joints: Samples) -> Samples:
    """The lengths (n, 21) m of the bones from each joint's parent to it."""
    return np.asarray(np.linalg.norm(joints[:, 1:] - joints[:, NUMBERS[1:]], axis=-1))


if __name__ == "__main__":
    main()
