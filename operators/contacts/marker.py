"""Ground contact from the path of one marker on a foot or leg, with or without a marker on the hip or sacrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import structlog

from kinegraph.operators.contacts.contacts import Contacts, Followed
from kinegraph.operators.contacts.legs import LEGS, LIMITS, LONGEST_NS
from kinegraph.operators.contacts.path import MEMORY_S, WALK, follow
from kinegraph.operators.filters.iir import butterworth, group_delay, settling, steady_memory
from kinegraph.operators.inputs.directions import HELP, right_handed_up
from kinegraph.operators.inputs.marker_columns import METRES, marker_columns, marker_metres
from kinegraph.stream.chunk import NEVER, NS, Array, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param

UNITS = {factor: unit for unit, factor in METRES.items()}
ORDER = 2
SWING_M, STANCE_M, REVERSE_M = 0.15, 0.08, 0.03
STILL_NS = 300_000_000
STRANGE = 200
"""This many samples where no leg can be, more than others, are reported; the warm-up shows far fewer."""

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class MarkerState(Followed):
    columns: Times
    metres: float
    period_ns: int
    fill_ns: int
    delay_ns: int
    alone: bool
    sos: Samples
    steady: Samples
    z: Samples
    limits: Array
    memory: Array
    motion: Array
    warned: bool


@dataclass(frozen=True, slots=True)
class MarkerContacts(Contacts[MarkerState]):
    """Contacts of one foot from a marker on it or on the leg, in m, cm or mm, at a regular rate.

    Takes markers (points, 3), or a signal with markers' coordinates as channels (LANK_x, LANK_y, LANK_z). Relative to the
    body a foot moves forwards in the swing and backwards in the stance; it turns back at touch-down and forwards at
    lift-off (Zeni 2008), overground and on a treadmill, whichever way one walks. That is where the thesis's curve of the
    left fore foot becomes flat (section 6.2.3, figure 6.1). Without a `reference` marker on hip or sacrum the body is
    taken to move as the foot does on average over some 4 s, which needs a stride or two of steady walking first.

    Positions are smoothed by a causal Butterworth of order 2 at `cutoff_hz` (the thesis: 10 Hz; it names no order), and its delay is
    removed from the onsets. Samples that are missing, not finite, or exactly 0, 0, 0 are filled on a straight line up to
    `fill_gap_s`; a longer gap, and a jump that no limb makes (30 m/s), restart detection. Positions that keep making such jumps, or lie
    less than 0.1 m or more than 2.5 m from the reference, are warned of once: their unit is not what it is taken for.
    Decided: touch-down some 70 to 120 ms after its onset, lift-off some 150 ms; a walker who stops within 0.3 s, the declared delay.

    >>> given, made = tried(MarkerContacts)
    >>> given["in"].shape, made["touchdown"]["onset"][:3].round(-7) / 1e9
    ((1200, 2, 3), array([2.05, 3.16, 4.27]))
    """

    marker: str = param(help="the marker on the foot or leg: its name, or its number from 0")
    reference: str = param("", help="a marker on hip or sacrum; empty: the foot's own mean motion is used")
    up: Literal["x", "y", "z"] | None = param(None, help=f"{HELP} z")
    unit: Literal["", "m", "cm", "mm"] = param("", help="unit of the positions; empty: the input's")
    cutoff_hz: float = param(10.0, above=0.0, help="low-pass of the positions")
    fill_gap_s: float = param(
        0.2, least=0.0, most=1.0, help="the longest gap that is filled; a longer one restarts detection"
    )
    side: Literal["left", "right", ""] = param("", help="side of the foot: left, right, or empty if unknown")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        foot = marker_columns(spec, self.marker, "marker")
        body = marker_columns(spec, self.reference, "reference") if self.reference else foot
        if spec.rate_hz is None:
            raise InputError("in", spec.describe(), "regular: its rate must be known")
        if self.cutoff_hz >= spec.rate_hz / 2:
            limit = f"below {spec.rate_hz / 2:g} (half of the input's {spec.rate_hz:g} Hz)"
            raise ParameterError("cutoff_hz", self.cutoff_hz, limit)
        sos = butterworth(ORDER, self.cutoff_hz, "lowpass", spec.rate_hz)
        delay_s = group_delay(sos, 0.0) / spec.rate_hz
        vertical = "xyz".index(right_handed_up(spec, self.up, "z", ("x", "y", "z")))
        order = [(vertical + 1) % 3, (vertical + 2) % 3, vertical]
        fill_ns = round(self.fill_gap_s * NS)
        state = MarkerState(
            gap_ns=fill_ns + spec.period_ns,
            last=NEVER,
            columns=np.array([foot[i] for i in order] + [body[i] for i in order]),
            metres=marker_metres(spec, (*foot, *body), self.unit),
            period_ns=spec.period_ns,
            fill_ns=fill_ns,
            delay_ns=round(delay_s * NS),
            alone=not self.reference,
            sos=sos,
            steady=steady_memory(sos),
            z=np.zeros((6, len(sos), 2)),
            limits=np.array([(SWING_M, STANCE_M, REVERSE_M, STILL_NS, 0.0)], LIMITS),
            memory=np.zeros(1, LEGS),
            motion=np.zeros(1, WALK),
            warned=False,
        )
        state.motion["last"] = NEVER
        known_s = 1e-9 * STILL_NS + delay_s + 2 * spec.period_ns / NS
        self.set_state(
            state, delay_s=known_s, decision_s={"touchdown": known_s, "liftoff": known_s + 1e-9 * LONGEST_NS}
        )
        settled_s = settling(sos) / spec.rate_hz
        return self.contacts(spec, settled_s if self.reference else MEMORY_S)

    def follow(self, time: Times, data: Array, found: Times) -> tuple[int, int]:
        s = self.state
        place = np.ascontiguousarray(data.reshape(len(data), -1)[:, s.columns], np.float64) * s.metres
        counts = follow(
            time,
            place,
            (s.period_ns, s.fill_ns, s.delay_ns),
            s.alone,
            s.sos,
            s.steady,
            s.z,
            s.limits,
            s.memory,
            s.motion,
            found,
        )
        if not s.warned and s.motion["strange"][0] > STRANGE:
            self._warn()
        return counts

    def _warn(self) -> None:
        """Once: these numbers cannot be in the unit that is taken for theirs."""
        self.state.warned = True
        apart = {} if self.state.alone else {"apart_m": round(float(self.state.motion["apart"][0]), 4)}
        log.warning(
            "markers jump, or are not a leg's length apart: contacts will be missing or wrong; is their unit right? `unit` sets it",
            marker=self.marker, reference=self.reference, taken_for=UNITS[self.state.metres], **apart,
        )  # fmt: skip

    @classmethod
    def cases(cls) -> Sequence[Case]:
        n, rate_hz = 1200, 100.0
        path = walker(n, rate_hz, speed_m_s=1.2, cadence_hz=0.9)
        spec = StreamSpec((2, 3), rate_hz=rate_hz, channels=("HIP", "ANK"), units=("m",))
        flat = StreamSpec((3,), rate_hz=rate_hz, channels=("ANK_x", "ANK_y", "ANK_z"), units=("mm",))
        belt = walker(n, rate_hz, speed_m_s=1.2, cadence_hz=0.9, belt=True)[:, 1] * 1000.0
        return [
            Case(cls(marker="ANK", reference="HIP"), {"in": (spec, grid(rate_hz, n), path)}, least=18),
            Case(cls(marker="ANK"), {"in": (flat, grid(rate_hz, n), belt)}, least=14),
        ]


def walker(n: int, rate_hz: float, *, speed_m_s: float, cadence_hz: float, belt: bool = False) -> Samples:
    """Hip and ankle of somebody who walks along -y, with noise of 0.5 mm: positions (n, 2, 3) m.

    The ankle lies still (on a `belt`: moves back with it) for 60 % of each stride, from whole multiples of the stride's time on.
    """
    seconds, stride_m = np.arange(n) / rate_hz, speed_m_s / cadence_hz
    whole, phase = np.divmod(seconds * cadence_hz, 1.0)
    swing = np.clip((phase - 0.6) / 0.4, 0.0, 1.0)
    gone = stride_m * (whole + swing - np.sin(2 * np.pi * swing) / (2 * np.pi)) + 0.3 * stride_m
    hip = speed_m_s * seconds
    path = np.zeros((n, 2, 3))
    path[:, 0, 1], path[:, 0, 2] = -hip, 1.0
    path[:, 1, 1], path[:, 1, 2] = -gone, 0.08 + 0.1 * np.sin(np.pi * swing) ** 2
    path[:, :, 1] += hip[:, None] if belt else 0.0
    return np.asarray(path + np.random.default_rng(9).normal(0.0, 0.0005, path.shape))
