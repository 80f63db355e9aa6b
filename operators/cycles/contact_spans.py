"""From when to when a limb's contacts were wrong, as the alarms about them say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import FOREVER, Array, Samples, Times
from kinegraph.stream.domain.alarm import ON

WRONG = ("cadence", "contacts", "muscles work half a cycle off")
"""What alarms begin with that contradict contacts: steps missed or found twice (`CycleWatch`), shifted, the other leg's (`TimingWatch`)."""
SPANS = 64
SPAN = np.dtype([("limb", "<i8"), ("kind", "<i8"), ("begin", "<i8"), ("end", "<i8")])


@dataclass(slots=True)
class ContactSpans:
    """spans (64,)   the latest spans, a ring: limb, which of `WRONG`, begin, end (FOREVER: it lasts);  seen: in all"""

    spans: Array
    seen: int

    @staticmethod
    def empty() -> ContactSpans:
        return ContactSpans(np.zeros(SPANS, SPAN), 0)

    def note(self, row: np.void, limb: int) -> int | None:
        """Take an alarm about a limb's contacts; returns from when on cycles change, None if the alarm is about something else."""
        kind = next((k for k, what in enumerate(WRONG) if str(row["what"]).startswith(what)), None)
        if kind is None:
            return None
        kept, onset = self.spans[: min(self.seen, SPANS)], int(row["onset"])
        lasting = (kept["limb"] == limb) & (kept["kind"] == kind) & (kept["end"] == FOREVER)
        if row["state"] != ON:
            kept["end"][lasting] = np.maximum(kept["begin"][lasting], onset)
        elif not lasting.any():
            self.spans[self.seen % SPANS] = limb, kind, onset, FOREVER
            self.seen += 1
        return onset

    def hold(self, limb: int, onset: int, end: int) -> bool:
        """Whether a limb's cycle touches one of them: the cycles at both edges lie across the change."""
        kept = self.spans[: min(self.seen, SPANS)]
        return bool(((kept["limb"] == limb) & (kept["begin"] <= end) & (kept["end"] >= onset)).any())


def changed_at(scores: Samples) -> int:
    """Index of the lasting change's start: the trailing scores (n,) with the largest sum start there; positive scores agree with it."""
    return int(len(scores) - 1 - np.asarray(scores[::-1].cumsum()).argmax())


@dataclass(slots=True)
class LatestCycles:
    """onsets (l, 32) and measures (l, 32, k) of each limb's latest cycles, in turn, a ring; seen (l,): how many in all."""

    onsets: Times
    measures: Samples
    seen: Times

    @staticmethod
    def empty(limbs: int, measures: int) -> LatestCycles:
        return LatestCycles(np.zeros((limbs, 32), np.int64), np.zeros((limbs, 32, measures)), np.zeros(limbs, np.int64))

    def add(self, limb: int, onset: int, measures: tuple[float, ...]) -> None:
        k = self.seen[limb] % self.onsets.shape[1]
        self.onsets[limb, k], self.measures[limb, k] = onset, measures
        self.seen[limb] += 1

    def latest(self, limb: int) -> tuple[Times, Array]:
        """Onsets (n,) and measures (n, k), the oldest first."""
        room, seen = self.onsets.shape[1], int(self.seen[limb])
        order = np.arange(max(0, seen - room), seen) % room
        return self.onsets[limb, order], self.measures[limb, order]
