"""`python -m bench.body_on_camera`: true joints in the image to markers in space, by depthai's calculator as devices.oak has it; Markdown.

Needs the folder that KINEGRAPH_DATA names, and depthai. The clips are those of bench.body. No network runs: the true joints (shoulders,
elbows, wrists, hips, knees, ankles) are projected into the image, `--off` pixels beside it (one standard deviation), and given to
depthai as a network's key points, all of confidence 0.9. So this is what a network without error would give, and no more.
`--every N`: every N-th frame.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from bench.body import SHOWN, clips
from bench.body_render import CAMERA, Clip
from kinegraph.devices.oak import Oak
from kinegraph.devices.oak.keypoint_sets import COCO
from kinegraph.devices.oak.keypoints import markers_of, sight_of
from kinegraph.devices.oak.library import library
from kinegraph.devices.oak.network import located
from kinegraph.devices.oak.simulated_keypoints import detection
from kinegraph.operators.body.names import MARKERS

LIMBS = SHOWN[1:]
"""The markers that are compared; the truth has no ears, of which the head is made."""
LEAST = 0.5


class OnHost:
    """depthai's nodes without a camera: depth and key points in, markers out."""

    def __init__(self, dai: Any, node: Any, queue: Any) -> None:
        self._dai, self._node, self._queue, self._number = dai, node, queue, 0

    @classmethod
    @contextmanager
    def running(cls, width: int, height: int) -> Iterator[OnHost]:
        dai = library()

        class Both(dai.node.ThreadedHostNode):  # type: ignore[misc, name-defined]
            def __init__(self) -> None:
                dai.node.ThreadedHostNode.__init__(self)
                self.depth, self.sight = self.createOutput(), self.createOutput()

            def run(self) -> None: ...

        with dai.Pipeline(createImplicitDevice=False) as pipeline:
            node = pipeline.create(Both)
            queue = located(dai, pipeline, Oak(width=width, height=height), node.depth, node.sight)
            pipeline.start()
            yield cls(dai, node, queue)

    def markers(self, depth: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Markers (20, 3) and confidence (20,) of a frame (h, w) and the pixels (12, 2) of LIMBS."""
        dai, (height, width) = self._dai, depth.shape
        points = np.full((len(COCO.names), 3), (-1.0, -1.0, 0.0))
        for k, pixel in zip(LIMBS, pixels, strict=True):
            points[COCO.names.index(MARKERS[k])] = *(pixel / (width, height)), 0.9
        fx, fy, cx, cy = CAMERA.tolist()
        lens = dai.ImgTransformation(width, height, [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        frame, sight = dai.ImgFrame(), dai.ImgDetections()
        frame.setData(np.ascontiguousarray(depth).view(np.uint8).reshape(-1))
        frame.setType(dai.ImgFrame.Type.RAW16)
        frame.setWidth(width)
        frame.setHeight(height)
        frame.setStride(2 * width)
        sight.detections = [detection(dai, points, 0.9)]
        for message, output in ((frame, self._node.depth), (sight, self._node.sight)):
            message.setTransformation(lens)
            message.setSequenceNum(self._number)
            message.setTimestamp(timedelta(seconds=1 + self._number / 30))
            message.setTimestampDevice(timedelta(seconds=1 + self._number / 30))
            output.send(message)
        self._number += 1
        (person,) = sight_of(self._queue.get()).people
        return markers_of(person)


def pixels_of(places: np.ndarray, off_px: float, random: np.random.Generator) -> np.ndarray:
    """Where places (n, 3) are in the image."""
    return places[:, :2] / places[:, 2:] * CAMERA[:2] + CAMERA[2:] + off_px * random.standard_normal((len(places), 2))


def on_camera(clip: Clip, off_px: float) -> tuple[np.ndarray, np.ndarray]:
    """How far the markers are off (n, 12) cm, and their confidence, by depthai."""
    random, off, sure = np.random.default_rng(1), [], []
    with OnHost.running(*clip.depth.shape[:0:-1]) as host:
        for depth, truth in zip(clip.depth, clip.truth[:, 1:], strict=True):
            places, confidence = host.markers(depth, pixels_of(truth, off_px, random))
            off.append(100 * np.linalg.norm(places[LIMBS] - truth, axis=1))
            sure.append(confidence[LIMBS])
    return np.stack(off), np.stack(sure)


def row(name: str, off: np.ndarray, sure: np.ndarray) -> str:
    """Mean and median of those given (cm), share of all off by more than 25 cm, share missing (%)."""
    given = off[(sure >= LEAST) & np.isfinite(off)]
    far, missing = 100 * (given > 25).sum() / off.size, 100 - 100 * given.size / off.size
    return f"| {name} | {given.mean():.1f} | {np.median(given):.1f} | {far:.1f} % | {missing:.1f} % |"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.body_on_camera", description=__doc__)
    parser.add_argument("--off", type=float, default=2.0, help="pixels (one standard deviation)")
    parser.add_argument("--every", type=int, default=3)
    given = parser.parse_args()
    print("| clip | mean, cm | median | off by > 25 cm | missing |")
    print("|---|---|---|---|---|")
    groups: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for group, name, clip in clips(Path(os.environ["KINEGRAPH_DATA"]) / "body", given.every):
        k = slice(None, None, given.every)
        clip = Clip(clip.depth[k], clip.infrared[k], clip.empty, clip.truth[k])
        found = on_camera(clip, given.off)
        print(row(name, *found), flush=True)
        groups.setdefault(group, []).append(found)
    for group, all_found in groups.items():
        off, sure = (np.concatenate(part) for part in zip(*all_found, strict=True))
        print(row(f"**{group}**", off, sure))


if __name__ == "__main__":
    main()
