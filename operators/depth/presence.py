"""In bed or out of it: by the depth against that of the empty bed, so that a still sleeper is not an empty bed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from operators.depth.regions import REGION, block_of, region_spec, sleepers_of, take
from operators.depth.seconds import Seconds, add, look, restless
from stream.chunk import FOREVER, NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times, add_lost
from stream.operator import Case, Operator, grid
from stream.params import param

BED = np.dtype([("onset", "<i8"), ("sleeper", "U16"), ("state", "U7"), ("height", "<f8"), ("raised", "<f8")])
"""A sleeper is in bed, out of it, or nobody knows, since `onset`; with the bed's mean height above the empty one, and the share raised."""
UNKNOWN, IN, OUT = 0, 1, 2
NAMES = np.array(["unknown", "in", "out"])
AGAIN = 0.7
"""Out of bed below this share of what makes in bed."""
BLIND_S = 300.0
"""While the empty bed is not known: without movement for so long is an empty bed."""
PAUSE_NS = 5 * NS
ALIVE = 0.005
"""So much of a region must move (2 blocks at least) to be somebody."""

Rows = list[tuple[Any, ...]]


@dataclass(slots=True)
class PresenceState:
    """
    regions    (k, 4)           in blocks: row, column, rows, columns; no rows: not known
    empty      (rows, columns)  the empty bed's depth, NaN where not known
    seconds                     the present second, and the present stretch of `learn_s`
    state, wanted (k,)          UNKNOWN, IN or OUT; what the depth has said since `since` (k,) ns; `seen` (k,) ns: when it was last seen
    still      (k,)             for how many stretches nothing has moved
    seen_now   (k, 3)           of the newest second: share raised, mean height (mm), share measured
    lost       what the next chunks of `out` and `height` say is missing before them
    """

    sleepers: list[str]
    block: int
    regions: Times
    empty: Samples
    seconds: Seconds
    state: Times
    wanted: Times
    since: Times
    seen: Times
    still: Times
    seen_now: Samples
    lost: Times


@dataclass(frozen=True, slots=True)
class Presence(Operator[PresenceState]):
    """Mean depths of blocks in; per sleeper whether anybody lies in the region.

    out     an event at the first decision and at every change: `in`, `out` or `unknown`. `onset`: since when (the decision comes
            `hold_s` later); `height`, `raised` as at the decision
    height  (sleepers,) float64, mm, once a second: how high the region is above the empty bed, on average; NaN: not known

    In bed: a share of `least_share` of the region is more than `rise_mm` above the empty bed; out: less than 0.7 of that share.
    The empty bed is learned where nothing moves for `learn_s`, breath included, and nobody is known to be in bed; and learned anew
    whenever that is so again (a blanket lies differently, the camera has sunk). Nothing moves: hardly any block of the region varies,
    second by second, by more than `still_mm` and three times what blocks of the frame vary by on average.
    Before the empty bed is known, movement in the region is somebody in bed, and 5 min without any is an empty bed. Afterwards, too, so
    long as `vacant_min` without any movement or breath is an empty bed, however high it is: a heap of blankets. Unseen for `unseen_s` is
    unknown. Who sleeps without visible breath for so long is taken for absent; set `vacant_min: 0` against that.
    """

    inputs: ClassVar[tuple[str, ...]] = ("regions", "blocks")
    outputs: ClassVar[tuple[str, ...]] = ("out", "height")

    rise_mm: float = param(80.0, above=0.0, help="how far above the empty bed a body is")
    least_share: float = param(0.15, above=0.0, most=1.0, help="how much of the region a body covers at least")
    hold_s: float = param(5.0, least=0.0, help="for how long the depth must say so before it is believed")
    learn_s: float = param(60.0, least=4.0, help="without movement for so long: this is the empty bed")
    still_mm: float = param(1.0, above=0.0, help="a block that varies less does not move")
    vacant_min: float = param(45.0, least=0.0, help="so long without any movement is an empty bed; 0: never")
    unseen_s: float = param(30.0, above=0.0, help="not seen for so long: unknown")
    least_valid: float = param(0.2, above=0.0, most=1.0, help="share of the region's blocks that must be measured")

    def open(self, specs: Specs) -> Specs:
        spec = specs["blocks"]
        block = block_of(spec, "blocks")
        sleepers = sleepers_of(specs)
        k = len(sleepers)
        self.hold(
            PresenceState(
                list(sleepers), block, np.zeros((k, 4), np.int64), np.full(spec.shape, np.nan), Seconds.of(spec.shape),
                np.zeros(k, np.int64), np.zeros(k, np.int64), np.full(k, NEVER), np.full(k, NEVER), np.zeros(k, np.int64),
                np.full((k, 3), np.nan), np.zeros(2, np.int64),
            ),
            delay_s=1.0,
        )  # fmt: skip
        meta = {**spec.meta, "sleepers": list(sleepers)}
        unit = spec.units[0]
        height = StreamSpec((k,), channels=sleepers, units=(unit,), meta=meta)
        return {"out": StreamSpec((), BED, units=("ns", "", "", unit, ""), meta=meta), "height": height}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        emitted: list[tuple[str, Chunk]] = []
        events: Rows = []
        heights: list[tuple[int, Samples]] = []
        if port == "blocks":
            if chunk.lost:
                before = int(chunk.time[0]) - 1
                self._pass(before, events, heights)
                emitted = self._chunks(events, heights, before)
                events, heights = [], []
                s.lost[:] = [add_lost(int(lost), chunk.lost) for lost in s.lost]
            for i, time in enumerate(chunk.time.tolist()):
                self._pass(time - 1, events, heights)
                if s.seconds.begin == NEVER:
                    s.seconds.begin = time // NS * NS
                add(chunk.data[i], s.seconds.sums, s.seconds.counts)
        elif len(chunk.time):
            self._pass(int(chunk.time[0]) - 1, events, heights)
            take(chunk.data, tuple(s.sleepers), s.regions, s.block)
        self._pass(chunk.until, events, heights)
        return [*emitted, *self._chunks(events, heights, chunk.until)]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(15)
        depth = np.full((300, 6, 8), 2000.0)
        second = np.arange(300) / 5.0
        there = (second > 20) & (second < 45)
        depth[there, 1:5, 2:5] -= 200.0
        depth[there, 2, 3] += 8.0 * np.sin(2.0 * second[there])
        depth += random.normal(0, 0.3, depth.shape)
        depth[random.random(depth.shape) < 0.05] = np.nan
        meta = {"simplified": {"block": 8, "components": 2}}
        time = grid(5.0, 300)
        regions = np.array([(time[2], "a", 0, 0, 48, 48, True), (time[2], "b", 0, 48, 48, 16, True)], REGION)
        inputs = {
            "regions": (region_spec(("a", "b"), meta), regions["onset"], regions),
            "blocks": (StreamSpec((6, 8), rate_hz=5.0, units=("mm",), meta=meta), time, depth),
        }
        return [
            Case(cls(learn_s=4.0, hold_s=2.0, unseen_s=3.0, vacant_min=0.2), inputs, least=63),
            Case(cls(learn_s=8.0, vacant_min=0.0), inputs, least=60),
        ]

    def _pass(self, until: int, events: Rows, heights: list[tuple[int, Samples]]) -> None:
        """All that is decided by `until`."""
        s = self.state
        if s.seconds.begin != NEVER and until >= s.seconds.begin + NS - 1:
            end = s.seconds.begin + NS
            self._forget(end - 2, events)
            s.seconds.end(PAUSE_NS)
            look(s.seconds.mean, s.empty, s.regions, self.rise_mm, s.seen_now)
            heights.append((end - NS, s.seen_now[:, 1].copy()))
            for k in range(len(s.sleepers)):
                self._judge(k, end, events)
            if end - s.seconds.since >= self.learn_s * NS:
                for k in range(len(s.sleepers)):
                    self._judge_stretch(k, end, events)
                s.seconds.since = NEVER
        self._forget(until, events)

    def _forget(self, until: int, events: Rows) -> None:
        """Who has not been seen for too long is nobody knows where."""
        s = self.state
        unseen_ns = round(self.unseen_s * NS)
        due = [(int(s.seen[k]) + unseen_ns, k) for k in range(len(s.sleepers)) if s.state[k] != UNKNOWN]
        for stamp, k in sorted(d for d in due if d[0] <= until):
            s.seen_now[k] = np.nan
            self._become(k, UNKNOWN, int(s.seen[k]), stamp, events)

    def _judge(self, k: int, end: int, events: Rows) -> None:
        """What the newest second says."""
        s = self.state
        raised, _, measured = s.seen_now[k]
        if measured < self.least_valid:
            s.wanted[k] = s.state[k]
            return
        s.seen[k] = end
        says = int(s.state[k])
        if raised >= self.least_share:
            says = IN
        elif raised < AGAIN * self.least_share:
            says = OUT
        if says == s.state[k] or says == UNKNOWN:
            s.wanted[k] = s.state[k]
            return
        if s.wanted[k] != says:
            s.wanted[k], s.since[k] = says, end - NS
        if end - s.since[k] >= self.hold_s * NS:
            self._become(k, says, int(s.since[k]), end - 1, events)

    def _judge_stretch(self, k: int, end: int, events: Rows) -> None:
        """What the stretch that is over says: learn the empty bed, or note that somebody is there."""
        s = self.state
        moving = restless(s.seconds.stretch, s.regions[k], self.still_mm)
        row, column, rows, columns = s.regions[k]
        part = (slice(row, row + rows), slice(column, column + columns))
        known = bool(np.isfinite(s.empty[part]).any())
        if moving < 0 or s.seen_now[k, 2] < self.least_valid:
            s.still[k] = 0
            return
        if moving > max(2.0, ALIVE * rows * columns):
            s.still[k] = 0
            if not known and s.state[k] == UNKNOWN:
                self._become(k, IN, s.seconds.since, end - 1, events)
            return
        s.still[k] += 1
        patience = BLIND_S if not known else 60.0 * self.vacant_min
        if s.state[k] == IN and (not patience or s.still[k] * self.learn_s < patience):
            return
        depth = s.seconds.depth()[part]
        s.empty[part] = np.where(np.isfinite(depth), depth, s.empty[part])
        if s.state[k] != OUT:
            self._become(k, OUT, end - round(int(s.still[k]) * self.learn_s * NS), end - 1, events)

    def _become(self, k: int, state: int, since: int, stamp: int, events: Rows) -> None:
        s = self.state
        s.state[k] = s.wanted[k] = state
        s.still[k] = 0
        events.append((stamp, (since, s.sleepers[k], NAMES[state], s.seen_now[k, 1], s.seen_now[k, 0])))

    def _chunks(self, events: Rows, heights: list[tuple[int, Samples]], until: int) -> list[tuple[str, Chunk]]:
        s = self.state
        stamps = np.array([stamp for stamp, _ in events], np.int64)
        bed = Chunk(stamps, np.array([row for _, row in events], BED), until, int(s.lost[0]))
        data = np.array([row for _, row in heights]).reshape(len(heights), len(s.sleepers))
        promise = until if s.seconds.begin == NEVER else min(until, s.seconds.begin - 1)
        if NEVER < until < FOREVER and s.seconds.begin == NEVER:
            promise = (until + 1) // NS * NS - 1
        height = Chunk(np.array([t for t, _ in heights], np.int64), data, promise, int(s.lost[1]))
        s.lost[:] = 0
        return [("out", bed), ("height", height)]
