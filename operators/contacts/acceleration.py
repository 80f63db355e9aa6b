"""Ground contact from an accelerometer alone, worn on the foot: between two steps a foot lies still."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.operators.contacts.contacts import Contacts, Followed, signal_channels
from kinegraph.stream.chunk import NEVER, NS, Array, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param

METRES_S2 = {"m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "g": 9.80665, "mg": 0.00980665}
GRAVITY = 9.80665
MOVING_M_S2, STRIKING_M_S2 = 2.0, 8.0
STILL_NS, LATEST_NS = 150_000_000, 600_000_000
SHORTEST_NS, LONGEST_NS, PUSH_NS = 250_000_000, 2_000_000_000, 250_000_000
STRIKE_NS, PEAK_NS = 90_000_000, 20_000_000
SLOWEST_HZ = 40.0

BOUT = np.dtype(
    [
        ("last", "<i8"),
        ("moving", "<i8"),
        ("began", "<i8"),
        ("moved_at", "<i8"),
        ("struck_at", "<i8"),
        ("peak", "<f8"),
        ("peak_at", "<i8"),
    ]
)
"""The last stamp; whether the foot moves, since when, when it last did, when it was last shaken hard; its first peak, and
when. Times are ns."""


@kernel
def follow(time: Times, acceleration: Samples, gap_ns: int, motion: Array, found: Times) -> tuple[int, int]:
    """Follow the size of the acceleration (n, 3) m/s2 from one rest to the next.

    found  (2, 2 n + 2, 2)  touch-downs and lift-offs: stamp, onset. Returns how many of each.
    """
    bout = motion[0]
    count = 0
    for i in range(time.shape[0]):
        at, a = time[i], acceleration[i]
        size = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
        if not np.isfinite(size):
            continue
        if bout["last"] == NEVER or at - bout["last"] > gap_ns:
            bout["moving"] = 0
        bout["last"] = at
        shaken = abs(size - GRAVITY)
        if shaken > MOVING_M_S2:
            if not bout["moving"]:
                bout["moving"], bout["began"], bout["peak"], bout["struck_at"] = 1, at, 0.0, at
            bout["moved_at"] = at
            if shaken > STRIKING_M_S2:
                bout["struck_at"] = at
            if size > bout["peak"] and at - bout["began"] < PUSH_NS:
                bout["peak"], bout["peak_at"] = size, at
        if not bout["moving"] or at - bout["moved_at"] < STILL_NS:
            continue
        bout["moving"] = 0
        moved = bout["moved_at"] - bout["began"]
        if moved < SHORTEST_NS or moved > LONGEST_NS or at - bout["struck_at"] > LATEST_NS:
            continue
        found[0, count, 0], found[0, count, 1] = at, bout["struck_at"] - STRIKE_NS
        found[1, count, 0], found[1, count, 1] = at, bout["peak_at"] - PEAK_NS
        count += 1
    return count, count


@dataclass(slots=True)
class AccelerationState(Followed):
    picked: Times
    scale: float
    motion: Array


@dataclass(frozen=True, slots=True)
class AccelerationContacts(Contacts[AccelerationState]):
    """Contacts of one foot from a three-axis accelerometer worn on it, in m/s2, g or mg, mounted anyhow.

    Where the sensor also gives angular velocity, `InertialContacts` is better in every respect. Here only the size of the
    acceleration is used. A step is what lies between two rests of the foot, as walking has in every stance; in running,
    and on a shank, there are no such rests, and it finds nothing. The touch-down is put 90 ms before the last hard shake (the heel's and
    the sole's impact), the lift-off 20 ms before the first peak (the push-off): medians over 13 people.

    Decided: when the foot has been still for 0.15 s; both contacts of a step come together, some 0.3 s after the touch-down.

    >>> given, made = tried(AccelerationContacts)
    >>> given["in"].shape, made["touchdown"]["onset"][:3] / 1e9
    ((1200, 3), array([1.9, 3.1, 4.3]))
    """

    acceleration: tuple[str, ...] = param((), help="the three channels of acceleration; empty: those in m/s2, g or mg")
    reset_gap_s: float = reset_gap(0.3, "a longer gap, or run of bad samples, restarts detection", most=1.0)
    side: Literal["left", "right", ""] = param("", help="side of the foot: left, right, or empty if unknown")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        picked = signal_channels(spec, self.acceleration, "acceleration")
        units = [spec.units[0] if len(spec.units) == 1 else spec.units[i] for i in picked]
        picked = [i for i, unit in zip(picked, units, strict=True) if unit in METRES_S2]
        used = {unit for unit in units if unit in METRES_S2}
        if len(picked) != 3 or len(used) != 1:
            accepts = (
                f"three channels of acceleration in one of {', '.join(METRES_S2)}; of more, name three in acceleration"
            )
            raise InputError("in", f"{spec.describe()}, of which {len(picked)} in a unit of acceleration", accepts)
        if spec.rate_hz is not None and spec.rate_hz < SLOWEST_HZ:
            raise InputError("in", spec.describe(), f"at {SLOWEST_HZ:g} Hz or faster")
        state = AccelerationState(
            gap_ns=round(self.reset_gap_s * NS) + spec.period_ns,
            last=NEVER,
            picked=np.array(picked),
            scale=METRES_S2[used.pop()],
            motion=np.zeros(1, BOUT),
        )
        state.motion["last"] = NEVER
        delay_s = 1e-9 * (LATEST_NS + STRIKE_NS)
        self.set_state(
            state, delay_s=delay_s, decision_s={"touchdown": delay_s, "liftoff": delay_s + 1e-9 * LONGEST_NS}
        )
        return self.contacts(spec)

    def follow(self, time: Times, data: Array, found: Times) -> tuple[int, int]:
        acceleration = np.ascontiguousarray(data[:, self.state.picked], np.float64) * self.state.scale
        return follow(time, acceleration, self.state.gap_ns, self.state.motion, found)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rate_hz, n, rng = 100.0, 1200, np.random.default_rng(10)
        phase = (np.arange(n) / rate_hz) % 1.2
        swing = (phase > 0.5) & (phase < 1.0)
        shake = np.where(swing, 12.0 + 8.0 * np.cos(4 * np.pi * (phase - 0.5) / 0.5), 0.0)
        data = np.column_stack([shake, np.zeros(n), np.full(n, GRAVITY)]) + rng.normal(0.0, 0.1, (n, 3))
        spec = StreamSpec((3,), rate_hz=rate_hz, channels=("ax", "ay", "az"), units=("m/s2",))
        return [Case(cls(side="left"), {"in": (spec, grid(rate_hz, n), data)}, least=18)]
