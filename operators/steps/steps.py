"""Every step of a person who wears one inertial sensor: when it was, how long it took, and its features (thesis, chapter 7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from scipy.signal import butter

from kinegraph.operators.steps.step_detection import APART_S, CUTOFF_HZ, ORDER, find_steps, fresh_track, rule_of
from kinegraph.operators.steps.step_kernel import COUNT, WEINBERG, describe, feature_names, turned_by
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

STEP = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("number", "<i8"),
        ("kind", "<U8"),
        ("duration_s", "<f8"),
        ("length_m", "<f8"),
        ("turn_deg", "<f8"),
        ("features", "<f8", (COUNT,)),
    ]
)
"""A step, from the peak before it (`onset`) to its own (`end`), both where the signal has them. `kind`: "first" has nothing before it: the
person stood, or the signal began; "slow" took longer than `longest_s`, with a pause in it; "turn" turned the body; else "walk". Only walk
and turn have numbers and features; of three channels, those of the angular velocity are NaN."""
STEP_UNITS = ("ns", "ns", "", "", "s", "m", "deg", "")
FACTORS = {"m/s2": 1.0, "m/s^2": 1.0, "g": 9.80665, "rad/s": 1.0, "deg/s": np.pi / 180, "dps": np.pi / 180}
LATE_NS = {"lower_back": 80_000_000, "wrist": 46_000_000, "pocket": 46_000_000, "foot": 46_000_000, "other": 46_000_000}
"""By how much the smoothed peak is later than the event: 46 ms of the filter; at the lower back 34 ms more from the heel's contact."""


@dataclass(slots=True)
class StepsState:
    """
    sos, z     the smoothing filter and its memory;  track: the peak under way (`TRACK`);  rule: what makes a step (`RULE`)
    stamps, ring, held   the latest samples (keep, 6), oldest first, `held` of them
    """

    scale: Samples
    picked: Times
    sos: Samples
    z: Samples
    track: Array
    rule: Array
    stamps: Times
    ring: Samples
    held: int
    number: int
    rate: float


@dataclass(frozen=True, slots=True)
class Steps(Operator[StepsState]):
    """A regular signal of an inertial sensor in (3 channels of acceleration, perhaps 3 of angular velocity), its steps out.

    Acceleration is found by its unit (m/s2, g), angular velocity by its (rad/s, deg/s). A step is a peak of acceleration's norm below 5 Hz;
    it is certain when the value has fallen by 0.7 m/s2, and `wait_s` after the peak at the earliest: waiting costs delay and saves false
    steps (docs/lab/steps.md has the curve). Steps are more than `shortest_s` apart: 0.36 s are 166 steps/min, and runners take more.

    The features are the thesis's: length and duration, and of each channel mean, standard deviation, least, most, RMS, entropy, energy and
    the largest spectral amplitude. `axes: gravity` takes amounts that do not depend on how the sensor is turned: along the step's mean
    acceleration, across it, and the norm. `length_m` is Weinberg's model (2002): `length_factor` times the fourth root of the range of
    vertical acceleration. 0.37 fits 10 m walks of 13 people best (docs/lab/steps.md); the feature `length` has Weinberg's
    0.46 always, which trained models rely on.

    Stamped when it is certain; onset and end are where the peaks are. NaN in a sample leaves that sample out; a gap longer than
    `reset_gap_s` begins again.

    >>> given, made = tried(Steps)
    >>> given["in"].shape, made["kind"][:3].tolist(), made["duration_s"][1:3].round(2).tolist()
    ((1400, 6), ['first', 'walk', 'walk'], [0.55, 0.56])
    """

    inputs = {"in": Input(finite=True)}
    outputs: ClassVar[tuple[str, ...]] = ("steps",)

    site: Literal["lower_back", "wrist", "pocket", "foot", "other"] = param(
        "lower_back", help="where the sensor is worn"
    )
    axes: Literal["gravity", "sensor"] = param(
        "gravity", help="what the features are of: axes by gravity, or the sensor's own"
    )
    wait_s: float = param(0.0, least=0.0, most=0.5, help="how long a peak must stand before it is reported")
    shortest_s: float = param(
        APART_S, least=0.15, most=1.0, help="a peak no later than this after a step is ignored; less for runners"
    )
    longest_s: float = param(1.2, above=0.35, most=3.0, help="a longer step has a pause in it")
    length_factor: float = param(0.37, above=0.0, most=2.0, help="of the step length: scale it by a known distance")
    turn_deg: float = param(20.0, above=0.0, help="a step that turns the body by more is a turn")
    reset_gap_s: float = reset_gap(0.3, "a longer gap begins again", most=2.0)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if not spec.is_signal or spec.rate_hz is None or not 40.0 <= spec.rate_hz <= 1000.0:
            accepts = "an inertial sensor at a regular rate of 40 to 1000 Hz; operators.filters.resample.Resample makes one of bursts"
            raise InputError("in", spec.describe(), accepts)
        units = spec.units if len(spec.units) == spec.shape[0] else spec.units * spec.shape[0]
        acceleration = [i for i, unit in enumerate(units) if unit in ("m/s2", "m/s^2", "g")]
        angular = [i for i, unit in enumerate(units) if unit in ("rad/s", "deg/s", "dps")]
        if len(acceleration) != 3 or len(angular) not in (0, 3):
            raise InputError("in", spec.describe(), "3 channels in m/s2 or g, and 3 or 0 in rad/s or deg/s")
        if self.shortest_s >= self.longest_s:
            raise ParameterError("shortest_s", self.shortest_s, f"below longest_s ({self.longest_s})")
        picked = acceleration + angular
        keep = int((self.longest_s + 2.0) * spec.rate_hz) + 8
        self.set_state(
            StepsState(
                np.array([FACTORS[units[i]] for i in picked]), np.array(picked),
                np.ascontiguousarray(butter(ORDER, CUTOFF_HZ, fs=spec.rate_hz, output="sos")), np.zeros((1, 2)), fresh_track(),
                rule_of(self.wait_s, self.reset_gap_s + 1.0 / spec.rate_hz, self.shortest_s),
                np.zeros(keep, np.int64), np.full((keep, 6), np.nan), 0, 0, spec.rate_hz,
            )
        )  # fmt: skip
        channels = [spec.channels[i] for i in picked] if spec.channels else []
        meta = {
            **spec.meta, "site": self.site, "axes": self.axes, "imu_rate_hz": spec.rate_hz, "imu_channels": channels,
            "features": feature_names(self.axes), "angular_velocity": bool(angular),
        }  # fmt: skip
        return {"steps": StreamSpec((), STEP, units=STEP_UNITS, meta=meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s, rows = self.state, list[tuple[int, Array]]()
        piece = max(len(s.ring) // 4, 1)
        for a in range(0, len(chunk.time), piece):
            rows += self._take(chunk.time[a : a + piece], chunk.data[a : a + piece])
        stamps = np.array([stamp for stamp, _ in rows], np.int64)
        data = np.concatenate([np.empty(0, STEP), *(row for _, row in rows)])
        return Chunk(stamps, data, chunk.until, -1 if chunk.lost else 0)

    @classmethod
    def cases(cls) -> list[Case]:
        return [
            Case(cls(), {"in": some_walk(14.0, 100.0, 6)}, least=14),
            Case(cls(site="wrist", axes="sensor", wait_s=0.1), {"in": some_walk(14.0, 60.0, 3)}, least=14),
        ]

    def _take(self, time: Times, data: Samples) -> list[tuple[int, Array]]:
        s = self.state
        six = np.full((len(time), 6), np.nan)
        six[:, : len(s.picked)] = data[:, s.picked] * s.scale
        found = np.empty((len(time), 3), np.int64)
        count = find_steps(time, six, s.sos, s.z, s.track, s.rule, found)
        s.held = push(s.stamps, s.ring, s.held, time, six)
        return [(int(time[i]), self._step(int(end), int(before))) for i, end, before in found[:count]]

    def _step(self, end: int, before: int) -> Array:
        """The event (1,) of a step, from the samples after the peak before it up to its own."""
        s, row = self.state, np.zeros(1, STEP)
        s.number += 1
        late = LATE_NS[self.site]
        row["onset"], row["end"], row["number"] = end - late, end - late, s.number
        row["duration_s"] = row["length_m"] = row["turn_deg"] = row["features"] = np.nan
        if before == NEVER or end - before > round(self.longest_s * NS):
            row["kind"] = "first" if before == NEVER else "slow"
            return row
        row["onset"] = before - late
        a, b = s.stamps[: s.held].searchsorted((before, end), "right")
        window = s.ring[a:b]
        window = np.ascontiguousarray(window[np.isfinite(window[:, :3]).all(axis=1)])
        if len(window) < 4:
            row["kind"] = "slow"
            return row
        features = np.empty(COUNT)
        describe(window, s.rate, self.axes == "gravity", np.empty((6, len(window))), features)
        angle = turned_by(window, s.rate)
        row["kind"] = "turn" if abs(angle) > self.turn_deg else "walk"
        row["duration_s"], row["length_m"], row["turn_deg"] = (
            (end - before) / NS,
            features[0] * (self.length_factor / WEINBERG),
            angle,
        )
        features[1] = row["duration_s"][0]
        row["features"] = features
        return row


@kernel
def push(stamps: Times, ring: Samples, held: int, time: Times, data: Samples) -> int:
    """Append samples to those held, the oldest first; returns how many there are. No more than a quarter of the ring at a time."""
    n, keep = time.shape[0], stamps.shape[0]
    drop = max(held + n - keep, 0)
    if drop:
        for i in range(held - drop):
            stamps[i] = stamps[i + drop]
            ring[i] = ring[i + drop]
    for i in range(n):
        stamps[held - drop + i] = time[i]
        ring[held - drop + i] = data[i]
    return int(held - drop + n)


def some_walk(seconds: float, rate_hz: float, channels: int, seed: int = 3) -> tuple[StreamSpec, Times, Samples]:
    """A made-up walk at the lower back with a rest, a turn and noise, for trying operators on."""
    n, rng = int(seconds * rate_hz), np.random.default_rng(seed)
    t = np.arange(n) / rate_hz
    walking = ((t > 1.0) & (t < seconds * 0.5)) | (t > seconds * 0.5 + 2.0)
    beat = 2 * np.pi * 1.8 * t
    data = rng.normal(0.0, 0.15, (n, 6)) + np.array([9.81, 0.0, 0.0, 0.0, 0.0, 0.0])
    data[:, 0] += walking * (3.0 * np.sin(beat) + 1.0 * np.sin(2 * beat + 0.5))
    data[:, 2] += walking * 1.2 * np.cos(beat)
    data[:, 3] += np.where((t > seconds * 0.8) & (t < seconds * 0.8 + 1.5), 1.5, 0.0)
    data[:, 4] += walking * 0.5 * np.sin(beat / 2)
    names, units = ("ax", "ay", "az", "gx", "gy", "gz"), ("m/s2",) * 3 + ("rad/s",) * 3
    spec = StreamSpec((channels,), rate_hz=rate_hz, channels=names[:channels], units=units[:channels])
    return spec, grid(rate_hz, n), np.ascontiguousarray(data[:, :channels])
