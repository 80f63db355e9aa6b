"""Who is in bed: decided from the beds' depths, second by second, and stretch by stretch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import structlog
from numpy.typing import NDArray

from kinegraph.operators.bed.bed_depths import BedDepths
from kinegraph.operators.bed.bed_events import IN, NAMES, OUT, UNKNOWN
from kinegraph.operators.bed.bodies import CROWD, CROWD_S, SUSPECT_S, Bodies, share_high
from kinegraph.operators.bed.breath_watch import WINDOW_NS, BreathWatch
from kinegraph.operators.bed.frames.regions import take
from kinegraph.operators.bed.mattress import somebody
from kinegraph.operators.bed.region_fit import MIN_BLOCKS, MIN_INSIDE, body_at, is_same, suggested, within
from kinegraph.operators.bed.visitor import RoamingBody
from kinegraph.stream.chunk import NEVER, NS, Array, Samples, Times

AGAIN = 0.7
"""Out of bed below this share of what makes in bed."""
BLIND_S = 300.0
"""While the empty bed is not known: without movement for this long is an empty bed."""
DOUBTS = ("", "still", "region", "camera", "dark", "region")
STILL, ODD, CAMERA, DARK, MISFIT = 1, 2, 3, 4, 5
CONFIRMED = 2
"""A region does not fit if it is so in this many stretches after each other, of somebody who lies where he lay."""
SITS_MM = 300.0
"""Half of what is seen of who lies is no higher than this (in tilted rooms 110 to 190 mm, of who sits on the edge 360 to 1700): who sits
need not be within a region."""
MIN_SHARE = 0.05
"""Who covers less of a region that is too large may be a pet."""
SMALL_SHARE, SMALL_WINDOWS = 0.06, 3
"""Who covers less than `min_share` of a bed that was found, and breathes in this many windows in a row, is a child; a cat covers .04."""
SEEN_SHARE = 0.02
"""Where this much is raised, and something has breathed within `BLIND_S`, it is not learned as the empty bed."""
TREMBLE = 0.03
"""This share of a region may seem to move though nothing does: blocks on the edges of a heap near the camera (5 of 338 in chosen rooms)."""
ALIVE = 0.005
"""This much of a region must move (2 blocks at least) to be somebody."""

log = structlog.get_logger(__name__)

Rows = list[tuple[int, tuple[Any, ...]]]
"""Events, and when each was decided."""


@dataclass(frozen=True, slots=True)
class OccupancyLimits:
    """What is decided by; see the parameters of `operators.bed.presence.Presence`. 0 of `vacant_s`, `unsure_s`, `odd_s`: never."""

    rise_mm: float
    min_share: float
    min_valid: float
    hold_s: float
    learn_s: float
    still_mm: float
    vacant_s: float
    unsure_s: float
    odd_s: float
    unseen_s: float


@dataclass(slots=True)
class Occupancy:
    """
    state, wanted (k,)          UNKNOWN, IN or OUT; what the depth has shown since `since` (k,) ns; `seen` (k,) ns: when it was last seen
    still      (k,)             for how many stretches nothing has moved
    lay        (k,)             whether what may be a body stood out of the mattress in the newest stretch, while the bed was not known
    doubt      (k,)             why the depth is not believed (of DOUBTS); alive: for how many stretches something has moved; was_in: in
                                bed when the camera was moved
    watch                       whether breath is seen
    bodies, visitor             one in a region, or two; and whether something small walks about
    reported   (k,)             whether the newest event says `body`
    found      (k,)             whether the region was found, not set
    needs      (k,)             how much of the region this sleeper covers at least
    body       (rows, columns)  who lay there in the stretch before; misfits: for how many stretches the regions have not held them; -1:
                                they do, and this is not asked again
    block      pixels
    """

    sleepers: list[str]
    limits: OccupancyLimits
    beds: BedDepths
    state: Times
    wanted: Times
    since: Times
    seen: Times
    still: Times
    lay: Times
    doubt: Times
    alive: Times
    was_in: Times
    watch: BreathWatch
    bodies: Bodies
    visitor: RoamingBody
    reported: Times
    found: Times
    needs: Samples
    body: NDArray[np.bool_]
    misfits: int
    block: int

    @staticmethod
    def unknown(
        sleepers: tuple[str, ...], shape: tuple[int, ...], rate_hz: float, limits: OccupancyLimits, block: int
    ) -> Occupancy:
        """The state before the first frame: unknown for all sleepers. `shape`: (rows, columns) of the frames in blocks."""
        k = len(sleepers)
        state, wanted, still, lay, doubt, alive, was_in, reported = (np.zeros(k, np.int64) for _ in range(8))
        return Occupancy(
            list(sleepers), limits, BedDepths.of(k, shape), state, wanted, np.full(k, NEVER), np.full(k, NEVER), still, lay, doubt, alive,
            was_in, BreathWatch.of(k, shape, rate_hz), Bodies.of(k, shape), RoamingBody.of(k, shape), reported,
            np.zeros(k, np.int64), np.full(k, limits.min_share), np.zeros(shape, np.bool_), 0, block,
        )  # fmt: skip

    def end_second(self, end: int, events: Rows) -> None:
        """What the second that is over at `end` says, and the stretch if it is, too."""
        self.beds.end_second(self.limits.rise_mm)
        for k in range(len(self.sleepers)):
            self._judge(k, end, events)
        self.visitor.second += 1
        if self.watch.end(end, self.beds.regions, (self.state == IN).tolist()):
            for k in range(len(self.sleepers)):
                self._judge_breath(k, end, events)
        if end - self.beds.seconds.since >= self.limits.learn_s * NS:
            for k in range(len(self.sleepers)):
                self._judge_stretch(k, end, events)
            if self.misfits >= 0:
                self._judge_fit(end, events)
            self.beds.seconds.since = NEVER

    def take_regions(self, rows: Array, stamp: int, events: Rows) -> None:
        """The regions have changed; where no bed was found, that is why nothing is known."""
        self.misfits = 0
        take(rows, tuple(self.sleepers), self.beds.regions, self.block)
        for row in rows:
            k = self.sleepers.index(str(row["sleeper"]))
            self.found[k] = int(row["found"])
            self.doubt[k] *= int(self.doubt[k] != MISFIT)
            if row["found"] and not row["rows"]:
                self._become(k, UNKNOWN, stamp, stamp, events, "region")

    def look(self, what: str, onset: int, stamp: int, events: Rows) -> None:
        """The view has become another one."""
        if what == "moved":
            self.bodies.moved(self.beds.empty, self.beds.regions)
            self.visitor.forget()
            self.beds.forget()
            self.watch.forget()
        for k in range(len(self.sleepers)):
            if what in ("moved", "dark"):
                self.was_in[k] = int(self.state[k] == IN or (self.was_in[k] and self.state[k] == UNKNOWN))
                self.doubt[k] = CAMERA if what == "moved" else DARK
                self.still[k] = self.alive[k] = 0
                if self.state[k] != UNKNOWN:
                    self._become(k, UNKNOWN, onset, stamp, events, str(DOUBTS[self.doubt[k]]))
            elif self.doubt[k] == DARK:
                self.doubt[k] = 0

    def forget_unseen(self, until: int, events: Rows) -> None:
        """Report sleepers as unknown who were not seen for too long."""
        unseen_ns = round(self.limits.unseen_s * NS)
        due = [(int(self.seen[k]) + unseen_ns, k) for k in range(len(self.sleepers)) if self.state[k] != UNKNOWN]
        for stamp, k in sorted(d for d in due if d[0] <= until):
            self.beds.seen_now[k] = np.nan
            self.doubt[k] = 0
            self._become(k, UNKNOWN, int(self.seen[k]), stamp, events, "unseen")

    def _judge(self, k: int, end: int, events: Rows) -> None:
        """What the newest second says."""
        raised, _, measured = self.beds.seen_now[k]
        if measured < self.limits.min_valid:
            self.wanted[k] = self.state[k]
            return
        self.seen[k] = end
        says = int(self.state[k])
        if raised >= self.needs[k]:
            says = IN
        elif raised < AGAIN * self.needs[k]:
            says = OUT
        self._count_bodies(k, float(raised), end, events)
        doubt = int(self.doubt[k])
        if doubt in (CAMERA, DARK, MISFIT) or (doubt == STILL and says == IN) or (doubt == ODD and says == OUT):
            says = UNKNOWN
        if says == self.state[k] or says == UNKNOWN:
            self.wanted[k] = self.state[k]
            return
        if self.wanted[k] != says:
            self.wanted[k], self.since[k] = says, end - NS
        if end - self.since[k] >= self.limits.hold_s * NS:
            self._become(k, says, int(self.since[k]), end - 1, events)

    def _count_bodies(self, k: int, raised: float, end: int, events: Rows) -> None:
        """Learn what one body raises, and notice a second one, or something that walks about."""
        if self.state[k] != IN:
            self.bodies.crowd[k] = 0
            return
        rise = self.limits.rise_mm
        changed = self.bodies.count(k, self._times(k))
        above = self.beds.above(k)
        if not self.bodies.known(k):
            self.bodies.learn(k, raised, share_high(above, rise), float(self.beds.seen_now[k, 1]))
        if not self.beds.known(k):
            above = self.beds.above_mattress(k)
        self.visitor.look(k, self.beds.part(k), above, rise)
        suspected = self.bodies.suspected(k)
        body = suspected or self.visitor.here(k)
        if body != bool(self.reported[k]):
            for_s = SUSPECT_S if suspected else CROWD_S if changed else 1
            events.append((end - 1, self._event(k, end - for_s * NS, "body" if body else "")))
            self.reported[k] = int(body)

    def _times(self, k: int) -> float:
        """How many times the share of one body is raised now; NaN: not known."""
        beds, rise = self.beds, self.limits.rise_mm
        if not self.bodies.known(k):
            return self.bodies.early(k, share_high(beds.above(k), rise), float(beds.seen_now[k, 1]))
        return self.bodies.times(k, float(beds.seen_now[k, 0]), beds.seconds.mean, beds.regions, rise)

    def _judge_breath(self, k: int, end: int, events: Rows) -> None:
        """What the newest window of breath says: that nobody breathes any more in a heap, or that somebody does after all."""
        beds = self.beds
        away = self.state[k] == OUT or self.doubt[k] == ODD
        if away and self.found[k] and beds.seen_now[k, 0] >= SMALL_SHARE and self.watch.run[k] >= SMALL_WINDOWS:
            self.needs[k] = min(self.limits.min_share, SMALL_SHARE)
            self._become(k, IN, end - SMALL_WINDOWS * WINDOW_NS, end - 1, events)
            return
        if not beds.known(k) and not somebody(beds.above_mattress(k), self.limits.rise_mm, self.limits.min_share):
            return  # nothing there may be a body: the stretch decides
        if self.state[k] == IN and self.watch.silent(k):
            self.doubt[k] = STILL
            self._become(k, UNKNOWN, end - int(self.watch.lull[k]) * WINDOW_NS, end - 1, events, "still", keep=True)
        elif self.state[k] == UNKNOWN and self.doubt[k] == STILL and self._breathes(k, end - WINDOW_NS):
            self._become(k, IN, end - WINDOW_NS, end - 1, events)

    def _breathes(self, k: int, since: int) -> bool:
        """Whether breath was seen in a window that ended after `since`, and something is there that may be a body."""
        if self.watch.seen[k] <= since:
            return False
        if not self.beds.known(k):
            return bool(self.lay[k])
        return bool(self.beds.seen_now[k, 0] >= AGAIN * self.needs[k])

    def _judge_stretch(self, k: int, end: int, events: Rows) -> None:
        """What the stretch that is over says: learn the empty bed, or note that somebody is there."""
        beds, limits = self.beds, self.limits
        known = beds.known(k)
        lies = not known and beds.lies(k, limits.rise_mm, limits.min_share)
        moving = beds.moving(k, limits.still_mm, limits.rise_mm, anywhere=known)
        if moving < 0 or beds.seen_now[k, 2] < limits.min_valid:
            self.still[k] = 0
            return
        if self.doubt[k] in (DARK, MISFIT):
            return
        self.still[k] *= lies or not self.lay[k]  # what was raised has gone unseen
        self.lay[k] = int(lies)
        away = self.state[k] == OUT or self.doubt[k] == ODD
        breathes = self._breathes(k, beds.seconds.since) or (away and self.watch.seen[k] > beds.seconds.since)
        if breathes or moving > max(2.0, ALIVE * beds.regions[k, 2] * beds.regions[k, 3]):
            self._moves(k, known, moving, end, events)
            return
        self.still[k] += 1
        self.alive[k] = 0
        quiet_s = int(self.still[k]) * limits.learn_s
        held = self.state[k] == IN or self.doubt[k] == STILL or bool(self.was_in[k])
        if lies and not held:
            self.doubt[k] = STILL
            self._become(k, UNKNOWN, end - round(quiet_s * NS), end - 1, events, "still", keep=True)
            return
        judged = known or bool(self.was_in[k]) or lies
        patience_s = limits.vacant_s if judged else BLIND_S
        if self.state[k] == IN and judged and limits.unsure_s and quiet_s >= limits.unsure_s:
            self.doubt[k] = STILL
            self._become(k, UNKNOWN, end - round(quiet_s * NS), end - 1, events, "still", keep=True)
        flat = not known and (bool(beds.flat[k]) or (not lies and self.watch.silent(k)))
        if held and not flat and (not patience_s or quiet_s < patience_s):
            return
        if away and beds.seen_now[k, 0] >= SEEN_SHARE and self.watch.seen[k] > end - round(BLIND_S * NS):
            return
        beds.learn(k)
        self.bodies.taken[beds.part(k)] = np.nan
        self.doubt[k] = self.was_in[k] = 0
        if self.state[k] != OUT:
            self._become(k, OUT, end - round(quiet_s * NS), end - 1, events)

    def _moves(self, k: int, known: bool, moving: int, end: int, events: Rows) -> None:
        """Something has moved in the stretch that is over: this number of its blocks."""
        beds, limits = self.beds, self.limits
        self.still[k] = 0
        self.alive[k] = self.alive[k] + 1 if self.state[k] == OUT else 0
        # where breath was usually seen, it brings the sleeper back, or more movement than that of blocks at the edges of what rests
        few = moving <= TREMBLE * beds.regions[k, 2] * beds.regions[k, 3]
        rests = few and self.doubt[k] == STILL and self.watch.silent(k)
        if self.state[k] == UNKNOWN and not rests and (not known or self.doubt[k] in (STILL, CAMERA)):
            if not known:
                self.bodies.take(k, beds.part(k), beds.stretch(k), limits.rise_mm)
            self._become(k, IN, beds.seconds.since, end - 1, events)
        elif limits.odd_s and (self.doubt[k] == ODD or self.alive[k] * limits.learn_s >= limits.odd_s):
            beds.lies(k, limits.rise_mm, limits.min_share)
            if beds.flat[k]:  # nothing stands out of the mattress: a fan that lifts the blanket
                if self.state[k] != OUT:
                    self._become(k, OUT, end - NS, end - 1, events)
            elif self.state[k] == OUT:
                self.doubt[k] = ODD
                self._become(
                    k, UNKNOWN, end - round(int(self.alive[k]) * limits.learn_s * NS), end - 1, events, "region"
                )

    def _judge_fit(self, end: int, events: Rows) -> None:
        """Whether the regions hold who lies there, as a setup check asks; until they once did."""
        beds, limits = self.beds, self.limits
        regions = [tuple(region) for region in beds.regions.tolist()]
        inside = within(regions, self.body.shape)
        above = beds.room - beds.seconds.depth()
        with np.errstate(invalid="ignore"):
            body = body_at(above > limits.rise_mm, inside)
        if body.any() and np.median(above[body]) > SITS_MM:
            body[:] = False
        same, held = is_same(body, self.body), float((body & inside).sum() / max(1, body.sum()))
        self.body = body
        if body.sum() < MIN_BLOCKS or held >= MIN_INSIDE:
            self.doubt[self.doubt == MISFIT] = 0
        there = self.state == IN
        small = [
            k for k in range(len(self.sleepers)) if self.alive[k] > CONFIRMED and body[beds.part(k)].mean() > MIN_SHARE
        ]
        if not same or not (there.any() or small):
            self.misfits = 0
            return
        if held >= MIN_INSIDE and there.any():
            self.misfits = -1
            return
        self.misfits += 1
        if self.misfits < CONFIRMED or not (small or self.found.all()):
            return
        doubt = MISFIT if held < MIN_INSIDE else ODD
        log.warning(
            f"the region holds {held:.0%} of who lies there: it is too small, or elsewhere"
            if doubt == MISFIT
            else "who lies there covers too little of the region: it is too large",
            hint=suggested({"": body}, self.block),
        )
        for k in np.flatnonzero(there).tolist() if there.any() else small:
            self.doubt[k] = doubt
            self._become(k, UNKNOWN, end - round(CONFIRMED * limits.learn_s * NS), end - 1, events, "region")

    def _become(
        self, k: int, state: int, since: int, stamp: int, events: Rows, why: str = "", *, keep: bool = False
    ) -> None:
        """Be in another state; `keep`: how long it has been still goes on counting."""
        if state == IN and self.state[k] == UNKNOWN:
            # a second one is still there, or came unseen: known at once
            self.bodies.two[k] = self.bodies.two[k] or self._times(k) >= CROWD
            why = "body" if self.bodies.two[k] else ""
        self.reported[k] = int(why == "body")
        self.state[k] = self.wanted[k] = state
        self.still[k] = self.still[k] if keep else 0
        self.alive[k] = 0
        if state != UNKNOWN:
            self.doubt[k] = 0
        if state == OUT:
            self.was_in[k], self.needs[k] = 0, self.limits.min_share
            self.bodies.left(k)
            self.visitor.left(k)
            self.watch.left(k)
        events.append((stamp, self._event(k, since, why)))

    def _event(self, k: int, since: int, why: str) -> tuple[Any, ...]:
        raised, height, _ = self.beds.seen_now[k]
        return since, self.sleepers[k], NAMES[self.state[k]], height, raised, why
