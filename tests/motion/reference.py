"""The segmentation in its plainest form: a whole recording, every distance there is, Python loops; it defines what the live one must tell.

Each event is (kind, frame of the decision, ...). A decision at frame t looks at frames up to t only, at most a window back, and at the
exemplars that were kept: every distance is asked for through `Reference.apart`, which notes how far back was looked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

Event = tuple[Any, ...]
KNOWN, SHARED, FAR, CALM, LEAST, STILL, NOISE, TRAVELS = 2, 4, 100.0, 3.0, 0.02, 0.12, 1.5, 0.5
SURE, STRAYS, SAME, HOLE = 3, 4.0, 0.4, 8
DIP, RETURNS, SEEN, LEAVES, GAIN, TRUSTS, SAMPLED, MAX_CLUSTERS = 0.6, 0.75, 0.7, 0.8, 0.3, 1.25, 64, 32
CHANCE = 0.7
RISES = 2
STANDS, EXTENT, HOME, LIKE_IT, MOST = 0.75, 2.0, 0.4, 0.5, 128


@dataclass
class Exemplar:
    """A cluster's first cycle: its number, frames (length, features), and when it was used last."""

    number: int
    frames: Any
    used: int = 0
    lead: float = 0.0
    travel: float = 0.0


@dataclass
class Paths:
    """The cheapest warping paths along an exemplar that end at the newest frame, per column: cost and first frame."""

    frames: Any
    free: int
    cost: list[float] = field(default_factory=list)
    begin: list[int] = field(default_factory=list)
    best: tuple[float, int, int] | None = None

    def __post_init__(self) -> None:
        self.cost, self.begin = [np.inf] * len(self.frames), [-1] * len(self.frames)

    def advance(self, apart: Any, i: int, radius: float) -> float:
        """Steps (1,1) weigh 2, (1,0) and (0,1) weigh 1; a node costs its distance less GAIN radii. Mean distance at the last column."""
        m, old, begin = len(apart), self.cost, self.begin
        cost, first = [np.inf] * m, [-1] * m
        for c in range(m):
            step = apart[c] - GAIN * radius
            if c == 0:
                ways = [(2 * step, i)] if i >= self.free else []
            else:
                ways = [
                    (old[c - 1] + 2 * step, begin[c - 1]),
                    (cost[c - 1] + step, first[c - 1]),
                    (old[c] + step, begin[c]),
                ]
            for price, start in ways:
                if price < cost[c]:
                    cost[c], first[c] = price, start
            if first[c] < self.free or i - first[c] >= 2 * m:
                cost[c], first[c] = np.inf, -1
        self.cost, self.begin = cost, first
        frames = i - first[-1] + 1
        if cost[-1] == np.inf or frames * 2 < m:
            return np.inf
        return cost[-1] / (frames + m) + GAIN * radius

    @property
    def patience(self) -> int:
        return max(3, len(self.frames) // 4)

    @property
    def slack(self) -> int:
        return len(self.frames) // 2

    def release(self) -> None:
        assert self.best
        self.free = self.best[2] + 1 - self.patience // 2
        for c, start in enumerate(self.begin):
            if start < self.free:
                self.cost[c], self.begin[c] = np.inf, -1
        self.best = None


@dataclass
class Held:
    """An activity that has ended; its end is decided with the next one's start."""

    first: int
    last: int
    cycles: int
    cluster: int
    forced: int
    how: int
    certain: float
    radius: float


class Reference:
    """Feed `run` a recording (n, features); `frames` are the parameters in frames, named as in operators/segmentation/kernels/layout.py.

    mirrored, firsts  the mirror images (n, features), if there are any, and which features are the first of a pair
    """

    def __init__(
        self,
        x: Any,
        frames: dict[str, int],
        share: float,
        radius: float | None = None,
        mirrored: Any = None,
        firsts: Any = None,
    ) -> None:
        self.came = np.where(np.isfinite(x), x, np.nan)
        self.known = np.isfinite(x)
        self.x, self.firsts = np.empty_like(self.came), firsts
        self.images = None if mirrored is None else np.where(np.isfinite(mirrored), mirrored, np.nan)
        self.mirrored = None if mirrored is None else np.empty_like(self.came)
        self.frames: list[int] = []
        self.present, self.good = np.zeros(len(x), int), np.zeros(len(x), bool)
        self.moves: list[float] = []
        self.rested: set[int] = set()
        self.moved = self.peak = 0.0
        self.calmest = np.inf
        self.peak_at = 0
        self.resting: list[int] = []
        self.rest_from, self.rest_to = 0, -1
        self.stood = self.paused = False
        self.parked = -1
        self.measured: dict[tuple[int, int, int], float] = {}
        self.p, self.share, self.fixed = frames, share, radius
        self.radius, self.band, self.early = radius or 0.0, frames["max_band"], 0.0
        self.events: list[Event] = []
        self.now = self.back = 0
        self.exemplars: list[Exemplar | None] = [None] * MAX_CLUSTERS
        self.clock = self.turn = self.clusters = self.activity = 0
        self.believed = self.believed_of = self.from_grown = self.ahead = self.foreseen = self.noticed = 0
        self.counted: dict[int, int] = {}
        self.spans: dict[int, Event] = {}
        self.gestures = self.back_from = self.start = self.pieces = self.count = 0
        self.begun = self.reported = False
        self.paths: Paths | None = None
        self.pending: tuple[int, int] | None = None
        self.back_to = -1
        self.like: list[float] = []
        self.certain: list[float] = []
        self.held: Held | None = None
        self.resumed = -1
        self.blind = 0

    def run(self, *, end: bool = True) -> list[Event]:
        self.seed = self.untold = self.when = self.repeated = self.opened = self.last = 0
        self.open = False
        self.flags = np.zeros(len(self.x), bool)
        for i in range(len(self.came)):
            self.frame = i
            if self.rests(i):
                self.leave_out(len(self.resting))
            elif self.unseen(i):
                self.leave_out(self.blind - self.p["rest"])
            else:
                self.now = len(self.frames)
                self.take(i)
                self.step(self.now)
        if end and self.frames:
            self.end()
        return self.events

    def leave_out(self, count: int) -> None:
        """A frame is left out, as so many in a row."""
        if self.parked >= 0 or not self.frames:
            return
        repeated = not self.paused and ((self.open and self.count > 1) or (self.held and self.held.cycles > 1))
        if count == self.p["max_lag"] or (count == self.p["transition"] + 1 and self.resting and repeated):
            stop = self.now + 1
            while self.resting and stop > self.untold and stop - 1 in self.rested:
                stop -= 1
            first = self.close_all(0, stop)
            if self.resting:
                self.parked = self.frames[first] if first < len(self.frames) else self.rest_from
        elif count == self.p["transition"] + 1 and not self.open:
            self.let_go()

    def unseen(self, i: int) -> bool:
        """Whether frame `i` is left out, as nothing has been known for long, or ever."""
        if self.known[i].any():
            if self.blind > self.p["rest"] + self.p["transition"]:
                self.resumed = len(self.frames)
            self.blind = 0
            return False
        self.blind += 1
        return not self.frames or self.blind > self.p["rest"]

    def tell(self, kind: str, *what: int) -> None:
        """An event; processed frames are identified by their arrival number."""
        spans = {"rest": 0, "begin": 1, "activity": 2, "primitive": 2, "bout": 2, "provisional": 2}.get(kind, 0)
        numbers = [self.frames[v] for v in what[:spans]] + [int(v) for v in what[spans:]]
        self.events.append((kind, self.frame, *numbers))

    # Rest

    def rests(self, i: int) -> bool:
        """Whether frame `i`, as it came, is left out: it has moved little."""
        n = self.p["rest"]
        self.moved = self.movement(i)
        if i < n or self.moved >= self.calm():
            self.tell_rest(0)
            return False
        if not self.resting:
            self.stood = True
            ends = [self.pending[1]] if self.open and self.pending else []
            ends += [self.paths.best[2]] if self.open and self.paths and self.paths.best else []
            lately = [j for j in range(max(ends, default=-1) + 1, len(self.frames)) if self.frames[j] >= max(0, i - n)]
            self.rested.update(lately)
            behind = [self.frames[j] for j in lately if self.frames[j] > self.rest_to]
            self.rest_from = behind[0] if behind else i
            self.tell("resting", self.rest_from)
        self.resting.append(i)
        self.rest_to = i
        return True

    def tell_rest(self, forced: int) -> None:
        """A rest, if there was one, is over; it may be an activity of its own."""
        if not self.resting:
            return
        self.tell("rest", self.rest_from, self.resting[-1])
        if len(self.resting) > self.p["transition"]:
            self.resumed = len(self.frames)
        if self.parked >= 0:
            self.events.append(
                ("primitive", self.frame, self.parked, self.resting[-1], self.activity, 0, -1, forced, 0)
            )
            self.settle_count(self.activity, 0)
            self.certain.append(0.0)
            self.events.append(("activity", self.frame, self.parked, self.resting[-1], self.activity, 0, -1, forced, 0))
            self.activity += 1
        self.resting, self.parked = [], -1

    def movement(self, i: int) -> float:
        """Mean distance to the REST frames before, over what is known in both, less their noise; as before, where less than half of them
        are known."""
        if not i:
            return 0.0
        near = self.came[max(0, i - self.p["rest"]) : i + 1]
        far, steps = self.distances(near[:-1] - near[-1], 0), self.distances(np.diff(near, axis=0), 0)
        far, steps = far[np.isfinite(far)], steps[np.isfinite(steps)]
        if not len(far) or 2 * len(far) < len(near) - 1:
            return self.moved
        noise = NOISE * float((steps**2).mean()) if len(steps) and 2 * (len(near) - 1) >= self.p["rest"] else 0.0
        if len(near) - 1 >= self.p["rest"] and far.mean() > 0.0:
            self.calmest = min(self.calmest, float(far.mean()))
        return math.sqrt(max(1e-24, STILL**2 * noise, float(far.mean()) ** 2 - noise))

    def calm(self) -> float:
        """Who moves less is at rest."""
        return min(STILL * self.peak, max(LEAST * self.peak, CALM * self.calmest))

    def at_rest(self, i: int) -> bool:
        return self.moves[i] < self.calm()

    def choose_peak(self, t: int) -> None:
        """What frames worth MASS, of the window, move at least."""
        if t >= self.peak_at:
            self.peak_at = t + self.p["every"]
            found = sorted(self.moves[max(0, t - self.p["window"] + 1) : t + 1])
            self.peak = found[-self.p["mass"]] if len(found) >= self.p["mass"] else 0.0
            if not self.stood and len(found) >= self.p["mass"]:
                self.tell_first_rest(max(0, t - self.p["window"] + 1), t)

    def tell_first_rest(self, first: int, t: int) -> None:
        """Stillness before the first motion, which has gone on for MASS, but not for long."""
        still = [self.at_rest(i) for i in range(first, t + 1)]
        lively = len(still) if True not in still else still[::-1].index(True)
        before = still[: len(still) - lively]
        rest = len(before) if False not in before else before[::-1].index(False)
        settled = self.p["rest"] + self.p["mass"] + self.p["every"]
        least = self.p["mass"] if rest == len(before) else settled
        if rest > self.p["rest"] and least <= lively <= settled + self.p["every"]:
            self.stood = True
            self.rested.update(range(t + 1 - lively - rest, t + 1 - lively))
            self.tell("rest", self.frames[t + 1 - lively - rest], self.frames[t - lively])

    def take(self, i: int) -> None:
        """Frame `i`, as it came, is the next one to be worked through; it stands for the one before it if too little of it is known."""
        t = self.now
        self.frames.append(i)
        self.moves.append(self.moved)
        lately = self.known[self.frames[max(0, t - self.p["window"] + 1) :]]
        self.present[t], known = lately.any(0).sum(), self.known[i].sum()
        self.good[t] = known > 0 and known * KNOWN >= self.present[t]
        self.x[t] = self.came[i] if self.good[t] else self.x[t - 1] if t else 0.0
        if self.mirrored is not None and self.images is not None:
            self.mirrored[t] = self.images[i] if self.good[t] else np.nan

    def apart(self, i: int, j: int, present: int = 0) -> float:
        assert i <= self.now and j <= self.now
        self.back = max(self.back, self.now - min(i, j))
        key = i, j, present or int(self.present[max(i, j)])
        if key not in self.measured:
            self.measured[key] = float(self.distances(self.x[i] - self.x[j], key[2]))
        return self.measured[key]

    @staticmethod
    def distances(differences: Any, present: Any) -> Any:
        """Over the features that both frames have, (..., features); infinity where too few of those present are common."""
        common = np.isfinite(differences).sum(-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            far = np.sqrt(np.nansum(differences**2, axis=-1) / common)
        return np.where((common == 0) | (common * SHARED < present), np.inf, far)

    def along(self, i: int, frames: Any) -> Any:
        """Distances of frame `i` to an exemplar's frames."""
        self.back = max(self.back, self.now - i)
        far = self.distances(frames - self.x[i], self.present[self.now])
        return np.where(np.isinf(far), FAR * self.radius, far)

    # Activities

    def has_neighbour(self, i: int) -> bool:
        lags = range(self.band, min(self.p["max_lag"], i - self.seed) + 1)
        return bool(self.good[i]) and not self.at_rest(i) and any(self.apart(i, i - k) <= self.radius for k in lags)

    def step(self, t: int) -> None:
        p = self.p
        self.choose_peak(t)
        if not self.open:
            if t + 1 < p["learn"]:
                self.anticipate(t)
                return
            if self.believed and t + 1 >= p["learn"] + p["mass"]:
                self.give_up()
            if self.held and t - self.held.last > p["max_lag"] + p["transition"]:
                self.let_go()
            if t >= self.when:
                self.choose_radius(t)
                self.when = t + p["every"]
                for i in range(max(self.seed, t - p["max_lag"] + 1), t):
                    self.flags[i] = self.has_neighbour(i)
            self.flags[t] = self.has_neighbour(t)
            recent = slice(max(self.seed, t - p["max_lag"] + 1), t + 1)
            if self.flags[t] and self.flags[recent].sum() >= p["mass"]:
                self.open_up(t)
        elif self.has_neighbour(t):
            self.last = t
        if self.open:
            due = t - self.last >= p["quiet"] or t >= self.opened + p["settle"]
            if due and (not self.begun or not (self.reported or self.returned or (t - self.opened) % p["settle"])):
                self.begin()
            if self.begun:
                while self.done < t:
                    self.done += 1
                    self.explore(self.done)
                if not self.reported and t >= self.opened + p["firm"]:
                    if self.counts():
                        self.tell_start()
                    elif t >= self.start + 2 * p["max_lag"]:
                        self.open, self.when = False, 0
                        self.give_up()
                        return
                self.watch_returns(t)
                if self.paths:
                    more = self.paths.best is not None and not self.replaces(self.paths)
                    self.believe_open(self.count + self.gestures + more)
                self.look_ahead(t)
            else:
                if not self.foresee(self.grown(), t, grown=True):
                    self.foresee(self.noticed, t)
                self.watch_returns(t)
            if t - self.last >= p["quiet"]:
                self.finish(False)
        else:
            self.watch_returns(t)

    def anticipate(self, t: int) -> None:
        """Before there is enough for a decision: what repeats is believed, by what is typical so far."""
        kept = self.radius, self.band, self.last
        if self.fixed is None:
            if t % self.p["every"] == 0:
                self.early = self.typical(t)
            self.radius = self.early
        self.choose_band(t)
        self.last = t
        self.foresee(self.grown(), t, grown=True)
        self.radius, self.band, self.last = kept

    def choose_radius(self, t: int) -> None:
        if self.fixed is None:
            self.radius = self.typical(t)
        self.choose_band(t)

    def typical(self, t: int) -> float:
        """Of the window, and no more than of what has come since a longer rest."""
        made = self.typical_since(max(0, t - self.p["window"] + 1), t)
        if 0 < self.resumed <= t - self.p["mass"]:
            made = min(made, self.typical_since(max(self.resumed, t - self.p["window"] + 1), t))
        return made

    def typical_since(self, first: int, t: int) -> float:
        moving = [i for i in range(first, t + 1) if not self.at_rest(i)]
        chosen = moving[:: max(1, len(moving) // SAMPLED)]
        apart = [d for i in chosen for j in chosen if j < i and (d := self.apart(i, j, self.present[t])) < np.inf]
        return self.share * float(np.median(apart)) if apart else 0.0

    def choose_band(self, t: int) -> None:
        p = self.p
        stays = []
        for i in range(max(0, t - p["max_lag"]), t):
            if self.at_rest(i):
                continue
            k = 1
            while k < p["max_band"] and k <= i and self.apart(i, i - k) <= self.radius:
                k += 1
            stays.append(k)
        typical = sorted(stays)[(len(stays) - 1) // 2] if stays else 0
        self.band = min(p["max_band"], max(p["min_band"], typical + typical // 2))

    def open_up(self, t: int) -> None:
        self.open, self.opened, self.begun, self.reported, self.paths = True, t, False, False, None
        first = max(self.seed, t - self.p["max_lag"] + 1)
        marked = [i for i in range(first, t + 1) if self.flags[i]]
        self.last, first = marked[-1], marked[0]
        k = next(k for k in range(self.band, first + 1) if self.apart(first, first - k) <= self.radius)
        self.noticed, self.from_grown = first - k, False
        self.tell("radius")
        self.tell("provisional", first - k, t, self.number_of(first - k), 0)

    def grown(self) -> int:
        """Grow backward from the last frame with a neighbour."""
        p, first, found = self.p, self.last, 0
        for i in range(self.last, max(self.seed, self.opened - 2 * p["max_lag"]) - 1, -1):
            lags = range(self.band, min(p["max_lag"], self.last - i) + 1)
            if self.good[i] and not self.at_rest(i) and any(self.apart(i + k, i) <= self.radius for k in lags):
                first, found = i, found + 1
            elif first - i >= p["quiet"] and found >= p["mass"]:
                break
        return first

    def begin(self) -> None:
        first = self.grown()
        if self.begun and first >= self.start:
            return
        self.begun, self.start, self.paths, self.origin, self.done = True, first, None, first, first - 1
        self.returned = False
        self.forget()

    # What is believed

    def believe(self, activity: int, count: int) -> None:
        """So many repetitions have come, and no other believed ones remain, except excursions before."""
        if self.believed_of != activity and self.believed and not (self.gestures and self.believed_of < activity):
            self.tell_count(self.believed_of, 0)
        self.tell_count(activity, count)
        self.believed_of, self.believed = activity, count

    def tell_count(self, activity: int, count: int) -> None:
        """Every number is reported once, and a lower one than the last is a correction."""
        before = self.counted.get(activity, 0)
        if count < before:
            self.tell("count", activity, count)
        for k in range(before, count):
            self.tell("count", activity, k + 1)
        self.counted[activity] = count

    def tell_span(self, onset: int, end: int, activity: int, number: int) -> None:
        """What is new of where a repetition is."""
        span = (activity, number, self.frames[onset], self.frames[end])
        place = (29 * activity + number) % 64
        if self.spans.get(place) != span:
            self.spans[place] = span
            self.tell("provisional", onset, end, activity, number)

    def conclude(self, count: int) -> None:
        if count or self.believed:
            self.believe(self.activity if count else self.believed_of, count)
        self.believed = 0
        if self.ahead:
            self.believed_of, self.believed, self.ahead = self.activity + 1, self.ahead, 0

    def believe_open(self, count: int) -> None:
        """If there is one more in the open activity, what was believed of the next one was wrong."""
        if self.ahead and count > self.believed:
            self.tell_count(self.activity + 1, 0)
            self.ahead = 0
        self.believe(self.activity, count)

    def give_up(self) -> None:
        """What is open is no activity; excursions that came back in it remain, in a stretch."""
        if self.gestures:
            self.believe(self.activity, self.gestures)
        else:
            self.conclude(0)

    def forget_returns(self) -> None:
        self.gestures, self.back_to = 0, -1

    def watch_returns(self, t: int) -> None:
        """Excursions up to frame `t`, that were not reported yet."""
        if self.ahead or (t % max(1, self.p["quiet"] // 3) and self.back_to >= 0):
            return
        q, first, last = self.paths, self.untold, t
        if self.open and self.reported:
            first = max(self.pieces, self.pending[1] + 1 if self.pending else 0)
            if q and q.best:
                last = q.best[1] - 1
            elif q and t - first < len(q.frames):
                last = first - 1
        first = max(first, t - 2 * self.p["max_lag"])
        self.back_to = max(self.back_to, first - 1, 0)
        if last - first < self.p["mass"]:
            return
        for onset, end in self.excursions(first, last, self.radius):
            if (onset + end) // 2 <= self.back_to:
                continue
            if self.open and self.reported:
                more = int(q is not None and q.best is not None and not self.replaces(q))
                if q is None and self.believed_of == self.activity:
                    before = self.believed - self.count
                    if (onset + end) // 2 > self.foreseen:
                        self.gestures = max(self.gestures, before)
                    more = max(0, before - self.gestures - 1)
                self.came_back(onset, end)
                self.tell_span(onset, end, self.activity, self.count + self.gestures)
                self.believe(self.activity, self.count + self.gestures + more)
            else:
                self.believe_stretch(onset, end)

    def believe_stretch(self, onset: int, end: int) -> None:
        """An excursion of an activity that is not decided."""
        first = self.start if self.open and self.begun else self.noticed
        inside = self.open and (onset + end) // 2 >= first
        activity = self.number_of(first) if inside else self.activity
        if self.believed_of != activity:
            if self.believed and not self.gestures:
                return
            self.believe(activity, 0)
            self.gestures = 0
        elif self.believed and (onset + end) // 2 <= self.foreseen:
            return
        self.gestures = max(self.gestures, self.believed)
        self.came_back(onset, end)
        self.tell_span(onset, end, activity, self.gestures)
        self.believe(activity, self.gestures)

    def came_back(self, onset: int, end: int) -> None:
        self.gestures += 1
        self.back_from, self.back_to = onset, end
        self.foreseen = max(self.foreseen, end)

    def is_last_return(self, q: Paths) -> bool:
        """Whether the best path is what was believed as an excursion."""
        return bool(self.gestures and q.best and q.best[1] <= (self.back_from + self.back_to) // 2)

    def replaces(self, q: Paths) -> bool:
        """Whether the best path is to replace the pending repetition, or the other way round."""
        return bool(self.pending and q.best and q.best[1] - self.pending[0] < q.slack)

    def foresee(self, first: int, t: int, *, grown: bool = False) -> bool:
        """Before anything is decided of an activity that began about frame `first`: its repetitions, if it has a cycle by now."""
        length, _ = self.first_dip(self.means(first, t), RISES)
        if length:
            while first + 2 * length <= t and self.strays(first, length):
                first += length
            activity, count = self.number_of(first), (t - first + 1) // length
            if self.believed_of != activity or (grown and not self.from_grown):
                self.foreseen = first - 1
            self.from_grown |= grown
            for k in range(count):
                last = first + (k + 1) * length - 1
                if last - self.foreseen > length // 2:
                    self.tell_span(last + 1 - length, last, activity, k + 1)
                    self.foreseen = last
            self.believe(activity, max(count, self.believed if self.believed_of == activity else 0))
        return length > 0

    def strays(self, first: int, length: int) -> bool:
        """Whether the cycle from `first` on does not come back: on the mean it lies too far from the frames a cycle later."""
        far = [self.apart(i + length, i, int(self.present[i + length])) for i in range(first, first + length)]
        return sum(FAR * self.radius if d == np.inf else d for d in far) > TRUSTS * length * self.radius

    def look_ahead(self, t: int) -> None:
        """While no cycle is found, what came back when the activity was noticed; later, what repeats in place of its cycle."""
        q = self.paths
        if q is None:
            if not self.reported:
                self.foresee(self.noticed, t)
        elif self.count and q.best is None:
            first = max(self.latest + 1, self.origin)
            length = self.first_dip(self.means(first, t), RISES)[0] if t - first >= len(q.frames) else 0
            for k in range(self.ahead, (t - first + 1) // length if length else 0):
                self.tell_span(first + k * length, first + (k + 1) * length - 1, self.activity + 1, k + 1)
                self.tell_count(self.activity + 1, k + 1)
                self.ahead = k + 1

    def counts(self) -> bool:
        """Motion that does not come back is no activity, unless there were repetitions within a window."""
        return self.returned or self.repeated > self.now

    def forget(self) -> None:
        self.count = self.cycles = self.bouts = self.ventured = 0
        self.bout: list[tuple[int, int]] = []
        self.kinds = [0, 0, 0, 0]
        self.prices: list[float] = []
        self.pending, self.paused = None, False
        self.cluster = -1

    def tell_start(self) -> None:
        if self.meets(self.start):
            assert self.held
            self.start = self.border(self.held, self.start)
            self.held.last, self.untold = self.start - 1, self.start
        self.let_go()
        self.reported, self.pieces = True, self.start
        self.forget_returns()
        if self.start > self.untold:
            self.stretch(self.start - 1, 0)
        self.tell("begin", self.start, self.activity)

    def stretch(self, last: int, forced: int) -> None:
        self.pieces = self.untold
        count = self.tell_rest_of(last, self.activity, 0, forced, self.radius)
        self.tell_activity(Held(self.untold, last, count, -1, forced, 0, 0.0, self.radius), self.activity)
        self.activity += 1

    def tell_activity(self, made: Held, number: int) -> None:
        self.settle_count(number, made.cycles)
        self.certain.append(made.certain)
        self.tell("activity", made.first, made.last, number, made.cycles, made.cluster, made.forced, made.how)

    def settle_count(self, number: int, count: int) -> None:
        """An activity is reported with so many repetitions."""
        self.tell_count(number, count)
        self.counted[number] = 0
        if self.believed_of == number:
            self.believed = 0

    # Where activities meet

    def hold(self, last: int, forced: int) -> None:
        """The open activity has ended: it is reported when the next one's start is decided, or when no other can follow."""
        later = self.cycles - 1
        made = self.cycles + self.ventured
        certain = max(0.0, 1 - sum(self.prices) / (later * CHANCE * self.radius)) if later > 0 else 0.0
        self.held = Held(self.start, last, made, self.cluster, forced, self.how(), certain, self.radius)
        self.activity += 1

    def let_go(self) -> None:
        made = self.held
        if made is None:
            return
        self.held = None
        more = self.tell_rest_of(made.last, self.activity - 1, made.cycles, made.forced, made.radius)
        self.tell_activity(replace(made, cycles=made.cycles + more), self.activity - 1)

    def meets(self, first: int) -> bool:
        """Whether an activity from `first` on follows the held one within a transition, and with no long rest between."""
        if self.held is None or self.held.last < self.resumed <= first:
            return False
        return first - self.held.last - 2 <= self.p["transition"]

    def number_of(self, first: int) -> int:
        return self.activity + (first > self.untold and not self.meets(first))

    def border(self, held: Held, first: int) -> int:
        """From where on frames lie nearer to what comes from `first` on than to the held activity."""
        p, mass = self.p, self.p["mass"]
        start = min(first, max(self.pieces, held.first + mass, held.last + 1 - mass - mass // 2))
        best, total, cut = 0.0, 0.0, start
        for i in range(start, first):
            lags = range(self.band, p["max_lag"] + 1)
            before = min((self.apart(i, i - k) for k in lags if held.first <= i - k < start), default=np.inf)
            after = min((self.apart(i + k, i) for k in lags if first <= i + k <= self.now), default=np.inf)
            if before < np.inf and after < np.inf:
                total += before - after
            if total < best:
                best, cut = total, i + 1
        return cut

    def finish(self, forced: bool) -> None:
        if self.paths is None and not self.reported:
            length = self.cycle_length(self.done, last_chance=True)
            if length:
                self.take_up(self.done, length)
        if not self.reported and not self.counts():
            self.open, self.when = False, 0
            self.give_up()
            return
        if not self.reported:
            self.tell_start()
        last = self.last
        if self.paths and self.paths.best and self.paths.best[1] <= last:
            self.accept()
        if self.pending:
            assert self.paths
            self.settle(min(self.pending[1], last))
        self.close_bout()
        behind = self.excursions(self.pieces, last, self.radius) if self.pieces <= last else []
        for k, (onset, end) in enumerate(behind):
            self.tell_span(onset, end, self.activity, self.cycles + self.ventured + k + 1)
        self.conclude(self.cycles + self.ventured + len(behind))
        self.forget_returns()
        self.hold(last, int(forced))
        self.open, self.when = False, 0
        self.seed = self.untold = last + 1

    def end(self) -> None:
        self.tell_rest(1)
        self.close_all(1, self.now + 1)

    def close_all(self, forced: int, stop: int) -> int:
        """What is open closes with the frame before `stop`; returns the first frame that is in no activity."""
        if self.open:
            if not self.begun:
                self.begin()
            while self.done < self.now:
                self.done += 1
                self.explore(self.done)
            self.last = max(self.start, min(self.last, stop - 1))
            self.finish(bool(forced))
        elif self.believed:
            self.give_up()
        self.let_go()
        if self.untold < stop:
            self.stretch(stop - 1, forced)
        elif self.believed:
            self.conclude(0)
        first = max(stop, self.untold)
        self.forget_returns()
        self.seed = self.untold = self.now + 1
        self.when = 0
        return first

    # Cycles

    def explore(self, i: int) -> None:
        if self.paths:
            self.pursue(i)
            return
        length = self.cycle_length(i)
        if length:
            self.take_up(i, length)

    def take_up(self, i: int, length: int) -> None:
        origin = max(self.origin, i + 1 - 2 * length)
        slot, met = self.recognise(origin, i, length)
        new = slot < 0
        if new:
            first = self.lead_in(origin if self.reported else self.start, length)
            if not self.reported:
                self.start = first
                origin = max(first, i + 1 - 2 * length)
            slot = self.keep(self.in_phase(first, origin, i + 1 - length), length)
        found = self.use(slot)
        if self.reported and self.cycles and found.number != self.cluster:
            self.close_bout()
            if origin - self.pieces > self.p["firm"]:
                self.piece(origin - 1, False)
            self.conclude(self.cycles + self.ventured)
            self.hold(self.pieces - 1, 0)
            self.seed = self.untold = self.pieces
            self.reported = False
            self.start = max(origin, self.seed)
            self.forget()
        self.slot = slot
        self.forget_returns()
        if self.reported:
            origin = self.look_back(i, origin, self.pieces)
        else:
            origin = self.start = self.look_back(i, self.start, self.untold)
            self.tell_start()
        free = origin if new else self.first_whole(origin, met, len(found.frames))
        self.origin, self.paths, self.like = origin, Paths(found.frames, free), []
        for j in range(origin, i + 1):
            if self.paths:
                self.pursue(j)

    def cycle_length(self, i: int, *, last_chance: bool = False) -> int:
        length, returned = self.first_dip(self.means(self.origin, i), 0 if last_chance else self.p["max_lag"])
        self.returned = self.returned or returned
        return length

    def means(self, origin: int, i: int) -> dict[int, float]:
        """By lag: mean distance of the newest frames, up to `i`, to those before them, back to `origin`."""
        seen = i - origin + 1
        means: dict[int, float] = {}
        for k in [k for k in range(1, self.p["max_lag"] + 1) if seen - k >= SEEN * max(k, self.p["mass"])]:
            n = min(max(k, self.p["mass"]), seen - k)
            rows = np.arange(i - n + 1, i + 1)
            self.back = max(self.back, self.now - int(rows[0]) + k)
            far = self.distances(self.x[rows] - self.x[rows - k], self.present[rows])
            means[k] = float(np.where(np.isinf(far), FAR * self.radius, far).mean())
        return means

    def first_dip(self, means: dict[int, float], later: int) -> tuple[int, bool]:
        largest, returned = 0.0, False
        for k in means:
            if (
                k >= self.band
                and largest >= LEAVES * self.radius
                and means[k] < RETURNS * largest
                and means[k] <= TRUSTS * self.radius
            ):
                returned = True
                wide = max(2, k // 5)
                if means[k] < DIP * largest and means[k] <= self.radius:
                    if k + min(wide, later) not in means:
                        return 0, True
                    if all(means.get(j, np.inf) >= means[k] for j in range(k - wide, k + wide + 1)):
                        return k, True
            largest = max(largest, means[k])
        return 0, returned

    def lead_in(self, start: int, length: int) -> int:
        """The first frame before `start` that comes back a cycle later, between 2/3 and 3/2 of it; once reported, if from a rest."""
        p, first, i = self.p, start, start - 1
        least = max(self.seed, self.opened - 2 * p["max_lag"])
        if self.reported:
            least = max(least, self.pieces, start - p["max_lag"])
        while i >= least and first - i <= max(p["quiet"], length // HOLE):
            if self.reported and i in self.rested:
                return first
            lags = range(max(1, 2 * length // 3), min(p["max_lag"], 3 * length // 2, self.now - i) + 1)
            if self.good[i] and not self.at_rest(i) and any(self.apart(i + k, i) <= self.radius for k in lags):
                first = i
            i -= 1
        return start if self.reported else first

    def in_phase(self, start: int, first: int, last: int) -> int:
        """Where the frames first..last are at the phase of `start`."""
        if start >= first:
            return first
        n = max(1, (last - first) // HOLE)
        far = [sum(self.apart(start + c, j + c) for c in range(n)) for j in range(first, last + 1)]
        return first + int(np.argmin(far))

    @staticmethod
    def first_whole(start: int, met: int, length: int) -> int:
        """What starts in the middle of a known cycle begins with its rest: no repetition begins there."""
        head = (met - start) % length
        return start if 4 * head > 3 * length else max(start, start + head - length // HOLE)

    def look_back(self, i: int, start: int, floor: int) -> int:
        first = max(floor, start - self.p["max_lag"])
        if first >= start:
            return start
        exemplar = self.exemplars[self.slot]
        assert exemplar
        paths, found, self.like = Paths(exemplar.frames, first), [], []
        for j in range(first, i + 1):
            if self.track(paths, j):
                assert paths.best
                found.append(paths.best[1:])
                paths.release()
        for begin, end in reversed(found):
            if begin < start <= end + paths.slack:
                start = begin
        return start

    def travel(self, first: int, last: int, length: int) -> float:
        """How far frames move, from stride to stride, of which a cycle of `length` frames has eight."""
        stride = max(1, length // 8)
        far = [self.apart(i, i - stride) for i in range(first + stride, last + 1, stride)]
        return sum(d for d in far if d < np.inf)

    def track(self, paths: Paths, i: int) -> bool:
        for c, start in enumerate(paths.begin):
            if start in self.rested:
                paths.cost[c], paths.begin[c] = np.inf, -1
        mean = paths.advance(self.along(i, paths.frames), i, self.radius)
        exemplar = self.exemplars[self.slot]
        assert exemplar
        trusted = TRUSTS * self.radius
        if len(self.like) >= SURE:
            trusted = min(trusted, max(STRAYS * max(self.like), SAME * self.radius))
        better = mean <= trusted and (paths.best is None or mean < paths.best[0])
        if better and self.travel(paths.begin[-1], i, len(paths.frames)) >= TRAVELS * exemplar.travel:
            paths.best = (mean, paths.begin[-1], i)
        return paths.best is not None and i - paths.best[2] >= paths.patience

    def pursue(self, i: int) -> None:
        q = self.paths
        assert q
        fresh = q.best is None
        if self.track(q, i):
            self.accept()
        elif fresh and q.best:
            self.gestures -= self.is_last_return(q)
            number = self.count + self.gestures + (not self.replaces(q))
            self.tell_span(q.best[1], q.best[2], self.activity, number)
        since = self.pending[1] if self.pending else self.origin
        if i - since > q.slack + 2 * len(q.frames) + q.patience:
            if self.pending:
                self.settle(self.pending[1])
            self.close_bout()
        if i - since > q.slack + 2 * len(q.frames) + q.patience and q.best is None:
            self.paths, self.origin = None, max(self.pieces, i - self.p["max_lag"])

    def accept(self) -> None:
        q = self.paths
        assert q and q.best
        price, start, end = q.best
        close = bool(self.pending and start - self.pending[0] < q.slack)
        if close and price >= self.price:
            self.last = max(self.last, end)
            q.release()
            return
        if close:
            self.count -= 1
        elif self.pending:
            lost = self.frames[end] - self.frames[self.pending[0]] - (end - self.pending[0])
            self.paused |= lost > self.p["transition"]
            until = self.pending[1]
            before = next((i - 1 for i in range(until + 1, start) if i in self.rested), start - 1)
            self.settle(before if start - 1 - until <= q.slack else min(until, start - 1))
            if self.frames[start] - self.frames[self.bout[-1][1]] - 1 > len(q.frames):
                self.close_bout()
        self.last = max(self.last, end)
        start = max(start, self.pieces)
        rested = [i for i in range(self.pieces, start) if i in self.rested]
        if rested and start - 1 - rested[-1] <= q.slack:
            start = rested[-1] + 1
        while self.pieces < start and self.pieces in rested:
            self.pieces += 1
        if start > self.pieces:
            self.piece(start - 1, False)
        self.pending, self.price, self.latest = (start, end), price, end
        found = self.exemplars[self.slot]
        assert found
        self.cluster = found.number
        self.count += 1
        self.forget_returns()
        self.tell_span(start, end, self.activity, self.count)
        q.release()

    def settle(self, last: int) -> None:
        assert self.pending
        first = self.pending[0]
        self.like.append(self.price)
        self.prices.append(self.price)
        self.pending, self.cycles, self.pieces = None, self.cycles + 1, last + 1
        if self.cycles > 1:
            self.repeated = self.now + 1 + self.p["window"]
        self.bout.append((first, last))
        self.tell_span(first, last, self.activity, self.cycles + self.ventured)
        kind, half = self.symmetry(first, last + 1)
        self.kinds[kind] += 1
        side = self.leader(first, half, last + 1) if half >= 0 else 0
        steps = [(first, half - 1, side), (half, last, 3 - side)] if side else [(first, last, 0)]
        for a, b, moved_side in steps:
            self.tell("primitive", a, b, self.activity, self.cycles + self.ventured, self.cluster, 0, moved_side)
        other = self.alike(first, last)
        if other >= 0:
            here, there = self.exemplars[self.slot], self.exemplars[other]
            assert here and there
            self.tell("merge", max(here.number, there.number), min(here.number, there.number))
            if here.number > there.number:
                self.cluster = there.number
            here.number = min(here.number, there.number)
            self.exemplars[other] = None

    def piece(self, last: int, forced: bool) -> None:
        found = self.tell_rest_of(last, self.activity, self.cycles + self.ventured, forced, self.radius)
        self.ventured += found
        self.count += found
        self.pieces = last + 1

    # Excursions

    def tell_rest_of(self, last: int, activity: int, before: int, forced: bool | int, radius: float) -> int:
        """Report the excursions up to frame `last`, outside cycles, and the parts between them; returns the number of excursions."""
        made = self.excursions(self.pieces, last, radius) if self.pieces <= last else []
        for k, (onset, end) in enumerate(made):
            onset = max(onset, self.pieces)
            if onset > self.pieces:
                self.tell("primitive", self.pieces, onset - 1, activity, 0, -1, 0, 0)
            self.tell_span(onset, end, activity, before + k + 1)
            self.tell("primitive", onset, end, activity, before + k + 1, -1, 0, 0)
            self.pieces = end + 1
        if self.pieces <= last:
            self.tell("primitive", self.pieces, last, activity, 0, -1, forced, 0)
            self.pieces = last + 1
        return len(made)

    def excursions(self, first: int, last: int, radius: float) -> list[tuple[int, int]]:
        """Those with the larger part and the farthest frame in first..last, and like another one, cut to these frames."""
        p, present = self.p, int(self.present[self.now])
        start = max(0, first - p["max_lag"], self.now + 1 - 3 * p["max_lag"] - p["firm"])
        stop = min(self.now + 1, last + 1 + p["max_lag"])
        stays = {
            i: sum(self.apart(i, i - k) for k in range(1, p["quiet"] + 1)) / p["quiet"]
            for i in range(max(first, start + p["quiet"]), last + 1)
        }
        pose = min(stays, key=lambda i: stays[i], default=-1)
        if pose < 0 or stays[pose] >= STANDS * radius:
            return []
        far = {i: self.apart(max(i, pose), min(i, pose), present) for i in range(start, stop)}
        trips: list[tuple[int, int, int]] = []
        home, away = (np.inf, start), (0.0, -1)
        for i in far:
            if np.isinf(far[i]):
                continue
            if away[1] < 0:
                if far[i] <= home[0]:
                    home = far[i], i
                elif far[i] >= EXTENT * radius and home[0] <= HOME * far[i]:
                    away = far[i], i
            elif far[i] > away[0]:
                away = far[i], i
            elif far[i] <= HOME * away[0]:
                trips.append((home[1], away[1], i))
                home, away = (far[i], i), (0.0, -1)
        made = []
        for onset, farthest, end in trips if len(trips) <= MOST else ():
            others = [j for _, j, _ in trips if j != farthest]
            least = {j: min(far[j], far[farthest]) for j in others}
            like = [
                j
                for j in others
                if least[j] >= LIKE_IT * max(far[j], far[farthest])
                and self.apart(max(farthest, j), min(farthest, j), present) <= LIKE_IT * least[j]
            ]
            mine = min(end, last) + 1 - max(onset, first)
            if first <= farthest <= last and 2 * mine > end + 1 - onset and like:
                made.append((max(onset, first), min(end, last)))
        return made

    def close_bout(self) -> None:
        """Repetitions that followed one another without a pause as long as a cycle."""
        if self.bout:
            self.bouts += 1
            (first, _), (_, last) = self.bout[0], self.bout[-1]
            self.tell("bout", first, last, self.activity, self.bouts, len(self.bout), self.cluster)
            self.bout = []

    def how(self) -> int:
        """The open activity's symmetry: that of most of its repetitions."""
        return max((1, 2, 3), key=lambda kind: self.kinds[kind]) if any(self.kinds[1:]) else 0

    # Clusters

    def fit(self, exemplar: Exemplar, first: int, last: int, whole: bool) -> tuple[float, int]:
        paths, best, m = Paths(exemplar.frames, first), (np.inf, first), len(exemplar.frames)
        for i in range(first, last + 1):
            mean = paths.advance(self.along(i, paths.frames), i, self.radius)
            if not whole or (i == last and paths.begin[-1] <= first + m // 8):
                best = (mean, paths.begin[-1]) if mean < best[0] else best
        return best

    def recognise(self, first: int, last: int, length: int) -> tuple[int, int]:
        best, found, met = self.radius, -1, first
        for slot, exemplar in enumerate(self.exemplars):
            if exemplar and 3 * len(exemplar.frames) <= 4 * length and 3 * length <= 4 * len(exemplar.frames):
                mean, start = self.fit(exemplar, first, last, False)
                if mean < best:
                    best, found, met = mean, slot, start
        return found, met

    def keep(self, first: int, length: int) -> int:
        kept = {slot: exemplar for slot, exemplar in enumerate(self.exemplars) if exemplar}
        if len(kept) == MAX_CLUSTERS:
            self.exemplars[min(kept, key=lambda k: kept[k].used)] = None
        slot = self.exemplars.index(None)
        frames = self.x[first : first + length].copy()
        self.exemplars[slot] = Exemplar(self.clusters, frames, travel=self.travel(first, first + length - 1, length))
        self.clusters += 1
        self.use(slot)
        return slot

    def symmetry(self, first: int, stop: int) -> tuple[int, int]:
        """How a cycle's mirror image fits: 1 at once, 2 half a cycle later, 3 not, 0 not known; at 2 also where the second step begins."""
        at_once = self.to_mirror(first, stop)
        if np.isnan(at_once):
            return 0, -1
        half = self.second_step(first, stop)
        exemplar = self.exemplars[self.slot]
        assert exemplar
        if half >= 0 and (exemplar.lead or self.to_other_step(first, half, stop) <= TRUSTS * self.radius):
            return 2, half
        return (1 if at_once <= self.radius else 3), -1

    def leader(self, first: int, half: int, stop: int) -> int:
        """1, if the first of each pair moves more in the first steps of the cluster's cycles so far than in the second ones; else 2."""
        exemplar = self.exemplars[self.slot]
        assert exemplar
        own, other = (np.diff(y[first:stop, self.firsts > 0], axis=0) ** 2 for y in (self.x, self.mirrored))
        more, cut = np.nansum(own - other, axis=1), half - first - 1
        exemplar.lead += float(more[:cut].sum() - more[cut:].sum())
        return 1 if exemplar.lead >= 0 else 2

    def second_step(self, first: int, stop: int) -> int:
        """From where on, in its middle third, a cycle is the mirror image of what it was until then; -1: it is not."""
        third = -(-(stop - first) // 3)
        far = {m: self.to_other_step(first, m, stop) for m in range(first + max(1, third), stop - third + 1)}
        half = min(far, key=lambda m: far[m], default=-1)
        return half if half >= 0 and far[half] < 0.6 * self.to_mirror(first, stop) else -1

    def to_mirror(self, first: int, stop: int) -> float:
        if self.mirrored is None:
            return np.nan
        return self.mean_apart(np.arange(first, stop), np.arange(first, stop))

    def to_other_step(self, first: int, middle: int, stop: int) -> float:
        c, n = np.arange((stop - first) // 2), (stop - first) // 2
        return self.mean_apart(first + c * (middle - first) // n, middle + c * (stop - middle) // n)

    def mean_apart(self, rows: Any, images: Any) -> float:
        """Mean distance of frames to the mirror images of others."""
        self.back = max(self.back, self.now - int(rows[0]))
        far = self.distances(self.x[rows] - self.mirrored[images], 0)
        return float(np.where(np.isinf(far), np.nan, far).mean())

    def use(self, slot: int) -> Exemplar:
        self.clock += 1
        found = self.exemplars[slot]
        assert found
        found.used = self.clock
        return found

    def alike(self, first: int, last: int) -> int:
        length = last - first + 1
        for k in range(MAX_CLUSTERS):
            other = (self.turn + k) % MAX_CLUSTERS
            exemplar = self.exemplars[other]
            if other == self.slot or exemplar is None or not length / 2 <= len(exemplar.frames) <= 2 * length:
                continue
            self.turn = other + 1
            return other if self.fit(exemplar, first, last, True)[0] <= self.radius else -1
        return -1
