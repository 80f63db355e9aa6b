"""A simulated performer: someone who stands, waves, walks on the spot and squats, with markers on the body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.devices.simulation.paced import FrameSource
from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.domain.axes import BODY
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

MARKED = {
    "hip": "UpperLeg",
    "knee": "LowerLeg",
    "ankle": "Foot",
    "shoulder": "UpperArm",
    "elbow": "LowerArm",
    "wrist": "Hand",
}
MARKERS = (*(f"{name}_{side}" for name in MARKED for side in "lr"), "head")
JOINT_OF = [
    *(BONES.index(f"{side}{bone}") for bone in MARKED.values() for side in ("Left", "Right")),
    BONES.index("Head"),
]
CROWN_M = 0.15
PART_S = 2.0
"""Standing takes this long at first; then waving, walking on the spot and squatting in turn."""


@dataclass(frozen=True, slots=True)
class Performer(FrameSource):
    """Someone before a camera, standing, waving, walking on the spot and squatting in turn; y up, facing z.

    markers  (13, 3) float64, m: hips, knees, ankles, shoulders, elbows, wrists, head; NaN where one is hidden
    pose     the true pose (stream/domain/humanoid.py)

    Sample i is the same whenever and in whatever chunks it is made.
    """

    outputs: ClassVar[tuple[str, ...]] = ("markers", "pose")

    noise_mm: float = param(5.0, least=0.0, help="standard deviation of every coordinate")
    hides: bool = param(True, help="the left hand goes behind the back now and then")
    lost: tuple[float, ...] = param((), least=0.0, help="[from (s), for (s)]: frames that do not arrive; empty: never")
    seed: int = param(0, least=0, help="another seed, other noise")

    def specs(self) -> Specs:
        if len(self.lost) not in (0, 2):
            raise ParameterError("lost", list(self.lost), "two numbers: from (s), for (s)")
        made = {"simulated": True, "axes": BODY.facts()}
        markers = StreamSpec((len(MARKERS), 3), rate_hz=self.rate_hz, channels=MARKERS, units=("m",), meta=made)
        return {"markers": markers, "pose": usual_body().spec(self.rate_hz, meta=made)}

    def prepare(self) -> None:
        true_pose(0.0)

    def read(self, feed: Feed) -> None:
        missing = 0
        for frame, stamp in self.frames(feed, self.rate_hz):
            if self._is_lost(frame / self.rate_hz):
                missing += 1
                continue
            pose = true_pose(frame / self.rate_hz)
            at = np.array([stamp])
            feed.emit(Chunk(at, self.markers(frame, pose)[None], stamp, missing), "markers")
            feed.emit(Chunk(at, pose[None], stamp, missing), "pose")
            missing = 0

    def _is_lost(self, time_s: float) -> bool:
        return bool(self.lost) and self.lost[0] <= time_s < sum(self.lost)

    def markers(self, frame: int, pose: Samples) -> Samples:
        """The markers (13, 3) of a frame."""
        turns, joints = joints_of(usual_body(), pose[None])
        made = joints[0, JOINT_OF]
        w, v = turns[0, JOINT_OF[-1], 0], turns[0, JOINT_OF[-1], 1:]
        u = 2.0 * np.cross(v, [0.0, CROWN_M, 0.0])
        made[-1] += [0.0, CROWN_M, 0.0] + w * u + np.cross(v, u)
        made = made + np.random.default_rng([self.seed, frame]).normal(0.0, self.noise_mm / 1000, made.shape)
        if self.hides and (frame / self.rate_hz) % 9.0 > 7.7:
            made[[MARKERS.index("elbow_l"), MARKERS.index("wrist_l")]] = np.nan
        return made


def true_pose(time_s: float) -> Samples:
    """The performer's pose, a row of the humanoid skeleton, at a time from the beginning."""
    tree = usual_body()
    row = np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))])

    def bend(bone: str, axis: int, angle: float) -> None:
        at = 3 + 4 * BONES.index(bone)
        row[at], row[at + axis] = np.cos(angle / 2), np.sin(angle / 2)

    part, into = int(time_s // PART_S), (time_s % PART_S) / PART_S
    share = np.sin(np.pi * into) ** 2
    wave, walk, squat = (share if part and part % 3 == kind else 0.0 for kind in (1, 2, 0))
    phase = 2.0 * np.pi * 2.0 * into
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        lifted = wave if side == "Right" else 0.0
        bend(f"{side}UpperArm", 3, -sign * (1.3 - 1.9 * lifted))
        if lifted:
            bend(f"{side}LowerArm", 3, -0.9 * lifted + 0.4 * lifted * np.sin(2 * phase))
        else:
            bend(f"{side}LowerArm", 2, -sign * (0.3 + 0.4 * walk * np.sin(phase) * sign))
        step = walk * max(0.0, np.sin(phase) * sign)
        bend(f"{side}UpperLeg", 1, -0.9 * step - 0.8 * squat)
        bend(f"{side}LowerLeg", 1, 1.3 * step + 1.6 * squat)
        bend(f"{side}Foot", 1, -0.4 * step - 0.8 * squat)
    thigh, shank = (abs(tree.offsets[BONES.index(f"Left{bone}"), 1]) for bone in ("LowerLeg", "Foot"))
    row[1] -= (thigh + shank) * (1.0 - np.cos(0.8 * squat))
    return row
