"""Rotations as numbers: which channels of a stream are unit quaternions, and the same rotation with a sign that does not leap.

q and -q are the same rotation. So a mean, a filter or an interpolation of quaternions channel by channel is wrong wherever the sign
changes: `rotation_free` refuses them, and `continuous` takes out the changes where a stream enters.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array, StreamSpec
from kinegraph.stream.errors import InputError

META = "rotations"
"""In a spec's `meta`: the first channel of each quaternion, or of the only one; [] where channels that look so are none."""
ORDERS = ("wxyz", "xyzw", "0123", "1234")


def rotations(spec: StreamSpec) -> tuple[int, ...]:
    """Where in the last axis of a sample quaternions begin: as declared, or by channels named alike but for w, x, y, z.

    >>> rotations(StreamSpec((7,), channels=("x", "y", "z", "qw", "qx", "qy", "qz")))
    (3,)
    """
    if spec.is_event or spec.dtype.kind != "f" or not spec.shape or spec.shape[-1] < 4:
        return ()
    if META in spec.meta:
        declared = spec.meta[META]
        starts = declared if isinstance(declared, list) else [declared]
        return tuple(at for at in starts if isinstance(at, int) and 0 <= at <= spec.shape[-1] - 4)
    if len(spec.shape) != 1 or len(spec.channels) != spec.shape[0]:
        return ()
    return tuple(at for at in range(len(spec.channels) - 3) if _named_so(spec.channels[at : at + 4]))


def _named_so(names: tuple[str, ...]) -> bool:
    """Whether four channels have the names of one quaternion: qw qx qy qz, Quat_X .. Quat_W, w x y z, q0 .. q3."""
    stems, ends = {name[:-1].lower() for name in names}, "".join(name[-1:] for name in names).lower()
    if len(stems) != 1 or ends not in ORDERS:
        return False
    (stem,) = stems
    return not ends.isdigit() or stem.rstrip("_. ").endswith(("q", "quat", "quaternion"))


def with_rotations(meta: dict[str, Any], *starts: int) -> dict[str, Any]:
    """`meta` that declares quaternions from these channels on."""
    return {**meta, META: list(starts)}


def rotation_free(spec: StreamSpec, port: str = "in") -> None:
    """For operators that treat channels as plain numbers. Raises InputError where some are quaternions."""
    starts = rotations(spec)
    if not starts:
        return
    names = ", ".join(spec.channels[starts[0] : starts[0] + 4]) or f"channels {starts[0]} to {starts[0] + 3}"
    raise InputError(
        port, f"{spec.describe()}, of which {names} are a rotation (a quaternion)",
        "plain numbers: q and -q are one rotation, so that its numbers cannot be filtered or averaged; choose other channels (Select)",
    )  # fmt: skip


class RotationSigns:
    """One stream's quaternions, each of the sign that is nearer to the one before it. Samples that are not numbers keep their sign."""

    __slots__ = ("_last", "_starts")

    def __init__(self, starts: tuple[int, ...]) -> None:
        self._starts = starts
        self._last: dict[int, Array] = {}

    def of(self, data: Array) -> Array:
        """Samples (n, ..., k): themselves where no sign leaps, else a copy."""
        made = data
        for start in self._starts if len(data) else ():
            part = made[..., start : start + 4]
            last = self._last.get(start, part[0])
            signs = _signs(part, last)
            if (signs < 0).any():
                made = made.copy() if made is data else made
                made[..., start : start + 4] *= signs[..., None].astype(data.dtype)
            good: Array = np.asarray(np.isfinite(made[..., start : start + 4]).all(axis=-1))
            if good.all():
                self._last[start] = made[-1, ..., start : start + 4].copy()
            else:
                self._last[start] = _newest(made[..., start : start + 4], good, last)
        return made


def _signs(part: Array, last: Array) -> Array:
    """1 or -1 for each quaternion (n, ..., 4), so that none is turned away from the one before."""
    before = np.concatenate([last[None], part[:-1]])
    with np.errstate(invalid="ignore"):
        if not np.isfinite(part).all():
            return _signs_with_holes(part, last)
        turned = np.where(np.einsum("...k,...k->...", part, before) < 0, -1.0, 1.0)
    return np.cumprod(turned, axis=0)


def _signs_with_holes(part: Array, last: Array) -> Array:
    signs = np.ones(part.shape[:-1])
    before = np.nan_to_num(last)
    for i in range(len(part)):
        good = np.isfinite(part[i]).all(axis=-1)
        dot = np.einsum("...k,...k->...", np.nan_to_num(part[i]), before)
        signs[i] = np.where(good & (dot < 0), -1.0, 1.0)
        before = np.where(good[..., None], np.nan_to_num(part[i]) * signs[i][..., None], before)
    return signs


def _newest(part: Array, good: Array, last: Array) -> Array:
    made = last.copy()
    for i in range(len(part)):
        made = np.where(good[i][..., None], part[i], made)
    return made
