"""Whether a declared counter counts: held against its own steps in a device's first seconds."""

from __future__ import annotations

from collections import Counter as Tally

import numpy as np

from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.errors import DeclarationError
from kinegraph.stream.source import Feed

FROM_S, TO_S = 2.0, 10.0
ENOUGH = 50
"""This many steps decide."""
MOSTLY, STANDS = 0.6, 0.95
"""The share of steps that makes one the rule; a step of 0 may be records that come twice."""
TURNS = 3


class CounterCheck:
    """One stream's, of its first seconds. A counter that does not count by one ends the session, or, opened again, raises the alarm."""

    def __init__(self, device: str, turn: int, setting: str) -> None:
        """`turn`: after how many it starts again, as declared; `setting`: the parameter that says so."""
        self._device, self._turn, self._setting = device, turn, setting
        self._steps: Tally[int] = Tally()
        self._leaps: Tally[tuple[int, int]] = Tally()
        """By the numbers before and after, how often it has leapt."""
        self._last: int | None = None
        self._from = 0
        self._over = False

    def see(self, counters: Array, arrival_ns: int, feed: Feed) -> None:
        """Records with these counters (n,), n > 0, have come now. Raises DeclarationError."""
        if self._over:
            return
        self._from = self._from or arrival_ns
        before = int(counters[0]) - 1 if self._last is None else self._last
        whole = np.concatenate([[before], counters.astype(np.int64)])
        steps = np.diff(whole) % self._turn
        self._steps.update(steps.tolist())
        self._leaps.update((int(whole[i]), int(whole[i + 1])) for i in np.flatnonzero(steps > 1))
        self._last = int(whole[-1])
        passed = arrival_ns - self._from
        if passed < FROM_S * NS or self._steps.total() < ENOUGH:
            return
        if text := self._wrong():
            self._over = True
            if not feed.again:
                raise DeclarationError(f"{self._device} is not as declared: {text}")
            feed.problem("counter mismatch")
            feed.tell("counter mismatch", text=text)
        elif passed > TO_S * NS:
            self._over = True
            if text := self._early():
                feed.problem("counter mismatch")
                feed.tell("counter mismatch", text=text)

    def _wrong(self) -> str:
        """What is wrong with most of its steps; "": nothing."""
        step, times = self._steps.most_common(1)[0]
        share = times / self._steps.total()
        if step == 1 or share < (MOSTLY if step else STANDS):
            return ""
        what = "is it the column or field of the counter? Else leave the counter out"
        if not step:
            return f"its counter stands still at {self._last}: {what}"
        if step == self._turn - 1:
            return f"its counter counts down: {what}"
        return f"its counter goes up by {step} a record: does it count samples, or records of other kinds, too? {what[0].upper()}{what[1:]}"

    def _early(self) -> str:
        """The finding if the counter restarts before its declared end."""
        if not self._leaps:
            return ""
        (last, first), times = self._leaps.most_common(1)[0]
        if times < TURNS or times < MOSTLY * self._leaps.total() or first >= last:
            return ""
        return f"its counter goes from {last} to {first} again and again ({times} times so far): set {self._setting} to {last + 1 - first}"
