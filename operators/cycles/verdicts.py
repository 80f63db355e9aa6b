"""Which cycles and muscles count: what a channel's quality says, and what a person says, who has the last word."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Array, Times

FLAGS = ("good", "doubtful", "bad")
UNSAID, OUT, IN = 0, 1, 2
WINDOWS = 256
"""This many of the latest judged windows are kept per channel: of windows of a second, those of the latest 64 cycles of up to 4 s."""


@dataclass(slots=True)
class Windows:
    """onset, end (256,), flag (256, m): the latest windows of signal quality, a ring; `seen` in all; reasons (256, m)."""

    onset: Times
    end: Times
    flag: Times
    reason: Array
    seen: int

    @staticmethod
    def empty(muscles: int) -> Windows:
        return Windows(
            np.zeros(WINDOWS, np.int64),
            np.zeros(WINDOWS, np.int64),
            np.zeros((WINDOWS, muscles), np.int64),
            np.zeros((WINDOWS, muscles), "<U16"),
            0,
        )

    def add(self, row: Array, muscle: int) -> None:
        """Take an event of signal quality; those of one window share its onset."""
        k = (self.seen - 1) % WINDOWS
        if not self.seen or self.onset[k] != row["onset"]:
            k = self.seen % WINDOWS
            self.seen += 1
            self.onset[k], self.end[k], self.flag[k], self.reason[k] = row["onset"], row["end"], 0, ""
        self.flag[k, muscle], self.reason[k, muscle] = FLAGS.index(str(row["flag"])), row["reason"]

    def of(self, onset: int, end: int) -> tuple[Times, Array]:
        """The worst flag (m,) of the windows that overlap a cycle, and its reason (m,)."""
        count = min(self.seen, WINDOWS)
        here = np.flatnonzero((self.onset[:count] < end) & (self.end[:count] > onset))
        if not len(here):
            return np.zeros(self.flag.shape[1], np.int64), np.zeros(self.flag.shape[1], "<U16")
        worst = self.flag[here].argmax(axis=0)
        muscles = np.arange(self.flag.shape[1])
        return self.flag[here][worst, muscles], self.reason[here][worst, muscles]


@dataclass(slots=True)
class PersonVerdicts:
    """Verdicts, UNSAID, OUT or IN: on a muscle in one of the latest cycles, `cycle` (64, m), or in all of them, `session` (m,)."""

    cycle: Times
    session: Times

    @staticmethod
    def empty(cycles: int, muscles: int) -> PersonVerdicts:
        return PersonVerdicts(np.zeros((cycles, muscles), np.int64), np.zeros(muscles, np.int64))

    def say(self, k: int, muscle: int, verdict: int) -> None:
        """Of the cycle at `k`; of all its muscles, where `muscle` is -1."""
        self.cycle[k, slice(None) if muscle < 0 else muscle] = verdict

    def of(self, k: int) -> Times:
        """Of each muscle (m,) in the cycle at `k`."""
        return np.where(self.cycle[k] != UNSAID, self.cycle[k], self.session)


def understood(text: str, muscles: list[str], latest: int) -> tuple[int, int] | None:
    """ "17", "17 TA", "TA" or "last" as (number, muscle), -1 for all of them; None if it is another text."""
    words = text.split()
    number = muscle = -1
    for word in words:
        if word.isdigit():
            number = int(word)
        elif word == "last":
            number = latest
        elif word in muscles:
            muscle = muscles.index(word)
        else:
            return None
    return (number, muscle) if 1 <= len(words) <= 2 else None
