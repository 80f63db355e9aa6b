"""Alarms about contacts and leads that the muscles' own timing speaks against: later than at first, the other leg's, another muscle's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kinegraph.operators.contacts.limbs import Belonging
from kinegraph.operators.cycles.contact_spans import LatestCycles, changed_at
from kinegraph.operators.cycles.cycle import POINTS, Expected, check_named_cycles, longest_cycle_s, some_cycles
from kinegraph.operators.monitors.latch import Latch
from kinegraph.operators.monitors.reference_patterns import (
    WORKS_PCT,
    likeness,
    muscle_called,
    side_called,
    textbook_pattern,
)
from kinegraph.operators.monitors.stage_change import StageUnderWay
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.domain.alarm import FoundAlarms, alarm, alarm_chunk, alarms_spec
from kinegraph.stream.errors import ParameterError, nearest
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

SHIFT, HALF = 0, 1
OVERS = ("contacts later or earlier than at first", "muscles work half a cycle off")
SHIFTED = "see the contact sensor, its threshold and delay; or the person walks in another way"
OTHER_LEG = "are these the other leg's contacts, or leads of muscles that work in turn swapped? patients may walk so"
OTHER_MUSCLE = (
    "look whether the electrodes are on that muscle, or leads were swapped; patients may differ from the textbook"
)
FARTHEST_PCT = 10
"""A curve is looked for so far from where it was at first; what is further off is another pattern."""
MIN_PAIRS = 5
ALIKE = 0.6
"""The correlation that a curve has at least with the textbook's pattern of a muscle that it is taken for."""


@dataclass(slots=True)
class TimingWatchState:
    """
    first (100, m), taken (m,)   sum of each muscle's first cycles in the stage under way, and how many
    lags (l, k), measured (l,)   how much later than at first the latest cycles were, in % of the cycle, rings by limb
    scatter (l, 3)               sum of squared differences of neighbouring lags, how many, the latest lag
    recent (k, 100, m), seen (m,) the latest cycles, rings
    limb (l, 2), muscle (m,)     alarms about each limb's contacts, and each muscle (what is on: another's place + 1)
    past                         of each limb's latest cycles: by how much half a cycle later fits better, and the lag;  newest (l,): number
    decided (l, 2)               the begin of the cycle with which each alarm about contacts began or ended
    lag (l,)                     how much later than at first the cycles of the alarm about it were
    stage                        of each limb;  known: the textbook's muscle of each channel;  patterns (100, m): its pattern
    """

    expected: Expected
    first: Samples
    taken: Times
    lags: Samples
    measured: Times
    scatter: Samples
    recent: Samples
    seen: Times
    limb: Latch
    muscle: Latch
    past: LatestCycles
    newest: Times
    decided: Times
    lag: Samples
    stage: StageUnderWay
    limbs: Belonging
    names: list[str]
    known: list[str]
    patterns: Samples


@dataclass(frozen=True, slots=True)
class TimingWatch(Operator[TimingWatchState]):
    """Cycles and their events in, alarms out where the muscles' own timing says that contacts or leads are wrong:

    contacts later    a limb's curves have moved against those of its first `first` cycles (of the stage, where `closed` has stages): the
                      lag with the highest circular correlation, to a part of a point, the median of the limb's muscles; its mean over
                      the latest `latest` cycles is `off_pct` of the cycle or more, and `sds` times its own standard error. Over below
                      half of that. One muscle of several that works later is no alarm; for a single muscle it is unknown which one moved.
    half a cycle off  a limb's muscles (two or more that the textbook knows, by their names) fit it better by `margin` half a cycle later,
                      in the mean of their correlations: the contacts may be the other leg's
    another muscle's  a muscle fits the textbook's pattern of another better than its own, by `margin` + 0.2, and by 0.6 at least

    Both latter use the mean of the latest `latest` cycles, from the third on, so they hold from the start; they do not exist with more than
    two limbs, nor for a channel named after the other side than the contacts' (RTA in the left leg's cycles), or no muscle that the
    textbook has (then `muscles` says which it is; the report names those that are not watched so). Each alarm comes when
    `cycles` cycles in a row agree, and once more when it is over; the onset of one about contacts is that of the cycle with which the
    change began, as its latest cycles show. A cycle half a cycle off has no lag. Patterns and their source:
    `operators.monitors.reference_patterns`.

    >>> given, made = tried(TimingWatch)
    >>> given["cycles"].shape, made[["subject", "state", "what"]][0].item()
    ((49, 100, 3), ('TA', 'on', 'its curve is rather that of SO'))
    """

    inputs = {"closed": Input(), "cycles": Input(trigger=True)}

    first: int = param(10, least=3, most=200, help="cycles that show where each muscle works")
    latest: int = param(6, least=3, most=50, help="cycles over which the timing of now is averaged")
    cycles: int = param(2, least=1, most=50, help="cycles in a row that must agree")
    off_pct: float = param(
        1.2, above=0.0, most=10.0, help="curves this much of the cycle later or earlier are an alarm"
    )
    sds: float = param(4.0, above=0.0, help="and this many standard errors of their mean")
    textbook: bool = param(True, help="hold muscles that are known by name against when they work in a walking person")
    muscles: dict[str, str] | None = param(
        None, help="which muscle a channel shows, where its name does not say so: {EMG1: TA, EMG2: SO}"
    )
    margin: float = param(
        0.8,
        above=0.0,
        most=2.0,
        help="by how much half a cycle later must fit better (correlation, mean of the muscles)",
    )
    subject: str = param("contacts", help="what the alarms about contacts are about, where limbs have no names")

    def open(self, specs: Specs) -> Specs:
        spec = check_named_cycles(specs)
        m, limbs, longest_s = spec.shape[1], Belonging.of(spec), longest_cycle_s(specs["closed"])
        ways, known = (
            max(1, len(limbs.names)),
            known_muscles(spec, len(limbs.names), self.muscles or {}, textbook=self.textbook),
        )
        self.set_state(
            TimingWatchState(
                Expected.empty(specs["closed"].dtype), np.zeros((POINTS, m)), np.zeros(m, np.int64), np.zeros((ways, self.latest)),
                np.zeros(ways, np.int64), np.zeros((ways, 3)), np.zeros((self.latest, POINTS, m)), np.zeros(m, np.int64),
                Latch.calm(ways, 2), Latch.calm(m), LatestCycles.empty(ways, 2), np.full(ways, -1),
                np.zeros((ways, 2), np.int64), np.zeros(ways), StageUnderWay.empty(ways), limbs, list(spec.channels), known,
                np.stack([textbook_pattern(name) for name in known], axis=1),
            ),
            decision_s={"out": longest_s} if longest_s else None,
        )  # fmt: skip
        unnamed = [name for name, muscle in zip(spec.channels, known, strict=True) if self.textbook and not muscle]
        meta = {**spec.meta, "needs_cycles": self.first + self.latest, "unnamed": unnamed}
        return alarms_spec(meta)

    def process(self, port: str, chunk: Chunk) -> Chunk:
        found: FoundAlarms = []
        for stamp, closed, curve in self.state.expected.heard(port, chunk):
            self._cycle(found, stamp, closed, curve)
        return alarm_chunk(found, chunk)

    @classmethod
    def cases(cls) -> list[Case]:
        inputs = some_cycles(60, 3, 9)
        spec, time, curves = inputs["cycles"]
        late = curves.copy()
        late[24:36] = np.roll(curves[24:36], 5, axis=1)
        given = {**inputs, "cycles": (spec, time, late)}
        return [Case(cls(first=5, latest=3), given, least=2), Case(cls(first=8, latest=4, cycles=1), given, least=2)]

    def _cycle(self, found: FoundAlarms, stamp: int, closed: np.void, curve: Samples) -> None:
        s, when = self.state, (stamp, int(closed["onset"]))
        limb = s.limbs.names.index(str(closed["limb"])) if s.limbs.names else 0
        belongs = s.limbs.mine(closed)
        if s.stage.begins(limb, closed):
            self._begin_again(found, when, limb, belongs)
        if not s.stage.holds(limb, int(closed["number"])) or closed["number"] <= s.newest[limb]:
            return
        s.newest[limb] = closed["number"]
        mine = np.flatnonzero(belongs & ~np.isnan(curve).any(axis=0))
        half = self._half(mine, curve)
        s.past.add(limb, when[1], (half, 0.0))
        for i in mine.tolist():
            s.recent[s.seen[i] % self.latest, :, i] = curve[:, i]
            s.seen[i] += 1
        self._textbook(found, when, limb, mine)
        if half < self.margin and not s.limb.on[limb, HALF]:
            self._lag(found, when, limb, mine, curve)

    def _half(self, mine: Array, curve: Samples) -> float:
        """By how much one cycle's muscles fit the textbook better half a cycle later; 0 where fewer than two are known."""
        known = [i for i in mine.tolist() if self.state.known[i]]
        return half_later(curve[:, known], self.state.patterns[:, known]) if len(known) > 1 else 0.0

    def _begin_again(self, found: FoundAlarms, when: tuple[int, int], limb: int, mine: Array) -> None:
        """Another stage has begun: at another speed muscles work at another time."""
        s = self.state
        if s.limb.on[limb, SHIFT]:
            found.append(alarm(*when, self._who(limb), OVERS[SHIFT]))
        s.first[:, mine], s.taken[mine] = 0.0, 0
        s.measured[limb], s.scatter[limb], s.past.measures[limb, :, 1] = 0, 0.0, 0.0
        s.limb.end((limb, SHIFT))

    def _lag(self, found: FoundAlarms, when: tuple[int, int], limb: int, mine: Array, curve: Samples) -> None:
        """Take a cycle into what was at first, or measure how much later it is."""
        s = self.state
        for i in mine[s.taken[mine] < self.first].tolist():
            s.first[:, i] += curve[:, i]
            s.taken[i] += 1
        ready = mine[s.taken[mine] >= self.first]
        if not len(ready):
            return
        lag = float(np.median(lags_pct(curve[:, ready], s.first[:, ready])))
        if s.measured[limb]:
            s.scatter[limb, :2] += (lag - s.scatter[limb, 2]) ** 2, 1
        s.scatter[limb, 2] = s.past.measures[limb, (s.past.seen[limb] - 1) % s.past.onsets.shape[1], 1] = lag
        s.lags[limb, s.measured[limb] % self.latest] = lag
        s.measured[limb] += 1
        if s.measured[limb] < self.latest or s.scatter[limb, 1] < MIN_PAIRS:
            return
        mean = float(s.lags[limb].mean())
        error = np.sqrt(s.scatter[limb, 0] / s.scatter[limb, 1] / 2 * (1 / self.latest + 1 / self.first))
        least = self.off_pct / 2 if s.limb.on[limb, SHIFT] else self.off_pct
        other = int(abs(mean) >= max(least, self.sds * error))
        towards = np.sign(mean if other else s.lag[limb])
        size = abs(mean) if other else abs(float(s.lag[limb]))
        text = f"contacts {abs(mean):.1f} % of the cycle {'earlier' if mean > 0 else 'later'} than at first"
        s.lag[limb] = mean if other else s.lag[limb]
        scores = towards * s.past.latest(limb)[1][:, 1] - size / 2
        self._contacts(
            found,
            when,
            limb,
            SHIFT,
            other,
            scores if other else -scores,
            (self._who(limb), text, OVERS[SHIFT], SHIFTED),
        )

    def _textbook(self, found: FoundAlarms, when: tuple[int, int], limb: int, mine: Array) -> None:
        """Hold the mean of a limb's latest cycles against the textbook."""
        s = self.state
        known = [i for i in mine.tolist() if s.known[i] and s.seen[i] >= 3]
        if len(known) < 2:
            return
        curves = np.stack([s.recent[: min(self.latest, s.seen[i]), :, i].mean(axis=0) for i in known], axis=1)
        like = likeness(curves, s.patterns[:, known])
        own = like.diagonal()
        half = int(half_later(curves, s.patterns[:, known]) >= self.margin)
        scores = s.past.latest(limb)[1][:, 0]
        self._contacts(
            found,
            when,
            limb,
            HALF,
            half,
            scores if half else -scores,
            (self._who(limb), OVERS[HALF], OVERS[HALF], OTHER_LEG),
        )
        for k, i in enumerate(known):
            best = int(like[k].argmax())
            other = not s.limb.on[limb, HALF] and not half and like[k, best] >= max(ALIKE, own[k] + self.margin + 0.2)
            name = s.known[known[best]] if other else ""
            text = f"its curve is rather that of {name}", "its curve is another muscle's", OTHER_MUSCLE
            self._report(found, when, s.muscle, i, int(known[best]) + 1 if other else 0, (s.names[i], *text))

    def _contacts(
        self, found: FoundAlarms, when: tuple[int, int], limb: int, kind: int, now: int, scores: Samples,
        words: tuple[str, str, str, str],
    ) -> None:  # fmt: skip
        """An alarm about a limb's contacts, or its end. `scores` of its latest cycles: positive ones agree with what is so now. The change
        began after the cycle with which the one before it was reported."""
        s, onsets = self.state, self.state.past.latest(limb)[0]
        later = onsets > s.decided[limb, kind]
        began = int(onsets[later][changed_at(scores[later])])
        if self._report(found, (when[0], began), s.limb, (limb, kind), now, words):
            s.decided[limb, kind] = when[1]

    def _report(
        self, found: FoundAlarms, when: tuple[int, int], alarms: Latch, at: int | tuple[int, int], now: int,
        words: tuple[str, str, str, str],
    ) -> bool:  # fmt: skip
        """Take what is so now; whether an alarm begins or ends. `words`: about whom, what, what when it is over, what to do."""
        turned = alarms.turns(at, now, self.cycles)
        if turned:
            who, what, over, advice = words
            found.append(alarm(*when, who, what if now else over, advice if now else ""))
        return turned

    def _who(self, limb: int) -> str:
        return self.state.limbs.names[limb] if self.state.limbs.names else self.subject


def known_muscles(spec: StreamSpec, limbs: int, given: Mapping[str, str], *, textbook: bool) -> list[str]:
    """The textbook's muscle of each channel, "" where it is not to be held against one."""
    for channel, muscle in given.items():
        if channel not in spec.channels:
            raise ParameterError("muscles", channel, f"a channel of `cycles`; {nearest(channel, spec.channels)}")
        if not muscle_called(muscle):
            raise ParameterError("muscles", muscle, f"a muscle that the textbook has: {', '.join(WORKS_PCT)}")
    muscles = {**dict(spec.meta.get("muscles") or {}), **given}
    side = str(spec.meta.get("side", ""))
    if not textbook or limbs > 2:
        return [""] * len(spec.channels)
    if limbs:
        return [muscle_called(str(muscles.get(name, name))) for name in spec.channels]
    sides = {side_called(muscles.get(name, name)) for name in spec.channels} - {""}
    own = {"", side} if side else {"", *sides} if len(sides) < 2 else {""}
    named = [muscles.get(name, name) for name in spec.channels]
    return [muscle_called(name) if side_called(name) in own else "" for name in named]


def half_later(curves: Samples, patterns: Samples) -> float:
    """By how much curves (100, m) fit their patterns (100, m) better half a cycle later: the mean difference of the correlations."""
    later = np.roll(patterns, POINTS // 2, axis=0)
    return float((likeness(curves, later).diagonal() - likeness(curves, patterns).diagonal()).mean())


def lags_pct(curves: Samples, patterns: Samples) -> Samples:
    """How much later (% of the cycle) each curve (100, m) is than its pattern (100, m): (m,), by circular correlation within 10 %."""
    a, b = curves - curves.mean(axis=0), patterns - patterns.mean(axis=0)
    shifts = np.arange(-FARTHEST_PCT - 1, FARTHEST_PCT + 2)
    like = np.stack([(np.roll(a, -k, axis=0) * b).sum(axis=0) for k in shifts.tolist()])
    at, muscles = like[1:-1].argmax(axis=0) + 1, np.arange(a.shape[1])
    before, top, after = like[at - 1, muscles], like[at, muscles], like[at + 1, muscles]
    bend = before - 2 * top + after
    part = np.where(bend < 0, (before - after) / np.where(bend < 0, 2 * bend, 1.0), 0.0)
    return np.asarray(shifts[at] + np.clip(part, -1.0, 1.0))
