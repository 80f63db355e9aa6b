"""Finds the bed as the plateau above the floor, or takes regions set by hand, and shares it among the sleepers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import structlog

from kinegraph.operators.bed.bed_plateau import BedLimits, bed_in
from kinegraph.operators.bed.frames.regions import REGION, block_of, region_spec
from kinegraph.operators.bed.frames.view import VIEW, check_view
from kinegraph.stream.chunk import NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

WIDE = 1.5
"""Only in a bed that looks this many times wider than long do sleepers lie along the picture's rows."""

Regions: TypeAlias = list[tuple[int, str, int, int, int, int, bool]]

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class BedState:
    """
    block         pixels
    sums, counts  (rows, columns)  mean depths of blocks since `begun` (ns), and how many
    emitted       whether the regions were emitted; tries: number of failed searches
    shift         (2,) how far the picture has gone down and to the right since the regions were set (pixels); NaN: unknown
    """

    block: int
    sums: Samples
    counts: Times
    begun: int
    emitted: bool
    tries: int
    shift: Samples


@dataclass(frozen=True, slots=True)
class BedRegion(Operator[BedState]):
    """Mean depths of blocks in, one event per sleeper out: the rectangle of pixels where that sleeper lies.

    With `regions` they are reported with the first sample. Without, the bed is looked for in the mean of `learn_s`: the largest level
    surface from `lowest_mm` to `highest_mm` above the floor, if it covers `min_share` of the frame and half of its own rectangle; less
    a block at sides of more than 20, for blocks that hold the bed's edge tremble with the pixels that happen to be measured. The camera
    may be tilted by up to 60 degrees from looking straight down, and must see some floor. Several sleepers share the bed side by side,
    in the order of their names from the left; from the top, where it looks half as wide again as it is long, for then the camera hangs
    beside it. Until a bed is found, it keeps searching; after four attempts it reports regions without rows.

    When the camera was moved (`view`, of operators.bed.frames.view.View), a region without rows says that it is not known. One that was
    found
    is looked for again; one that was set goes with the picture, as far as the frame reaches, if the jump could be measured. If not, it
    stays unknown, and has to be set again.

    >>> given, made = tried(BedRegion)
    >>> made[["sleeper", "row", "column", "rows", "columns"]][0].item()
    ('sleeper', 16, 8, 40, 40)
    """

    inputs = {"view": Input(optional=True), "in": Input(trigger=True)}

    sleepers: tuple[str, ...] = param(("sleeper",), help="the sleepers' names")
    regions: tuple[tuple[int, int, int, int], ...] = param(
        (), least=0, help="per sleeper: first row, first column, rows, columns, in pixels; left out: found"
    )
    learn_s: float = param(30.0, above=0.0, help="how long to observe before searching for the bed")
    lowest_mm: float = param(200.0, above=0.0, help="how high above the floor a bed is at least")
    highest_mm: float = param(1200.0, above=0.0, help="and, with the sleeper in it, at most")
    min_share: float = param(0.08, above=0.0, most=1.0, help="how much of the frame it covers at least")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        block = block_of(spec, "in")
        check_view(specs)
        names = self.sleepers
        if not names or len(set(names)) < len(names) or any(not 0 < len(name) <= 16 for name in names):
            raise ParameterError("sleepers", list(names), "different names of at most 16 letters, at least one")
        if self.regions and len(self.regions) != len(names):
            raise ParameterError("regions", list(self.regions), f"one for each of {', '.join(names)}")
        height, width = (side * block for side in spec.shape)
        for row, column, rows, columns in self.regions:
            if not (rows and columns and row + rows <= height and column + columns <= width):
                raise ParameterError("regions", list(self.regions), f"within {height} rows and {width} columns")
        state = BedState(block, np.zeros(spec.shape), np.zeros(spec.shape, np.int64), NEVER, False, 0, np.zeros(2))
        self.set_state(state, decision_s={"out": 0.0})
        meta = {key: value for key, value in spec.meta.items() if key != "sleepers"}
        return {"out": region_spec(names, meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        made: Regions = []
        if port == "view":
            for stamp, event in zip(chunk.time.tolist(), chunk.data, strict=True):
                if event["what"] == "moved":
                    made += self._moved(stamp, float(event["down"]), float(event["right"]))
        elif len(chunk.time) and not s.emitted:
            if self.regions:
                s.emitted = True
                made = self._set(int(chunk.time[0]))
            else:
                made = self._look(chunk)
        out = np.array(made, REGION)
        return Chunk(out["onset"].copy(), out, chunk.until, chunk.lost if port == "in" else 0)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(14)
        depth = np.full((12, 16), 2600.0)
        depth[1:11, 4:12] = 2100.0
        frames = depth + random.normal(0, 1, (90, 12, 16))
        frames[random.random(frames.shape) < 0.05] = np.nan
        meta = {"simplified": {"block": 8, "components": 2}}
        inputs = {"in": (StreamSpec((12, 16), rate_hz=30.0, units=("mm",), meta=meta), grid(30.0, 90), frames)}
        view = np.array([(10**9, "moved", 8.0, -16.0), (2 * 10**9, "steady", np.nan, np.nan)], VIEW)
        moved = {"view": (StreamSpec((), VIEW), view["onset"].copy(), view), **inputs}
        return [
            Case(cls(regions=((8, 24, 40, 40),)), moved, least=2),
            Case(cls(("left", "right"), learn_s=1.0), inputs, least=2),
            Case(cls(regions=((0, 0, 40, 40),)), inputs, least=1),
        ]

    def _moved(self, stamp: int, down: float, right: float) -> Regions:
        """The regions after the picture jumped; closed where the shift is unknown."""
        s = self.state
        s.sums[:], s.counts[:], s.begun = 0.0, 0, NEVER
        s.shift += down, right
        gone: Regions = [(stamp, name, 0, 0, 0, 0, False) for name in self.sleepers]
        if not self.regions:
            s.emitted = False
            return gone
        if np.isnan(s.shift).any():
            log.warning("the camera was moved too far to follow: `regions` hold no more; set them again")
            return gone
        return self._set(stamp)

    def _set(self, stamp: int) -> Regions:
        """The regions that were set, where the picture is now."""
        s = self.state
        made: Regions = []
        height, width = (side * s.block for side in s.sums.shape)
        down, right = (round(v) for v in s.shift.tolist())
        for name, (row, column, rows, columns) in zip(self.sleepers, self.regions, strict=True):
            top, left = min(max(0, row + down), height), min(max(0, column + right), width)
            bottom, end = min(max(0, row + down + rows), height), min(max(0, column + right + columns), width)
            there = bottom > top and end > left
            made.append((stamp, name, top, left, bottom - top if there else 0, end - left if there else 0, False))
        return made

    def _look(self, chunk: Chunk) -> Regions:
        s = self.state
        for i, time in enumerate(chunk.time.tolist()):
            s.begun = time if s.begun == NEVER else s.begun
            finite = np.isfinite(chunk.data[i])
            s.sums[finite] += chunk.data[i][finite]
            s.counts += finite
            if time - s.begun < self.learn_s * NS:
                continue
            with np.errstate(invalid="ignore"):
                depth = s.sums / s.counts
            found = bed_in(depth, BedLimits(self.lowest_mm, self.highest_mm, self.min_share))
            s.sums[:], s.counts[:], s.begun = 0.0, 0, NEVER
            if found is not None:
                s.emitted = True
                parts = _shared(found, len(self.sleepers))
                return [
                    (time, name, *(side * s.block for side in part), True)
                    for name, part in zip(self.sleepers, parts, strict=True)
                ]
            s.tries += 1
            if s.tries in (4, 20, 100):  # not at once: the warm-up shows it frames without a bed
                log.warning("no bed is found in the frames; set `regions`", tries=s.tries)
            if s.tries == 4:
                return [(time, name, 0, 0, 0, 0, True) for name in self.sleepers]
        return []


def _shared(bed: tuple[int, int, int, int], count: int) -> list[tuple[int, int, int, int]]:
    """Equal parts side by side: a camera at the foot of the bed sees sleepers lie along the columns, one beside it along the rows."""
    row, column, rows, columns = bed
    if columns < WIDE * rows:
        cuts = [column + columns * k // count for k in range(count + 1)]
        return [(row, a, rows, b - a) for a, b in pairwise(cuts)]
    cuts = [row + rows * k // count for k in range(count + 1)]
    return [(a, column, b - a, columns) for a, b in pairwise(cuts)]
