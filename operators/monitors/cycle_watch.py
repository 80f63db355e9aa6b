"""Alarms about contacts: a detector that has gone silent, misses every other step, or sees a part of the session only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kinegraph.operators.cycles.cycle import CLOSED, is_closed, longest_cycle_s
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Array, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.domain.alarm import ON, OVER, FoundAlarms, alarms_spec, alarms_until
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

RECENT, LATEST = 11, 3
ADVICE = {
    "silent": "is somebody walking? see the contact sensor, zero the plate, look at its threshold",
    "slow": "steps may be missed, or found twice: see the contact sensor and its threshold",
    "sparse": "see why cycles are rejected or not found, before the session goes on",
    "uneven": "either the person walks so, or contacts are found early and late: see the contact sensor",
}
ALARMS = np.dtype([(kind, "?") for kind in ADVICE])


@dataclass(slots=True)
class CycleWatchState:
    """
    began, newest   the signal's first and newest stamp;  heard: the stamp of the latest cycle
    durations (11,) of the latest cycles in ns, while their pace is not in question, a ring; `measured` in all
    latest, onsets (3,)   the duration and begin of the latest of all cycles
    covered         how much of the session lies in accepted cycles, ns;  on (1,): which alarms there are
    spans (11,)     of the latest cycles in ns, in turn, a ring; `walked` in all
    gap             stamp before which input is missing, where no output has said so yet; NEVER: nothing is
    """

    began: int = NEVER
    newest: int = NEVER
    heard: int = NEVER
    durations: Times = field(default_factory=lambda: np.zeros(RECENT, np.int64))
    measured: int = 0
    latest: Times = field(default_factory=lambda: np.zeros(LATEST, np.int64))
    onsets: Times = field(default_factory=lambda: np.zeros(LATEST, np.int64))
    seen: int = 0
    covered: int = 0
    on: Array = field(default_factory=lambda: np.zeros(1, ALARMS))
    spans: Times = field(default_factory=lambda: np.zeros(RECENT, np.int64))
    walked: int = 0
    gap: int = NEVER


@dataclass(frozen=True, slots=True)
class CycleWatch(Operator[CycleWatchState]):
    """Cycles (`closed` of `operators.cycles.cycles.Cycles`) and the signal that they are cut from in, alarms out:

    no contact            no cycle has ended for the time of `silent_cycles` of the latest 11 (before the first: for `first_s`)
    cadence               the latest 3 cycles' median is `off_pace` times that of the 11 before them, or as much shorter
    uneven                cycles differ from their neighbours by more than `max_uneven` of their duration (median of the latest 11)
    cycles too few        accepted cycles cover less than `min_covered` of the session, from its 30th second on

    Of several limbs (a field `limb` in `closed`), `operators.monitors.limb_watch.LimbWatch` watches each.

    Each is reported once, and once more when it is over. Stamped when it is decided: the silence's at its end, the others' with a cycle.

    >>> closed = events([12.0], CLOSED, onset=[11], end=[12], number=[1], duration_s=[1.0])
    >>> apply(CycleWatch(first_s=5.0), signal=series(np.zeros(400), rate_hz=20), closed=closed)["what"].tolist()
    ['no contact for 5.0 s', 'no contact', 'no contact for 2.0 s']
    """

    inputs = {"signal": Input(), "closed": Input()}

    silent_cycles: float = param(2.0, above=1.0, most=20.0, help="this many cycles' time without a contact is an alarm")
    first_s: float = param(10.0, above=0.0, help="the same before the first cycle")
    off_pace: float = param(1.6, above=1.0, help="cycles this many times longer or shorter than before are an alarm")
    min_covered: float = param(0.7, least=0.0, most=1.0, help="the part of a session that cycles must cover")
    max_uneven: float = param(
        0.1, above=0.0, help="the part of its duration by which a cycle may differ from the one before it"
    )
    subject: str = param("contacts", help="what the alarms are about, where there are several")

    def open(self, specs: Specs) -> Specs:
        if not is_closed(specs["closed"].dtype):
            raise InputError(
                "closed", specs["closed"].describe(), "cycles' events (`closed` of operators.cycles.cycles.Cycles)"
            )
        longest_s = longest_cycle_s(specs["closed"])
        silent_s = max(self.first_s, self.silent_cycles * longest_s)
        self.set_state(
            CycleWatchState(),
            decision_s={"out": silent_s} if longest_s else None,
        )
        return alarms_spec(specs["closed"].meta)

    def process(self, port: str, chunk: Chunk) -> Sequence[tuple[str, Chunk]]:
        s = self.state
        if chunk.lost and s.gap == NEVER:
            s.gap = int(chunk.time[0])
        found: FoundAlarms = []
        if port == "signal":
            if len(chunk.time):
                s.began = int(chunk.time[0]) if s.began == NEVER else s.began
                s.newest = int(chunk.time[-1])
        else:
            for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
                self._silence(found, stamp - 1)
                self._cycle(found, stamp, row)
        self._silence(found, s.newest if chunk.until == FOREVER else chunk.until)
        if s.gap == NEVER or s.gap > chunk.until:
            return [("out", alarms_until(found, chunk.until))]
        # alarms of the time before the gap are complete, whichever input brought them and when
        early = [alarm for alarm in found if alarm[0] < s.gap]
        before, s.gap = s.gap - 1, NEVER
        return [("out", alarms_until(early, before)), ("out", alarms_until(found[len(early) :], chunk.until, lost=-1))]

    @classmethod
    def cases(cls) -> list[Case]:
        n = 50
        lengths = np.where(np.arange(n) == 20, 6.0, np.where(np.arange(n) > 35, 2.0, 1.0))
        touch = (NS + np.cumsum(lengths) * NS).astype(np.int64)
        rows = np.zeros(n - 1, CLOSED)
        rows["onset"], rows["end"], rows["number"] = touch[:-1], touch[1:], np.arange(1, n)
        rows["duration_s"] = np.diff(touch) / NS
        rows["rejected"] = np.where(
            rows["duration_s"] > 4, "too long", np.where(rows["duration_s"] > 1.5, "irregular", "")
        )
        signal = StreamSpec((1,), rate_hz=20.0)
        samples = int(touch[-1] / NS * 20)
        closed = StreamSpec((), CLOSED, units=("",), meta={"longest_s": 4.0})
        inputs = {
            "signal": (signal, grid(20.0, samples), np.zeros((samples, 1))),
            "closed": (closed, touch[1:] + 20_000_000, rows),
        }
        return [Case(cls(), inputs, least=4)]

    def _median(self) -> float:
        """The usual duration in ns; 0 before there is one."""
        s = self.state
        return float(np.median(s.durations[: s.measured])) if s.measured else 0.0

    def _silence(self, found: FoundAlarms, until: int) -> None:
        s = self.state
        if s.on["silent"] or s.began == NEVER:
            return
        since = s.began if s.heard == NEVER else s.heard
        usual = self._median()
        allowed = round(self.silent_cycles * usual if usual else self.first_s * NS)
        if since + allowed <= until:
            s.on["silent"] = 1
            found.append((since + allowed, self._alarm(since, ON, f"no contact for {allowed / NS:.1f} s", "silent")))

    def _cycle(self, found: FoundAlarms, stamp: int, row: Array) -> None:
        s = self.state
        duration, reason = int(row["end"]) - int(row["onset"]), str(row["rejected"])
        if s.on["silent"]:
            s.on["silent"] = 0
            found.append((stamp, self._alarm(s.heard, OVER, "no contact", "silent")))
        s.heard = max(s.heard, stamp)
        s.covered += 0 if reason else duration
        if reason not in ("too long", "too short", "gap"):
            s.latest[s.seen % LATEST], s.onsets[s.seen % LATEST] = duration, row["onset"]
            s.seen += 1
            self._pace(found, stamp, duration)
            self._evenness(found, stamp, duration)
        self._coverage(found, stamp)

    def _pace(self, found: FoundAlarms, stamp: int, duration: int) -> None:
        s, usual = self.state, self._median()
        now = float(np.median(s.latest)) if s.seen >= LATEST else usual
        times = max(now / usual, usual / now) if usual else 1.0
        if s.measured >= LATEST and times >= self.off_pace and not s.on["slow"]:
            s.on["slow"] = 1
            text = f"cadence went from {60 * NS / usual:.0f} to {60 * NS / now:.0f} strides/min"
            found.append((stamp, self._alarm(self._since(now, usual), ON, text, "slow")))
        elif s.on["slow"] and times < 1 + (self.off_pace - 1) / 2:
            s.on["slow"] = 0
            found.append((stamp, self._alarm(self._since(now, now), OVER, "cadence", "slow")))
        near = usual == 0 or max(duration / usual, usual / duration) < self.off_pace
        if near and not s.on["slow"]:
            s.durations[s.measured % RECENT] = duration
            s.measured += 1

    def _since(self, now: float, other: float) -> int:
        """When the first of the latest cycles began that lasts nearer to `now` than to the `other` duration, or near to `now` itself."""
        s = self.state
        off = np.abs(np.log(s.latest / now))
        near = off < abs(np.log(now / other)) / 2 if now != other else off < np.log(self.off_pace) / 2
        return int(s.onsets[near].min())

    def _evenness(self, found: FoundAlarms, stamp: int, duration: int) -> None:
        """Of neighbours: a belt that changes its speed makes one of them differ, a contact that is found late makes three."""
        s = self.state
        s.spans[s.walked % RECENT] = duration
        s.walked += 1
        if s.walked < RECENT:
            return
        in_turn = np.roll(s.spans, -(s.walked % RECENT))
        uneven = float(np.median(np.abs(np.diff(in_turn))) / np.median(in_turn))
        if uneven > self.max_uneven and not s.on["uneven"]:
            s.on["uneven"] = 1
            text = f"cycles differ by {100 * uneven:.0f} % from one to the next"
            found.append((stamp, self._alarm(stamp, ON, text, "uneven")))
        elif s.on["uneven"] and uneven < self.max_uneven / 1.5:
            s.on["uneven"] = 0
            found.append((stamp, self._alarm(stamp, OVER, "cycles differ", "uneven")))

    def _coverage(self, found: FoundAlarms, stamp: int) -> None:
        s = self.state
        elapsed = stamp - s.began if s.began != NEVER else 0
        if elapsed < 30 * NS:
            return
        share = s.covered / elapsed
        if share < self.min_covered and not s.on["sparse"]:
            s.on["sparse"] = 1
            text = f"cycles cover {100 * share:.0f} % of {elapsed / NS:.0f} s"
            found.append((stamp, self._alarm(stamp, ON, text, "sparse")))
        elif s.on["sparse"] and share > (1 + self.min_covered) / 2:
            s.on["sparse"] = 0
            found.append((stamp, self._alarm(stamp, OVER, "cycles cover too little", "sparse")))

    def _alarm(self, onset: int, state: str, what: str, kind: str) -> tuple[int, str, str, str, str]:
        return onset, self.subject, state, what, ADVICE[kind] if state == ON else ""
