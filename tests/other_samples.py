"""The samples of a case, changed in ways that bring an operator to its limits: what golden answers (`tests/golden.py`) are asked on.

Everything here is made from the samples of `cases` and the operator's parameters; nothing is drawn, and no operator is known by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stream.chunk import NS, Array
from stream.conformance.case_samples import CaseSamples, Tapes, repeat, span
from stream.operator import Operator

MANY_BYTES = 4_000_000
"""What is more than this is not tried three times in a row."""
COARSE_NS = 10_000_000
"""Irregular stamps and times of events are rounded to this, so that they are just so far apart as limits allow."""
LEANS, ELSEWHERE = Rotation.from_rotvec([0.2, 0.7, -0.13]), np.array([0.31, 0.12, -0.23])
HOLES = 4
"""Limits in seconds, the first ones of an operator, that gaps are made just as long as."""


def otherwise(tapes: Tapes, operator: Operator[Any]) -> Iterator[tuple[str, Tapes]]:
    """Other samples, with a name for each; but those that are the same as the case's."""
    for name, other in _all(tapes, operator):
        if not _same(tapes, other):
            yield name, other


def _all(tapes: Tapes, operator: Operator[Any]) -> Iterator[tuple[str, Tapes]]:
    for name, change in (*DATA.items(), *MORE_DATA.items()):
        yield name, with_data(tapes, change)
    if sum(tape.data.nbytes for tape in tapes.values()) < MANY_BYTES:
        yield "again", repeat(tapes, 3)
    yield "leaning", _leaning(tapes)
    if limits := limits_of(operator):
        yield "limits", with_data(tapes, lambda x: _at(x, limits))
    for name, change_event in EVENTS.items():
        yield name, _with_events(tapes, change_event)
    yield "staged", {port: _staged(tape) for port, tape in tapes.items()}
    yield "first-channels", _some_channels(tapes, slice(None, -2))
    yield "last-channels", _some_channels(tapes, slice(2, None))
    yield "fewer-channels", _some_channels(tapes, slice(None, None, 2))
    yield "upper-channels", _some_channels(tapes, slice(None, 7))
    yield "slower", _stretched(tapes, 2, 1)
    yield "faster", _stretched(tapes, 1, 2)
    yield "coarse", _coarse(tapes)
    yield "holes", _with_holes(tapes, operator)
    if len(tapes) > 1:
        for port in tapes:
            yield f"without-{port}", {**tapes, port: tapes[port].keep(slice(0, 0))}
            yield f"late-{port}", _late(tapes, port)


def _same(tapes: Tapes, other: Tapes) -> bool:
    return all(
        tapes[port].spec == tape.spec
        and tapes[port].time.tobytes() == tape.time.tobytes()
        and tapes[port].data.tobytes() == tape.data.tobytes()
        for port, tape in other.items()
    )


def with_data(tapes: Tapes, other: Callable[[Array], Array]) -> Tapes:
    """The same stamps, with other numbers in what is not an event."""
    return {
        port: tape
        if tape.spec.is_event or not len(tape)
        else replace(tape, data=np.ascontiguousarray(other(tape.data).astype(tape.data.dtype)))
        for port, tape in tapes.items()
    }


def rounded_off(data: Array, part: float = 0.5) -> Array:
    """To one or two digits, so that numbers are often equal to each other and to thresholds."""
    size = _size(data)
    step = part * 10.0 ** np.floor(np.log10(size)) if 0.0 < size < np.inf else 1.0
    return np.asarray(np.round(data / step) * step)


def _size(data: Array) -> float:
    return float(np.nanstd(data.astype(np.float64)))


def _rows(data: Array) -> Array:
    """A weight a sample can be multiplied by, from 0 at the first to 1 at the last."""
    return np.linspace(0.0, 1.0, len(data)).reshape(-1, *(1,) * (data.ndim - 1))


def _holed(data: Array) -> Array:
    """Runs of NaN, of 1, 2, 3, ... samples, with as many between them, later from column to column; zeros, in whole numbers."""
    flat = data.reshape(len(data), -1).copy()
    width = max(1, int(np.sqrt(len(flat))))
    bad = np.concatenate([np.repeat([False, True], k) for k in range(1, width + 1)] + [np.zeros(len(flat), bool)])
    for column in range(flat.shape[1]):
        here = np.roll(bad[: len(flat)], 5 * column)
        flat[here, column] = np.nan if flat.dtype.kind == "f" else 0
    return flat.reshape(data.shape)


def _column_gone(data: Array) -> Array:
    """The first number of each sample is NaN throughout."""
    flat = data.reshape(len(data), -1).copy()
    flat[:, :1] = np.nan if flat.dtype.kind == "f" else 0
    return flat.reshape(data.shape)


def _uneven(data: Array) -> Array:
    """Each column by a factor of its own."""
    flat = data.reshape(len(data), -1)
    return np.asarray(flat * (0.3 + 0.35 * (np.arange(flat.shape[1]) % 5))).reshape(data.shape)


def _pieces(data: Array) -> Array:
    """Twelve pieces in another order."""
    parts = np.array_split(data, 12)
    return np.concatenate([parts[(5 * k) % 12] for k in range(12)])


def _hops(data: Array) -> Array:
    """Every eighth of the samples at another level."""
    level = np.array([0.0, 3.0, -1.0, 0.5, 8.0, 0.0, -4.0, 1.0])[np.arange(len(data)) * 8 // max(1, len(data))]
    return np.asarray(data + _size(data) * level.reshape(-1, *(1,) * (data.ndim - 1)))


DATA: dict[str, Callable[[Array], Array]] = {
    "rounded": rounded_off,
    "steps": lambda x: np.repeat(x[::3], 3, axis=0)[: len(x)],
    "still": lambda x: np.repeat(x[:1], len(x), axis=0),
    "none": np.zeros_like,
    "small": lambda x: x * 0.1,
    "large": lambda x: x * 5,
    "back": lambda x: x[::-1],
}
MORE_DATA: dict[str, Callable[[Array], Array]] = {
    "finer": lambda x: rounded_off(x, 0.1),
    "turned": lambda x: -x if x.dtype.kind == "f" else x.max() - x,
    "swelling": lambda x: x * (3.0 * _rows(x)),
    "shrinking": lambda x: x * (2.0 - 1.95 * _rows(x)),
    "holed": _holed,
    "column-gone": _column_gone,
    "uneven": _uneven,
    "pieces": _pieces,
    "hops": _hops,
}


def limits_of(operator: Operator[Any]) -> list[float]:
    """The numbers that an operator's parameters say, where they may be limits of what is measured."""
    values = (getattr(operator, f.name) for f in fields(operator) if not f.name.endswith(("_s", "_hz")))  # type: ignore[arg-type]
    return [float(v) for v in values if isinstance(v, int | float) and not isinstance(v, bool) and np.isfinite(v)]


def _at(data: Array, limits: list[float]) -> Array:
    """Just what the parameters say, in every third sample."""
    other = data.copy()
    wanted = np.array(limits)[np.arange(len(other[::3])) // 3 % len(limits)]
    other[::3] = np.broadcast_to(wanted.reshape(-1, *(1,) * (data.ndim - 1)), other[::3].shape)
    return other


def _some_channels(tapes: Tapes, kept: slice) -> Tapes:
    """Only these of the named channels, where at least two are left."""
    return {port: _channels_of(tape, kept) for port, tape in tapes.items()}


def _channels_of(tape: CaseSamples, kept: slice) -> CaseSamples:
    spec, axis = tape.spec, tape.spec.channel_axis
    if spec.is_event or len(spec.channels[kept]) < 2 or len(spec.channels) != spec.shape[axis]:
        return tape
    data = tape.data.reshape(len(tape), *spec.shape)[(slice(None),) * (axis + 1) + (kept,)]
    shape = data.shape[1:]
    units = spec.units if len(spec.units) == 1 else spec.units[kept]
    flat = data if tape.data.ndim == 1 + len(shape) else data.reshape(len(tape), -1)
    made = spec.derive(shape=shape, channels=spec.channels[kept], units=units)
    return replace(tape, spec=made, data=np.ascontiguousarray(flat))


def _each(*kinds: str) -> Callable[[CaseSamples], list[str]]:
    return lambda tape: [n for n in tape.spec.dtype.names or () if tape.spec.dtype[n].base.kind in kinds]


def _mixed(tape: CaseSamples) -> CaseSamples:
    """What is no time goes to the next event."""
    data = tape.data.copy()
    for name in tape.spec.dtype.names or ():
        if tape.spec.unit_of(name) != "ns":
            data[name] = np.roll(data[name], 1, axis=0)
    return replace(tape, data=data)


def _numbers(change: Callable[[Array], Array]) -> Callable[[CaseSamples], CaseSamples]:
    def changed(tape: CaseSamples) -> CaseSamples:
        data = tape.data.copy()
        for name in _each("f")(tape):
            data[name] = change(data[name])
        return replace(tape, data=data)

    return changed


def _shorter(tape: CaseSamples) -> CaseSamples:
    """Everything lasts half as long."""
    data = tape.data.copy()
    if {"onset", "end"} <= {*(tape.spec.dtype.names or ())}:
        data["onset"] += (data["end"] - data["onset"]) // 2
    return replace(tape, data=data)


def _every_fifth_bad(values: Array) -> Array:
    other = values.copy()
    other[2::5] = np.nan
    return other


EVENTS: dict[str, Callable[[CaseSamples], CaseSamples]] = {
    "events-fewer": lambda tape: tape.keep(np.arange(len(tape)) % 3 != 1),
    "events-mixed": _mixed,
    "events-larger": _numbers(lambda x: x * 1.5),
    "events-rounded": _numbers(rounded_off),
    "events-holed": _numbers(_every_fifth_bad),
    "events-shorter": _shorter,
}


def _with_events(tapes: Tapes, change: Callable[[CaseSamples], CaseSamples]) -> Tapes:
    return {port: change(tape) if tape.spec.is_event and len(tape) else tape for port, tape in tapes.items()}


def _staged(tape: CaseSamples) -> CaseSamples:
    """Numbered cycles in stages of a walk: half of them slow, then fast, the last eighth in no stage."""
    names = {*(tape.spec.dtype.names or ())}
    if not {"onset", "end", "number"} <= names or "stage" in names or not len(tape):
        return tape
    data = np.zeros(len(tape), np.dtype([*tape.spec.dtype.descr, ("stage", "<U32"), ("speed_m_s", "<f8")]))
    for name in names:
        data[name] = tape.data[name]
    stage = np.searchsorted([0.5, 0.875], np.arange(len(tape)) / len(tape), side="right")
    data["stage"], data["speed_m_s"] = np.array(["slow", "fast", ""])[stage], np.array([1.0, 1.5, np.nan])[stage]
    units = tuple(tape.spec.unit_of(name) for name in tape.spec.channels)
    return replace(tape, spec=tape.spec.derive(dtype=data.dtype, channels=(), units=(*units, "", "m/s")), data=data)


def _leaning(tapes: Tapes) -> Tapes:
    """Places and poses in space, turned about an axis that is askew, and elsewhere."""
    return {port: _turned_about(tape) for port, tape in tapes.items()}


def _turned_about(tape: CaseSamples) -> CaseSamples:
    shape, data = tape.spec.shape, tape.data
    if tape.spec.is_event or not tape.is_float or not len(data):
        return tape
    if len(shape) == 2 and shape[1] == 3:
        turned = data.reshape(len(data), *shape) @ LEANS.as_matrix().T + ELSEWHERE
        return replace(tape, data=turned.reshape(data.shape).astype(data.dtype))
    if "skeleton" in tape.spec.meta and len(shape) == 1 and shape[0] % 4 == 3:
        made = data.copy()
        made[:, :3] = data[:, :3] @ LEANS.as_matrix().T + ELSEWHERE
        w, v, a, u = LEANS.as_quat()[3], LEANS.as_quat()[:3], data[:, 3:4], data[:, 4:7]
        made[:, 3:4] = w * a - u @ v[:, None]
        made[:, 4:7] = w * u + a * v + np.cross(v, u)
        return replace(tape, data=made)
    return tape


def _retimed(tape: CaseSamples, when: Callable[[Array], Array], first: int) -> CaseSamples:
    """Other times, of stamps and of what events say in ns from `first` on."""
    data = tape.data.copy()
    for name in tape.spec.dtype.names or ():
        if tape.spec.unit_of(name) == "ns":
            data[name] = np.where(data[name] >= first, when(data[name]), data[name])
    return replace(tape, time=when(tape.time), data=data)


def _stretched(tapes: Tapes, times: int, over: int) -> Tapes:
    """Everything takes `times` / `over` as long, at another rate."""
    first, _ = span(tapes)
    other = {port: _retimed(tape, lambda t: first + (t - first) * times // over, first) for port, tape in tapes.items()}
    return {
        port: replace(tape, spec=tape.spec.derive(rate_hz=tape.spec.rate_hz * over / times))
        if tape.spec.rate_hz
        else tape
        for port, tape in other.items()
    }


def _coarse(tapes: Tapes) -> Tapes:
    """Irregular stamps, and the times of events, in whole hundredths of a second after the first."""
    first, _ = span(tapes)

    def when(t: Array) -> Array:
        return first + (t - first + COARSE_NS // 2) // COARSE_NS * COARSE_NS

    return {port: tape if tape.spec.rate_hz else _retimed(tape, when, first) for port, tape in tapes.items()}


def _late(tapes: Tapes, port: str) -> Tapes:
    """One input is a thirtieth of the whole behind the others."""
    first, last = span(tapes)
    shift = (last - first) // 30 or NS
    if period := tapes[port].spec.period_ns:
        shift = max(1, shift // period) * period
    return {**tapes, port: _retimed(tapes[port], lambda t: t + shift, first)}


def _with_holes(tapes: Tapes, operator: Operator[Any]) -> Tapes:
    """Gaps just as long as each of the limits that parameters give in seconds, a sample less, and a sample more."""
    limits = [getattr(operator, f.name) for f in fields(operator) if f.name.endswith("_s")]  # type: ignore[arg-type]
    spans = [round(v * NS) for v in limits if isinstance(v, int | float) and np.isfinite(v) and v > 0][:HOLES]
    return {
        port: _holed_in_time(tape, spans) if tape.spec.rate_hz and not tape.spec.is_event else tape
        for port, tape in tapes.items()
    }


def _holed_in_time(tape: CaseSamples, spans: list[int]) -> CaseSamples:
    period = tape.spec.period_ns
    lengths = [n + more for n in (round(span / period) for span in spans) for more in (0, 1, -1) if n + more > 1]
    keep, lost = np.ones(len(tape), bool), tape.lost.copy()
    for k, n in enumerate(lengths):
        at = (k + 1) * len(tape) // (len(lengths) + 1)
        if at + n < (k + 2) * len(tape) // (len(lengths) + 1):
            keep[at + 1 : at + n] = False
            lost[at + n] = n - 1
    return replace(tape, lost=lost).keep(keep)
