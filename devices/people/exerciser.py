"""A simulated person before a depth camera, doing exercises: the skeleton that a Kinect's software makes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import ClassVar

import numpy as np

from kinegraph.devices.simulation.paced import PacedSource
from kinegraph.stream.chunk import NS, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.domain.axes import FACED
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

JOINTS = (
    "hip_center", "spine", "shoulder_center", "head", "shoulder_l", "elbow_l", "wrist_l", "hand_l", "shoulder_r", "elbow_r",
    "wrist_r", "hand_r", "hip_l", "knee_l", "ankle_l", "foot_l", "hip_r", "knee_r", "ankle_r", "foot_r",
)  # fmt: skip
EXERCISES = ("arms", "squat", "knees", "wave")
"""Both arms raised sideways; down and up; one knee after the other; the right hand waved."""
RATE_HZ = 30.0
TAKES_S = {"arms": 1.8, "squat": 2.2, "knees": 1.6, "wave": 1.2}


@dataclass(frozen=True, slots=True)
class Exerciser(PacedSource):
    """Someone faces a camera and does exercises in turn, each some times, and stands for a moment before each.

    joints  (20, 3) float64, m: x to the person's right, y up, z away from the camera; irregular, some 30 Hz, as a Kinect's

    A joint can be out of sight for a while: its coordinates are NaN then.
    Frame i is the same whenever it is made. `Routine` knows what is done when.
    """

    outputs: ClassVar[tuple[str, ...]] = ("joints",)

    exercises: tuple[str, ...] = param(EXERCISES, help=f"of {', '.join(EXERCISES)}, in this order, again and again")
    repetitions: int = param(6, least=1, most=50, help="of each exercise")
    pause_s: float = param(1.5, least=0.0, most=600.0, help="standing before each exercise")
    lost_joint: str = param("", help="a joint that is out of sight for a while")
    lost_s: tuple[float, float] = param((0.0, 0.0), least=0.0, help="from when to when, from the start")
    noise_mm: float = param(6.0, least=0.0, most=100.0, help="standard deviation of every coordinate")
    jitter_ms: float = param(3.0, least=0.0, most=15.0, help="of the frames' times, either way")
    seed: int = param(0, least=0, help="another seed, other tempos and noise")
    duration_s: float = param(60.0, least=0, help="how long; 0: until stopped")

    @property
    def chunk_s(self) -> float:
        return 1 / RATE_HZ

    def specs(self) -> Specs:
        unknown = [name for name in self.exercises if name not in EXERCISES]
        if unknown or not self.exercises:
            raise ParameterError("exercises", list(self.exercises), f"one or more of {', '.join(EXERCISES)}")
        if self.lost_joint and self.lost_joint not in JOINTS:
            raise ParameterError("lost_joint", self.lost_joint, f"one of {', '.join(JOINTS)}")
        if self.lost_s[0] > self.lost_s[1]:
            raise ParameterError("lost_s", list(self.lost_s), "two times in seconds, not falling")
        made = {"simulated": True, "axes": FACED.facts()}
        return {"joints": StreamSpec((20, 3), channels=JOINTS, units=("m",), meta=made)}

    def read(self, feed: Feed) -> None:
        routine, begun = Routine(self), feed.now()
        last = round(self.duration_s * RATE_HZ)
        for frame in range(last) if last else count():
            late = np.random.default_rng((self.seed, frame)).uniform(-self.jitter_ms, self.jitter_ms) * 1e-3
            stamp = begun + round((frame / RATE_HZ + 0.02 + late) * NS)
            if self.realtime and feed.wait(max(0, stamp - feed.now()) / NS):
                return
            if feed.stopped:
                return
            feed.emit(Chunk(np.array([stamp]), routine.joints(frame)[None], stamp), "joints")


class Routine:
    """The exercises in their order: who asks for a frame, or for what is done, gets the same answer every time.

    One exercise is remembered, so that it costs nothing to go on from there; to go back is to begin again.
    """

    def __init__(self, exerciser: Exerciser) -> None:
        self._of = exerciser
        self._first()

    def starts(self, number: int) -> Samples:
        """When each repetition of exercise `number` (0, 1, ... without end) starts, and when the last one ends, in seconds: (n + 1,)."""
        if number < self._number:
            self._first()
        while self._number < number:
            self._next()
        return self._starts

    def _first(self) -> None:
        self._number, self._starts = -1, np.zeros(1)
        self._next()

    def _next(self) -> None:
        self._number, self._since = self._number + 1, float(self._starts[-1])
        tempo = np.random.default_rng((self._of.seed, self._number, 1)).uniform(0.9, 1.1, self._of.repetitions)
        takes_s = TAKES_S[self.exercise(self._number)]
        self._starts = self._since + self._of.pause_s + np.append(0.0, np.cumsum(takes_s * tempo))

    def exercise(self, number: int) -> str:
        """Which one number `number` (0, 1, ... without end) is."""
        return self._of.exercises[number % len(self._of.exercises)]

    def joints(self, frame: int) -> Samples:
        """The skeleton (20, 3) in frame number `frame`."""
        t = frame / RATE_HZ
        if t < self._since:
            self._first()
        while t >= self._starts[-1]:
            self._next()
        number, starts = self._number, self._starts
        k = int(np.searchsorted(starts, t, side="right")) - 1
        share = (t - starts[k]) / (starts[k + 1] - starts[k]) if k >= 0 else 0.0
        made = skeleton(self.exercise(number), share)
        made = made + np.random.default_rng((self._of.seed, frame, 2)).normal(
            0.0, self._of.noise_mm / 1000.0, made.shape
        )
        if self._of.lost_joint and self._of.lost_s[0] <= t < self._of.lost_s[1]:
            made[JOINTS.index(self._of.lost_joint)] = np.nan
        return made


def skeleton(exercise: str, share: float) -> Samples:
    """A body in an exercise's repetition, of which `share` is done: joints (20, 3) in m. Share 0 is standing."""
    up = 0.5 - 0.5 * np.cos(2.0 * np.pi * share)
    down = 0.35 * up if exercise == "squat" else 0.0
    place: dict[str, Sequence[float] | Samples] = {"hip_center": (0.0, -down, 0.0), "spine": (0.0, 0.1 - down, 0.0)}
    place |= {"shoulder_center": (0.0, 0.5 - down, 0.1 * down), "head": (0.0, 0.7 - down, 0.1 * down)}
    for name, side in (("l", -1.0), ("r", 1.0)):
        lift = up if exercise == "arms" else 0.9 * min(1.0, 3.0 * up) if (exercise, name) == ("wave", "r") else 0.0
        angle = np.pi * (0.05 + 0.85 * lift)
        bend = 0.8 * np.sin(6.0 * np.pi * share) * up if (exercise, name) == ("wave", "r") else 0.0
        ahead = 0.5 * up if exercise == "squat" else 0.0
        shoulder = np.array([side * 0.18, 0.45 - down, 0.0])
        elbow = shoulder + 0.28 * np.array([side * np.sin(angle), -np.cos(angle), -ahead])
        wrist = elbow + 0.25 * np.array([side * np.sin(angle + bend), -np.cos(angle + bend), -ahead])
        raised = max(0.0, np.sin(2.0 * np.pi * share) * -side) if exercise == "knees" else 0.0
        hip = np.array([side * 0.09, -0.05 - down, 0.0])
        foot = np.array([side * 0.11, -0.88 + 0.35 * raised, -0.12 * raised])
        knee = (hip + foot) / 2.0 + np.array([0.0, 0.05 * raised, -0.3 * raised - 0.6 * down])
        place |= {
            f"shoulder_{name}": shoulder,
            f"elbow_{name}": elbow,
            f"wrist_{name}": wrist,
            f"hand_{name}": wrist * 1.02,
        }
        place |= {
            f"hip_{name}": hip,
            f"knee_{name}": knee,
            f"ankle_{name}": foot,
            f"foot_{name}": foot + np.array([0.0, -0.06, -0.12]),
        }
    made: Samples = np.array([place[joint] for joint in JOINTS]) + np.array([0.1, 0.1, 2.6])
    return made
