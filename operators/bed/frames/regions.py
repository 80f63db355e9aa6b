"""Regions of a frame, one per sleeper: the events that tell them, and what every operator that watches them keeps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError

REGION = np.dtype(
    [
        ("onset", "<i8"),
        ("sleeper", "U16"),
        ("row", "<i8"),
        ("column", "<i8"),
        ("rows", "<i8"),
        ("columns", "<i8"),
        ("found", "?"),
    ]
)
"""From `onset` on a sleeper's region is this rectangle of pixels; `found` in the frames, or set."""


def region_spec(sleepers: tuple[str, ...], meta: Mapping[str, Any]) -> StreamSpec:
    """The spec of a stream of regions of these sleepers."""
    return StreamSpec((), REGION, units=("ns", "", "", "", "", "", ""), meta={**meta, "sleepers": list(sleepers)})


def sleepers_of(specs: Specs, port: str = "regions") -> tuple[str, ...]:
    """Names of the sleepers with regions on `port`."""
    spec = specs[port]
    if spec.dtype != REGION or not spec.meta.get("sleepers"):
        raise InputError(port, spec.describe(), "regions, as operators.bed.bed.BedRegion gives them")
    return tuple(spec.meta["sleepers"])


def block_of(spec: StreamSpec, port: str) -> int:
    """How many pixels a block is wide; the stream is one of mean depths by blocks."""
    block = spec.meta.get("simplified", {}).get("block")
    if len(spec.shape) != 2 or spec.dtype != np.dtype(np.float64) or not block:
        raise InputError(
            port, spec.describe(), "mean depths of blocks (operators.bed.frames.simplify.Simplify, output blocks)"
        )
    return int(block)


def take(events: Array, sleepers: tuple[str, ...], regions: Times, block: int = 1) -> None:
    """Write the newest regions into `regions` (k, 4), in blocks: those that a region touches."""
    for event in events:
        row, column, rows, columns = (int(event[name]) for name in ("row", "column", "rows", "columns"))
        top, left = row // block, column // block
        regions[sleepers.index(str(event["sleeper"]))] = (
            top, left, -(-(row + rows) // block) - top, -(-(column + columns) // block) - left,
        )  # fmt: skip
