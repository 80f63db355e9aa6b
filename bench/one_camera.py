"""`python -m bench.one_camera`: how far markers from one ordinary camera are from those that four cameras triangulate; Markdown.

`--pose2sim FOLDER`: where the package `pose2sim` (BSD-3) was unpacked; its demonstration holds four calibrated videos of one person who
walks, 100 frames at 60 Hz. Truth: the network's landmarks in all four images, triangulated by least squares, those kept that all four show
within 30 of 1088 pixels (some 4 cm). It has the network's own errors, so this says how well one camera stands in for four, and nothing
about the network. `--rendered`: the rendered clips of KINEGRAPH_DATA, whose joints are known exactly; infrared-like, 320 x 240. Needs
`kinegraph files fetch camera-models`.
"""

from __future__ import annotations

import argparse
import io
import os
import time
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from PIL import Image

from kinegraph.devices.cameras.video import Video, container
from kinegraph.devices.cameras.video.source import VideoReading, frames_of
from kinegraph.operators.angles.joint_angles import JointAngles
from kinegraph.operators.body.camera.image_pose import ImagePose
from kinegraph.operators.body.camera.one_camera import OneCamera
from kinegraph.operators.body.names import LANDMARKS, MARKERS
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.domain.axes import CAMERA, Axes

JOINTS = [
    f"{side}_{name}" for name in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")
]
LANDMARK, MARKER = [LANDMARKS.index(name) for name in JOINTS], [MARKERS.index(name) for name in JOINTS]
HIPS = [JOINTS.index("left_hip"), JOINTS.index("right_hip")]
CALIBRATED_WIDTH = 1088
AGREE_PX = 30.0
Run = tuple[np.ndarray, np.ndarray, np.ndarray]
Known = tuple[np.ndarray, np.ndarray, np.ndarray]


def through(
    images: list[np.ndarray], rate: float, camera: tuple[float, ...], height_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Landmarks in the image (n, 34, 8), markers (n, 20, 3) in m, and processor time (s) of each frame."""
    meta = {"camera": dict(zip(("fx", "fy", "cx", "cy"), camera, strict=True))}
    network, placed = ImagePose(), OneCamera(height_m=height_m)
    seen = network.open({"in": StreamSpec(images[0].shape, np.dtype(np.uint8), rate_hz=rate, meta=meta)})["out"]
    placed.open({"in": seen})
    rows, markers, cpu = [], [], []
    for k, image in enumerate(images):
        stamp = np.array([NS + round(k * NS / rate)])
        began = time.process_time()
        chunk = network.process("in", Chunk(stamp, image[None], int(stamp[0])))
        made = placed.process("in", chunk)
        cpu.append(time.process_time() - began)
        rows.append(chunk.data["points"][0])
        markers.append(made[0][1].data[0])
    return np.array(rows), np.array(markers), np.array(cpu)


def video(path: Path, width: int) -> tuple[list[np.ndarray], float, float]:
    """The pictures, their rate, and how many calibrated pixels one of theirs is."""
    source = Video(str(path), width=width)
    reading = VideoReading(source, source.size())
    with container.opened(str(path), 0, 0, 0.0) as (opened, _):
        images = [reading.image(frame) for frame in frames_of(opened, str(path))]
    return images, float(source.specs()["image"].rate_hz or 60.0), CALIBRATED_WIDTH / width


def cameras(path: Path) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Of each camera in a Qualisys calibration: fx, fy, cx, cy (pixels); rotation (3, 3) and move (3,) from the room to the camera (m)."""
    half_turn = np.diag([1.0, -1.0, -1.0])
    for camera in ElementTree.parse(path).getroot().iter("camera"):
        intrinsic, transform = camera.find("intrinsic"), camera.find("transform")
        assert intrinsic is not None and transform is not None
        lens = [
            float(intrinsic.get(k, 0)) / 64 for k in ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
        ]
        turn = np.array([[float(transform.get(f"r{r}{c}", 0)) for c in (1, 2, 3)] for r in (1, 2, 3)])
        place = np.array([float(transform.get(axis, 0)) for axis in "xyz"]) / 1000
        rotation = half_turn @ turn
        yield np.array(lens), rotation, -rotation @ place


def triangulated(
    seen: np.ndarray, lenses: np.ndarray, turns: np.ndarray, moves: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places (m) of points seen at (cameras, points, 3: x, y, weight), and the largest distance (pixels) from what was seen."""
    places, off = np.full((seen.shape[1], 3), np.nan), np.full(seen.shape[1], np.inf)
    projections = [
        np.array([[f[0], 0, f[2]], [0, f[1], f[3]], [0, 0, 1]]) @ np.c_[r, t]
        for f, r, t in zip(lenses, turns, moves, strict=True)
    ]
    for k in range(seen.shape[1]):
        rows = []
        for camera, p in enumerate(projections):
            x, y, weight = seen[camera, k]
            rows += [weight * (x * p[2] - p[0]), weight * (y * p[2] - p[1])]
        if not np.isfinite(rows).all():
            continue
        solved = np.linalg.svd(np.array(rows))[2][-1]
        places[k] = solved[:3] / solved[3]
        shown = [p @ np.append(places[k], 1.0) for p in projections]
        off[k] = max(np.hypot(*(s[:2] / s[2] - seen[c, k, :2])) for c, s in enumerate(shown))
    return places, off


def errors(markers: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distances (n, 12) in m with both at one root; NaN where either is not known."""
    found = markers[:, MARKER]
    off = (found - found[:, HIPS].mean(1, keepdims=True)) - (truth - truth[:, HIPS].mean(1, keepdims=True))
    return np.asarray(np.linalg.norm(off, axis=2))


def flexion(places: np.ndarray, axes: Axes = CAMERA) -> dict[str, np.ndarray]:
    """Knee and hip flexion (degrees) of joints (n, 12, 3)."""
    operator = JointAngles()
    spec = StreamSpec((len(JOINTS), 3), rate_hz=60.0, channels=tuple(JOINTS), units=("m",), meta={"axes": axes.facts()})
    names = operator.open({"in": spec})["out"].channels
    times = np.arange(len(places)) * (NS // 60)
    made = operator.process(
        "in", Chunk(times, np.ascontiguousarray(places.reshape(len(places), -1)), int(times[-1]))
    ).data
    return {
        name: made[:, names.index(name)] for name in ("LKnee.flexion", "RKnee.flexion", "LHip.flexion", "RHip.flexion")
    }


def four_cameras(folder: Path, width: int, height_m: float) -> tuple[list[Run], list[Known], np.ndarray, float]:
    """What each camera alone makes of the walk, the cameras, the joints (n, 12, 3) in the room that all four show, and the rate."""
    demo = folder / "Demo_SinglePerson"
    known = list(cameras(next((demo / "calibration").glob("*.qca.txt"))))
    clips = [video(path, width) for path in sorted((demo / "videos").glob("*.mp4"))]
    runs = [
        through(images, rate, tuple((lens / scale).tolist()), height_m)
        for (images, rate, scale), (lens, _, _) in zip(clips, known, strict=True)
    ]
    _, rate, scale = clips[0]
    lenses, turns, moves = (np.array(part) for part in zip(*known, strict=True))
    n = min(len(run[0]) for run in runs)
    truth, off = np.full((n, len(JOINTS), 3), np.nan), np.full((n, len(JOINTS)), np.inf)
    for i in range(n):
        seen = np.array([run[0][i][LANDMARK][:, [0, 1, 3]] * [scale, scale, 1.0] for run in runs])
        truth[i], off[i] = triangulated(seen, lenses, turns, moves)
    truth[off > AGREE_PX] = np.nan
    return runs, known, truth, rate


def walk(folder: Path, width: int, height_m: float) -> None:
    runs, known, truth, _ = four_cameras(folder, width, height_m)
    n = len(truth)
    agree = 100 * np.isfinite(truth[..., 0]).mean()
    print(f"\nfour calibrated videos of a person who walks, {n} frames; {agree:.0f} % of the joints agree\n")
    print(
        "| camera | root, cm | joints, mean cm | p95 cm | knee flexion, RMS degrees | hip | ms of processor time a frame |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|")
    for camera, (run, (_, rotation, move)) in enumerate(zip(runs, known, strict=True)):
        there = truth @ rotation.T + move
        off_cm = 100 * errors(run[1][:n], there)
        root = 100 * np.linalg.norm(run[1][:n, MARKER][:, HIPS].mean(1) - there[:, HIPS].mean(1), axis=1)
        ours, theirs = flexion(run[1][:n, MARKER]), flexion(there)
        rms = [
            np.sqrt(
                np.nanmean([(ours[f"{side}{joint}.flexion"] - theirs[f"{side}{joint}.flexion"]) ** 2 for side in "LR"])
            )
            for joint in ("Knee", "Hip")
        ]
        print(
            f"| {camera + 1} | {np.nanmedian(root):.0f} | {np.nanmean(off_cm):.1f} | {np.nanpercentile(off_cm, 95):.1f} | {rms[0]:.1f} | "
            f"{rms[1]:.1f} | {1000 * np.median(run[2]):.1f} |"
        )


NAMES = {"shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand", "hip": "UpLeg", "knee": "Leg", "ankle": "Foot"}


def rendered(folder: Path) -> None:
    print(
        "\nrendered clips, joints known exactly\n\n| clip | seen, % | root, cm | joints, mean cm | p95 cm |\n|---|--:|--:|--:|--:|"
    )
    for path in sorted((folder / "body" / "depth").glob("*.npz")):
        clip = np.load(path)
        ends = clip["ir_offsets"]
        images = [
            np.asarray(Image.open(io.BytesIO(clip["ir_jpeg"][ends[i] : ends[i + 1]].tobytes())).convert("L"))
            for i in range(len(clip["depth"]))
        ]
        _, markers, _ = through(images, float(clip["fps"]), tuple(clip["K"].tolist()), 1.75)
        bones = clip["joint_names"].tolist()
        truth = clip["joints"][
            :, [bones.index(name.split("_")[0].capitalize() + NAMES[name.split("_")[1]]) for name in JOINTS]
        ]
        off_cm = 100 * errors(markers, truth)
        root = 100 * np.linalg.norm(markers[:, MARKER][:, HIPS].mean(1) - truth[:, HIPS].mean(1), axis=1)
        seen = 100 * np.isfinite(markers[:, MARKER, 0]).mean()
        print(
            f"| {path.stem} | {seen:.0f} | {np.nanmedian(root):.0f} | {np.nanmean(off_cm):.1f} | {np.nanpercentile(off_cm, 95):.1f} |"
        )


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--pose2sim", type=Path)
    given.add_argument("--rendered", action="store_true")
    given.add_argument("--width", type=int, default=544)
    given.add_argument("--height-m", type=float, default=1.75)
    chosen = given.parse_args()
    if chosen.pose2sim:
        walk(chosen.pose2sim, chosen.width, chosen.height_m)
    if chosen.rendered:
        rendered(Path(os.environ["KINEGRAPH_DATA"]))


if __name__ == "__main__":
    main()
