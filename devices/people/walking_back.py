"""What an inertial sensor at the lower back of a walking person measures: a pure function of the sample's index, with known steps.

People walk in one of two ways, each person a little differently: "brisk" (fast, with marked heel contacts and a turning pelvis) and
"shuffling" (slow, soft, swaying from side to side). They walk for 25 s, turn round, and stand for 5 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.devices.people.treadmill.signal import Gait, Indices, Walker, random
from kinegraph.stream.chunk import Samples

Manner = Literal["brisk", "shuffling"]
GRAVITY = 9.81
PERSON, NOISE, BLOCK = 21, 22, 256
BOUT_S, WALK_S, TURN_S, RAMP_S = 30.0, 25.0, 2.0, 0.5
"""Every 30 s begin with 25 s of walking, the last two of them a turn; what moves fades in and out within half a second."""
SCATTER = 0.1
"""By how much people of one manner differ, as the standard deviation of each amplitude's logarithm."""


@dataclass(frozen=True, slots=True)
class Amplitudes:
    """Strides per minute; accelerations in m/s2: of the body's rise and fall, its half-step harmonic, forwards, sideways, and the jolt of
    the heel; angular velocities in rad/s: of the pelvis about the vertical, the trunk forwards, and sideways."""

    strides_per_min: float
    rise: float
    harmonic: float
    forwards: float
    sideways: float
    jolt: float
    turning: float
    nodding: float
    swaying: float


MANNERS: dict[Manner, Amplitudes] = {
    "brisk": Amplitudes(58.0, 2.8, 1.1, 1.6, 0.9, 4.0, 0.6, 0.3, 0.25),
    "shuffling": Amplitudes(46.0, 1.5, 0.4, 0.8, 1.5, 1.2, 0.25, 0.15, 0.5),
}


class Back:
    """A sensor at the lower back, sampled at `rate_hz`; `gait` knows every right touch-down, and `steps` those of both feet."""

    def __init__(self, manner: Manner = "brisk", person: int = 0, rate_hz: float = 100.0) -> None:
        rng = random(person, PERSON, 0)
        usual = MANNERS[manner]
        self.rate_hz, self._person = rate_hz, person
        self._of = {
            name: getattr(usual, name) * float(np.exp(SCATTER * rng.standard_normal())) for name in usual.__slots__
        }
        self._phase = 0.3 * rng.standard_normal(4)
        self._axes = _mounting(rng)
        cadence = usual.strides_per_min * float(np.exp(0.4 * SCATTER * rng.standard_normal()))
        self.gait = Gait(Walker((), rate_hz=rate_hz, cadence_per_min=cadence, seed=person))

    def walking(self, index: Indices) -> Samples:
        """How much the person walks at these samples, 0 to 1 (n,)."""
        t = index / self.rate_hz % BOUT_S
        return np.asarray(np.clip(np.minimum(t, WALK_S - t) / RAMP_S, 0.0, 1.0))

    def steps(self, start: int, stop: int) -> Indices:
        """The sample of every heel's contact, of both feet, that lies in start..stop-1 while the person walks."""
        gait = self.gait
        cycles = range(gait.cycle_at(start) - 1, gait.cycle_at(stop) + 1)
        touch = [gait.touchdown(c) for c in cycles]
        middle = [(a + gait.touchdown(c + 1)) // 2 for a, c in zip(touch, cycles, strict=True)]
        found = np.sort(np.array(touch + middle, np.int64))
        found = found[(found >= start) & (found < stop)]
        return np.asarray(found[self.walking(found) >= 1.0])

    def measure(self, index: Indices) -> dict[str, Samples]:
        """acceleration (n, 3) m/s2, angular_velocity (n, 3) rad/s, magnetic_field (n, 3), orientation (n, 4), at consecutive samples."""
        of, phase = self._of, self._phase
        stride = 2 * np.pi * self._strides(index)
        moves = self.walking(index)
        up = (
            of["rise"] * np.sin(2 * stride + phase[0])
            + of["harmonic"] * np.cos(4 * stride + phase[1])
            + self._jolt(index)
        )
        accelerated = np.column_stack(
            [of["forwards"] * np.sin(2 * stride + phase[2] - 1.0), of["sideways"] * np.sin(stride + phase[3]), up]
        )
        turned = np.column_stack(
            [
                of["swaying"] * np.cos(stride + phase[3]),
                of["nodding"] * np.sin(2 * stride + phase[2]),
                of["turning"] * np.cos(stride + 0.4),
            ]
        )
        late = index / self.rate_hz % BOUT_S - (WALK_S - TURN_S)
        noise, still = self._noise(index), np.array([0.0, 0.0, GRAVITY])
        turned = moves[:, None] * turned
        turned[:, 2] += np.where(
            (late > 0) & (late < TURN_S), np.pi**2 / 2 / TURN_S * np.sin(np.pi * late / TURN_S), 0.0
        )
        field = np.tile(np.array([0.43, 0.0, -0.9]), (len(index), 1))
        return {
            "acceleration": (still + moves[:, None] * accelerated + 0.08 * noise[:, :3]) @ self._axes,
            "angular_velocity": (turned + 0.01 * noise[:, 3:6]) @ self._axes,
            "magnetic_field": field @ self._axes + 0.002 * noise[:, 6:],
            "orientation": np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (len(index), 1)),
        }

    def _strides(self, index: Indices) -> Samples:
        """Where in the gait each sample lies, in strides: 3.5 is the left heel's contact of stride 3."""
        cycles = np.arange(self.gait.cycle_at(int(index[0])), self.gait.cycle_at(int(index[-1])) + 2)
        touch = np.array([self.gait.touchdown(int(c)) for c in cycles], float)
        return np.asarray(np.interp(index, touch, cycles.astype(float)))

    def _jolt(self, index: Indices) -> Samples:
        since = self._strides(index) * 2 % 1.0
        return np.asarray(self._of["jolt"] * np.exp(-since / 0.08) * np.cos(2 * np.pi * since / 0.16))

    def _noise(self, index: Indices) -> Samples:
        """Standard normal numbers (n, 9), the same for a sample whenever it is made."""
        first, last = int(index[0]) // BLOCK, int(index[-1]) // BLOCK
        blocks = [random(self._person, NOISE, b).standard_normal((BLOCK, 9)) for b in range(first, last + 1)]
        return np.concatenate(blocks)[index - first * BLOCK]


def _mounting(rng: np.random.Generator) -> Samples:
    """The body's axes forwards, left and up in the sensor's frame (3, 3): worn a little slanted, by everybody differently."""
    turn = np.linalg.qr(np.eye(3) + 0.15 * rng.standard_normal((3, 3)))[0]
    return np.asarray(turn * np.sign(np.diag(turn)))
