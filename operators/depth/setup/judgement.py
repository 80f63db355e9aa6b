"""Whether a bed is seen as it must be: a minute out of it held against a minute in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stream.chunk import Samples

LEAST_MEASURED = 0.5
"""So much of the region must be measured; an epoch of which less is seen is unknown."""
LEAST_INSIDE = 0.75
"""So much of who lies in bed must be within the regions."""
NOISIER = 2.0
"""Where nobody lies noise grows so much only in another light."""
LEAST_BLOCKS = 4

Region = tuple[int, int, int, int]
Mask = NDArray[np.bool_]


@dataclass(slots=True)
class Minute:
    """Mean depths of blocks over a while: how many, their sum (rows, columns), their successive differences' squares, and frames.

    Half the mean square of successive differences is the noise's variance, whatever the depth does slowly.
    """

    count: Samples
    total: Samples
    squares: Samples
    pairs: Samples
    last: Samples
    frames: int = 0
    views: list[str] = field(default_factory=list)

    @staticmethod
    def of(shape: tuple[int, ...]) -> Minute:
        return Minute(np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape), np.full(shape, np.nan))

    def add(self, blocks: Samples) -> None:
        """One more frame (rows, columns); NaN: not measured."""
        seen, step = np.isfinite(blocks), blocks - self.last
        both = np.isfinite(step)
        self.count += seen
        self.total[seen] += blocks[seen]
        self.squares[both] += step[both] ** 2
        self.pairs += both
        self.last[:] = blocks
        self.frames += 1

    def depth(self) -> Samples:
        """(rows, columns), NaN where less than half of the frames were measured."""
        known = self.count >= max(1.0, 0.5 * self.frames)
        return np.where(known, self.total / np.maximum(self.count, 1.0), np.nan)

    def noise(self) -> Samples:
        """Standard deviation (rows, columns), mm; NaN: not known."""
        return np.where(self.pairs > 0, np.sqrt(self.squares / np.maximum(2 * self.pairs, 1.0)), np.nan)


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at: what it is like, and what to do where it is not `well`."""

    well: bool
    text: str


def judge(
    out: Minute, inn: Minute, regions: Sequence[Region], block: int, rise_mm: float, least: float
) -> list[Finding]:
    """What a minute out of bed and one in it say of these regions (row, column, rows, columns in blocks).

    block    pixels
    rise_mm  how far above the empty bed a body is; least: how much of a region it covers at least
    """
    if not out.frames or not inn.frames:
        return [Finding(False, "no frames came: is the camera connected, and is nothing else using it?")]
    found = [_seen(views, when) for views, when in ((out.views, "out of bed"), (inn.views, "in bed"))]
    inside: Mask = np.zeros(out.count.shape, np.bool_)
    for row, column, rows, columns in regions:
        inside[row : row + rows, column : column + columns] = True
    with np.errstate(invalid="ignore"):
        raised = out.depth() - inn.depth() > rise_mm
    if not inside.any():
        found.append(Finding(False, f"no bed was found while it was empty; {_suggested(raised, block)}"))
        return [f for f in found if f]
    measured = float((inn.count[inside] / inn.frames).mean())
    noise = float(np.nanmedian(out.noise()[inside])) if np.isfinite(out.noise()[inside]).any() else np.nan
    many = f"{measured:.0%} of the region is measured, and a block's noise is {noise:.1f} mm"
    found.append(
        Finding(
            measured >= LEAST_MEASURED,
            many if measured >= LEAST_MEASURED else f"only {many}: come nearer, or give it light",
        )
    )
    return [f for f in (*found, _held(raised, inside, regions, block, least), _light(out, inn, raised)) if f]


def _seen(views: list[str], when: str) -> Finding | None:
    if "dark" in views:
        return Finding(
            False, f"the camera sees nothing {when}: it needs a light of its own (`projector`), or a lit room"
        )
    if "moved" in views:
        return Finding(False, f"the camera was moved {when}: fix it, and check again")
    return None


def _held(raised: Mask, inside: Mask, regions: Sequence[Region], block: int, least: float) -> Finding:
    """Whether the regions hold who lies there."""
    whole, within = int(raised.sum()), int((raised & inside).sum())
    if whole < LEAST_BLOCKS:
        return Finding(
            False, "nobody was seen lying there: does the camera see the whole bed, and did you lie down in time?"
        )
    hint = _suggested(raised, block)
    if within < LEAST_INSIDE * whole:
        return Finding(
            False, f"the region holds {within / whole:.0%} of who lies there: it is too small, or elsewhere; {hint}"
        )
    shares = [float(raised[r : r + n, c : c + m].mean()) for r, c, n, m in regions]
    if max(shares) < least:
        return Finding(
            False,
            f"who lies there covers {max(shares):.0%} of the region, {least:.0%} is needed: it is too large; {hint}",
        )
    return Finding(True, f"the region holds {within / whole:.0%} of who lies there, who covers {max(shares):.0%} of it")


def _light(out: Minute, inn: Minute, raised: Mask) -> Finding | None:
    """Whether it is noisier while somebody lies there, where nobody lies."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = (inn.noise() / out.noise())[~raised]
    usual = float(np.median(ratio[np.isfinite(ratio)])) if np.isfinite(ratio).any() else 1.0
    if 1 / NOISIER < usual < NOISIER:
        return Finding(True, "the light is the same in both minutes")
    return Finding(
        False,
        f"the noise where nobody lies is {usual:.1f} times what it was: another light; check in the light of the night",
    )


def _suggested(raised: Mask, block: int) -> str:
    """The rectangle of what is raised, and a block around it, in pixels."""
    rows, columns = np.flatnonzero(raised.sum(axis=1) > 1), np.flatnonzero(raised.sum(axis=0) > 1)
    if not len(rows) or not len(columns):
        return "set it: regions: [[row, column, rows, columns]]"
    top, left = max(0, rows[0] - 1), max(0, columns[0] - 1)
    high, wide = min(raised.shape[0], rows[-1] + 2) - top, min(raised.shape[1], columns[-1] + 2) - left
    return f"try regions: [[{top * block}, {left * block}, {high * block}, {wide * block}]]"
