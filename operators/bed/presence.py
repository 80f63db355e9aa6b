"""In bed or out of it: by the depth against that of the empty bed, so that a still sleeper is not an empty bed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.bed.bed_events import BED
from kinegraph.operators.bed.bodies import CROWD_S
from kinegraph.operators.bed.frames.regions import REGION, block_of, region_spec, sleepers_of
from kinegraph.operators.bed.frames.seconds import add
from kinegraph.operators.bed.frames.view import VIEW, check_view
from kinegraph.operators.bed.occupancy import BLIND_S, Occupancy, OccupancyLimits, Rows
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times, add_lost
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param


@dataclass(slots=True)
class PresenceState:
    """`lost`: what the next chunks of `out` and `height` say is missing before them."""

    occupancy: Occupancy
    lost: Times


@dataclass(frozen=True, slots=True)
class Presence(Operator[PresenceState]):
    """Mean depths of blocks in; per sleeper whether anybody lies in the region.

    out     an event at the first decision and at every change: `in`, `out` or `unknown`. `onset`: since when (the decision comes
            `hold_s` later); `height`, `raised` as at the decision
    height  (sleepers,) float64, mm, once a second: how high the region is above the empty bed, on average; NaN: not known

    In bed: a share of `min_share` of the region is more than `rise_mm` above the empty bed; out: less than 0.7 of that share. In a bed that
    was found a share of .06 is enough where breath is seen in three windows of 30 s in a row: a child.
    The empty bed is learned where nothing moves for `learn_s`, breath included, and the bed is not known to be occupied; and learned again
    whenever that is so again (a blanket lies differently, the camera has sunk). Nothing moves: hardly any block of the region varies,
    second by second, by more than `still_mm` and three times what blocks of the frame vary by on average.
    Before the empty bed is known, movement in the region is somebody in bed, and 5 min without any is an empty bed, if nothing that may
    be a body stands out of the plane of the mattress. Where something does, and afterwards, `vacant_min` without any movement or breath
    is an empty bed, however high it is: a heap of blankets. Unseen for `unseen_s` is unknown. Who sleeps without visible breath for this
    long is taken for absent; set `vacant_min: 0` against that.

    What cannot be judged is `unknown`, and `why` says so: no breath and no movement for `unsure_min`, though the bed is high (a heap that
    was left behind, or breath that is not seen), or from the start, where the bed was not seen empty and something lies across the middle
    of its length: then movement, or a flat bed, decides; movement for `odd_min` without a break where the bed is empty (a region that is
    too large or elsewhere); a found region that holds less than three quarters of the first who lies there for 3 min, or any that they
    cover too little of; no bed was found; the camera was moved or sees nothing (`view`). After a move the empty bed is learned again. `in`
    with `body`: 1.4 times as much is raised, for 30 s, as in the sleeper's first five minutes: there are two. So it
    is reported after 3 s already, and withdrawn where it does not last. Within these five minutes the seconds so far count, and how high
    the region is as well: who sits and then lies down, or pulls a blanket up, stays one; a second body within the first minute is not
    noticed. While the empty bed is not known again, what is raised since the sleeper was seen again counts; who came before that is not
    noticed. `body` also while something small walks about: it is raised apart from the sleeper, on blocks that were flat a moment ago, and
    as many are flat behind it (a cat; not one that walks on the sleeper); before the empty bed is known: out of the mattress's plane.

    >>> given, made = tried(Presence)
    >>> given["blocks"].shape, made["out"][["sleeper", "state"]][:2].tolist()
    ((300, 6, 8), [('a', 'out'), ('b', 'out')])
    """

    inputs = {"view": Input(optional=True), "regions": Input(), "blocks": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("out", "height")

    rise_mm: float = param(80.0, above=0.0, help="how far above the empty bed a body is")
    min_share: float = param(0.15, above=0.0, most=1.0, help="how much of the region a body covers at least")
    hold_s: float = param(5.0, least=0.0, help="for how long the depth must say so before it is believed")
    learn_s: float = param(60.0, least=4.0, help="stillness of this length shows the empty bed")
    still_mm: float = param(1.0, above=0.0, help="a block that varies less does not move")
    vacant_min: float = param(45.0, least=0.0, help="a bed without any movement for this long is empty; 0: never")
    unsure_min: float = param(
        10.0, least=0.0, help="without movement or breath for this long presence is unknown; 0: never"
    )
    odd_min: float = param(10.0, least=0.0, help="unknown after this long with movement in an empty region; 0: never")
    unseen_s: float = param(30.0, above=0.0, help="not seen for this long: unknown")
    min_valid: float = param(0.2, above=0.0, most=1.0, help="share of the region's blocks that must be measured")

    def open(self, specs: Specs) -> Specs:
        spec = specs["blocks"]
        block = block_of(spec, "blocks")
        check_view(specs)
        sleepers = sleepers_of(specs)
        limits = OccupancyLimits(
            self.rise_mm, self.min_share, self.min_valid, self.hold_s, self.learn_s, self.still_mm,
            60.0 * self.vacant_min, 60 * self.unsure_min, 60 * self.odd_min, self.unseen_s,
        )  # fmt: skip
        longest_s = max(limits.vacant_s, limits.unsure_s, limits.odd_s, BLIND_S, CROWD_S, self.hold_s, self.unseen_s)
        self.set_state(
            PresenceState(
                Occupancy.unknown(sleepers, spec.shape, spec.rate_hz or 0.0, limits, block),
                np.zeros(2, np.int64),
            ),
            delay_s=1.0,
            decision_s={"out": longest_s + self.learn_s + 1},
        )
        meta = {**spec.meta, "sleepers": list(sleepers)}
        unit = spec.units[0]
        height = StreamSpec((len(sleepers),), channels=sleepers, units=(unit,), meta=meta)
        return {"out": StreamSpec((), BED, units=("ns", "", "", unit, "", ""), meta=meta), "height": height}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s, seconds = self.state, self.state.occupancy.beds.seconds
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
                if seconds.begin == NEVER:
                    seconds.begin = time // NS * NS
                add(chunk.data[i], seconds.sums, seconds.counts)
                s.occupancy.watch.add(chunk.data[i], time)
        elif port == "view":
            for stamp, event in zip(chunk.time.tolist(), chunk.data, strict=True):
                self._pass(stamp - 1, events, heights)
                s.occupancy.look(str(event["what"]), int(event["onset"]), stamp, events)
        elif len(chunk.time):
            self._pass(int(chunk.time[0]) - 1, events, heights)
            s.occupancy.take_regions(chunk.data, int(chunk.time[-1]), events)
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
        view = np.array([(time[150], "moved", 8.0, 0.0), (time[250], "dark", np.nan, np.nan)], VIEW)
        seen = (StreamSpec((), VIEW), view["onset"].copy(), view)
        return [
            Case(cls(learn_s=4.0, hold_s=2.0, unseen_s=3.0, vacant_min=0.2), inputs, least=63),
            Case(cls(learn_s=8.0, vacant_min=0.0), inputs, least=60),
            Case(cls(learn_s=4.0, unsure_min=0.1, odd_min=0.1), {"view": seen, **inputs}, least=60),
        ]

    def _pass(self, until: int, events: Rows, heights: list[tuple[int, Samples]]) -> None:
        """All that is decided by `until`."""
        occupancy = self.state.occupancy
        seconds = occupancy.beds.seconds
        if seconds.begin != NEVER and until >= seconds.begin + NS - 1:
            end = seconds.begin + NS
            occupancy.forget_unseen(end - 2, events)
            occupancy.end_second(end, events)
            heights.append((end - NS, occupancy.beds.seen_now[:, 1].copy()))
        occupancy.forget_unseen(until, events)

    def _chunks(self, events: Rows, heights: list[tuple[int, Samples]], until: int) -> list[tuple[str, Chunk]]:
        s, begin = self.state, self.state.occupancy.beds.seconds.begin
        stamps = np.array([stamp for stamp, _ in events], np.int64)
        bed = Chunk(stamps, np.array([row for _, row in events], BED), until, int(s.lost[0]))
        data = np.array([row for _, row in heights]).reshape(len(heights), len(s.occupancy.sleepers))
        promise = until if begin == NEVER else min(until, begin - 1)
        if NEVER < until < FOREVER and begin == NEVER:
            promise = (until + 1) // NS * NS - 1
        height = Chunk(np.array([t for t, _ in heights], np.int64), data, promise, int(s.lost[1]))
        s.lost[:] = 0
        return [("out", bed), ("height", height)]
