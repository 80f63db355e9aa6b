"""The key points that pose networks give, and which of the product's markers each is."""

from __future__ import annotations

from typing import NamedTuple

MARKERS = (
    "head", "nose", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel", "right_heel", "left_toe", "right_toe",
)  # fmt: skip
"""The markers of a body, as operators.body names them."""
INSIDE_M = (
    0.09, 0.02, 0.07, 0.07, 0.055, 0.055, 0.035, 0.035, 0.025, 0.025,
    0.10, 0.10, 0.055, 0.055, 0.04, 0.04, 0.03, 0.03, 0.02, 0.02,
)  # fmt: skip
"""How far behind the body's surface each of them lies (m); as operators.body has it, measured on rendered bodies."""


class KeypointSet(NamedTuple):
    """A network's key points in its order; what is no marker (eyes, fingers) bears a name that no marker has."""

    title: str
    names: tuple[str, ...]


COCO = KeypointSet(
    "COCO",
    (
        "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
        "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    ),
)  # fmt: skip
BLAZEPOSE = KeypointSet(
    "BlazePose",
    (
        "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer", "left_ear",
        "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist",
        "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index", "left_thumb", "right_thumb", "left_hip", "right_hip",
        "left_knee", "right_knee", "left_ankle", "right_ankle", "left_heel", "right_heel", "left_toe", "right_toe",
    ),
)  # fmt: skip
SETS = {len(known.names): known for known in (COCO, BLAZEPOSE)}
"""By the number of points."""
