"""A bedroom from above, as a depth camera sees it: bed, sleepers under blankets, a pet, a lamp; with the noise of a Kinect.

Every frame is a function of its number and time alone. The scene is plausible, not physical.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.people.night import Act, NightPlan
from kinegraph.stream.kernel import kernel

Frame = NDArray[np.uint16]
Map = NDArray[np.float32]

FLOOR_MM, BED_MM = 2600.0, 2050.0
"""How far the floor and the mattress are from the camera."""
DISPARITY = 43_500.0 * 8
"""A Kinect measures disparity: 43 500 / depth in mm, in eighths of a pixel."""
NOISE = 0.22
"""Standard deviation of that, in eighths of a pixel: 2.6 mm at 2 m."""
VARIANTS = 8
"""Different patterns of noise; each is shifted otherwise in every frame."""
BREATH_MM = 5.0
LIMBS = {
    "left arm": (-0.09, 0.42, 0.05, 0.07),
    "right arm": (0.09, 0.42, 0.05, 0.07),
    "left leg": (-0.04, 0.74, 0.05, 0.12),
    "right leg": (0.04, 0.74, 0.05, 0.12),
    "head": (0.0, 0.20, 0.06, 0.06),
}
"""Middle (x from the sleeper's, y) and widths, in shares of the image."""
SIDES = (-0.035, 0.0, 0.035)


EMPTY, HEAP = len(SIDES), len(SIDES) + 1
"""An empty bed: made, or with the blanket thrown back."""
WALKS_EVERY_S, WALK_S = 1800.0, 20.0
"""How often, and for how long, a cat walks along the bed."""
NAP_S, NAP_LENGTH_S = 4000.0, 600.0
"""When it lies on the foot of the bed, in s since the night's beginning."""


@dataclass(frozen=True, slots=True)
class Extras:
    """What else is in the room. The lamp is on while the bed is empty: it makes a patch of the frame noisier and partly invalid."""

    pet: bool = True
    lamp: bool = True
    invalid: float = 0.1
    noise: float = 1.0


@kernel(nogil=True)
def _sense(
    base: Map, chest: Map, breath: float, limb: Map, lifted: float, lamp: Map, lit: float, noise: Map, seen: Map,
    invalid: float, place: tuple[int, int, int], out: Frame,
) -> None:  # fmt: skip
    """Depths (h, w) less what has risen, as disparities with noise, in whole mm; 0 where nothing is measured.

    place  which pattern of noise, and by how many rows and columns it is moved
    """
    pattern, down, right = place
    height, width = base.shape
    for y in range(height):
        v = y + down if y + down < height else y + down - height
        for x in range(width):
            u = x + right if x + right < width else x + right - width
            z = base[y, x] - chest[y, x] * breath - limb[y, x] * lifted
            more = 1.0 + lit * lamp[y, x]
            step = np.floor(DISPARITY / z + noise[pattern, v, u] * more + 0.5)
            measured = seen[pattern, v, u] >= invalid + 0.25 * (more - 1.0)
            out[y, x] = np.uint16(DISPARITY / step + 0.5) if measured else np.uint16(0)


def prepare() -> None:
    """Compile what renders, so that nothing compiles while a session runs."""
    flat, pattern = np.full((1, 1), 2000.0, np.float32), np.zeros((1, 1, 1), np.float32)
    _sense(flat, flat, 0.0, flat, 0.0, flat, 0.0, pattern, pattern, 0.0, (0, 0, 0), np.empty((1, 1), np.uint16))


class Bedroom:
    """What the camera sees at any time of the night.

    Several sleepers lie side by side, each with a plan of their own.
    """

    def __init__(
        self, width: int, height: int, plans: tuple[NightPlan, ...], *, extras: Extras = Extras(), seed: int = 0
    ) -> None:
        self.width, self.height, self.plans, self._extras = width, height, plans, extras
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        self._x, self._y = (x + 0.5) / width, (y + 0.5) / height
        self.half = 0.22 if len(plans) == 1 else 0.34
        on_bed = (abs(self._x - 0.5) < self.half) & (abs(self._y - 0.5) < 0.45)
        duvet = 30.0 * ((self._y > 0.3) & on_bed)
        self._ground = (np.where(on_bed, BED_MM, FLOOR_MM) - duvet).astype(np.float32)
        self._middles = [0.5] if len(plans) == 1 else [0.5 - 0.17, 0.5 + 0.17]
        self._limbs = [{n: self._bump(m + dx, *r) for n, (dx, *r) in LIMBS.items()} for m in self._middles]
        self._bodies: dict[tuple[int, int], tuple[Map, Map]] = {}
        self._heaps = [150 * self._bump(m + 0.1, 0.62, 0.07, 0.14) for m in self._middles]
        self._lamp = self._bump(0.12, 0.2, 0.15, 0.15)
        self._nothing = np.zeros((height, width), np.float32)
        random = np.random.default_rng([seed, 13])
        self._noise = (extras.noise * random.normal(0, NOISE, (VARIANTS, height, width))).astype(np.float32)
        self._seen = random.random((VARIANTS, height, width), dtype=np.float32)
        self._onsets = [np.array([act.onset_s for act in p.acts]) for p in plans]
        self._sides = [_sides(p, seed + k) for k, p in enumerate(plans)]
        self._still: tuple[tuple[object, ...], Map, Map] | None = None

    def frame(self, index: int, seconds: float) -> Frame:
        """Frame number `index`, taken `seconds` after the night's beginning: (h, w) uint16 mm, 0 where nothing was measured."""
        base, chest, breath = self._resting(seconds)
        limb, lifted = self._nothing, 0.0
        for k in range(len(self.plans)):
            act = self._act(k, seconds)
            if act is not None and act.part in LIMBS:
                if lifted:
                    base = base - limb * np.float32(lifted)
                limb = self._limbs[k][act.part]
                lifted = act.size_mm * float(np.sin(np.pi * (seconds - act.onset_s) / act.duration_s)) ** 2
        pet = self._pet(seconds)
        if pet is not None:
            base = base - pet
        out = np.empty((self.height, self.width), np.uint16)
        lit = 1.0 if self._extras.lamp and not any(p.in_bed(seconds) for p in self.plans) else 0.0
        place = index % VARIANTS, index * 7919 % self.height, index * 104_729 % self.width
        _sense(
            base, chest, breath, limb, lifted, self._lamp, lit, self._noise, self._seen,
            self._extras.invalid, place, out,
        )  # fmt: skip
        return out

    def _bump(self, x: float, y: float, wide: float, high: float) -> Map:
        bump: Map = np.exp(-(((self._x - x) / wide) ** 2) - ((self._y - y) / high) ** 2).astype(np.float32)
        return bump

    def _act(self, k: int, seconds: float) -> Act | None:
        """The movement of a sleeper that is under way."""
        last = int(np.searchsorted(self._onsets[k], seconds, side="right")) - 1
        act = self.plans[k].acts[last] if last >= 0 else None
        return act if act is not None and seconds < act.end_s else None

    def _resting(self, seconds: float) -> tuple[Map, Map, float]:
        """The depths without breath and limbs; what moves with the breath, and by how much it has risen (mm)."""
        base, chest, breath = self._ground, self._nothing, 0.0
        for k, night in enumerate(self.plans):
            last = int(np.searchsorted(self._onsets[k], seconds, side="right")) - 1
            if last < 0:
                continue
            act, side = night.acts[last], self._sides[k]
            done = min(1.0, (seconds - act.onset_s) / act.duration_s)
            here = self._shape(k, side[last + 1])
            if done < 1.0 and act.part in ("in", "out", "turn"):
                before = self._shape(k, side[last])
                risen = np.float32(1.0 + act.size_mm / 230.0 * np.sin(np.pi * done))
                here = (before * np.float32(1.0 - done) + here * np.float32(done)) * risen
            base = base - here
            if side[last + 1] < len(SIDES) and (done == 1.0 or act.part != "in"):
                if breath:
                    base = base - chest * np.float32(breath)
                chest, breath = self._shape(k, side[last + 1], chest=True), _breath(night, seconds)
        return base, chest, breath

    def _shape(self, k: int, side: int, *, chest: bool = False) -> Map:
        """How high sleeper `k` lies on a side (or that sleeper's chest); beyond the sides: the bed made, or the blanket thrown back."""
        if (k, side) not in self._bodies:
            if side >= len(SIDES):
                shape = self._nothing if side == EMPTY else self._heaps[k]
                self._bodies[k, side] = shape, self._nothing
            else:
                x = self._middles[k] + SIDES[side]
                body = 220 * self._bump(x, 0.43, 0.09, 0.17) + 190 * self._bump(self._middles[k], 0.18, 0.06, 0.06)
                body += 140 * self._bump(x, 0.70, 0.08, 0.20)
                self._bodies[k, side] = body, self._bump(x, 0.36, 0.07, 0.08)
        return self._bodies[k, side][int(chest)]

    def _pet(self, seconds: float) -> Map | None:
        """The cat, where it can be seen."""
        if not self._extras.pet:
            return None
        nap = seconds - NAP_S
        if 0 <= nap < NAP_LENGTH_S:
            return 150 * self._bump(0.5 - 0.14, 0.88, 0.03, 0.04)
        walk = seconds % WALKS_EVERY_S
        if walk < WALK_S:
            return 250 * self._bump(0.5 + self.half + 0.07, 0.1 + 0.8 * walk / WALK_S, 0.025, 0.05)
        return None


def _breath(night: NightPlan, seconds: float) -> float:
    """How far the chest has risen (mm)."""
    second = min(int(seconds), len(night.phase) - 2)
    phase = night.phase[second] + (seconds - second) * (night.phase[second + 1] - night.phase[second])
    return BREATH_MM * float(np.sin(2 * np.pi * phase))


def _sides(night: NightPlan, seed: int) -> list[int]:
    """On which side the sleeper lies before the first movement and after each; EMPTY before the first time in bed, HEAP after it."""
    random = np.random.default_rng([seed, 14])
    sides = [EMPTY]
    for act in night.acts:
        side = sides[-1]
        if act.part == "out":
            side = HEAP
        elif act.part == "in":
            side = 1
        elif act.part == "turn":
            side = (side + 1 + int(random.integers(len(SIDES) - 1))) % len(SIDES)
        sides.append(side)
    return sides
