"""Foot contacts before the start: whether each side's are found while somebody walks, and where not, why and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.operators.contacts.acceleration import AccelerationContacts
from kinegraph.operators.contacts.force import ForceContacts, SwitchContacts
from kinegraph.operators.contacts.inertial import RADIANS, InertialContacts
from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.operators.inputs.marker_columns import METRES, marker_columns
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, Times

MIN_CONTACTS = 4
UNEVEN, MAX_UNEVEN_SHARE = 1.6, 0.2
"""A stride is uneven if it is longer or shorter than the median by this factor; a larger share of them is a fault."""
STANCE_PCT = (20.0, 85.0)
"""Of a stride; running is at the lower end, shuffling at the upper one."""
TOGETHER = 0.15
"""Part of a stride within which both feet must not touch down, if they are two feet that walk."""
MIN_TURN_RAD_S, MIN_SHAKE, MIN_PATH_M, MAX_MISSING = 1.0, 0.05, 0.1, 0.5
"""A walking foot turns faster, shakes by a larger part of its mean acceleration, and gets further; a marker is seen more often."""


@dataclass(frozen=True, slots=True)
class FootFinding:
    """What was found of one foot: `flag` good, doubtful or bad; what is wrong and what to do, or how it steps.

    stride_s, stance_pct   medians; 0 where there are too few contacts
    """

    name: str
    count: int
    stride_s: float
    stance_pct: float
    flag: str
    reason: str
    advice: str = ""


@dataclass(frozen=True, slots=True)
class FootInput:
    """What a foot's contacts are found in: the detector of this foot, and its input's samples (n, ...)."""

    node: str
    detector: Any
    spec: StreamSpec
    data: Samples


def judge_foot(name: str, touchdowns: Times, liftoffs: Times, end_ns: int, given: FootInput | None) -> FootFinding:
    """Judge one foot by the onsets of its contacts, until the end of the walk; `given` explains why there are none."""
    downs = np.sort(touchdowns)
    if not len(downs):
        reason, advice = why_no_contact(given)
        return FootFinding(name, 0, 0.0, 0.0, "bad", reason, advice)
    if len(downs) < MIN_CONTACTS:
        many = "contact" if len(downs) == 1 else "contacts"
        return FootFinding(
            name, len(downs), 0.0, 0.0, "doubtful", f"only {len(downs)} {many}", "walk on steadily, and check again"
        )
    strides = np.diff(downs) / NS
    stride = float(np.median(strides))
    ups = np.sort(liftoffs)
    at = np.searchsorted(ups, downs[:-1])
    known = at < len(ups)
    stances = (ups[at[known]] - downs[:-1][known]) / NS / strides[known]
    stance = 100 * float(np.median(stances[stances < 1])) if (stances < 1).any() else 0.0
    uneven = (strides > UNEVEN * stride) | (strides < stride / UNEVEN)
    found = (name, len(downs), stride, stance)
    if (end_ns - downs[-1]) / NS > 2 * UNEVEN * stride:
        late = (end_ns - downs[-1]) / NS
        return FootFinding(*found, "doubtful", f"no contact in the last {late:.0f} s", "walk until the check has ended")
    if uneven.mean() > MAX_UNEVEN_SHARE:
        reason = f"uneven strides, from {strides.min():.1f} to {strides.max():.1f} s"
        return FootFinding(*found, "doubtful", reason, "contacts are missed or counted twice: " + MOUNT)
    if not stance:
        return FootFinding(*found, "doubtful", "no lift-offs", "stance is not known; " + MOUNT)
    if not STANCE_PCT[0] <= stance <= STANCE_PCT[1]:
        return FootFinding(*found, "doubtful", f"on the ground for {stance:.0f} % of a stride", MOUNT)
    return FootFinding(*found, "good", f"{len(downs)} contacts, a stride in {stride:.2f} s, stance {stance:.0f} %")


MOUNT = "look whether the sensor sits firmly on this foot, and whether its channels are the right ones"


def together(feet: Sequence[FootFinding], touchdowns: Sequence[Times]) -> list[FootFinding]:
    """The findings; where both feet of a pair touch down at once, both are doubtful."""
    if len(feet) != 2 or any(foot.flag != "good" for foot in feet):
        return [*feet]
    one, two = touchdowns
    apart = np.array([np.abs(two - t).min() / NS for t in one])
    if np.median(apart) > TOGETHER * feet[0].stride_s:
        return [*feet]
    reason, advice = "both feet touch down at once", "look whether both sides read the same sensor or channel"
    return [FootFinding(f.name, f.count, f.stride_s, f.stance_pct, "doubtful", reason, advice) for f in feet]


def why_no_contact(given: FootInput | None) -> tuple[str, str]:
    """Why no contact was found, and what to do."""
    if given is None:
        return "no contact came", "look whether the device that sends contacts is on, and walk"
    if not len(given.data):
        return (
            f"nothing came from {given.node}",
            "look whether the sensor is on, charged and near, and whether its address is right",
        )
    with np.errstate(all="ignore"):
        reason, advice = _by_detector(given)
    return (reason, advice) if reason else ("no step found in its signal", f"walk as in the session; {MOUNT}")


def _by_detector(given: FootInput) -> tuple[str, str]:
    part, spec, x = given.detector, given.spec, np.asarray(given.data, np.float64)
    if isinstance(part, MarkerContacts):
        return _marker(part, spec, x)
    flat = x.reshape(len(x), -1)
    if isinstance(part, ForceContacts | SwitchContacts):
        return _load(part, spec, flat)
    if isinstance(part, InertialContacts):
        names = part.angular_velocity or [n for n, u in _units(spec) if u in RADIANS]
        radians = RADIANS.get(part.unit or dict(_units(spec)).get(names[0], ""), 1.0)
        speed = radians * np.linalg.norm(_columns(spec, flat, names), axis=1)
        fastest = _high(speed)
        if not fastest >= MIN_TURN_RAD_S:
            return f"the sensor hardly turns: {np.degrees(fastest):.0f}°/s at most", SITS
    if isinstance(part, AccelerationContacts):
        names = part.acceleration or [n for n, u in _units(spec) if u in ("m/s2", "g", "mg")]
        size = np.linalg.norm(_columns(spec, flat, names), axis=1)
        if not _high(np.abs(size - np.nanmedian(size))) >= MIN_SHAKE * np.nanmedian(size):
            return "the sensor hardly moves", SITS
    return "", ""


SITS = "look whether this is the sensor on the foot that steps, and whether it sits firmly; then walk"


def _load(part: ForceContacts | SwitchContacts, spec: StreamSpec, flat: Array) -> tuple[str, str]:
    """Of a plate or a switch: whether its load changes by as much as a step makes it change."""
    force = isinstance(part, ForceContacts)
    left_out = part.other if isinstance(part, ForceContacts) else ()
    names = part.channels or tuple(n for n in spec.channels if n not in left_out)
    picked = _columns(spec, flat, names)
    load = picked.sum(axis=1) if force else picked.min(axis=1) if part.inverted else picked.max(axis=1)
    if not np.isfinite(load).any():
        return "its channel has no values", "look whether its cable is plugged in"
    low, high = np.nanquantile(load, [0.01, 0.99])
    unit = dict(_units(spec)).get(names[0], "") if names else ""
    if isinstance(part, ForceContacts):
        level = part.threshold_n / (1000.0 if unit == "kN" else 1.0)
        if high - low < level:
            return (
                f"the force changes by {high - low:.3g} {unit} only; a step begins at {level:g}",
                "look whether this side's plate is on and its channel is the right one; then walk on it",
            )
    elif high < part.threshold or low > part.threshold:
        stays = f"{'below' if high < part.threshold else 'above'} {part.threshold:g} {unit}".rstrip()
        return (
            f"the switch stays {stays}: {low:.3g} to {high:.3g}",
            "look whether the switch is under this foot and its channel is the right one; or change the threshold",
        )
    return "", ""


def _marker(part: MarkerContacts, spec: StreamSpec, x: Array) -> tuple[str, str]:
    flat = x.reshape(len(x), -1)
    for name in filter(None, (part.marker, part.reference)):
        place = flat[:, list(marker_columns(spec, name, "marker"))]
        missing = 1 - (np.isfinite(place).all(axis=1) & (place != 0).any(axis=1)).mean()
        if missing > MAX_MISSING:
            return (
                f"marker {name} is missing in {100 * missing:.0f} % of the frames",
                "look whether the marker is there, labelled, and seen by the cameras",
            )
    place = flat[:, list(marker_columns(spec, part.marker, "marker"))]
    metres = METRES.get(part.unit or spec.units[0], 1.0)
    path = metres * float(np.linalg.norm(np.nanquantile(place, 0.99, axis=0) - np.nanquantile(place, 0.01, axis=0)))
    if not path >= MIN_PATH_M:
        return (
            f"marker {part.marker} moves by {100 * path:.0f} cm only",
            "walk, and look whether it has the right label",
        )
    return "", ""


def _units(spec: StreamSpec) -> list[tuple[str, str]]:
    units = spec.units * len(spec.channels) if len(spec.units) == 1 else spec.units
    return [*zip(spec.channels, units, strict=False)]


def _columns(spec: StreamSpec, flat: Array, names: Sequence[str]) -> Array:
    return np.asarray(flat[:, [spec.channels.index(n) for n in names]] if names and spec.channels else flat)


def _high(values: Array) -> float:
    return float(np.nanquantile(values, 0.95)) if np.isfinite(values).any() else 0.0
