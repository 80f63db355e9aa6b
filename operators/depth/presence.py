"""In bed or out of it: by the depth against that of the empty bed, so that a still sleeper is not an empty bed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from operators.depth.bodies import CROWD, CROWD_S, SUSPECT_S, Bodies, share_high
from operators.depth.mattress import mattress, somebody
from operators.depth.regions import REGION, block_of, region_spec, sleepers_of, take
from operators.depth.seconds import Seconds, add, look, restless
from operators.depth.view import VIEW, check_view
from operators.depth.visitor import RoamingBody
from stream.chunk import FOREVER, NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times, add_lost
from stream.operator import Case, Operator, grid
from stream.params import param

BED = np.dtype(
    [("onset", "<i8"), ("sleeper", "U16"), ("state", "U7"), ("height", "<f8"), ("raised", "<f8"), ("why", "U8")]
)
"""A sleeper is in bed, out of it, or nobody knows, since `onset`; with the bed's mean height above the empty one, and the share raised.

why   of `unknown`: unseen, dark, camera (it was moved), still (no breath for long), region (something lives where nobody lies); of `in`:
      body (there is, or seems to be, a second one), or ""
"""
UNKNOWN, IN, OUT = 0, 1, 2
NAMES = np.array(["unknown", "in", "out"])
AGAIN = 0.7
"""Out of bed below this share of what makes in bed."""
BLIND_S = 300.0
"""While the empty bed is not known: without movement for this long is an empty bed."""
PAUSE_NS = 5 * NS
DOUBTS = ("", "still", "region", "camera", "dark")
STILL, ODD, CAMERA, DARK = 1, 2, 3, 4
ALIVE = 0.005
"""This much of a region must move (2 blocks at least) to be somebody."""

Rows = list[tuple[Any, ...]]


@dataclass(slots=True)
class PresenceState:
    """
    regions    (k, 4)           in blocks: row, column, rows, columns; no rows: not known
    empty      (rows, columns)  the empty bed's depth, NaN where not known
    mattress   (rows, columns)  while it is not known, the plane that most of the bed lies in; NaN where not known
    seconds                     the present second, and the present stretch of `learn_s`
    state, wanted (k,)          UNKNOWN, IN or OUT; what the depth has said since `since` (k,) ns; `seen` (k,) ns: when it was last seen
    still      (k,)             for how many stretches nothing has moved
    lay        (k,)             whether what may be a body stood out of the mattress in the newest stretch, while the bed was not known
    seen_now   (k, 3)           of the newest second: share raised, mean height (mm), share measured
    doubt      (k,)             why the depth is not believed (of DOUBTS); alive: for how many stretches something has moved; was_in: in
                                bed when the camera was moved
    bodies, visitor             one in a region, or two; and whether something small walks about
    told     (k,)               whether the newest event says `body`
    lost       what the next chunks of `out` and `height` say is missing before them
    """

    sleepers: list[str]
    block: int
    regions: Times
    empty: Samples
    mattress: Samples
    seconds: Seconds
    state: Times
    wanted: Times
    since: Times
    seen: Times
    still: Times
    lay: Times
    seen_now: Samples
    doubt: Times
    alive: Times
    was_in: Times
    bodies: Bodies
    visitor: RoamingBody
    told: Times
    lost: Times


@dataclass(frozen=True, slots=True)
class Presence(Operator[PresenceState]):
    """Mean depths of blocks in; per sleeper whether anybody lies in the region.

    out     an event at the first decision and at every change: `in`, `out` or `unknown`. `onset`: since when (the decision comes
            `hold_s` later); `height`, `raised` as at the decision
    height  (sleepers,) float64, mm, once a second: how high the region is above the empty bed, on average; NaN: not known

    In bed: a share of `least_share` of the region is more than `rise_mm` above the empty bed; out: less than 0.7 of that share.
    The empty bed is learned where nothing moves for `learn_s`, breath included, and nobody is known to be in bed; and learned again
    whenever that is so again (a blanket lies differently, the camera has sunk). Nothing moves: hardly any block of the region varies,
    second by second, by more than `still_mm` and three times what blocks of the frame vary by on average.
    Before the empty bed is known, movement in the region is somebody in bed, and 5 min without any is an empty bed, if nothing that may
    be a body stands out of the plane of the mattress. Where something does, and afterwards, `vacant_min` without any movement or breath
    is an empty bed, however high it is: a heap of blankets. Unseen for `unseen_s` is unknown. Who sleeps without visible breath for this
    long is taken for absent; set `vacant_min: 0` against that.

    What cannot be judged is `unknown`, and `why` says so: no breath and no movement for `unsure_min`, though the bed is high (a heap that
    was left behind, or breath that is not seen), or from the start, where the bed was not seen empty and something lies across the middle
    of its length: then movement, or a flat bed, decides; movement for `odd_min` without a break where
    nobody lies (a region that is too large or elsewhere); the camera was moved or sees nothing (`view`). After a move the empty bed is
    learned again. `in` with `body`: 1.4 times as much is raised, for 30 s, as in the sleeper's first five minutes: there are two. So it
    is said after 3 s already, and taken back where it does not last. Within these five minutes the seconds so far count, and how high
    the region is as well: who sits and then lies down, or pulls a blanket up, stays one; a second body within the first minute is not
    noticed. While the empty bed is not known again, what is raised since the sleeper was seen again counts; who came before that is not
    noticed. `body` also while something small walks about: it is raised apart from the sleeper, on blocks that were flat a moment ago, and
    as many are flat behind it (a cat; not one that walks on the sleeper); before the empty bed is known: out of the mattress's plane.
    """

    inputs: ClassVar[tuple[str, ...]] = ("view", "regions", "blocks")
    optional: ClassVar[tuple[str, ...]] = ("view",)
    outputs: ClassVar[tuple[str, ...]] = ("out", "height")

    rise_mm: float = param(80.0, above=0.0, help="how far above the empty bed a body is")
    least_share: float = param(0.15, above=0.0, most=1.0, help="how much of the region a body covers at least")
    hold_s: float = param(5.0, least=0.0, help="for how long the depth must say so before it is believed")
    learn_s: float = param(60.0, least=4.0, help="stillness of this length shows the empty bed")
    still_mm: float = param(1.0, above=0.0, help="a block that varies less does not move")
    vacant_min: float = param(45.0, least=0.0, help="a bed without any movement for this long is empty; 0: never")
    unsure_min: float = param(
        10.0, least=0.0, help="without movement or breath for this long presence is unknown; 0: never"
    )
    odd_min: float = param(
        10.0, least=0.0, help="with movement for this long where nobody lies it is unknown; 0: never"
    )
    unseen_s: float = param(30.0, above=0.0, help="not seen for this long: unknown")
    least_valid: float = param(0.2, above=0.0, most=1.0, help="share of the region's blocks that must be measured")

    def open(self, specs: Specs) -> Specs:
        spec = specs["blocks"]
        block = block_of(spec, "blocks")
        check_view(specs)
        sleepers = sleepers_of(specs)
        k, quiet_min = len(sleepers), (self.vacant_min, self.unsure_min, self.odd_min)
        self.hold(
            PresenceState(
                list(sleepers), block, np.zeros((k, 4), np.int64), np.full(spec.shape, np.nan), np.full(spec.shape, np.nan),
                Seconds.of(spec.shape),
                np.zeros(k, np.int64), np.zeros(k, np.int64), np.full(k, NEVER), np.full(k, NEVER), np.zeros(k, np.int64),
                np.zeros(k, np.int64), np.full((k, 3), np.nan), np.zeros(k, np.int64), np.zeros(k, np.int64), np.zeros(k, np.int64),
                Bodies.of(k, spec.shape), RoamingBody.of(k, spec.shape), np.zeros(k, np.int64), np.zeros(2, np.int64),
            ),
            delay_s=1.0,
            decision_s={"out": max(60 * max(quiet_min), BLIND_S, CROWD_S, self.hold_s, self.unseen_s) + self.learn_s + 1},
        )  # fmt: skip
        meta = {**spec.meta, "sleepers": list(sleepers)}
        unit = spec.units[0]
        height = StreamSpec((k,), channels=sleepers, units=(unit,), meta=meta)
        return {"out": StreamSpec((), BED, units=("ns", "", "", unit, "", ""), meta=meta), "height": height}

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
        elif port == "view":
            for stamp, event in zip(chunk.time.tolist(), chunk.data, strict=True):
                self._pass(stamp - 1, events, heights)
                self._looks(str(event["what"]), int(event["onset"]), stamp, events)
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
        view = np.array([(time[150], "moved", 8.0, 0.0), (time[250], "dark", np.nan, np.nan)], VIEW)
        seen = (StreamSpec((), VIEW), view["onset"].copy(), view)
        return [
            Case(cls(learn_s=4.0, hold_s=2.0, unseen_s=3.0, vacant_min=0.2), inputs, least=63),
            Case(cls(learn_s=8.0, vacant_min=0.0), inputs, least=60),
            Case(cls(learn_s=4.0, unsure_min=0.1, odd_min=0.1), {"view": seen, **inputs}, least=60),
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
            s.visitor.second += 1
            if end - s.seconds.since >= self.learn_s * NS:
                for k in range(len(s.sleepers)):
                    self._judge_stretch(k, end, events)
                s.seconds.since = NEVER
        self._forget(until, events)

    def _looks(self, what: str, onset: int, stamp: int, events: Rows) -> None:
        """The view has become another one."""
        s = self.state
        if what == "moved":
            s.bodies.moved(s.empty, s.regions)
            s.visitor.forget()
            s.empty[:] = s.mattress[:] = np.nan
            s.seconds.since = NEVER
        for k in range(len(s.sleepers)):
            if what in ("moved", "dark"):
                s.was_in[k] = int(s.state[k] == IN or (s.was_in[k] and s.state[k] == UNKNOWN))
                s.doubt[k] = CAMERA if what == "moved" else DARK
                s.still[k] = s.alive[k] = 0
                if s.state[k] != UNKNOWN:
                    self._become(k, UNKNOWN, onset, stamp, events, str(DOUBTS[s.doubt[k]]))
            elif s.doubt[k] == DARK:
                s.doubt[k] = 0

    def _forget(self, until: int, events: Rows) -> None:
        """Who has not been seen for too long is nobody knows where."""
        s = self.state
        unseen_ns = round(self.unseen_s * NS)
        due = [(int(s.seen[k]) + unseen_ns, k) for k in range(len(s.sleepers)) if s.state[k] != UNKNOWN]
        for stamp, k in sorted(d for d in due if d[0] <= until):
            s.seen_now[k] = np.nan
            s.doubt[k] = 0
            self._become(k, UNKNOWN, int(s.seen[k]), stamp, events, "unseen")

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
        self._count_bodies(k, float(raised), end, events)
        doubt = int(s.doubt[k])
        if doubt in (CAMERA, DARK) or (doubt == STILL and says == IN) or (doubt == ODD and says == OUT):
            says = UNKNOWN
        if says == s.state[k] or says == UNKNOWN:
            s.wanted[k] = s.state[k]
            return
        if s.wanted[k] != says:
            s.wanted[k], s.since[k] = says, end - NS
        if end - s.since[k] >= self.hold_s * NS:
            self._become(k, says, int(s.since[k]), end - 1, events)

    def _count_bodies(self, k: int, raised: float, end: int, events: Rows) -> None:
        """Learn what one body raises, and notice a second one, or something that walks about."""
        s = self.state
        if s.state[k] != IN:
            s.bodies.crowd[k] = 0
            return
        changed = s.bodies.count(k, self._times(k))
        part, above = self._part(k), self._above(k)
        if not s.bodies.known(k):
            s.bodies.learn(k, raised, share_high(above, self.rise_mm), float(s.seen_now[k, 1]))
        known = bool(np.isfinite(s.empty[part]).any())
        s.visitor.look(k, part, above if known else s.mattress[part] - s.seconds.mean[part], self.rise_mm)
        suspected = s.bodies.suspected(k)
        body = suspected or s.visitor.here(k)
        if body != bool(s.told[k]):
            for_s = SUSPECT_S if suspected else CROWD_S if changed else 1
            events.append((end - 1, self._event(k, end - for_s * NS, "body" if body else "")))
            s.told[k] = int(body)

    def _times(self, k: int) -> float:
        """How many times the share of one body is raised now; NaN: not known."""
        s = self.state
        if not s.bodies.known(k):
            return s.bodies.early(k, share_high(self._above(k), self.rise_mm), float(s.seen_now[k, 1]))
        return s.bodies.times(k, float(s.seen_now[k, 0]), s.seconds.mean, s.regions, self.rise_mm)

    def _above(self, k: int) -> Samples:
        """How far each block of a sleeper's region is above the empty bed; NaN: not known."""
        part = self._part(k)
        above: Samples = self.state.empty[part] - self.state.seconds.mean[part]
        return above

    def _part(self, k: int) -> tuple[slice, slice]:
        """The blocks of a sleeper's region."""
        row, column, rows, columns = self.state.regions[k].tolist()
        return slice(row, row + rows), slice(column, column + columns)

    def _judge_stretch(self, k: int, end: int, events: Rows) -> None:
        """What the stretch that is over says: learn the empty bed, or note that somebody is there."""
        s = self.state
        moving = restless(s.seconds.stretch, s.regions[k], self.still_mm)
        part = self._part(k)
        known = bool(np.isfinite(s.empty[part]).any())
        if moving < 0 or s.seen_now[k, 2] < self.least_valid:
            s.still[k] = 0
            return
        if s.doubt[k] == DARK:
            return
        lies = False
        if not known:
            depth = s.seconds.depth()[part]
            s.mattress[part] = mattress(depth, self.rise_mm / 2)
            lies = somebody(s.mattress[part] - depth, self.rise_mm, self.least_share)
        s.still[k] *= lies or not s.lay[k]  # what stood out has gone, though nobody saw it go
        s.lay[k] = int(lies)
        if moving > max(2.0, ALIVE * s.regions[k, 2] * s.regions[k, 3]):
            self._moves(k, known, end, events)
            return
        s.still[k] += 1
        s.alive[k] = 0
        quiet_s = int(s.still[k]) * self.learn_s
        held = s.state[k] == IN or s.doubt[k] == STILL or bool(s.was_in[k])
        if lies and not held:
            s.doubt[k] = STILL
            self._become(k, UNKNOWN, end - round(quiet_s * NS), end - 1, events, "still", keep=True)
            return
        judged = known or bool(s.was_in[k]) or lies
        patience = 60.0 * self.vacant_min if judged else BLIND_S
        if s.state[k] == IN and judged and self.unsure_min and quiet_s >= 60 * self.unsure_min:
            s.doubt[k] = STILL
            self._become(k, UNKNOWN, end - round(quiet_s * NS), end - 1, events, "still", keep=True)
        if held and (not patience or quiet_s < patience):
            return
        depth = s.seconds.depth()[part]
        s.empty[part] = np.where(np.isfinite(depth), depth, s.empty[part])
        s.bodies.taken[part] = np.nan
        s.doubt[k] = s.was_in[k] = 0
        if s.state[k] != OUT:
            self._become(k, OUT, end - round(quiet_s * NS), end - 1, events)

    def _moves(self, k: int, known: bool, end: int, events: Rows) -> None:
        """Something has moved in the stretch that is over."""
        s = self.state
        s.still[k] = 0
        s.alive[k] = s.alive[k] + 1 if s.state[k] == OUT else 0
        if s.state[k] == UNKNOWN and (not known or s.doubt[k] in (STILL, CAMERA)):
            if not known:
                part = self._part(k)
                s.bodies.take(k, part, s.seconds.depth()[part], self.rise_mm)
            self._become(k, IN, s.seconds.since, end - 1, events)
        elif self.odd_min and s.alive[k] * self.learn_s >= 60 * self.odd_min:
            s.doubt[k] = ODD
            self._become(k, UNKNOWN, end - round(int(s.alive[k]) * self.learn_s * NS), end - 1, events, "region")

    def _become(
        self, k: int, state: int, since: int, stamp: int, events: Rows, why: str = "", *, keep: bool = False
    ) -> None:
        """Be in another state; `keep`: how long it has been still goes on counting."""
        s = self.state
        if (
            state == IN and s.state[k] == UNKNOWN
        ):  # a second one is still there, or came while nobody looked: known at once
            s.bodies.two[k] = s.bodies.two[k] or self._times(k) >= CROWD
            why = "body" if s.bodies.two[k] else ""
        s.told[k] = int(why == "body")
        s.state[k] = s.wanted[k] = state
        s.still[k] = s.still[k] if keep else 0
        s.alive[k] = 0
        if state != UNKNOWN:
            s.doubt[k] = 0
        if state == OUT:
            s.was_in[k] = 0
            s.bodies.left(k)
            s.visitor.left(k)
        events.append((stamp, self._event(k, since, why)))

    def _event(self, k: int, since: int, why: str) -> tuple[Any, ...]:
        s = self.state
        return since, s.sleepers[k], NAMES[s.state[k]], s.seen_now[k, 1], s.seen_now[k, 0], why

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
