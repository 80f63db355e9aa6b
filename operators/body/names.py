"""The names of what a pose network sees (BlazePose), and of the markers that are made of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.domain.axes import CAMERA

LANDMARKS = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer", "left_ear", "right_ear",
    "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_pinky", "right_pinky", "left_index", "right_index", "left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee",
    "right_knee", "left_ankle", "right_ankle", "left_heel", "right_heel", "left_toe", "right_toe", "head",
)  # fmt: skip
"""The network's 33, in its order, and the middle of the ears as the last. Left is the person's own left."""
OTHER_SIDE = np.array(
    [0, 4, 5, 6, 1, 2, 3, 8, 7, 10, 9, 12, 11, 14, 13, 16, 15, 18, 17, 20, 19, 22, 21, 24, 23, 26, 25, 28, 27, 30, 29, 32, 31, 33]
)  # fmt: skip
"""Which landmark each one is when left and right are exchanged."""
SIDED = np.flatnonzero(np.arange(len(OTHER_SIDE)) != OTHER_SIDE)
"""Those that there are left and right."""
MARKERS = (
    "head", "nose", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel", "right_heel", "left_toe", "right_toe",
)  # fmt: skip
TAKEN = np.array([LANDMARKS.index(name) for name in MARKERS])
"""Which landmark each marker is."""
LEFT_RIGHT = np.array(
    [(LANDMARKS.index(n), LANDMARKS.index("right" + n[4:])) for n in LANDMARKS if n.startswith("left")]
)

SEEN = np.dtype([("points", "<f8", (34, 8)), ("presence", "<f8"), ("facing", "<f8", (2,))])
"""What one frame shows of a person, small enough to be recorded where images are not.

points    per landmark: x, y (pixels), depth of the body's surface there (m; NaN: not measured), visibility, presence (0 to 1), and the
          network's own guess of the place (m, from the middle of the hips; x right, y down, z away from the camera)
presence  how sure the network is that there is a person; NaN: not examined
facing    where the shape in the depth image faces: x and z of a vector in the camera's axes, shorter than 1 where that is not sure
"""


def camera_of(spec: StreamSpec) -> tuple[float, float, float, float] | None:
    """fx, fy, cx, cy in pixels of a stream of images, if its spec says them."""
    camera = spec.meta.get("camera")
    if not isinstance(camera, dict):
        return None
    return tuple(float(camera[name]) for name in ("fx", "fy", "cx", "cy"))  # type: ignore[return-value]


def markers_specs(spec: StreamSpec) -> dict[str, StreamSpec]:
    """Made of `spec`: the specs of `markers` (20, 3) in metres, x right, y down, z away from the camera, and of their confidence (20,)."""
    meta = {key: value for key, value in spec.meta.items() if key in ("camera", "device")} | {"axes": CAMERA.facts()}
    facts: dict[str, Any] = {"rate_hz": spec.rate_hz, "settling_s": spec.settling_s, "channels": MARKERS, "meta": meta}
    return {
        "out": StreamSpec((len(MARKERS), 3), units=("m",), **facts),
        "confidence": StreamSpec((len(MARKERS),), **facts),
    }
