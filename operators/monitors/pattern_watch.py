"""Alarms about muscles with the curve of another muscle (swapped leads), or with a much larger or smaller one than at first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.contacts.limbs import Belonging
from kinegraph.operators.cycles.cycle import POINTS, Expected, check_cycles, longest_cycle_s, some_cycles
from kinegraph.operators.monitors.latch import Latch
from kinegraph.operators.monitors.reference_patterns import likeness
from kinegraph.operators.monitors.stage_change import StageUnderWay
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, Times
from kinegraph.stream.domain.alarm import FoundAlarms, alarm, alarm_chunk, alarms_spec
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

RESIZED = "look at the electrode, the gain and the belt's speed; it may also be that the muscle tires"
UNRESTED = "look at the electrode and its cable: there is noise, or another muscle, where this one was at rest"
SIZE, REST = 0, 1
MEASURES = (("its curve", "its curve has another size", RESIZED), ("its rest", "its rest is another", UNRESTED))
QUIET_PCT = 10
"""A curve's rest is this percentile of its points: its lowest ones are the low-pass's undershoot beside steep bursts."""
NOISE_SHARE = 0.005
"""What is below this part of the first curve's peak is baseline noise, not a rest that could be higher or lower."""
ADVICE = "look whether its leads were swapped with the other's; cycles since then belong to the other muscle"


@dataclass(slots=True)
class PatternWatchState:
    """
    first (100, m), taken (m,)   sum of each muscle's first cycles, and how many
    recent (k, 100, m), seen (m,) the latest cycles, rings
    like (m,)                    alarms about patterns: the muscle whose pattern each has (-1: its own)
    sized (2, m)                 alarms about size and rest
    level (100, m), within (m,)  sum of each muscle's first cycles in the stage under way; how many it has in it;  stage: of each limb
    newest (l,)                  the highest number of each limb's cycles: one that is reported again counts once
    """

    expected: Expected
    first: Samples
    taken: Times
    recent: Samples
    seen: Times
    like: Latch
    sized: Latch
    level: Samples
    within: Times
    stage: StageUnderWay
    newest: Times
    limbs: Belonging
    names: list[str]


@dataclass(frozen=True, slots=True)
class PatternWatch(Operator[PatternWatchState]):
    """Raises an alarm for each muscle with the curve of another of the same limb, or with another size.

    A muscle's pattern is the mean of its first `first` cycles. It has become another's where the mean of its latest `latest` cycles
    correlates by `margin` more with the other's pattern than with its own, and by 0.7 at least, in `cycles` cycles in a row; the alarm is
    over when it has been its own again for as long. It takes about `latest` / 2 + `cycles` cycles. Muscles that are alike from the
    start stay alike. A muscle has another size where the mean of its latest cycles' curves is `times` as high as that of its first
    ones or more, or as much lower, for as many cycles in a row; over below half of that change. Its rest, that curve's 10th
    percentile, but at least 0.5 % of the first curve's peak, is compared in the same way (`times_rest`): noise that is small beside a
    burst. A muscle has one alarm at a time, and another's pattern replaces another size or rest. Where `closed` has stages
    (`operators.cycles.stages.Stages`), these are the stage's first cycles: at another speed of the belt a muscle has another size, but its
    pattern still.

    >>> given, made = tried(PatternWatch)
    >>> given["cycles"].shape, made[["subject", "state", "what"]][0].item()
    ((33, 100, 3), ('TA', 'on', 'its curve is that of GM'))
    """

    inputs = {"closed": Input(), "cycles": Input(trigger=True)}

    first: int = param(10, least=2, most=200, help="cycles that show each muscle's pattern")
    latest: int = param(3, least=1, most=50, help="cycles over which the pattern of now is averaged")
    cycles: int = param(2, least=1, most=50, help="cycles in a row that must agree")
    times: float = param(
        1.4, above=1.0, help="a curve this many times as high as at first, or as much lower, raises an alarm"
    )
    times_rest: float = param(2.0, above=1.0, help="the same for its rest, between bursts")
    margin: float = param(0.3, above=0.0, most=2.0, help="by how much the other's pattern correlates better")

    def open(self, specs: Specs) -> Specs:
        spec = check_cycles(specs)
        m, limbs, longest_s = spec.shape[1], Belonging.of(spec), longest_cycle_s(specs["closed"])
        ways = max(1, len(limbs.names))
        self.set_state(
            PatternWatchState(
                Expected.empty(specs["closed"].dtype), np.zeros((POINTS, m)), np.zeros(m, np.int64), np.zeros((self.latest, POINTS, m)),
                np.zeros(m, np.int64), Latch.calm(m, value=-1), Latch.calm(2, m),
                np.zeros((POINTS, m)), np.zeros(m, np.int64), StageUnderWay.empty(ways), np.full(ways, -1), limbs,
                list(spec.channels),
            ),
            decision_s={"out": longest_s} if longest_s else None,
        )  # fmt: skip
        meta = {**spec.meta, "needs_cycles": self.first + self.latest}
        return alarms_spec(meta)

    def process(self, port: str, chunk: Chunk) -> Chunk:
        found: FoundAlarms = []
        for stamp, closed, curve in self.state.expected.heard(port, chunk):
            self._cycle(found, stamp, closed, curve)
        return alarm_chunk(found, chunk)

    @classmethod
    def cases(cls) -> list[Case]:
        inputs = some_cycles(40, 3, 9)
        spec, time, curves = inputs["cycles"]
        swapped = curves.copy()
        swapped[20:30, :, [0, 2]] = curves[20:30, :, [2, 0]]
        given = {**inputs, "cycles": (spec, time, swapped)}
        return [Case(cls(first=5, latest=2), given, least=2), Case(cls(first=8, latest=1, cycles=1), given, least=2)]

    def _cycle(self, found: FoundAlarms, stamp: int, closed: np.void, curve: Samples) -> None:
        s = self.state
        limb = s.limbs.names.index(str(closed["limb"])) if s.limbs.names else 0
        if s.stage.begins(limb, closed):
            self._begin_again(found, (stamp, int(closed["onset"])), s.limbs.mine(closed))
        if not s.stage.holds(limb, int(closed["number"])) or closed["number"] <= s.newest[limb]:
            return
        s.newest[limb] = closed["number"]
        mine = np.flatnonzero(s.limbs.mine(closed) & ~np.isnan(curve).any(axis=0))
        for i in mine.tolist():
            if s.within[i] < self.first:
                s.level[:, i] += curve[:, i]
            s.within[i] += 1
            if s.taken[i] < self.first:
                s.first[:, i] += curve[:, i]
                s.taken[i] += 1
            s.recent[s.seen[i] % self.latest, :, i] = curve[:, i]
            s.seen[i] += 1
        ready = mine[(s.taken[mine] >= self.first) & (s.seen[mine] >= self.first + self.latest)]
        when = stamp, int(closed["onset"])
        self._patterns(found, when, ready)
        for i in ready[s.within[ready] >= self.first + self.latest].tolist():
            level, now = s.level[:, i] / self.first, s.recent[:, :, i].mean(axis=0)
            noise = NOISE_SHARE * max(float(level.max()), 0.0)
            swapped = bool(s.like.on[i] >= 0 and likeness(now[:, None], level[:, None])[0, 0] < 0.7)
            size = float(level.mean()), float(now.mean()), self.times
            rest = _rest(level, noise), _rest(now, noise), self.times_rest
            self._size(found, when, (i, SIZE), size, explained=swapped or bool(s.sized.on[REST, i]))
            self._size(found, when, (i, REST), rest, explained=swapped or bool(s.sized.on[SIZE, i]))

    def _patterns(self, found: FoundAlarms, when: tuple[int, int], ready: Times) -> None:
        s = self.state
        if len(ready) < 2:
            return
        like = likeness(s.recent[:, :, ready].mean(axis=0), s.first[:, ready])
        for k, i in enumerate(ready.tolist()):
            best = int(like[k].argmax())
            other = like[k, best] > max(0.7, like[k, k] + self.margin)
            self._pattern(found, when, i, int(ready[best]) if other else -1)

    def _begin_again(self, found: FoundAlarms, when: tuple[int, int], mine: Array) -> None:
        """Another stage has begun: what a limb's muscles had before is no measure for their size."""
        s = self.state
        for kind, (_, over, _) in enumerate(MEASURES):
            found += [alarm(*when, s.names[i], over) for i in np.flatnonzero(mine & (s.sized.on[kind] == 1)).tolist()]
        s.level[:, mine], s.within[mine] = 0.0, 0
        s.sized.end((slice(None), mine))

    def _size(
        self, found: FoundAlarms, when: tuple[int, int], which: tuple[int, int], measured: tuple[float, float, float],
        *, explained: bool,
    ) -> None:  # fmt: skip
        """Compare a measure of a muscle before and now with how many times as high it may be; `which`: the muscle and the measure.
        `explained`: another alarm about the muscle is its cause."""
        i, kind = which
        sized, (before, now, times) = self.state.sized, measured
        ratio = now / before if before > 0 and now > 0 else 1.0
        off = max(ratio, 1 / ratio)
        other = off >= (1 + (times - 1) / 2 if sized.on[kind, i] else times)
        if sized.turns((kind, i), int(other), self.cycles, hold=other and explained):
            what, over, advice = MEASURES[kind]
            text = f"{what} is {ratio:.2g} times as high as at first" if other else over
            found.append(alarm(*when, self.state.names[i], text, advice if other else ""))

    def _pattern(self, found: FoundAlarms, when: tuple[int, int], i: int, like: int) -> None:
        s = self.state
        was = int(s.like.on[i])
        if not s.like.turns(i, like, self.cycles):
            return
        for kind in np.flatnonzero(s.sized.on[:, i]).tolist() if like >= 0 else ():
            found.append(alarm(*when, s.names[i], MEASURES[kind][1]))
            s.sized.end((kind, i))
        what = f"its curve is that of {s.names[like if like >= 0 else was]}"
        found.append(alarm(*when, s.names[i], what, ADVICE if like >= 0 else ""))


def _rest(curve: Samples, noise: float) -> float:
    return max(float(np.percentile(curve, QUIET_PCT)), noise)
