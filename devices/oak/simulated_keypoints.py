"""What a pose network on a simulated OAK camera sees of the rendered performer: COCO's key points in the image, as depthai's messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from kinegraph.devices.oak.keypoint_sets import COCO
from kinegraph.devices.people.rendered_performer import AWAY_M, EMPTY_S, HEIGHT_M, body_at, camera_of
from kinegraph.stream.chunk import Samples

EAR_M, EYE_M, EYES_UP_M, EYES_FORWARD_M = 0.09, 0.035, 0.03, 0.09
OFF_PX = 0.004
"""How far off the truth a point is, in widths of the image: one standard deviation."""
SURE, UNSURE = 0.9, 0.1
"""The confidence of a point that the camera sees; of one on the far side of the head."""


def coco_at(seconds: float) -> Samples:
    """COCO's 17 points (m) before the camera: x right, y down, z away from it."""
    joints, heading = body_at(seconds)
    left, forward = (
        np.array([math.cos(heading), 0.0, -math.sin(heading)]),
        np.array([math.sin(heading), 0.0, math.cos(heading)]),
    )
    head, up = joints["head"], np.array([0.0, EYES_UP_M, 0.0])
    made = dict(joints)
    for side, s in (("left", 1.0), ("right", -1.0)):
        made[f"{side}_ear"] = head + s * EAR_M * left
        made[f"{side}_eye"] = head + s * EYE_M * left + EYES_FORWARD_M * forward + up
    points = np.stack([made[name] for name in COCO.names])
    return points * [1.0, -1.0, -1.0] + [0.0, HEIGHT_M, AWAY_M]


class KeypointSight:
    """The network's word at any time."""

    def __init__(self, width: int, height: int, seed: int = 0) -> None:
        self._width, self._height, self._seed = width, height, seed
        self._camera = np.array(camera_of(width, height))

    def lens(self, dai: Any) -> Any:
        """How depthai says the camera's geometry."""
        fx, fy, cx, cy = self._camera.tolist()
        return dai.ImgTransformation(self._width, self._height, [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def points(self, index: int, seconds: float) -> Samples:
        """Of the one person (17, 3): x and y in shares of the image, confidence; (0, 3) without a person."""
        if seconds < EMPTY_S:
            return np.empty((0, 3))
        places = coco_at(seconds)
        fx, fy, cx, cy = self._camera
        off = OFF_PX * self._width * np.random.default_rng([self._seed, 5, index]).standard_normal((len(places), 2))
        pixels = places[:, :2] / places[:, 2:] * [fx, fy] + [cx, cy] + off
        points = np.column_stack([pixels / [self._width, self._height], np.full(len(places), SURE)])
        ears = [COCO.names.index(name) for name in ("left_ear", "right_ear")]
        far = places[ears, 2] > places[ears, 2].min() + EAR_M
        points[np.array(ears)[far], 2] = UNSURE
        return points

    def message(self, dai: Any, index: int, seconds: float) -> Any:
        """The same as depthai's ImgDetections, without number and times."""
        points = self.points(index, seconds)
        message = dai.ImgDetections()
        message.setTransformation(self.lens(dai))
        message.detections = [detection(dai, points, SURE)] if len(points) else []
        return message


def detection(dai: Any, points: Samples, confidence: float) -> Any:
    """A person of these key points (n, 3), x and y in shares of the image, as depthai says it."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    middle, size = ((low + high) / 2).tolist(), (high - low).tolist()
    box = dai.RotatedRect(dai.Point2f(*middle, True), dai.Size2f(*size, True), 0.0)
    person = dai.ImgDetection(box, confidence, 0)
    person.setKeypoints([dai.Keypoint(dai.Point2f(x, y), sure) for x, y, sure in points.tolist()])
    return person
