"""Whether a bed is seen as it must be: a minute out of it held against a minute in it, of each who sleeps there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kinegraph.operators.bed.mattress import mattress, somebody
from kinegraph.operators.bed.region_fit import MIN_BLOCKS, MIN_INSIDE, Mask, Region, suggested, within
from kinegraph.stream.chunk import Samples

LEAST_MEASURED = 0.5
"""This much of the region must be measured; an epoch of which less is seen is unknown."""
NOISIER = 2.0
"""In an empty region noise grows this much only in another light."""


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
class BedFinding:
    """One thing that was looked at: what it is like, and what to do where it is not `well`."""

    well: bool
    text: str


def judge(
    out: Minute, stays: Mapping[str, Minute], regions: Mapping[str, Region], block: int, rise_mm: float, least: float
) -> list[BedFinding]:
    """What a minute out of bed and those in it say of the regions (row, column, rows, columns in blocks).

    stays    by sleeper: several get into bed one after the other, and stay
    regions  by sleeper; left out where the bed was not found
    block    pixels
    rise_mm  how far above the empty bed a body is; least: how much of a region it covers at least
    """
    minutes = [out, *stays.values()]
    if not all(minute.frames for minute in minutes):
        return [BedFinding(False, "no frames came: is the camera connected, and is nothing else using it?")]
    found = [_seen(minute.views, "in bed" if k else "out of bed") for k, minute in enumerate(minutes)]
    with np.errstate(invalid="ignore"):
        bodies = {
            name: before.depth() - stay.depth() > rise_mm
            for (name, stay), before in zip(stays.items(), minutes, strict=False)
        }
    raised: Mask = np.logical_or.reduce(list(bodies.values()))
    inside = within(list(regions.values()), raised.shape)
    hint = suggested(bodies, block)
    if not inside.any():
        found.append(BedFinding(False, f"no bed was found while it was empty; {hint}"))
        return [f for f in found if f]
    found.append(_measured(out, minutes[-1], inside))
    for name, region in regions.items():
        found.append(_empty(out.depth(), region, f" ({name})" if len(bodies) > 1 else "", rise_mm, least))
    for name, body in bodies.items():
        found.append(_held(body, regions[name], f" ({name})" if len(bodies) > 1 else "", hint, least))
    return [f for f in (*found, _light(out, minutes[-1], raised)) if f]


def _measured(out: Minute, inn: Minute, inside: Mask) -> BedFinding:
    """How much of the regions is measured, and how well."""
    measured = float((inn.count[inside] / inn.frames).mean())
    noise = float(np.nanmedian(out.noise()[inside])) if np.isfinite(out.noise()[inside]).any() else np.nan
    many = f"{measured:.0%} of the region is measured, and a block's noise is {noise:.1f} mm"
    if measured < LEAST_MEASURED:
        return BedFinding(False, f"only {many}: come nearer, or give it light")
    return BedFinding(True, many)


def _seen(views: list[str], when: str) -> BedFinding | None:
    if "dark" in views:
        return BedFinding(
            False, f"the camera sees nothing {when}: it needs a light of its own (`projector`), or a lit room"
        )
    if "moved" in views:
        return BedFinding(False, f"the camera was moved {when}: fix it, and check again")
    return None


def _empty(depth: Samples, region: Region, who: str, rise_mm: float, least: float) -> BedFinding | None:
    """Whether the bed that ought to be empty looks as if somebody lay in it."""
    row, column, rows, columns = region
    bed = depth[row : row + rows, column : column + columns]
    if not somebody(mattress(bed, rise_mm / 2) - bed, rise_mm, least):
        return None
    return BedFinding(
        False,
        f"somebody, or a heap as large, was on the bed while it should be empty{who}: a night that begins so is unknown until it moves",
    )


def _held(body: Mask, region: Region, who: str, hint: str, least: float) -> BedFinding:
    """Whether a sleeper's region holds that body."""
    whole = int(body.sum())
    if whole < MIN_BLOCKS:
        return BedFinding(
            False, f"no person was seen in bed{who}: does the camera see the whole bed, and did you lie down in time?"
        )
    row, column, rows, columns = region
    mine = body[row : row + rows, column : column + columns]
    held = float(mine.sum()) / whole
    if held < MIN_INSIDE:
        return BedFinding(
            False, f"the region holds {held:.0%} of who lies there{who}: it is too small, or elsewhere; {hint}"
        )
    covered = float(mine.mean())
    if covered < least:
        return BedFinding(
            False,
            f"who lies there covers {covered:.0%} of the region{who}, {least:.0%} is needed: it is too large; {hint}",
        )
    return BedFinding(True, f"the region holds {held:.0%} of who lies there{who}, who covers {covered:.0%} of it")


def _light(out: Minute, inn: Minute, raised: Mask) -> BedFinding | None:
    """Whether the empty part of the view gets noisier when the bed is occupied."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = (inn.noise() / out.noise())[~raised]
    usual = float(np.median(ratio[np.isfinite(ratio)])) if np.isfinite(ratio).any() else 1.0
    if 1 / NOISIER < usual < NOISIER:
        return BedFinding(True, "the light is the same in both minutes")
    return BedFinding(
        False,
        f"the noise of the empty part is {usual:.1f} times what it was: the light has changed; check in the light of the night",
    )
