"""What an inertial sensor on a walking person's right foot or shank measures: a pure function of the sample's index, with known steps.

The gait is the treadmill's. In every cycle the limb turns about its pitch axis in a few half-sines with turning points at the
distances from lift-off and touch-down that `operators.contacts.inertial` states for real feet (medians over 13 people) and assumes for
shanks. The sensor sits slanted on the limb. Gravity follows the limb's pitch; the swing's push and the landing's jolt are added.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.devices.people.treadmill.signal import Gait, Indices, Walker, random
from kinegraph.stream.chunk import Samples

GRAVITY = 9.81
DIP_RAD = 1.13
"""The magnetic field points so far below the horizontal."""
NOISE, BLOCK = 7, 256
"""The purpose of the random numbers, and samples per block of them."""
_MOUNTING = np.array([0.48, -0.6, 0.64])
"""The pitch axis in the sensor's frame."""

Site = Literal["foot", "shank"]


@dataclass(frozen=True, slots=True)
class LimbTurn:
    """One half-sine of turning: by `angle` rad, from and to seconds after a cycle's touch-down (0), lift-off (1), next one (2)."""

    angle: float
    begin: tuple[int, float]
    end: tuple[int, float]


TURNS: dict[Site, tuple[LimbTurn, ...]] = {
    "foot": (
        LimbTurn(0.35, (0, -0.026), (0, 0.07)),  # the sole comes down
        LimbTurn(1.13, (1, -0.3), (1, 0.031)),  # the heel rises
        LimbTurn(-1.48, (1, 0.031), (2, -0.026)),  # the foot swings
    ),
    "shank": (
        LimbTurn(-1.1, (0, -0.04), (1, 0.07)),  # it leans forwards over the foot
        LimbTurn(1.1, (1, 0.07), (2, -0.04)),  # it swings
    ),
}
SWING_M = 1.1
"""How far the limb gets in a swing."""
JOLT_M_S2, JOLT_S, JOLT_HZ = 25.0, 0.02, 40.0


class Limb:
    """A sensor worn on the right foot or shank, sampled at `rate_hz`; `gait` knows the sample of every touch-down and lift-off."""

    def __init__(
        self, site: Site = "foot", rate_hz: float = 100.0, cadence_per_min: float = 57.0, seed: int = 0
    ) -> None:
        self.rate_hz, self._turns, self._seed = rate_hz, TURNS[site], seed
        self.gait = Gait(Walker((), rate_hz=rate_hz, cadence_per_min=cadence_per_min, seed=seed))
        across = np.cross(_MOUNTING, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        self._axes = np.array([across, _MOUNTING, np.cross(across, _MOUNTING)])
        """Forwards, pitch axis and up, of a level limb, in the sensor's frame (3, 3)."""

    def pitch(self, index: Indices) -> tuple[Samples, Samples]:
        """The limb's pitch (n,) rad, 0 when it began, and its speed (n,) rad/s, at consecutive samples."""
        angle, speed = np.zeros(len(index)), np.zeros(len(index))
        for touch, lift, after in self._cycles(index):
            for turn in self._turns:
                marks = (touch, lift, after)
                begin = marks[turn.begin[0]] / self.rate_hz + turn.begin[1]
                end = marks[turn.end[0]] / self.rate_hz + turn.end[1]
                x = np.clip((index / self.rate_hz - begin) / (end - begin), 0.0, 1.0)
                angle += turn.angle * (1 - np.cos(np.pi * x)) / 2
                speed += turn.angle * np.pi / 2 / (end - begin) * np.sin(np.pi * x)
        return angle, speed

    def measure(self, index: Indices) -> dict[str, Samples]:
        """acceleration (n, 3) m/s2, angular_velocity (n, 3) rad/s, magnetic_field (n, 3), orientation (n, 4), at consecutive samples."""
        angle, speed = self.pitch(index)
        forward, push = self._along(angle), self._push(index)
        up = np.column_stack([-np.sin(angle), np.zeros(len(index)), np.cos(angle)]) @ self._axes
        field = np.cos(DIP_RAD) * forward - np.sin(DIP_RAD) * up
        noise = self._noise(index)
        return {
            "acceleration": GRAVITY * up + push[:, :1] * forward + push[:, 1:] * up + 0.05 * noise[:, :3],
            "angular_velocity": speed[:, None] * self._axes[1] + 0.005 * noise[:, 3:6],
            "magnetic_field": field + 0.002 * noise[:, 6:],
            "orientation": np.column_stack([np.cos(angle / 2), np.sin(angle / 2)[:, None] * _MOUNTING]),
        }

    def _along(self, angle: Samples) -> Samples:
        """The horizontal direction of walking (n, 3) in the sensor's frame."""
        return np.asarray(np.column_stack([np.cos(angle), np.zeros(len(angle)), np.sin(angle)]) @ self._axes)

    def _push(self, index: Indices) -> Samples:
        """The limb's own acceleration (n, 2), forwards and up: there and back in the swing, a jolt at touch-down."""
        push, seconds = np.zeros((len(index), 2)), index / self.rate_hz
        for touch, lift, after in self._cycles(index):
            swing = (after - lift) / self.rate_hz
            x = (seconds - lift / self.rate_hz) / swing
            push[:, 0] += np.where((x > 0) & (x < 1), 2 * np.pi * SWING_M / swing**2 * np.sin(2 * np.pi * x), 0.0)
            since = seconds - touch / self.rate_hz
            jolt = np.where(since >= 0, np.exp(-np.maximum(since, 0) / JOLT_S), 0.0)
            push[:, 1] += JOLT_M_S2 * jolt * np.cos(2 * np.pi * JOLT_HZ * since)
        return push

    def _cycles(self, index: Indices) -> list[tuple[int, int, int]]:
        """(touch-down, lift-off, next touch-down) of every cycle that reaches into these samples."""
        gait = self.gait
        margin = round(0.2 * self.rate_hz)
        numbers = range(gait.cycle_at(int(index[0]) - margin) - 1, gait.cycle_at(int(index[-1]) + margin) + 2)
        return [(gait.touchdown(c), gait.liftoff(c), gait.touchdown(c + 1)) for c in numbers]

    def _noise(self, index: Indices) -> Samples:
        """Standard normal numbers (n, 9), the same for a sample whenever it is made."""
        first, last = int(index[0]) // BLOCK, int(index[-1]) // BLOCK
        blocks = [random(self._seed, NOISE, b).standard_normal((BLOCK, 9)) for b in range(first, last + 1)]
        return np.concatenate(blocks)[index - first * BLOCK]
