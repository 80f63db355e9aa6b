"""An alarm: something is wrong with what is being recorded, and somebody can still do something about it."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from kinegraph.stream.chunk import Chunk, Specs, StreamSpec

ALARM = np.dtype([("onset", "<i8"), ("subject", "<U16"), ("state", "<U8"), ("what", "<U64"), ("advice", "<U120")])
"""What is wrong, with whom (a channel, "contacts"), since when, and what to do; `state` is "on", or "over" when it has passed."""
ALARM_UNITS = ("ns", "", "", "", "")
ON, OVER = "on", "over"

FoundAlarm: TypeAlias = tuple[int, tuple[int, str, str, str, str]]
FoundAlarms: TypeAlias = list[FoundAlarm]
"""Alarms with their stamps."""


def alarms_spec(meta: dict[str, Any]) -> Specs:
    """What an operator whose only output is alarms returns from `open`."""
    return {"out": StreamSpec((), ALARM, units=ALARM_UNITS, meta=meta)}


def alarm(stamp: int, onset: int, subject: str, what: str, advice: str = "") -> FoundAlarm:
    """An alarm with its stamp. Without advice it is over: while it lasts there is something to do."""
    return stamp, (onset, subject, ON if advice else OVER, what, advice)


def alarm_chunk(found: FoundAlarms, chunk: Chunk) -> Chunk:
    """The alarms that a chunk of an input has led to."""
    return alarms_until(found, chunk.until, lost=-1 if chunk.lost else 0)


def alarms_until(found: FoundAlarms, until: int, *, lost: int = 0) -> Chunk:
    """All alarms up to `until`; `lost`: what is missing before them."""
    stamps = np.array([stamp for stamp, _ in found], np.int64)
    return Chunk(stamps, np.array([row for _, row in found], ALARM), until, lost)
