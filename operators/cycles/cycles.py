"""Gait cycles: a signal cut at one foot's touch-downs, each cycle on 100 points (thesis 6.2.3, "Detection of Cycles")."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from kinegraph.operators.cycles.cycle import CLOSED, POINTS, Closing
from kinegraph.operators.cycles.cycle_kernel import normalise_time
from kinegraph.operators.cycles.cycle_outputs import CycleOutputs
from kinegraph.operators.cycles.plausible import Durations, out_of_order, signal_reason
from kinegraph.operators.cycles.recent_samples import RecentSamples
from kinegraph.operators.cycles.reported_contacts import ReportedContacts
from kinegraph.stream.chunk import NEVER, NS, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.data.require import regular_signal
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

LOOK_AHEAD = 2
"""Samples after a touch-down that a cycle's last points need."""


@dataclass(slots=True)
class CyclesState:
    """
    recent         the signal's newest samples
    contacts       the foot's, as they have been reported
    durations      of the latest plausible cycles
    start          the open cycle's touch-down; `broken`: contacts may have been missed since
    reported       the newest `until` that was emitted
    """

    recent: RecentSamples
    period: int
    settling: int
    contacts: ReportedContacts
    durations: Durations
    start: int
    broken: bool
    number: int
    made: CycleOutputs
    reported: int


@dataclass(frozen=True, slots=True)
class Cycles(Operator[CyclesState]):
    """A regular signal (channels,) and one foot's contacts in, whole cycles out.

    cycles     (100, channels) of each accepted cycle: point p is the signal at p % of the time from touch-down to touch-down, so that the
               next cycle's point 0 follows point 99 (interpolation: `operators.cycles.cycle_kernel.normalise_time`)
    closed     one event per cycle, rejected ones with the reason (`CLOSED`); an accepted one comes before its sample in `cycles`
    maxima     one event per local maximum of an accepted cycle and channel; at 0 and 99 % the neighbouring cycle's points decide
    panorama   (200, channels) per accepted cycle, in order, -50..149 %: with the halves of its neighbours, NaN where a neighbour was
               rejected or missing. It is emitted when the next cycle closes; the last cycle has no panorama. (Thesis 6.4.1, outlook.)

    A cycle is closed as soon as its second touch-down is reported, two samples after that are there, and every input is complete up to
    then, so that the order in which equal stamps arrive does not matter; that is its events' stamp. Rejected is what
    - lasts less than `shortest_s` ("too short") or more than `longest_s` ("too long");
    - has a gap in signal or contacts inside ("gap"; gaps up to `gap_s` are interpolated), begins before the signal has settled
      ("settling"), begins before the signal did or was reported more than `late_s` after it ended ("incomplete");
    - holds two lift-offs that are further apart than a tenth of it ("order": a touch-down between them was missed), or stands for less
      than `min_stance_pct` or more than `max_stance_pct` of it ("stance"). Of lift-offs close together the last counts; without one the
      stance is not known, and the cycle counts;
    - differs from the median duration of the last 11 cycles by more than `off_median` of it ("irregular");
    - holds NaN ("missing"): in every channel, or with `missing: cycle` in any. With `missing: muscle` the other channels are used, and
      the one is NaN throughout.
    There is a median from the fifth cycle on. It judges the first five, too: one that was accepted before and is irregular is taken back
    by a second event in `closed` of the same number, with the reason. Such an event replaces the first, for whoever reads `closed`.
    A touch-down at or before the previous one is skipped, and so are contacts within `bounce_s` after one.

    Delay: the two samples after the touch-down, and up to one more until it is known that they are there. Memory: the signal of
    `longest_s` + `late_s` and its settling time, twice.

    >>> ramp = series(np.arange(300.0), rate_hz=100)
    >>> cycles = apply(Cycles(), signal=ramp, touchdown=events([0.5, 1.5, 2.5]))
    >>> cycles["closed"]["duration_s"], cycles["cycles"][0, [0, 50, 99], 0].round()
    (array([1., 1.]), array([ 50., 100., 149.]))
    """

    inputs = {"signal": Input(), "touchdown": Input(), "liftoff": Input(optional=True)}
    outputs: ClassVar[tuple[str, ...]] = ("cycles", "closed", "maxima", "panorama")

    shortest_s: float = param(0.4, above=0.0, help="a shorter cycle is rejected")
    longest_s: float = param(4.0, above=0.0, most=60.0, help="a longer cycle is rejected")
    bounce_s: float = param(
        0.05,
        least=0.0,
        help="contacts that follow a touch-down by no more are the same contact: a switch or foot that bounces",
    )
    off_median: float = param(
        0.5, least=0.0, help="rejected beyond this part of the recent median duration; 0: not asked"
    )
    min_stance_pct: float = param(15.0, least=0.0, most=100.0, help="rejected if the foot stands for less of the cycle")
    max_stance_pct: float = param(90.0, least=0.0, most=100.0, help="rejected if the foot stands for more of the cycle")
    gap_s: float = param(0.05, least=0.0, help="a longer gap inside rejects the cycle, a shorter one is interpolated")
    late_s: float = param(1.0, least=0.0, help="how long after it happened a touch-down may be reported")
    missing: Literal["muscle", "cycle"] = param(
        "muscle", help="what a NaN spoils: its muscle in that cycle, or the cycle"
    )

    def open(self, specs: Specs) -> Specs:
        spec, touch, rate_hz = specs["signal"], specs["touchdown"], _checked_rate(specs)
        if self.shortest_s >= self.longest_s:
            raise ParameterError("shortest_s", self.shortest_s, f"below longest_s ({self.longest_s:g})")
        if POINTS / self.shortest_s > 100 * rate_hz:
            raise ParameterError("shortest_s", self.shortest_s, f"at least one sample, {1 / rate_hz:g} s")
        n = spec.shape[0]
        names = list(spec.channels or [f"channel {i + 1}" for i in range(n)])
        _check_names(names)
        keep = int((self.longest_s + self.late_s + spec.settling_s + self.gap_s) * rate_hz * 1.1) + 8
        state = CyclesState(
            recent=RecentSamples.of(keep, n),
            period=spec.period_ns,
            settling=round(spec.settling_s * NS),
            contacts=ReportedContacts.empty(),
            durations=Durations.empty(),
            start=NEVER,
            broken=False,
            number=0,
            made=CycleOutputs.of(names),
            reported=NEVER,
        )
        ahead_s = (LOOK_AHEAD + 1) / rate_hz
        self.set_state(state, delay_s=ahead_s, decision_s={"closed": ahead_s, "maxima": self.longest_s + ahead_s})
        meta = {**spec.meta, "side": touch.meta.get("side", spec.meta.get("side", ""))}
        return CycleOutputs.specs(tuple(names), spec, CLOSED, self.longest_s, meta)

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]] | None:
        s = self.state
        closings: list[Closing] = []
        if port == "signal":
            for a in range(0, len(chunk.time), s.recent.keep):
                time = chunk.time[a : a + s.recent.keep]
                s.recent.append(time, chunk.data[a : a + s.recent.keep])
                self._close_due(closings, min(int(time[-1]) - 1, chunk.until))
        else:
            for i, (stamp, onset) in enumerate(zip(chunk.time.tolist(), chunk.data["onset"].tolist(), strict=True)):
                self._close_due(closings, stamp - 1)
                if port == "touchdown":
                    s.broken |= i == 0 and chunk.lost != 0
                    self._touch(closings, stamp, onset)
                else:
                    s.contacts.lift(onset)
        self._close_due(closings, chunk.until)
        if closings or chunk.lost or chunk.until > s.reported:
            s.reported = max(s.reported, int(chunk.until))
            return s.made.chunks(closings, chunk.until, -1 if chunk.lost else 0)
        return None

    @classmethod
    def cases(cls) -> list[Case]:
        rng = np.random.default_rng(7)
        n, meta = 900, {"side": "right"}
        signal = StreamSpec((2,), rate_hz=60.0, channels=("TA", "SO"), units=("uV",), settling_s=0.2, meta=meta)
        contact = StreamSpec((), np.dtype([("onset", "<i8")]), units=("ns",), meta=meta)
        time = grid(60.0, n)
        smooth = np.apply_along_axis(np.convolve, 0, rng.random((n + 8, 2)), np.ones(9) / 9, "valid")
        touch = (1e9 + np.cumsum(1.0 + 0.1 * rng.random(13)) * 1e9).astype(np.int64)
        lift = touch[:-1] + (0.6 * np.diff(touch)).astype(np.int64)
        inputs = {
            "signal": (signal, time, smooth),
            "touchdown": (contact, touch + 30_000_000, touch.view(contact.dtype)),
        }
        both = {**inputs, "liftoff": (contact, lift + 50_000_000, lift.view(contact.dtype))}
        ties = {**inputs, "liftoff": (contact, touch[1:] + 30_000_000, lift.view(contact.dtype))}
        return [
            Case(cls(), both, least=40),
            Case(cls(), ties, least=40),
            Case(cls(missing="cycle", gap_s=0.1, late_s=0.5), inputs, least=40),
        ]

    def _touch(self, closings: list[Closing], stamp: int, onset: int) -> None:
        """A touch-down has been reported. Where too many wait for samples that do not come, the first is closed without."""
        s = self.state
        if s.contacts.full:
            self._close(closings, s.contacts.first[0], stamp)
            s.contacts.next_touch()
        s.contacts.touch(onset, stamp)

    def _close_due(self, closings: list[Closing], until: int) -> None:
        """Close every ended cycle that has its samples, once every input has passed its stamp (`until`)."""
        s = self.state
        while s.contacts.waiting:
            onset, stamp = s.contacts.first
            if s.start == NEVER or onset <= s.start + self._bounce_ns:
                if stamp > until:
                    return
                if s.start == NEVER:
                    s.start, s.broken = onset, False
            else:
                second = s.recent.after(onset) + LOOK_AHEAD - 1
                if second >= s.recent.fill or (due := max(stamp, int(s.recent.time[second]))) > until:
                    return
                self._close(closings, onset, due)
            s.contacts.next_touch()

    def _close(self, closings: list[Closing], end: int, stamp: int) -> None:
        """Close the open cycle at the touch-down `end`, and open the next."""
        s = self.state
        s.number += 1
        onset, duration = s.start, end - s.start
        a = max(s.recent.after(onset - s.settling - s.period) - 2, 0)
        b = min(s.recent.after(end) + LOOK_AHEAD, s.recent.fill)
        time, data = s.recent.time[a:b], s.recent.data[a:b]
        curve = np.full((POINTS + 2, data.shape[1]), np.nan)
        lifts = s.contacts.lifts_between(onset + self._bounce_ns, end) or s.contacts.lifts_between(onset, end)
        stance = (max(lifts) - onset) / duration * 100 if lifts else np.nan
        rejected = self._plausible(duration, lifts, stance, self._complete(time, onset, end, stamp))
        if not rejected:
            normalise_time(time, data, onset, duration, curve)
            bad = np.isnan(curve[1:-1]).any(axis=0)
            curve[:, bad] = np.nan
            if bad.all() or (self.missing == "cycle" and bad.any()):
                rejected = "missing"
        closing = Closing(stamp, onset, end, s.number, stance, rejected, curve)
        closings += s.durations.judge(closing, self.off_median)
        s.start, s.broken = end, False

    @property
    def _bounce_ns(self) -> int:
        return round(self.bounce_s * NS)

    def _plausible(self, duration: int, lifts: list[int], stance: float, incomplete: str) -> str:
        """Why a cycle cannot be one; "" if it can."""
        s = self.state
        if duration < self.shortest_s * NS:
            return "too short"
        if duration > self.longest_s * NS:
            return "too long"
        if s.broken or incomplete:
            return "gap" if s.broken else incomplete
        if out_of_order(lifts, duration):
            return "order"
        if stance < self.min_stance_pct or stance > self.max_stance_pct:
            return "stance"
        return "irregular" if s.durations.irregular(duration, self.off_median) else ""

    def _complete(self, time: Times, onset: int, end: int, stamp: int) -> str:
        s = self.state
        told_ns = round(self.late_s * NS)
        reason = signal_reason(time, onset, s.recent.began, s.settling, round(s.period + self.gap_s * NS))
        enough = len(time) > 3 and int(time[1]) <= onset and int(time[-2]) > end
        return reason or ("" if enough and stamp - end <= told_ns else "incomplete")


def _check_names(names: list[str]) -> None:
    """Raises InputError where two channels would have one name in events, which have room for 16 characters."""
    short: dict[str, str] = {}
    for name in names:
        if (other := short.setdefault(name[:16], name)) != name:
            differ = "names that differ in their first 16 characters: cycles and reports know muscles by these"
            raise InputError("signal", f"channels {other!r} and {name!r}", differ)


def _checked_rate(specs: Specs) -> float:
    """The signal's rate (Hz). Raises InputError for inputs that cycles cannot be cut from."""
    rate_hz = regular_signal(specs["signal"], "signal")
    for port in ("touchdown", "liftoff"):
        if port in specs and "onset" not in (specs[port].dtype.names or ()):
            raise InputError(port, specs[port].describe(), "contact events with a field 'onset'")
    return rate_hz
