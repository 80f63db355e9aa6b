"""Ground contact from what a foot presses on: vertical force, a footswitch, or a trigger line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.operators.contacts.baseline import BLOCK_S, ZERO, zeroed
from kinegraph.operators.contacts.contacts import Contacts, Followed, signal_channels
from kinegraph.stream.chunk import NEVER, NS, Array, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param

NEWTONS = {"N": 1.0, "kN": 1000.0}
UNKNOWN, FREE, PRESSED = -1, 0, 1
PRESS = np.dtype(
    [("level", "<i8"), ("above", "<i8"), ("since", "<i8"), ("deep", "<i8"), ("last", "<i8"), ("load", "<f8")]
)
"""The level now (-1: not known), whether the last load was above `on`, since when, whether it reached `off`; its stamp, and the load."""


@kernel
def presses(
    time: Times, load: Samples, on: float, off: float, hold_ns: int, gap_ns: int, memory: Array, found: Times
) -> tuple[int, int]:
    """Follow `load` (n,): pressed once it has stayed at or above `on` for `hold_ns`, free once it has stayed below and reached `off`.

    Both onsets are where the straight line between two samples crosses `on`. Loads that are not finite are passed over.

    memory (1,)   see PRESS
    found  (2, 2 n + 2, 2)   presses and releases: stamp, onset. Returns how many of each.
    """
    seen, downs, ups = memory[0], 0, 0
    for i in range(time.shape[0]):
        value, at = load[i], time[i]
        if not np.isfinite(value):
            continue
        above = 1 if value >= on else 0
        if seen["last"] == NEVER or at - seen["last"] > gap_ns:
            seen["level"], seen["above"], seen["since"], seen["deep"] = UNKNOWN, above, at, 0
        elif above != seen["above"]:
            share = (on - seen["load"]) / (value - seen["load"])
            seen["above"], seen["deep"] = above, 0
            seen["since"] = seen["last"] + int(share * (at - seen["last"]))
        if value <= off:
            seen["deep"] = 1
        seen["last"], seen["load"] = at, value
        if above == seen["level"] or at - seen["since"] < hold_ns or not (above or seen["deep"]):
            continue
        if seen["level"] != UNKNOWN and above:
            found[0, downs, 0], found[0, downs, 1] = at, seen["since"]
            downs += 1
        elif seen["level"] != UNKNOWN:
            found[1, ups, 0], found[1, ups, 1] = at, seen["since"]
            ups += 1
        seen["level"] = above
    return downs, ups


@dataclass(slots=True)
class PressState(Followed):
    picked: Times
    sign: float
    memory: Array
    others: Times
    zero: Array
    block: int


class _Press(Contacts[PressState]):
    """What force and switch share: one number per sample, a threshold, a hysteresis, and a time for which it must last."""

    __slots__ = ()
    channels: tuple[str, ...]
    inverted: bool
    debounce_s: float
    reset_gap_s: float

    def watch(self, spec: StreamSpec, gain: float, others: Sequence[int] = ()) -> None:
        picked = signal_channels(spec, self.channels, "channels")
        state = PressState(
            gap_ns=round(self.reset_gap_s * NS) + spec.period_ns,
            last=NEVER,
            picked=np.array(picked),
            sign=-gain if self.inverted else gain,
            memory=np.array([(UNKNOWN, 0, 0, 0, NEVER, 0.0)], PRESS),
            others=np.array(others, np.int64),
            zero=np.zeros(1, ZERO),
            block=max(2, round(BLOCK_S * (spec.rate_hz or 100.0))),
        )
        delay_s = self.debounce_s + spec.period_ns / NS
        self.set_state(state, delay_s=delay_s, decision_s=dict.fromkeys(self.outputs, delay_s))

    def run(self, time: Times, load: Samples, threshold: float, hysteresis: float, found: Times) -> tuple[int, int]:
        state, hold_ns = self.state, round(self.debounce_s * NS)
        return presses(time, load, threshold, threshold - hysteresis, hold_ns, state.gap_ns, state.memory, found)


@dataclass(frozen=True, slots=True)
class ForceContacts(_Press):
    """Contacts of one foot from the vertical force under it, in N or kN; 20 N is what gait laboratories use.

    Takes a signal (channels,); several channels (the cells of one plate or insole) are added up. A touch-down is where the force rises
    through `threshold_n` and stays there for `debounce_s`; a lift-off where it falls through `threshold_n`, goes on to `threshold_n` less
    `hysteresis_n`, and stays below for as long. Both onsets lie between samples, on the straight line. What is there at the start, or
    after a gap, is no event. Decided `debounce_s` after the onset.

    With `zero: swing` force counts from what the plate shows without the foot: tared by the first 0.15 s that are flat and within
    `max_offset_n` of 0, then by every swing (the lowest flat 0.15 s of the latest 4 s, in which the load changes by five thresholds)
    within `max_offset_n` of the zero so far. So offset and drift do not matter. Where the plate's noise, measured there, is above a
    quarter of `threshold_n`, a contact begins at four of its standard deviations, and the hysteresis grows alike. `other`, the other
    belt's channels of the same stream, takes its cross-talk out: the part of its load that this plate shows in swing, by least squares
    with a fading memory. `zero: none` takes the force as it comes.

    >>> load = np.tile(np.repeat([0.0, 700.0], [40, 60]), 3)
    >>> found = ForceContacts(zero="none")(load, rate_hz=100, units=["N"])
    >>> found["touchdown"]["onset"].round(-6) / 1e9
    array([1.39, 2.39, 3.39])
    """

    threshold_n: float = param(20.0, above=0.0, help="on the ground from this force up")
    hysteresis_n: float = param(5.0, least=0.0, help="a lift-off must fall this much further")
    channels: tuple[str, ...] = param((), help="the channels to add up; empty: all but `other`")
    other: tuple[str, ...] = param((), help="the other belt's channels, with the cross-talk to remove")
    zero: Literal["swing", "none"] = param("swing", help="what force counts from: the plate's reading in swing, or 0")
    max_offset_n: float = param(
        100.0, above=0.0, help="a reading that is further from the zero so far is a load, not an offset"
    )
    inverted: bool = param(False, help="the plate shows pressure as a negative force")
    debounce_s: float = param(0.03, least=0.0, most=0.5, help="how long a contact or a swing lasts at least")
    reset_gap_s: float = reset_gap(0.1, "after a longer gap it is not known where the foot is")
    side: Literal["left", "right", ""] = param("", help="side of the foot: left, right, or empty if unknown")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        others = signal_channels(spec, self.other, "other") if self.other else []
        named = self.channels or tuple(name for name in spec.channels if name not in self.other)
        if set(named) & set(self.other) or (self.other and not named):
            raise ParameterError("other", list(self.other), "channels of the other belt, not of this one")
        picked = signal_channels(spec, named, "channels") + others
        units = {spec.units[0] if len(spec.units) == 1 else spec.units[i] for i in picked}
        if len(units) != 1 or not units <= set(NEWTONS):
            raise InputError("in", f"in {', '.join(sorted(units)) or 'no unit'}", f"in {' or '.join(NEWTONS)}: a force")
        if self.hysteresis_n >= self.threshold_n:
            raise ParameterError("hysteresis_n", self.hysteresis_n, f"below threshold_n, which is {self.threshold_n:g}")
        self.watch(spec, NEWTONS[units.pop()], others)
        self.state.picked = np.array(picked[: len(picked) - len(others)])
        return self.contacts(spec)

    def follow(self, time: Times, data: Array, found: Times) -> tuple[int, int]:
        s = self.state
        load, other = np.zeros(len(time)), np.zeros(len(time))
        for i in s.picked:
            load += data[:, i]
        for i in s.others:
            other += data[:, i]
        load, other = load * s.sign, other * s.sign
        if self.zero == "swing":
            starts = np.diff(time, prepend=time[0] if s.last == NEVER else s.last) > s.gap_ns
            zeroed(load, other, starts, s.block, self.threshold_n, self.max_offset_n, s.zero, load)
        return self.run(time, load, self.threshold_n, self.hysteresis_n, found)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        time, load = _footfalls(0.0, 700.0)
        _, other = _footfalls(0.0, 700.0, 0.2)
        one, two = (StreamSpec((n,), rate_hz=200.0, channels=("R", "L")[:n], units=("N",)) for n in (1, 2))
        both = np.hstack([load + 0.05 * other + 30.0, other])
        return [
            Case(cls(side="right"), {"in": (one, time, load)}, least=12),
            Case(cls(zero="none"), {"in": (one, time, load)}, least=12),
            Case(cls(other=("L",)), {"in": (two, time, both)}, least=12),
        ]


@dataclass(frozen=True, slots=True)
class SwitchContacts(_Press):
    """Contacts of one foot from a footswitch or a trigger line, in whatever unit it comes: on from `threshold` up.

    Takes a signal (channels,); of several channels (heel, ball and toe switches of one foot) the highest counts. Onsets as in
    `ForceContacts`: where the line between samples crosses `threshold`. Decided `debounce_s` after the onset.

    >>> pressed = np.repeat([0.0, 3.0, 0.0], 50)
    >>> SwitchContacts(threshold=1.5)(pressed, rate_hz=100)["touchdown"]["onset"] / 1e9
    array([1.495])
    """

    threshold: float = param(
        help="on the ground from this level up, in the input's unit; half of the switch's swing is a good choice"
    )
    hysteresis: float = param(0.0, least=0.0, help="a lift-off must fall this much further, in the input's unit")
    channels: tuple[str, ...] = param((), help="the foot's switches; empty: all channels")
    inverted: bool = param(
        False, help="the switch is closed to ground: low means pressed; the threshold is that of the line itself"
    )
    debounce_s: float = param(0.03, least=0.0, most=0.5, help="how long a contact or a swing lasts at least")
    reset_gap_s: float = reset_gap(0.1, "after a longer gap it is not known where the foot is")
    side: Literal["left", "right", ""] = param("", help="side of the foot: left, right, or empty if unknown")

    def open(self, specs: Specs) -> Specs:
        self.watch(specs["in"], 1.0)
        return self.contacts(specs["in"])

    def follow(self, time: Times, data: Array, found: Times) -> tuple[int, int]:
        sign = self.state.sign
        load = np.max(np.asarray(data[:, self.state.picked], np.float64) * sign, axis=1)
        return self.run(time, load, self.threshold * sign, self.hysteresis, found)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        time, load = _footfalls(0.1, 3.2)
        spec = StreamSpec((1,), rate_hz=200.0, units=("V",))
        return [
            Case(cls(threshold=1.5), {"in": (spec, time, load)}, least=12),
            Case(cls(threshold=1.5, inverted=True), {"in": (spec, time, 3.3 - load)}, least=12),
        ]


def _footfalls(low: float, high: float, begins: float = 0.7) -> tuple[Array, Array]:
    """Eight strides of 1.1 s at 200 Hz, on the ground for 60 % of each, with noise: stamps (n,) and loads (n, 1)."""
    n, rng = 1760, np.random.default_rng(6)
    phase = (np.arange(n) / 220.0 + begins) % 1.0
    bump = np.clip(6.0 * np.minimum(phase, 0.6 - phase), 0.0, 1.0)
    return grid(200.0, n), (low + (high - low) * bump + rng.normal(0.0, 0.001 * high, n))[:, None]
