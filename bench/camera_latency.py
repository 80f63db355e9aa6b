"""`python -m bench.camera_latency`: from a camera's stamp to the VMC datagram, and from motion to what the datagram says of it.

Runs the shipped config `avatar` in real time, a rendered performer in the camera's place, and receives its datagrams over UDP. Prints one
row of the table in docs/lab/latency.md: the time from a frame's stamp to the last datagram of its pose; the lag of the sent wrists behind
the true ones by cross-correlation, with the filters of the config; both together. `--alone` leaves the network out.

`--webcam`: the shipped config `webcam_avatar` before a camera on the network (640 x 480, 30 frames/s, JPEG over HTTP, drawn on this machine
too): from a frame's stamp to its datagram, with hands and face and without, and the machine's load.
"""

from __future__ import annotations

import argparse
import os
import re
import tempfile
from pathlib import Path

import numpy as np

from bench.avatar import lag_of, received
from kinegraph.devices.cameras.video.simulator import network_camera
from kinegraph.devices.people.rendered_performer import POINTS
from kinegraph.operators.body.network.blazepose import default_model
from kinegraph.stream.chunk import NS
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.recording import Recording

CONFIG = Path(__file__).resolve().parent.parent / "configs" / "avatar.yaml"
CAMERA = "  camera:\n    use: devices.people.before_camera.BeforeCamera\n\n"
FOLLOWED_S = 6.0
"""By then the performer has stepped into view and the avatar follows."""


def rendered_config(folder: Path, *, alone: bool) -> Path:
    """The shipped config with the rendered performer for its camera, in `folder`."""
    text, count = re.subn(r"  camera:\n(?:    .*\n)+\n", CAMERA, CONFIG.read_text(encoding="utf-8"))
    if count != 1:
        raise SystemExit(f"{CONFIG} has no camera of the form that this bench knows")
    text = text.replace("record: [", "record: [camera.joints, ", 1)
    if alone:
        text = text.replace("needed: false", "needed: false\n    model: no_such_network.tflite")
    path = folder / "avatar_rendered.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def webcam(seconds: float) -> None:
    text = (CONFIG.parent / "webcam_avatar.yaml").read_text(encoding="utf-8")
    body = re.sub(r"  (?:hands|fingers|face):\n(?:    .*\n)+\n", "", text)
    body = body.replace("fingers: fingers, blends: face", "").replace("[avatar, fingers, face]", "avatar")
    body = body.replace("hands, fingers, face, ", "")
    print("webcam_avatar | load before | stamp to datagram, p50 | p99 | poses a second\n|---|--:|--:|--:|--:|")
    for title, graph in (("body only", body), ("with hands and face", text)):
        with tempfile.TemporaryDirectory() as name, network_camera(640, 480, 30.0) as camera:
            folder, load = Path(name), os.getloadavg()[0]
            (folder / "graph.yaml").write_text(graph, encoding="utf-8")
            came = received(seconds, folder, [f"url={camera.url}"], str(folder / "graph.yaml"))
            with Recording.open(folder / "run") as recording:
                stamps, _ = recording.read("avatar")
        after = [(sent, now) for sent, now in came if sent > FOLLOWED_S]
        if len(after) < 2:
            print(f"{title} | {load:.1f} | no pose came: give it more --seconds")
            continue
        late = np.array([now - (int(stamps[0]) + sent * NS) for sent, now in after]) / 1e6
        p50, p99 = np.percentile(late, [50, 99])
        print(
            f"| {title} | {load:.1f} | {p50:.0f} ms | {p99:.0f} ms | {len(after) / (after[-1][0] - after[0][0]):.1f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.camera_latency", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--alone", action="store_true", help="depth alone, as where the network is missing")
    parser.add_argument("--set", action="append", default=[], metavar="NODE.PARAMETER=VALUE")
    parser.add_argument("--webcam", action="store_true", help="one ordinary camera in place of the depth camera")
    given = parser.parse_args()
    if given.webcam:
        webcam(given.seconds)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        came = received(given.seconds, folder, given.set, str(rendered_config(folder, alone=given.alone)))
        with Recording.open(folder / "run") as recording:
            stamps, poses = recording.read("avatar")
            true_stamps, true = recording.read("camera.joints")
    if len(came) < 2:
        raise SystemExit("no pose came: give it more --seconds")
    after = [(sent, now) for sent, now in came if sent > FOLLOWED_S] or came
    late = np.array([now - (int(stamps[0]) + sent * NS) for sent, now in after]) / 1e6
    lag_ms = lag_of_wrists(stamps, poses, true_stamps, true)
    seen = "depth alone" if given.alone or not default_model().is_file() else "network and depth"
    p50, p99 = np.percentile(late, [50, 99])
    print("markers from | stamp to datagram, p50 | p99 | lag of wrists | motion to datagram, p50 | p99 | poses")
    print(
        f"{seen} | {p50:.0f} ms | {p99:.0f} ms | {lag_ms:.0f} ms | {lag_ms + p50:.0f} ms"
        f" | {lag_ms + p99:.0f} ms | {len(late)}"
    )


def lag_of_wrists(stamps: np.ndarray, poses: np.ndarray, true_stamps: np.ndarray, true: np.ndarray) -> float:
    """By how many ms the wrists' heights over the hips in `poses` lag behind those of `true` (n, 13, 3), y down."""
    _, mine, theirs = np.intersect1d(stamps, true_stamps, return_indices=True)
    late = (stamps[mine] - stamps[0]) / NS > FOLLOWED_S
    joints, places = joints_of(usual_body(), poses[mine][late])[1], true[theirs][late]
    made = np.stack([joints[:, BONES.index(f"{side}Hand"), 1] - joints[:, 0, 1] for side in ("Left", "Right")], axis=1)
    hips = 0.5 * (places[:, POINTS.index("left_hip"), 1] + places[:, POINTS.index("right_hip"), 1])
    meant = np.stack([hips - places[:, POINTS.index(f"{side}_wrist"), 1] for side in ("left", "right")], axis=1)
    if len(made) < 60:
        return float("nan")
    return 1e3 * lag_of(meant, made, 30.0)


if __name__ == "__main__":
    main()
