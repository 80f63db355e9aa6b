"""A walking person, made up: footfalls, surface EMG of the right leg and the ground's push, as a pure function of a sample's index.

Nothing here knows a clock, a thread or a chunk. Sample i depends on the seed and on i alone: random numbers come from a counter-based
generator (Philox) keyed by what they are for, in blocks of fixed length, so any part of the signal can be made again at any time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from kinegraph.stream.chunk import Samples

Indices = NDArray[np.int64]

BURSTS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "ME": ((9, 5, 95), (24, 8, 45), (98, 4, 20)),
    "MA": ((4, 5, 60), (97, 3, 30)),
    "FL": ((9, 5, 110), (28, 8, 40), (97, 4, 25)),
    "RF": ((7, 5, 45), (62, 5, 18), (97, 3, 22)),
    "VM": ((6, 5, 60), (97, 3, 28)),
    "VL": ((7, 5, 75), (97, 3, 35)),
    "ST": ((94, 5, 65), (22, 5, 14)),
    "BF": ((94, 5, 110), (2, 4, 50), (22, 5, 12)),
    "TA": ((2, 4, 130), (76, 7, 90), (95, 4, 60)),
    "PL": ((3, 4, 35), (43, 7, 95), (76, 6, 22)),
    "GM": ((36, 8, 135), (42, 5, 70)),
    "GL": ((38, 7, 95), (20, 6, 20)),
    "SO": ((22, 9, 65), (45, 7, 135)),
}
"""Per muscle: bursts of (centre and standard width in % of the cycle from right touch-down, size in uV rms).

Times follow the textbooks (Perry and Burnfield, "Gait Analysis"; Winter, "The Biomechanics and Motor Control of Human Gait"): extensors
and abductors load at 0-15 %, calf muscles push off at 30-50 %, hamstrings brake the leg at 85-100 %, tibialis anterior lifts the foot in
swing and lowers it after the heel's contact. Sizes are those of an ordinary adult at a comfortable speed.
"""

NAMES: dict[str, str] = {
    "ME": "gluteus medius", "MA": "gluteus maximus", "FL": "tensor fasciae latae", "RF": "rectus femoris",
    "VM": "vastus medialis", "VL": "vastus lateralis", "ST": "semitendinosus", "BF": "biceps femoris",
    "TA": "tibialis anterior", "PL": "peroneus longus", "GM": "gastrocnemius medialis",
    "GL": "gastrocnemius lateralis", "SO": "soleus",
}  # fmt: skip

STEPS, NOISE, FORCE, BURST = range(4)
USUAL_M_S, STANCE_PER_M_S = 1.2, 5.0
_BLOCK = 200
_TAPS = 96
_WEIGHT_N = 700.0


@dataclass(frozen=True, slots=True)
class Walker:
    """Who walks, and how. `cadence_per_min` counts strides (one foot's touch-down to its next); spreads are standard deviations.

    `speeds` are the belt's: from which second on, in m/s; before the first, and by default, 1.2 m/s. The walker answers as people
    do who walk as they like: the ratio of step length to cadence stays (Sekiya 1996), so cadence goes with the root of the speed, and
    stance is 5 % of the cycle shorter per m/s. Muscles keep their size, which real ones do not.

    A leg's touch-downs come `lag` of a stride later, its muscles have the given `share` of their size; legs of one walker share their pace.
    """

    muscles: tuple[str, ...] = tuple(BURSTS)
    rate_hz: float = 1000.0
    cadence_per_min: float = 57.0
    stance_percent: float = 63.0
    jitter_percent: float = 2.0
    noise_uv: float = 2.0
    seed: int = 0
    lag: float = 0.0
    share: float = 1.0
    pace_seed: int | None = None
    speeds: tuple[tuple[float, float], ...] = ()


def random(seed: int, purpose: int, index: int) -> np.random.Generator:
    """The random numbers of one purpose and one block, cycle or fault: always the same ones."""
    return np.random.Generator(np.random.Philox(key=[seed, purpose], counter=[0, 0, 0, index]))


class Gait:
    """When the right foot stands and when it swings. Cycle 0 begins with the first touch-down, 0.4 s or so after sample 0.

    The belt sets the pace, so a touch-down strays from an even beat instead of adding up: by chance from stride to stride (cut at 3
    deviations), and in slow waves of 23 and 61 strides. So each one is known without those before it. All fall on samples, as a
    footswitch's do that is read with the EMG.
    """

    def __init__(self, walker: Walker) -> None:
        self._walker = walker
        self._mean = walker.rate_hz * 60.0 / walker.cadence_per_min
        self._knots, self._beats = self._pace()
        pace = walker.seed if walker.pace_seed is None else walker.pace_seed
        self._wave = random(pace, STEPS, 0).uniform(0, 2 * np.pi, 2)
        self._stray = lru_cache(maxsize=64)(self._make_stray)
        self._touch = lru_cache(maxsize=64)(self._make_touch)

    def cycle_at(self, index: int) -> int:
        """The cycle that a sample lies in; -1 before the first touch-down."""
        cycle = (
            round(float(np.interp(index, self._knots, self._beats))) if len(self._knots) else round(index / self._mean)
        )
        while self.touchdown(cycle) > index:
            cycle -= 1
        while self.touchdown(cycle + 1) <= index:
            cycle += 1
        return cycle

    def touchdown(self, cycle: int) -> int:
        """The sample of a cycle's first ground contact; cycle -1 is the one that sample 0 lies in."""
        return self._touch(cycle)

    def liftoff(self, cycle: int) -> int:
        """The sample at which the foot leaves the ground within a cycle."""
        begin, end = self.touchdown(cycle), self.touchdown(cycle + 1)
        faster = self.speed_at(begin) - USUAL_M_S
        share = (self._walker.stance_percent - STANCE_PER_M_S * faster + 0.6 * self._stray(cycle)[1]) / 100
        stance = round((end - begin) * share)
        return begin + min(end - begin - 1, max(1, stance))

    def touchdowns(self, start: int, stop: int) -> Indices:
        """All touch-downs at samples start..stop-1."""
        cycles = range(self.cycle_at(start), self.cycle_at(stop) + 1)
        return np.array([at for c in cycles if start <= (at := self.touchdown(c)) < stop], np.int64)

    def liftoffs(self, start: int, stop: int) -> Indices:
        """All lift-offs at samples start..stop-1."""
        cycles = range(self.cycle_at(start), self.cycle_at(stop) + 1)
        return np.array([at for c in cycles if start <= (at := self.liftoff(c)) < stop], np.int64)

    def cycles(self, start: int, stop: int) -> Indices:
        """The truth: every cycle that lies whole in samples start..stop-1, as rows (touch-down, lift-off, next touch-down)."""
        found = range(self.cycle_at(start), self.cycle_at(stop) + 1)
        rows = [(self.touchdown(c), self.liftoff(c), self.touchdown(c + 1)) for c in found]
        return np.array([row for row in rows if start <= row[0] and row[2] < stop], np.int64).reshape(-1, 3)

    def _make_touch(self, cycle: int) -> int:
        beat = cycle + self._walker.lag + self._stray(cycle)[0]
        if len(self._knots):
            return round(0.4 * self._walker.rate_hz + float(np.interp(beat, self._beats, self._knots)))
        return round(0.4 * self._walker.rate_hz + self._mean * beat)

    def speed_at(self, index: int) -> float:
        """The belt's speed in m/s at a sample."""
        past = [speed for from_s, speed in self._walker.speeds if from_s * self._walker.rate_hz <= index]
        return past[-1] if past else USUAL_M_S

    def _pace(self) -> tuple[Samples, Samples]:
        """Samples, and how many strides an even walk has made by then, at the ends of stretches of one speed; empty for a single speed."""
        speeds = self._walker.speeds
        if not speeds:
            return np.empty(0), np.empty(0)
        rate = self._walker.rate_hz
        knots = np.array([-60 * rate, *(from_s * rate for from_s, _ in speeds), (speeds[-1][0] + 1e6) * rate])
        strides = np.sqrt(np.array([USUAL_M_S, *(speed for _, speed in speeds)]) / USUAL_M_S) / self._mean
        beats = np.append(0.0, np.cumsum(np.diff(knots) * strides)) - 60 * rate * strides[0]
        return knots, np.asarray(beats)

    def _make_stray(self, cycle: int) -> tuple[float, float]:
        """How far a touch-down is off its beat, in cycles, and a number in -1..1 for its stance."""
        rng = random(self._walker.seed, STEPS, cycle + (1 << 32))
        chance = float(np.clip(rng.standard_normal(), -3, 3)) / np.sqrt(2)
        waves = float(np.sum(np.sin(2 * np.pi * cycle / np.array([23.0, 61.0]) + self._wave)))
        return self._walker.jitter_percent / 100 * (chance + waves), float(rng.uniform(-1, 1))


class Signal:
    """EMG and vertical force of a walker, for any range of samples."""

    def __init__(self, walker: Walker) -> None:
        self.walker = walker
        self.gait = Gait(walker)
        table = [(column, *burst) for column, m in enumerate(walker.muscles) for burst in BURSTS[m]]
        self._column = np.array([row[0] for row in table])
        self._centre, self._width, self._size = np.array([row[1:] for row in table]).T * np.array(
            [[1], [1], [walker.share]]
        )
        self._shape = _shape(walker.rate_hz)
        self.spoil: Callable[[int, Samples], None] = lambda start, emg: None
        """Called with every block of EMG and its first sample's index; may change it in place (see `faults.py`)."""
        self._block = lru_cache(maxsize=4)(self._make_block)
        self._bursts = lru_cache(maxsize=8)(self._make_bursts)

    def read(self, start: int, stop: int) -> tuple[Samples, Samples]:
        """Samples start..stop-1: EMG (n, muscles) in uV and vertical force (n, 1) in N; fresh arrays."""
        emg = np.empty((stop - start, len(self.walker.muscles)))
        force = np.empty((stop - start, 1))
        at = start
        while at < stop:
            number, offset = divmod(at, _BLOCK)
            n = min(_BLOCK - offset, stop - at)
            made = self._block(number)
            emg[at - start : at - start + n] = made[0][offset : offset + n]
            force[at - start : at - start + n] = made[1][offset : offset + n]
            at += n
        return emg, force

    def phase(self, index: Indices) -> Samples:
        """Where in the gait each sample lies, counted in cycles: 3.25 is a quarter through cycle 3.

        Stance and swing are each run through evenly, so that lift-off falls on `stance_percent` in every cycle.
        """
        cycles = np.arange(self.gait.cycle_at(int(index[0])), self.gait.cycle_at(int(index[-1])) + 1)
        touch = np.array([self.gait.touchdown(int(c)) for c in [*cycles, cycles[-1] + 1]], float)
        lift = np.array([self.gait.liftoff(int(c)) for c in cycles], float)
        knots = np.append(np.column_stack([touch[:-1], lift]).ravel(), touch[-1])
        share = self.walker.stance_percent / 100
        ends = np.append(np.column_stack([cycles, cycles + share]).ravel(), cycles[-1] + 1)
        return np.asarray(np.interp(index, knots, ends))

    def on_ground(self, index: Indices) -> Indices:
        """What a footswitch under the foot shows at each sample: 1 on the ground, 0 in swing."""
        return (self.phase(index) % 1.0 < self.walker.stance_percent / 100).astype(np.int64)

    def envelope(self, index: Indices) -> Samples:
        """The standard deviation (n, muscles) in uV of the EMG at the given samples, noise left out: what an envelope estimates."""
        phase = self.phase(index)
        total = np.zeros((len(index), len(self.walker.muscles)))
        for cycle in range(int(phase[0]) - 2, int(phase[-1]) + 2):
            size, late = self._bursts(cycle)
            off = (phase[:, None] - cycle) * 100 - self._centre - late
            burst = size * np.exp(-0.5 * np.square(off / self._width))
            for j, column in enumerate(self._column):
                total[:, column] += burst[:, j]
        return total

    def _make_bursts(self, cycle: int) -> tuple[Samples, Samples]:
        """No stride is like the last: sizes vary by some 12 %, times by 0.7 % of the cycle."""
        rng = random(self.walker.seed, BURST, cycle + (1 << 32))
        n = len(self._column)
        return self._size * np.exp(0.12 * rng.standard_normal(n)), 0.7 * rng.standard_normal(n)

    def _make_block(self, number: int) -> tuple[Samples, Samples]:
        index = np.arange(number * _BLOCK, (number + 1) * _BLOCK)
        muscles = len(self.walker.muscles)
        white = np.concatenate([self._white(number - 1, muscles)[-_TAPS:], self._white(number, muscles)])
        emg = np.empty((_BLOCK, muscles))
        for column in range(muscles):
            emg[:, column] = np.convolve(white[:, column], self._shape, "valid")[1:]
        emg *= np.sqrt(np.square(self.envelope(index)) + self.walker.noise_uv**2)
        self.spoil(number * _BLOCK, emg)
        return emg, self._force(index, number)

    def _white(self, number: int, muscles: int) -> Samples:
        return random(self.walker.seed, NOISE, number + (1 << 32)).standard_normal((_BLOCK, muscles))

    def _force(self, index: Indices, number: int) -> Samples:
        """Body weight's two humps while the foot stands (1.1 times the weight, 0.8 between them), 1.5 N of noise always."""
        phase = self.phase(index) % 1.0 / (self.walker.stance_percent / 100)
        angle = np.pi * np.minimum(phase, 1.0)
        push = _WEIGHT_N * (1.22 * np.sin(angle) + 0.42 * np.sin(3 * angle))
        noise = 1.5 * random(self.walker.seed, FORCE, number + (1 << 32)).standard_normal(_BLOCK)
        return np.asarray(push + noise)[:, None]


def _shape(rate_hz: float) -> Samples:
    """A filter (96 taps) that turns white noise into noise with a muscle's spectrum and a variance of 1.

    The spectrum is that of Shwedyk, Balasubramanian and Scott (IEEE Trans. Biomed. Eng. 24, 1977): power ~ f^2 fh^4 / ((f^2 + fl^2)
    (f^2 + fh^2)^2), here with fl = 60 Hz and fh = 120 Hz.
    """
    f = np.fft.rfftfreq(_TAPS, 1 / rate_hz)
    gain = 120.0**2 * f / np.sqrt((f**2 + 60.0**2) * (f**2 + 120.0**2) ** 2)
    taps = np.roll(np.fft.irfft(gain), _TAPS // 2) * np.hanning(_TAPS)
    return np.asarray(taps / np.sqrt(np.sum(taps**2)))
