"""Samples to try an operator on: as its case gives them, repeated, or with gaps, pauses and bad values put in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from kinegraph.stream.chunk import NS, Array, StreamSpec, Times, add_lost
from kinegraph.stream.operator import Case

Draw: TypeAlias = Callable[[int, int], int]
"""Where chance comes from: a whole number between two bounds, both included; the lower one is the simpler choice."""


@dataclass(frozen=True, slots=True)
class CaseSamples:
    """All samples of one input.

    time  (n,) int64, data (n, *shape); lost (n,) int64: how many samples are missing just before each (-1: an unknown number)
    """

    spec: StreamSpec
    time: Times
    data: Array
    lost: Times

    def __len__(self) -> int:
        return len(self.time)

    def keep(self, chosen: Array | slice) -> CaseSamples:
        return replace(self, time=self.time[chosen], data=self.data[chosen], lost=self.lost[chosen])

    @property
    def is_float(self) -> bool:
        return bool(np.issubdtype(self.spec.dtype, np.floating))

    def columns(self) -> Array:
        """The samples as (n, numbers per sample), sharing memory."""
        return self.data.reshape(len(self), -1)


Tapes: TypeAlias = dict[str, CaseSamples]
"""By port, in port order."""


def tapes_of(case: Case) -> Tapes:
    """A case's samples, as contiguous arrays of the types that their specs name."""
    tapes = {}
    for port, (spec, time, data) in case.inputs.items():
        stamps = np.ascontiguousarray(time, np.int64)
        tapes[port] = CaseSamples(spec, stamps, np.ascontiguousarray(data, spec.dtype), np.zeros(len(stamps), np.int64))
    return tapes


def span(tapes: Tapes) -> tuple[int, int]:
    """The first and the last stamp of all."""
    full = [t for t in tapes.values() if len(t)]
    return min(int(t.time[0]) for t in full), max(int(t.time[-1]) for t in full)


def repeat(tapes: Tapes, times: int) -> Tapes:
    """The same samples again and again, each time with later stamps.

    A regular stream that ends before another one is marked as lacking samples where it starts again.
    """
    first, _ = span(tapes)
    shift = max(int(t.time[-1]) - first + (t.spec.period_ns or 1_000_000) for t in tapes.values() if len(t))
    again = {}
    for port, tape in tapes.items():
        parts = [_later(tape, first, k * shift) for k in range(times)]
        if len(tape) and (missing := _missing(tape, shift)):
            for part in parts[1:]:
                part.lost[0] = add_lost(int(part.lost[0]), missing)
        again[port] = CaseSamples(
            tape.spec, *(np.concatenate([getattr(p, name) for p in parts]) for name in ("time", "data", "lost"))
        )
    return again


def _missing(tape: CaseSamples, shift: int) -> int:
    """How many samples lack between a regular stream's last and its first, `shift` later; -1: a broken number of them."""
    if not tape.spec.period_ns:
        return 0
    periods = (int(tape.time[0]) + shift - int(tape.time[-1])) * (tape.spec.rate_hz or 0.0) / NS
    return round(periods) - 1 if abs(periods - round(periods)) < 1e-3 else -1


def _later(tape: CaseSamples, since: int, shift: int) -> CaseSamples:
    """Every time at or after `since`, be it a stamp or an event's field in ns, `shift` later."""
    data = tape.data.copy()
    for name in tape.spec.dtype.names or ():
        if tape.spec.unit_of(name) == "ns":
            data[name][data[name] >= since] += shift
    time = tape.time.copy()
    time[time >= since] += shift
    return replace(tape, time=time, data=data, lost=tape.lost.copy())


def pause(tapes: Tapes, at: int, shift: int, *, known: bool = False, marked: bool = False) -> Tapes:
    """Shift everything from `at` on by `shift` ns. Regular streams mark the missing samples there; `marked`: all streams do.

    known   they say how many, where that is a whole number
    """
    later = {}
    for port, tape in tapes.items():
        moved = _later(tape, at, shift)
        k = int(tape.time.searchsorted(at))
        if 0 < k < len(tape) and (marked or tape.spec.period_ns):
            lost = tape.lost.copy()
            count = shift * (tape.spec.rate_hz or 0.0) / NS
            missing = round(count) if known and abs(count - round(count)) < 1e-3 and round(count) else -1
            lost[k] = add_lost(int(lost[k]), missing)
            moved = replace(moved, lost=lost)
        later[port] = moved
    return later


def drop(tapes: Tapes, port: str, start: int, count: int, *, known: bool) -> Tapes:
    """`count` samples of one port are missing."""
    tape = tapes[port]
    lost = tape.lost.copy()
    if start + count < len(tape):
        missing = count if known else -1
        for k in range(start, start + count + 1):
            missing = add_lost(missing, int(lost[k]))
        lost[start + count] = missing
    chosen = np.r_[0:start, start + count : len(tape)]
    return {**tapes, port: replace(tape, lost=lost).keep(chosen)}


def spoil(tapes: Tapes, port: str, rows: slice, column: int | None, value: float) -> Tapes:
    """Some samples of one column (None: of all columns) are NaN or infinite."""
    tape = replace(tapes[port], data=tapes[port].data.copy())
    tape.columns()[rows, slice(None) if column is None else column] = value
    return {**tapes, port: tape}


def with_faults(draw: Draw, tapes: Tapes, limit_s: float) -> tuple[Tapes, list[str]]:
    """Up to two gaps, pauses or silences, and up to two bad stretches; with a line on each. `limit_s`: what a long gap exceeds."""
    rows: list[str] = []
    for _ in range(draw(0, 2)):
        full = [port for port, tape in tapes.items() if len(tape) > 1]
        if full:
            tapes = _gap(draw, tapes, full[draw(0, len(full) - 1)], limit_s, rows)
    for _ in range(draw(0, 2)):
        floats = [port for port, tape in tapes.items() if tape.is_float and len(tape)]
        if floats:
            tapes = _bad(draw, tapes, floats[draw(0, len(floats) - 1)], rows)
    return tapes, rows


def _gap(draw: Draw, tapes: Tapes, port: str, limit_s: float, lines: list[str]) -> Tapes:
    tape, kind, known = tapes[port], draw(0, 2), bool(draw(0, 1))
    at = draw(0, len(tape) - 1)
    if kind == 0:
        count = draw(1, min(5, len(tape) - at))
        lines.append(f"{count} samples of '{port}' missing from sample {at} on (marked: {count if known else -1})")
        return drop(tapes, port, at, count, known=known)
    period = tape.spec.period_ns or 1_000_000
    longest = max(1, int(limit_s * NS / period))
    periods = draw(1, min(longest, 50)) if kind == 1 else 3 * longest + draw(0, 1000)
    lines.append(f"{periods * period / NS:g} s of silence on all inputs before sample {at} of '{port}'")
    return pause(tapes, int(tape.time[at]), periods * period, known=known)


def _bad(draw: Draw, tapes: Tapes, port: str, lines: list[str]) -> Tapes:
    tape, value = tapes[port], (np.nan, np.inf, -np.inf)[draw(0, 2)]
    start = draw(0, len(tape) - 1)
    stop = start + draw(1, min(40, len(tape) - start))
    width = tape.columns().shape[1]
    column = draw(0, width)
    lines.append(
        f"{value} in samples {start}..{stop - 1} of '{port}', {'all numbers' if column == width else f'number {column}'}"
    )
    return spoil(tapes, port, slice(start, stop), None if column == width else column, value)
