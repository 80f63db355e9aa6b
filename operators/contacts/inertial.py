"""Ground contact from an inertial sensor on the foot or the shank: its angular velocity, about whatever axis it is mounted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.operators.contacts.contacts import Contacts, Followed, signal_channels
from kinegraph.operators.contacts.legs import (
    BY_ENERGY,
    BY_SIZE,
    LEGS,
    LIFTOFF,
    LIMITS,
    LONGEST_NS,
    TOUCHDOWN,
    glide,
    judge,
    rest,
)
from kinegraph.stream.chunk import NEVER, NS, Array, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param

RADIANS = {"rad/s": 1.0, "deg/s": np.pi / 180, "°/s": np.pi / 180, "dps": np.pi / 180}
SWING_RAD, STANCE_RAD, REVERSE_RAD = 0.25, 0.1, 0.08
STILL_NS = 80_000_000
DEAD_RAD_S = 0.3
MOVING_RAD_S, LANDING_RAD_S = 0.7, 2.0
PAUSE_NS = 200_000_000
APART_NS = 500_000_000
LATEST_NS = 500_000_000
STEP_RAD = 0.8
MEMORY_S = 10.0
SLOWEST_HZ = 40.0
FOOT_NS = (26_000_000, -31_000_000, -28_000_000, 80_000_000)
SHANK_NS = (40_000_000, -70_000_000, -28_000_000, 80_000_000)

TURN = np.dtype(
    [
        ("last", "<i8"),
        ("speed", "<f8"),
        ("moving", "<i8"),
        ("began", "<i8"),
        ("moved_at", "<i8"),
        ("landed_at", "<i8"),
        ("path", "<f8"),
        ("found", "<i8"),
        ("touched_at", "<i8"),
    ]
)
"""The last stamp and speed about the axis; whether the sensor moves, since when, when it last moved and last turned
fast, by how much it turned in all, whether that was a step by the rule of legs; the last touch-down. Times are ns."""


@kernel
def axis_speed(w: Samples, dt: float, spread: Samples, axis: Samples) -> float:
    """The speed of turning `w` (3,) rad/s about the limb's own axis: the direction of most of the turning so far (about 10 s of motion).

    spread (3, 3) is the decaying second moment of `w`, `axis` (3,) its first eigenvector, followed by one step of the power method a
    sample, so that its sign never jumps.
    """
    keep = 1.0
    if w[0] * w[0] + w[1] * w[1] + w[2] * w[2] > 1.0:
        keep = np.exp(-dt / MEMORY_S)
    for i in range(3):
        for j in range(3):
            spread[i, j] = keep * spread[i, j] + w[i] * w[j] * dt
    a = spread[0, 0] * axis[0] + spread[0, 1] * axis[1] + spread[0, 2] * axis[2]
    b = spread[1, 0] * axis[0] + spread[1, 1] * axis[1] + spread[1, 2] * axis[2]
    c = spread[2, 0] * axis[0] + spread[2, 1] * axis[1] + spread[2, 2] * axis[2]
    length = np.sqrt(a * a + b * b + c * c)
    axis[0], axis[1], axis[2] = a / length, b / length, c / length
    return float(w[0] * axis[0] + w[1] * axis[1] + w[2] * axis[2])


@kernel
def bout(turn: np.void, at: int, dt: float, speed: float) -> bool:
    """Follow how fast the sensor turns about any axis, `speed` in rad/s; returns whether a step ended that the legs did not show.

    Such are the steps of turning on the spot and of coming to a halt, where the foot hardly pitches: it turns by 0.8 rad
    in all between two rests, and no touch-down was found meanwhile or within half a second.
    """
    if speed > MOVING_RAD_S:
        if not turn["moving"]:
            turn["moving"], turn["began"], turn["landed_at"], turn["path"], turn["found"] = 1, at, at, 0.0, 0
        turn["moved_at"] = at
        if speed > LANDING_RAD_S:
            turn["landed_at"] = at
    if not turn["moving"]:
        return False
    turn["path"] += speed * dt
    if at - turn["moved_at"] <= PAUSE_NS:
        return False
    turn["moving"] = 0
    if at - turn["landed_at"] > LATEST_NS or turn["landed_at"] - turn["began"] > LONGEST_NS:
        return False
    return not turn["found"] and turn["path"] > STEP_RAD and turn["landed_at"] - turn["touched_at"] > APART_NS


@kernel
def follow(
    time: Times,
    rate: Samples,
    limits: Array,
    shifts: Times,
    voting: int,
    gap_ns: int,
    memory: Array,
    motion: Array,
    spread: Samples,
    axis: Samples,
    found: Times,
) -> tuple[int, int]:
    """Follow the angular velocity `rate` (n, 3) rad/s through legs and bouts.

    shifts (4,)  ns from a turning point, and from a bout's begin and end, to the contact: touch-down, lift-off, bout's end, bout's begin
    found  (2, 2 n + 2, 2)  touch-downs and lift-offs: stamp, onset. Returns how many of each.
    """
    legs, turn = memory[0], motion[0]
    downs = ups = 0
    for i in range(time.shape[0]):
        w, at, last = rate[i], time[i], turn["last"]
        total = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
        if not np.isfinite(total):
            continue
        turn["last"] = at
        if last == NEVER or at - last > gap_ns:
            rest(legs)
            turn["speed"], turn["moving"] = 0.0, 0
            continue
        dt = 1e-9 * (at - last)
        speed = axis_speed(w, dt, spread, axis)
        speed = speed - DEAD_RAD_S if speed > DEAD_RAD_S else speed + DEAD_RAD_S if speed < -DEAD_RAD_S else 0.0
        glide(legs, last, at, turn["speed"], speed)
        turn["speed"] = speed
        certain = judge(legs, at, limits[0], voting)
        if certain & LIFTOFF:
            found[1, ups, 0], found[1, ups, 1] = at, legs["liftoff_at"] + shifts[1]
            ups += 1
        if certain & TOUCHDOWN:
            found[0, downs, 0], found[0, downs, 1] = at, legs["touchdown_at"] + shifts[0]
            downs += 1
            turn["found"], turn["touched_at"] = 1, legs["touchdown_at"]
        if bout(turn, at, dt, np.sqrt(total)):
            found[1, ups, 0], found[1, ups, 1] = at, turn["began"] + shifts[3]
            found[0, downs, 0], found[0, downs, 1] = at, turn["landed_at"] + shifts[2]
            ups, downs = ups + 1, downs + 1
            turn["touched_at"] = turn["landed_at"]
    return downs, ups


@dataclass(slots=True)
class InertialState(Followed):
    picked: Times
    radians: float
    limits: Array
    shifts: Times
    voting: int
    memory: Array
    motion: Array
    spread: Samples
    axis: Samples


@dataclass(frozen=True, slots=True)
class InertialContacts(Contacts[InertialState]):
    """Contacts of one foot from the angular velocity of a sensor worn on that foot or shank, in rad/s or deg/s.

    Takes a signal (channels,); only the three channels of angular velocity are used, found by their unit or named. How the
    sensor is turned on the limb does not matter: the pitch axis is the one about which most turning happens, and which way
    is forward follows from the legs themselves, as a foot's swing turns it by as much as push-off and landing together.
    Nothing is fitted to a person or session.

    The foot's pitch turns some 31 ms after lift-off and again 26 ms before touch-down (medians over 13 people); onsets make
    up for that. Steps without pitch (turning on the spot, stopping) are recognised when the foot has come to rest, by how far it
    has turned about any axis.

    Decided: touch-down mostly 20 to 60 ms after its onset, at most about 0.5 s (steps without pitch), which is the declared
    delay. Lift-off 0.1 to 0.2 s after its onset, but only with the touch-down where it was not clear before that this is
    a swing (the first step). `site: shank` uses the shank's turning points; their distance from the contacts is an
    assumption that was never measured.

    >>> given, made = tried(InertialContacts)
    >>> given["in"].shape, made["touchdown"]["onset"][:3] / 1e9
    ((1300, 6), array([2.926, 4.026, 5.126]))
    """

    site: Literal["foot", "shank"] = param("foot", help="where the sensor is worn")
    angular_velocity: tuple[str, ...] = param(
        (), help="the three channels of angular velocity; empty: those in rad/s or deg/s"
    )
    unit: Literal["", "rad/s", "deg/s"] = param(
        "", help="unit of the channels named in angular_velocity; empty: the input's"
    )
    reset_gap_s: float = reset_gap(
        0.3, "a longer gap, or run of bad samples, restarts detection; the axis is kept", most=1.0
    )
    side: Literal["left", "right", ""] = param("", help="side of the foot: left, right, or empty if unknown")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        picked, unit = self._angular(spec)
        foot = self.site == "foot"
        shifts = FOOT_NS if foot else SHANK_NS
        if spec.rate_hz is not None and spec.rate_hz < SLOWEST_HZ:
            raise InputError("in", spec.describe(), f"at {SLOWEST_HZ:g} Hz or faster")
        state = InertialState(
            gap_ns=round(self.reset_gap_s * NS) + spec.period_ns,
            last=NEVER,
            picked=np.array(picked),
            radians=RADIANS[unit],
            limits=np.array([(SWING_RAD, STANCE_RAD, REVERSE_RAD, STILL_NS, shifts[0])], LIMITS),
            shifts=np.array(shifts),
            voting=BY_SIZE if foot else BY_ENERGY,
            memory=np.zeros(1, LEGS),
            motion=np.zeros(1, TURN),
            spread=np.eye(3) * 1e-6,
            axis=np.full(3, np.sqrt(1 / 3)),
        )
        state.motion["last"] = NEVER
        state.motion["touched_at"] = NEVER // 2
        delay_s = 1e-9 * (LATEST_NS - FOOT_NS[2]) + spec.period_ns / NS
        self.set_state(
            state, delay_s=delay_s, decision_s={"touchdown": delay_s, "liftoff": delay_s + 1e-9 * LONGEST_NS}
        )
        return self.contacts(spec)

    def _angular(self, spec: StreamSpec) -> tuple[list[int], str]:
        """Where the angular velocity stands, and its unit."""
        picked = signal_channels(spec, self.angular_velocity, "angular_velocity")
        units = [spec.units[0] if len(spec.units) == 1 else spec.units[i] for i in picked]
        if self.unit and self.angular_velocity:
            units = [self.unit] * len(picked)
        picked = [i for i, unit in zip(picked, units, strict=True) if unit in RADIANS]
        used = {unit for unit in units if unit in RADIANS}
        if len(picked) != 3 or len(used) != 1:
            raise InputError(
                "in",
                f"{spec.describe()}, of which {len(picked)} in {' and '.join(sorted(used)) or 'a unit of angular velocity'}",
                f"three channels of angular velocity in one of {', '.join(RADIANS)}; else name the three in "
                "angular_velocity, and their unit in unit",
            )
        return picked, used.pop()

    def follow(self, time: Times, data: Array, found: Times) -> tuple[int, int]:
        s = self.state
        rate = np.ascontiguousarray(data[:, s.picked], np.float64) * s.radians
        return follow(time, rate, s.limits, s.shifts, s.voting, s.gap_ns, s.memory, s.motion, s.spread, s.axis, found)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [_case(cls(side="left"), 100.0, "rad/s"), _case(cls(site="shank"), 64.0, "deg/s")]


def _case(operator: InertialContacts, rate_hz: float, unit: str) -> Case:
    """Ten strides of 1.1 s between two rests, about a slanting axis, with noise; acceleration goes along unused."""
    n, rng = round(13 * rate_hz), np.random.default_rng(8)
    seconds = np.arange(n) / rate_hz - 1.0
    phase = np.where((seconds > 0) & (seconds < 11.0), seconds % 1.1, 1.05)
    pitch = np.zeros(n)
    for begin, end, peak in ((0.2, 0.5, 6.0), (0.5, 0.9, -5.6), (0.9, 1.0, 4.0)):
        inside = (phase > begin) & (phase < end)
        pitch[inside] += peak * np.sin(np.pi * (phase[inside] - begin) / (end - begin))
    turning = pitch[:, None] * np.array([0.48, -0.6, 0.64]) + rng.normal(0.0, 0.03, (n, 3))
    data = np.hstack([rng.normal([0.0, 0.0, 9.8], 1.0, (n, 3)), turning / RADIANS[unit]])
    spec = StreamSpec(
        (6,), rate_hz=rate_hz, channels=("ax", "ay", "az", "gx", "gy", "gz"), units=("m/s2",) * 3 + (unit,) * 3
    )
    return Case(operator, {"in": (spec, grid(rate_hz, n), data)}, least=18)
