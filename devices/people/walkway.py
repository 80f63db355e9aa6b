"""A simulated overground trial: someone walks through a laboratory with EMG on both lower legs and eight markers on the legs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from typing import ClassVar

import numpy as np

from kinegraph.devices.people.treadmill.signal import Indices, Signal, Walker
from kinegraph.devices.simulation.paced import PacedSource
from kinegraph.stream.chunk import NS, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.domain.axes import Axes
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

MUSCLES = ("LTA", "LMG", "RTA", "RMG")
MARKERS = ("LHIP", "LKNE", "LANK", "LTOE", "RHIP", "RKNE", "RANK", "RTOE")
PELVIS_AND_LEGS = (
    "LASI", "RASI", "LPSI", "RPSI", "LKNE", "LANK", "LHEE", "LTOE", "RKNE", "RANK", "RHEE", "RTOE",
)  # fmt: skip
EMG_HZ, MARKERS_HZ = 1000.0, 100.0
_EVERY = round(EMG_HZ / MARKERS_HZ)
_STEP_MM = 330.0
"""How far an ankle gets before and behind its hip."""


@dataclass(frozen=True, slots=True)
class Walkway(PacedSource):
    """Someone walks along y, with surface EMG on both shins and calves and markers on hips, knees, ankles and toes.

    emg      (4,) float64, mV, 1000 Hz: LTA LMG RTA RMG (tibialis anterior, gastrocnemius medialis)
    markers  (8, 3) float64, mm, 100 Hz: x to the right, y forwards, z up; with `pelvis` (12, 3)

    A foot is farthest before its hip at touch-down, and farthest behind it at lift-off. Sample i is the same whenever and in whatever
    chunks it is made.
    """

    outputs: ClassVar[tuple[str, ...]] = ("emg", "markers")

    speed_m_s: float = param(1.2, above=0.2, most=2.5, help="walking speed")
    cadence_per_min: float = param(55.0, least=30, most=90, help="strides per minute")
    pelvis: bool = param(False, help="markers as for joint angles: on the pelvis instead of the hips, and on the heels")
    seed: int = param(0, least=0, help="another seed, another walk")
    duration_s: float = param(20.0, least=0, help="how long; 0: until stopped")

    @property
    def chunk_s(self) -> float:
        return 1 / MARKERS_HZ

    def specs(self) -> Specs:
        made, names = {"simulated": True}, PELVIS_AND_LEGS if self.pelvis else MARKERS
        placed = {**made, "axes": Axes("z", "y").facts()}
        return {
            "emg": StreamSpec((4,), rate_hz=EMG_HZ, channels=MUSCLES, units=("mV",), meta=made),
            "markers": StreamSpec((len(names), 3), rate_hz=MARKERS_HZ, channels=names, units=("mm",), meta=placed),
        }

    def read(self, feed: Feed) -> None:
        trial, begun = WalkwayTrial(self), feed.now()
        last = round(self.duration_s * MARKERS_HZ)
        for frame in range(last) if last else count():
            due = begun + round((frame + 1) * NS / MARKERS_HZ)
            if self.realtime and feed.wait(max(0, due - feed.now()) / NS):
                return
            if feed.stopped:
                return
            index = np.arange(frame * _EVERY, (frame + 1) * _EVERY)
            stamps = begun + np.round(index * (NS / EMG_HZ)).astype(np.int64)
            feed.emit(Chunk(stamps, trial.emg(index), int(stamps[-1])), "emg")
            feed.emit(Chunk(stamps[:1], trial.markers(index[:1]), int(stamps[0])), "markers")


class WalkwayTrial:
    """The walk itself: any samples of it, in any order. The left leg follows the right one half a mean stride later."""

    def __init__(self, walkway: Walkway) -> None:
        walker = Walker(
            muscles=("TA", "GM"), rate_hz=EMG_HZ, cadence_per_min=walkway.cadence_per_min, seed=walkway.seed
        )
        self._right, self._left = Signal(walker), Signal(walker)
        self._share = walker.stance_percent / 100
        self._half = round(EMG_HZ * 30.0 / walkway.cadence_per_min)
        self._speed_mm_s, self._pelvis = walkway.speed_m_s * 1000, walkway.pelvis

    def emg(self, index: Indices) -> Samples:
        """(n, 4) mV."""
        start, stop = int(index[0]), int(index[-1]) + 1
        left = self._left.read(start + self._half, stop + self._half)[0]
        return np.hstack([left, self._right.read(start, stop)[0]]) / 1000

    def markers(self, index: Indices) -> Samples:
        """(n, 8, 3) mm; with the pelvis (n, 12, 3)."""
        legs = [
            self._leg(index, self._left.phase(index + self._half) % 1, -90.0),
            self._leg(index, self._right.phase(index) % 1, 90.0),
        ]
        if not self._pelvis:
            return np.concatenate(legs, axis=1)
        middle = (legs[0][:, 0] + legs[1][:, 0]) / 2
        spines = [middle + np.array(at) for at in ((-120, 100, 70), (120, 100, 70), (-50, -90, 80), (50, -90, 80))]
        heels = [leg[:, 2] + np.array([0.0, -60.0, -50.0]) for leg in legs]
        feet = [
            np.stack([*leg[:, 1:3].swapaxes(0, 1), heel, leg[:, 3]], 1) for leg, heel in zip(legs, heels, strict=True)
        ]
        return np.concatenate([np.stack(spines, axis=1), *feet], axis=1)

    def touchdowns(self, start: int, stop: int, side: str) -> Indices:
        """The truth: samples at which a foot meets the ground."""
        if side == "right":
            return self._right.gait.touchdowns(start, stop)
        return self._left.gait.touchdowns(start + self._half, stop + self._half) - self._half

    def _leg(self, index: Indices, phase: Samples, aside: float) -> Samples:
        """Hip, knee, ankle and toe (n, 4, 3) of one leg."""
        swing = np.clip((phase - self._share) / (1 - self._share), 0, 1)
        reach = np.where(phase < self._share, np.cos(np.pi * phase / self._share), -np.cos(np.pi * swing)) * _STEP_MM
        forward = self._speed_mm_s * index / EMG_HZ
        lift = 110.0 * np.sin(np.pi * swing) ** 2
        hip = np.stack([np.full_like(phase, aside), forward, 950 + 15 * np.cos(4 * np.pi * phase)], axis=1)
        ankle = np.stack([np.full_like(phase, aside), forward + reach, 90 + lift], axis=1)
        toe = ankle + np.stack([np.zeros_like(phase), np.full_like(phase, 150.0), -70 + 0.2 * lift], axis=1)
        knee = (hip + ankle) / 2 + np.stack(
            [np.zeros_like(phase), 40 + 60 * np.sin(np.pi * swing), np.zeros_like(phase)], axis=1
        )
        return np.stack([hip, knee, ankle, toe], axis=1)
