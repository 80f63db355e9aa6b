"""A sleeper under a blanket, seen by a depth camera above the bed: breathing and movements that are known, the same for a seed.

Everything is a function of time alone, so a camera that was unplugged comes back to the same night. The scene is plausible, not physical:
bumps for head, trunk and legs rise from the mattress, the trunk's with every breath; limbs twitch, and now and then the sleeper turns over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint16]
Map = NDArray[np.float32]

FLOOR_MM, BED_MM = 2600.0, 2050.0
"""How far the floor and the mattress are from the camera."""
BLOCK_S = 60.0
"""Movements are drawn minute by minute."""
BREATH_HZ, BREATH_MM = 0.23, 5.0
SIDES = (-0.06, 0.0, 0.06)
"""Where the trunk lies, in widths of the image off the middle: on the left side, on the back, on the right side."""
VARIANTS = 8
"""Different patterns of noise; each is used in four mirrorings."""

PARTS = {
    "left arm": (0.40, 0.42, 0.05, 0.07),
    "right arm": (0.60, 0.42, 0.05, 0.07),
    "left leg": (0.46, 0.72, 0.05, 0.12),
    "right leg": (0.54, 0.72, 0.05, 0.12),
    "head": (0.50, 0.22, 0.06, 0.06),
}
"""Middle and widths of what moves, in shares of the image's width and height."""


@dataclass(frozen=True, slots=True)
class Movement:
    """One movement: when it begins (s since the sleeper's time 0), how long it takes, what moves and by how much (mm at its height).

    A turn moves the whole body to another side.
    """

    onset_s: float
    duration_s: float
    part: str
    size_mm: float


class Sleeper:
    """What the camera sees at any time."""

    def __init__(
        self,
        width: int,
        height: int,
        *,
        seed: int = 0,
        per_min: float = 1.5,
        invalid: float = 0.1,
        noise_mm: float = 4.0,
    ) -> None:
        """`per_min` movements a minute on average; of the pixels, the share `invalid` is without a measurement, others in every frame."""
        self.width, self.height, self._seed, self._per_min = width, height, seed, per_min
        self._blocks: dict[int, tuple[list[Movement], int, int]] = {}
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        self._x, self._y = x / width, y / height
        on_bed = (abs(self._x - 0.5) < 0.22) & (abs(self._y - 0.5) < 0.45)
        self._ground = np.where(on_bed, BED_MM, FLOOR_MM).astype(np.float32)
        self._limbs = {name: self._bump(*place) for name, place in PARTS.items()}
        still = 190 * self._limbs["head"] + 90 * self._limbs["left leg"] + 90 * self._limbs["right leg"]
        trunk = [self._bump(0.5 + side, 0.45, 0.08, 0.16) for side in SIDES]
        self._bodies = [(still + 230 * bump).astype(np.float32) for bump in trunk]
        self._chest = [self._bump(0.5 + side, 0.38, 0.07, 0.08) for side in SIDES]
        random = np.random.default_rng([seed, 1])
        shape = (VARIANTS, height, width)
        self._noise = np.round(random.normal(0.0, noise_mm, shape)).astype(np.int16)
        self._seen = (random.random(shape, dtype=np.float32) >= invalid).astype(np.uint16)

    def _bump(self, x: float, y: float, wide: float, high: float) -> Map:
        bump: Map = np.exp(-(((self._x - x) / wide) ** 2) - ((self._y - y) / high) ** 2).astype(np.float32)
        return bump

    def movements(self, start_s: float, stop_s: float) -> list[Movement]:
        """Those that begin in this time, in order."""
        first, last = int(start_s // BLOCK_S), int(stop_s // BLOCK_S)
        moved = [m for block in range(first, last + 1) for m in self._block(block)[0]]
        return [m for m in moved if start_s <= m.onset_s < stop_s]

    def breathing_mm(self, seconds: float) -> float:
        """How far the chest has risen from its middle."""
        return float(BREATH_MM * np.sin(2 * np.pi * BREATH_HZ * seconds + 0.8 * np.sin(2 * np.pi * seconds / 47)))

    def frame(self, index: int, seconds: float) -> Frame:
        """Frame number `index`, taken at `seconds`: (height, width) uint16 mm, 0 where nothing was measured."""
        height = self._body(seconds)
        height += self._chest[self._side(seconds)] * np.float32(self.breathing_mm(seconds))
        for movement in self._under_way(seconds):
            if movement.part in self._limbs:
                phase = (seconds - movement.onset_s) / movement.duration_s
                height += self._limbs[movement.part] * np.float32(movement.size_mm * np.sin(np.pi * phase) ** 2)
        depth = (self._ground - height).astype(np.int16)
        noise, seen = self._pattern(index)
        return (depth + noise).astype(np.uint16) * seen

    def _pattern(self, index: int) -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
        """Noise and valid pixels of a frame; the same only every 32 frames."""
        which, mirrored = index % VARIANTS, index // VARIANTS % 4
        rows, columns = slice(None, None, -1 if mirrored & 1 else 1), slice(None, None, -1 if mirrored & 2 else 1)
        return self._noise[which, rows, columns], self._seen[which, rows, columns]

    def _under_way(self, seconds: float) -> list[Movement]:
        block = int(seconds // BLOCK_S)
        return [m for m in self._block(block)[0] if m.onset_s <= seconds < m.onset_s + m.duration_s]

    def _body(self, seconds: float) -> Map:
        """The resting body; while it turns, something between both sides, risen by an arm's breadth."""
        moved, before, after = self._block(int(seconds // BLOCK_S))
        for turn in (m for m in moved if m.part == "turn"):
            phase = (seconds - turn.onset_s) / turn.duration_s
            if 0 <= phase < 1:
                share = np.float32(phase)
                risen = np.float32(1 + turn.size_mm / 230 * np.sin(np.pi * phase))
                return ((1 - share) * self._bodies[before] + share * self._bodies[after]) * risen
        return self._bodies[self._side(seconds)].copy()

    def _side(self, seconds: float) -> int:
        moved, before, after = self._block(int(seconds // BLOCK_S))
        turned = any(m.part == "turn" and seconds >= m.onset_s + m.duration_s for m in moved)
        return after if turned else before

    def _block(self, block: int) -> tuple[list[Movement], int, int]:
        """The movements of a minute, all within it, and the sides on which it begins and ends."""
        if block not in self._blocks:
            if len(self._blocks) > 100:
                self._blocks.clear()
            before, after = self._side_after(block - 1), self._side_after(block)
            self._blocks[block] = (self._drawn(block, turns=before != after), before, after)
        return self._blocks[block]

    def _side_after(self, block: int) -> int:
        """One side for some minutes, then another."""
        return int(np.random.default_rng([self._seed, 2, (block + 10**6) // 5]).integers(len(SIDES)))

    def _drawn(self, block: int, *, turns: bool) -> list[Movement]:
        random = np.random.default_rng([self._seed, 3, block + 10**6])
        moved = [
            Movement(
                round(block * BLOCK_S + float(random.uniform(2, 50)), 3),
                round(float(random.uniform(0.5, 4)), 3),
                str(random.choice(list(PARTS))),
                round(float(random.uniform(20, 120)), 1),
            )
            for _ in range(int(random.poisson(self._per_min)))
        ]
        if turns:
            onset = round(block * BLOCK_S + float(random.uniform(2, 50)), 3)
            moved.append(Movement(onset, round(float(random.uniform(3, 6)), 3), "turn", 100.0))
        return sorted(moved, key=lambda m: m.onset_s)
