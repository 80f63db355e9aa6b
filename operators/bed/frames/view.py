"""Whether the camera still looks where it looked: a jump of the whole picture, and darkness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.bed.frames.regions import block_of
from kinegraph.operators.bed.frames.registration import Fit, cost, registered
from kinegraph.operators.bed.frames.seconds import Seconds, add
from kinegraph.stream.chunk import NEVER, NS, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

VIEW = np.dtype([("onset", "<i8"), ("what", "U8"), ("down", "<f8"), ("right", "<f8")])
"""Since `onset` the view is `steady`, `moved` or `dark`; moved: by how many pixels the picture went down and right, NaN: unknown."""
RECENT = 5
"""Seconds of which the mean is held against the reference."""
CONFIRM, CONFIRM_PARTLY = 3, 10
"""Seconds in a row in which a jump must explain the change, and in which it must explain a quarter of it, or all must be another."""
ACCEPT_S = 60
"""A change that no jump explains is a change in the room: after this long it is what is there."""
FLICKER_MM = 100.0
"""A block that differs this much from the second before was not measured, or something moved there."""
LEAST_MM = 3.0
"""A mean change below this, or below `USUAL` times the usual, is ignored."""
USUAL = 3.0
SETTLED_S = 60
"""So long after a jump the view is steady again."""
SLOW = 0.05
REPLACED_MM, REPLACED_SHARE = 60.0, 0.6

Rows = list[tuple[int, tuple[int, str, float, float]]]


@dataclass(slots=True)
class ViewState:
    """
    seconds    the present second. newest (RECENT, rows, cols): the means of the newest ones, a ring; count: how many there were
    reference  (rows, cols)  what is there, as it was before; NaN: not known. settled: of how many seconds it is
    usual      how much the picture differs from the reference when nothing has happened (mm)
    changed    seconds since it has differed more. explained, partly, replaced: those in a row which a jump explains, or explains in
               part, or in which all is another
    since      when the present change was noticed first (ns)
    dark       whether it is; hidden: seconds in a row that disagree
    reported   whether anything was reported; jumped: whether the newest that was reported is a jump
    lost       how many samples are missing before the next emission
    """

    block: int
    seconds: Seconds
    newest: Samples
    count: int
    reference: Samples
    settled: int
    usual: float
    changed: int
    explained: int
    partly: int
    replaced: int
    since: int
    dark: bool
    hidden: int
    reported: bool
    jumped: bool
    lost: int


@dataclass(frozen=True, slots=True)
class View(Operator[ViewState]):
    """Mean depths of blocks in, an event at the first look and whenever the view becomes another one out.

    moved   the camera was: one shift of the picture (up to 3 blocks, to half a block) with one tilt explains at least half of what has
            changed against the room as it was, in 3 seconds in a row, or a quarter in 10 (somebody lay down or got up, too);
            or, by more than that, 60 % of the blocks have another depth for 10 s. People, blankets, furniture and lamps change a part of
            the picture, which no shift of the whole explains
    dark    for `dark_s` less than `min_seen` of the blocks was measured steadily: a camera without a light of its own, at night
    steady  the view at the beginning, after darkness, and a minute after a jump

    A jump is reported some 3 to 8 s after it; a change below a quarter of a block, or one that takes longer than a minute, is not noticed.

    >>> given, made = tried(View)
    >>> given["in"].shape, made["what"].tolist()
    ((360, 12, 16), ['steady', 'moved', 'dark', 'steady'])
    """

    dark_s: float = param(10.0, least=2.0, help="for how long next to nothing must be measured")
    min_seen: float = param(
        0.3, above=0.0, most=1.0, help="share of blocks that are measured steadily where it is light enough"
    )

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        block = block_of(spec, "in")
        rows, columns = spec.shape
        self.set_state(
            ViewState(
                block, Seconds.of(spec.shape), np.full((RECENT, rows, columns), np.nan), 0, np.full(spec.shape, np.nan), 0, 0.0,
                0, 0, 0, 0, NEVER, False, 0, False, False, 0,
            ),
            delay_s=1.0,
            decision_s={"out": max(self.dark_s, ACCEPT_S + 2.0) + 1.0},
        )  # fmt: skip
        return {"out": StreamSpec((), VIEW, units=("ns", "", "", ""), meta=dict(spec.meta))}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        emitted: list[tuple[str, Chunk]] = []
        made: Rows = []
        if chunk.lost:
            before = int(chunk.time[0]) - 1 if len(chunk.time) else chunk.until
            self._pass(before, made)
            emitted.append(("out", self._chunk(made, before)))
            made, s.lost = [], -1
        for i, time in enumerate(chunk.time.tolist()):
            self._pass(time - 1, made)
            # whole seconds of the clock, so that it does not matter when the session began
            if s.seconds.begin == NEVER:
                s.seconds.begin = time // NS * NS
            add(chunk.data[i], s.seconds.sums, s.seconds.counts)
        self._pass(chunk.until, made)
        return [*emitted, ("out", self._chunk(made, chunk.until))]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(31)
        room = np.full((12, 16), 2600.0)
        room[2:10, 4:12] = 2100.0
        room[0:2, 13:15] = 1800.0
        moved = np.roll(room, 1, axis=1) + np.linspace(-30, 30, 16)
        depth = np.where(np.arange(360)[:, None, None] < 180, room, moved) + random.normal(0, 1, (360, 12, 16))
        depth[280:320] = np.nan
        meta = {"simplified": {"block": 8, "components": 1}}
        inputs = {"in": (StreamSpec((12, 16), rate_hz=4.0, units=("mm",), meta=meta), grid(4.0, 360), depth)}
        return [Case(cls(dark_s=4.0), inputs, least=4), Case(cls(dark_s=2.0, min_seen=0.5), inputs, least=4)]

    def _pass(self, until: int, made: Rows) -> None:
        """Look at the second that is over by `until`."""
        s = self.state
        if s.seconds.begin == NEVER or until < s.seconds.begin + NS - 1:
            return
        end = s.seconds.begin + NS
        s.seconds.end(2 * NS)
        mean, before = s.seconds.mean, s.newest[(s.count - 1) % RECENT]
        with np.errstate(invalid="ignore"):
            held = np.isfinite(mean) & ((np.abs(mean - before) < FLICKER_MM) | (s.count == 0))
        self._light(float(held.mean()), end, made)
        s.newest[s.count % RECENT] = only_finite(mean)
        s.count += 1
        if not s.reported and not s.dark:
            self._report("steady", end - NS, end, made)
        if not s.dark and s.hidden == 0 and s.count >= RECENT:
            self._compare(_mean(s.newest), end, made)

    def _light(self, share: float, end: int, made: Rows) -> None:
        """Whether it is dark."""
        s = self.state
        says = share < self.min_seen if not s.dark else share < min(1.0, 1.5 * self.min_seen)
        s.hidden = s.hidden + 1 if says != s.dark else 0
        if s.hidden >= self.dark_s:
            s.dark = not s.dark
            onset, s.hidden = end - s.hidden * NS, 0
            self._report("dark" if s.dark else "steady", onset, end, made)
            s.changed = s.explained = s.partly = s.replaced = 0
            s.count = RECENT if s.dark else 0
            s.newest[:] = np.nan

    def _compare(self, recent: Samples, end: int, made: Rows) -> None:
        """Hold the newest seconds against the room as it was."""
        s = self.state
        if not s.settled:
            s.reference[:], s.settled = recent, 1
            return
        s.settled += 1
        if s.settled == SETTLED_S and s.jumped:
            s.jumped = False
            self._report("steady", end - NS, end, made)
        differs = cost(recent - s.reference)
        if not differs > max(LEAST_MM, USUAL * s.usual):
            fresh = ~np.isfinite(s.reference)
            s.reference[:] = np.where(
                fresh, recent, s.reference + SLOW * np.where(np.isfinite(recent), recent - s.reference, 0.0)
            )
            s.usual += SLOW * (differs - s.usual) if differs == differs else 0.0
            s.changed = s.explained = s.partly = s.replaced = 0
            return
        if not s.changed:
            s.since = end - 2 * NS
        s.changed += 1
        fit = registered(recent, s.reference)
        s.explained = s.explained + 1 if fit.explains else 0
        s.partly = s.partly + 1 if fit.explains_partly else 0
        with np.errstate(invalid="ignore"):
            other = float((np.abs(recent - s.reference) > REPLACED_MM).sum() / max(1, int(np.isfinite(recent).sum())))
        s.replaced = s.replaced + 1 if other >= REPLACED_SHARE else 0
        if s.explained >= CONFIRM or max(s.partly, s.replaced) >= CONFIRM_PARTLY:
            self._moved(fit, end, made)
        elif s.changed >= ACCEPT_S:
            s.reference[:], s.changed, s.explained, s.partly, s.replaced = recent, 0, 0, 0, 0

    def _moved(self, fit: Fit, end: int, made: Rows) -> None:
        s = self.state
        known = s.explained >= CONFIRM or s.partly >= CONFIRM_PARTLY
        down, right = (fit.down * s.block, fit.right * s.block) if known else (math.nan, math.nan)
        self._report("moved", s.since, end, made, down, right)
        s.settled, s.count, s.jumped = 0, 0, True
        s.newest[:] = np.nan
        s.changed = s.explained = s.partly = s.replaced = 0

    def _report(
        self, what: str, onset: int, end: int, made: Rows, down: float = math.nan, right: float = math.nan
    ) -> None:
        self.state.reported = True
        made.append((end - 1, (onset, what, down, right)))

    def _chunk(self, made: Rows, until: int) -> Chunk:
        s = self.state
        lost, s.lost = s.lost, 0
        return Chunk(np.array([t for t, _ in made], np.int64), np.array([row for _, row in made], VIEW), until, lost)


def check_view(specs: Specs) -> None:
    """Raises where `view` is connected to something else."""
    if "view" in specs and specs["view"].dtype != VIEW:
        raise InputError("view", specs["view"].describe(), "the output of operators.bed.frames.view.View")


def _mean(seconds: Samples) -> Samples:
    """The mean of what was measured; NaN where nothing was."""
    seen: NDArray[Any] = np.isfinite(seconds)
    with np.errstate(invalid="ignore"):
        mean: Samples = np.where(seen, seconds, 0.0).sum(axis=0) / seen.sum(axis=0)
    return mean
