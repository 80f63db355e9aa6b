"""What the segmentation gives out: its events, and how they are made of the rows that the kernels write."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from kinegraph.operators.segmentation.kernels.final import SIDED, SYMMETRIC
from kinegraph.operators.segmentation.kernels.layout import (
    ACTIVITY_EVENT,
    BEGIN_EVENT,
    BELIEVED_EVENT,
    BOUT_EVENT,
    COUNT_EVENT,
    EVENT_WIDTH,
    MERGE_EVENT,
    PRIMITIVE_EVENT,
    RADIUS_EVENT,
    REST_EVENT,
    RESTING_EVENT,
)
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times

SPAN = [("onset", "<i8"), ("end", "<i8"), ("activity", "<i8")]
ACTIVITY = np.dtype(
    [
        *SPAN,
        ("repeats", "?"),
        ("cluster", "<i8"),
        ("repetitions", "<i4"),
        ("transition", "?"),
        ("forced", "?"),
        ("symmetry", "<i4"),
        ("certainty", "<f8"),
    ]
)
PRIMITIVE = np.dtype([*SPAN, ("repetition", "<i4"), ("cluster", "<i8"), ("forced", "?"), ("side", "<i4")])
BOUT = np.dtype([*SPAN, ("bout", "<i4"), ("repetitions", "<i4"), ("cluster", "<i8")])
BEGIN = np.dtype([("onset", "<i8"), ("activity", "<i8")])
COUNT = np.dtype([("activity", "<i8"), ("count", "<i4"), ("certainty", "<f8")])
MERGE = np.dtype([("cluster", "<i8"), ("into", "<i8")])
BELIEVED = np.dtype([*SPAN, ("repetition", "<i4")])
REST = np.dtype([("onset", "<i8"), ("end", "<i8")])
RESTING = np.dtype([("onset", "<i8")])
RADIUS = np.dtype([("radius", "<f8")])
OUTPUTS = {
    "activity": (ACTIVITY, ACTIVITY_EVENT),
    "primitive": (PRIMITIVE, PRIMITIVE_EVENT),
    "bout": (BOUT, BOUT_EVENT),
    "begin": (BEGIN, BEGIN_EVENT),
    "count": (COUNT, COUNT_EVENT),
    "merge": (MERGE, MERGE_EVENT),
    "provisional": (BELIEVED, BELIEVED_EVENT),
    "rest": (REST, REST_EVENT),
    "resting": (RESTING, RESTING_EVENT),
    "radius": (RADIUS, RADIUS_EVENT),
}
"""By the name of an output: its events, and their kind in the kernels' table."""
COLUMNS: dict[np.dtype[Any], tuple[str, ...]] = {
    ACTIVITY: ("onset", "end", "activity", "repetitions", "cluster"),
    PRIMITIVE: ("onset", "end", "activity", "repetition", "cluster"),
    BOUT: ("onset", "end", "activity", "bout", "repetitions", "cluster"),
    BEGIN: ("onset", "activity"),
    COUNT: ("activity", "count"),
    REST: ("onset", "end"),
    RESTING: ("onset",),
    MERGE: ("cluster", "into"),
    BELIEVED: ("onset", "end", "activity", "repetition"),
}
"""Which field each of the kernels' numbers is."""


def specs_of(spec: StreamSpec) -> Specs:
    """The specs of all outputs, for features of `spec`."""
    unit = spec.units[0] if len(set(spec.units)) == 1 else ""
    units = {"onset": "ns", "end": "ns", "radius": unit}
    return {
        name: StreamSpec((), dtype, units=tuple(units.get(field, "") for field in dtype.names or ()), meta=spec.meta)
        for name, (dtype, _) in OUTPUTS.items()
    }


def emitted(tables: Sequence[tuple[Times, Samples]], longest: int, until: int, lost: int) -> dict[str, Chunk]:
    """A chunk for each output, of the rows that the kernels wrote and their ratings. longest: ns, of a transition."""
    table = np.concatenate([t for t, _ in tables]) if tables else np.empty((0, EVENT_WIDTH), np.int64)
    ratings = np.concatenate([r for _, r in tables]) if tables else np.empty(0)
    chunks = {}
    for name, (dtype, kind) in OUTPUTS.items():
        mine = table[:, 0] == kind
        events = _events(dtype, table[mine, 2:], ratings[mine], longest)
        chunks[name] = Chunk(table[mine, 1].copy(), events, until, lost)
    return chunks


def _events(dtype: np.dtype[Any], table: Times, ratings: Samples, longest: int) -> Array:
    """The kernels' six numbers as events."""
    events: Array = np.zeros(len(table), dtype)
    if dtype == RADIUS:
        events["radius"] = ratings
        return events
    for field, column in zip(COLUMNS[dtype], table.T, strict=False):
        if field:
            events[field] = column
    if dtype == ACTIVITY:
        events["repeats"] = events["repetitions"] > 1
        events["transition"] = (table[:, 5] & 2 > 0) & (events["end"] - events["onset"] <= longest)
        events["symmetry"] = table[:, 5] // SYMMETRIC
        events["certainty"] = np.where(events["repeats"], ratings, 0.0)
    if dtype == COUNT:
        events["certainty"] = ratings
    if dtype == PRIMITIVE:
        events["side"] = table[:, 5] // SIDED
    if dtype in (ACTIVITY, PRIMITIVE):
        events["forced"] = table[:, 5] & 1
    return events
