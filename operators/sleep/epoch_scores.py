"""The newest epochs of activity and their scores, until each is final."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.operators.sleep.methods import ScoringRule
from kinegraph.operators.sleep.rescoring import RULES, rules_applied, settled
from kinegraph.stream.chunk import NEVER, NS, Samples, Times
from kinegraph.stream.domain.night import NAMES, SLEEP, UNKNOWN, WAKE, States

MINUTE = 60 * NS

CAUSES = ("", "movement", "still", "rescored", "unseen", "gaps", "start")
"""Why an epoch has its state: its score reaches wake, or does not; a rule of Webster; it was not seen; too much around it was not seen;
its method knows no epochs before the first."""
MOVEMENT, STILL, RESCORED, UNSEEN, GAPS, START = range(1, len(CAUSES))


@dataclass(slots=True)
class EpochScores:
    """The newest `n` epochs, oldest first; a place that no epoch has taken yet has onset NEVER.

    rule, rescore, min_seen  how they are scored
    activity (n,) counts or motion; NaN: not seen. raw (n,) the state by the score alone, score (n,) that score
    cause (n,) of CAUSES, as the score alone has it; mover (n,) onset of the epoch whose movement adds most to the score, 0: no movement;
    weight (n,) that epoch's share of all weight, adds (n,) how much of the score is its
    open     how many of the newest are not scored for good yet; waiting: how many of those scored wait for Webster's rules
    """

    rule: ScoringRule
    rescore: bool
    min_seen: float
    epoch_ns: int
    onset: Times
    activity: Samples
    raw: States
    score: Samples
    cause: States
    mover: Times
    weight: Samples
    adds: Samples
    open: int
    waiting: int

    @staticmethod
    def empty(rule: ScoringRule, rescore: bool, min_seen: float, epoch_ns: int, n: int) -> EpochScores:
        missing, zeros = [np.full(n, np.nan) for _ in range(4)], [np.zeros(n, np.int8) for _ in range(2)]
        return EpochScores(
            rule, rescore, min_seen, epoch_ns, np.full(n, NEVER), missing[0], zeros[0], missing[1], zeros[1],
            np.zeros(n, np.int64), missing[2], missing[3], 0, 0,
        )  # fmt: skip

    @property
    def newest(self) -> int:
        """Onset of the newest epoch; NEVER before the first."""
        return int(self.onset[-1])

    def add(self, onset: int, activity: float) -> tuple[Any, ...]:
        """One more epoch; its provisional event, as if no movement were to follow."""
        for array in (self.onset, self.activity, self.raw, self.score, self.cause, self.mover, self.weight, self.adds):
            array[:-1] = array[1:]
        self.onset[-1], self.activity[-1] = onset, activity
        last = len(self.onset) - 1
        self._score(last)
        applied = int(rules_applied(self.raw, self.epoch_ns / MINUTE)[-1]) if self.rescore else 0
        event = self._event(last, applied, final=False)
        self.open += 1
        if self.open > self.rule.future:
            self._score(last - self.rule.future)
            self.open -= 1
            self.waiting += 1
        return event

    def final(self, *, ended: bool) -> tuple[Any, ...] | None:
        """The final event of the oldest epoch that waits for it; None without one, or while later epochs may change it."""
        if not self.waiting:
            return None
        known = len(self.onset) - self.open
        place = known - self.waiting
        applied = 0
        if self.rescore:
            minutes = self.epoch_ns / MINUTE
            if not ended and not settled(self.raw[:known], place, minutes):
                return None
            applied = int(rules_applied(self.raw[:known], minutes, ahead=UNKNOWN if ended else WAKE)[place])
        self.waiting -= 1
        return self._event(place, applied, final=True)

    def end(self) -> None:
        """Nothing follows: what is open is scored as it is, and waits."""
        for place in range(len(self.onset) - self.open, len(self.onset)):
            self._score(place)
        self.waiting, self.open = self.waiting + self.open, 0

    def forget(self) -> None:
        self.onset[:], self.activity[:], self.score[:], self.raw[:] = NEVER, np.nan, np.nan, UNKNOWN
        self.cause[:], self.mover[:], self.weight[:], self.adds[:] = 0, 0, np.nan, np.nan

    def distrust(self, onset: int) -> None:
        """Movement in the epoch that began at `onset`, if it is still open, may be somebody else's: it counts as not seen."""
        for place in range(len(self.onset) - self.open, len(self.onset)):
            if self.onset[place] == onset and self.activity[place] > 0:
                self.activity[place] = np.nan

    def _score(self, place: int) -> None:
        """Score the epoch at `place` by itself and its neighbours, those to come taken as still."""
        first, stop = place - self.rule.past, place + self.rule.future + 1
        around = np.zeros(len(self.rule.weights))
        around[: len(self.onset) - first] = self.activity[first:stop]
        absent = self.onset[first : place + 1] == NEVER
        if self.rule.before == "zero":
            around[: len(absent)][absent] = 0.0
        score, asleep = self.rule.score(around, self.min_seen)
        mover, self.weight[place], self.adds[place] = self.rule.strongest(around, self.min_seen)
        self.mover[place] = self.onset[first + mover] if mover >= 0 else 0
        if score != score or (self.rule.before == "unknown" and absent.any()):
            self.score[place], self.raw[place] = np.nan, UNKNOWN
            self.mover[place], self.weight[place], self.adds[place] = 0, np.nan, np.nan
            unseen = self.activity[place] != self.activity[place]
            self.cause[place] = UNSEEN if unseen else GAPS if score != score else START
        else:
            self.score[place], self.raw[place] = score, SLEEP if asleep else WAKE
            self.cause[place] = STILL if asleep else MOVEMENT

    def _event(self, place: int, applied: int, *, final: bool) -> tuple[Any, ...]:
        """`applied`: which of RULES has made wake of it."""
        onset = int(self.onset[place])
        state, cause = (WAKE, RESCORED) if applied else (int(self.raw[place]), int(self.cause[place]))
        return (
            onset, onset + self.epoch_ns, NAMES[state], self.score[place], self.activity[place], final, applied > 0,
            CAUSES[cause], self.mover[place], self.weight[place], self.adds[place], RULES[applied],
        )  # fmt: skip
