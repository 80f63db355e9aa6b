"""The newest scored epochs of somebody's sleep, kept until the night that they belong to is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.night import NAMES, UNKNOWN, States


@dataclass(slots=True)
class ScoredEpochs:
    """
    onset, states, activity (capacity,)  the newest `count` final epochs, at the front
    """

    length_ns: int
    onset: Times
    states: States
    activity: Samples
    count: int

    @staticmethod
    def empty(length_ns: int, capacity: int) -> ScoredEpochs:
        return ScoredEpochs(length_ns, np.zeros(capacity, np.int64), np.zeros(capacity, np.int8), np.zeros(capacity), 0)

    @property
    def full(self) -> bool:
        return self.count == len(self.onset)

    @property
    def begin(self) -> int:
        """The first one's onset; of some epochs only."""
        return int(self.onset[0])

    @property
    def end(self) -> int:
        """When the last one ends; of some epochs only."""
        return int(self.onset[self.count - 1]) + self.length_ns

    def add(self, event: Array) -> None:
        """One more; where there is no room, the oldest goes."""
        if self.full:
            for array in (self.onset, self.states, self.activity):
                array[:-1] = array[1:]
            self.count -= 1
        self.onset[self.count] = event["onset"]
        self.states[self.count] = int(np.flatnonzero(event["state"] == NAMES)[0])
        self.activity[self.count] = event["activity"]
        self.count += 1

    def any_known(self, begin: int, end: int) -> bool:
        """Whether anything is known of the time from `begin` to `end`."""
        onset = self.onset[: self.count]
        return bool((self.states[: self.count][(onset >= begin) & (onset < end)] != UNKNOWN).any())

    def between(self, begin: int, end: int) -> tuple[States, Samples]:
        """States and activity (n,) of the epochs from `begin` to `end`; missing ones are unknown."""
        n = round((end - begin) / self.length_ns)
        place = (self.onset[: self.count] + self.length_ns // 2 - begin) // self.length_ns
        here = (place >= 0) & (place < n)
        states, activity = np.full(n, UNKNOWN, np.int8), np.full(n, np.nan)
        states[place[here]] = self.states[: self.count][here]
        activity[place[here]] = self.activity[: self.count][here]
        return states, activity
