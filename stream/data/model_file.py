"""Models on disk: what was learned offline, as plain arrays with a JSON header. Loading one runs no code.

A model is a .npz archive. The entry `header` holds JSON in UTF-8; every other entry is one array of numbers. The header names the kind of
model, the format's version, when and from what it was made, and the spec of the stream that the model takes; an operator refuses a model
of another kind, or one that was trained on another stream.
"""

from __future__ import annotations

import json
import math
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array, StreamSpec
from kinegraph.stream.data import bounded
from kinegraph.stream.errors import InputError, KinegraphError, nearest
from kinegraph.stream.system.atomic_file import complete
from kinegraph.stream.system.file_permissions import refuse_shared

VERSION = 1
NUMBERS = "biufc"


class ModelError(KinegraphError):
    """A file that is no model, or not the model that is needed."""


@dataclass(frozen=True, slots=True)
class Model:
    """What was learned.

    kind     what it is for, e.g. "pose"
    header   whatever else its makers state: numbers, texts, and lists and mappings of these
    arrays   by name
    path     where it was read from, for messages
    """

    kind: str
    header: Mapping[str, Any]
    arrays: Mapping[str, Array]
    path: Path = field(default_factory=Path)

    def array(self, name: str, shape: Sequence[int | None], dtype: Any = np.float64) -> Array:
        """An array of this shape (None: any length), C-contiguous, as `dtype`. Raises ModelError."""
        if name not in self.arrays:
            raise ModelError(f"{self.path}: the model has no array {name!r}; {nearest(name, self.arrays)}")
        found = self.arrays[name]
        if len(found.shape) != len(shape) or any(n not in (None, m) for n, m in zip(shape, found.shape, strict=True)):
            wanted = ", ".join("any" if n is None else str(n) for n in shape)
            raise ModelError(f"{self.path}: array {name!r} has the shape {found.shape}; it must be ({wanted})")
        if found.dtype.kind == "f" and not np.isfinite(found).all():
            raise ModelError(f"{self.path}: array {name!r} holds numbers that are not finite")
        return np.ascontiguousarray(found, dtype)

    def check_input(self, port: str, spec: StreamSpec) -> None:
        """Raise InputError unless `spec` is of the kind that the model was trained on: shape, channels, units, and rate within 2 %."""
        trained_on = self.header.get("input")
        if not isinstance(trained_on, dict):
            raise ModelError(f"{self.path}: the header does not say what stream the model takes")
        mine = describe_input(spec)
        for name in ("shape", "channels", "units"):
            if trained_on.get(name) != mine[name]:
                raise InputError(
                    port, f"{name} {mine[name]}", f"{name} {trained_on.get(name)}, as {self.path} was trained on"
                )
        rate, trained = mine["rate_hz"], trained_on.get("rate_hz")
        if trained and (not rate or abs(rate - trained) > 0.02 * trained):
            raise InputError(
                port, f"{rate or 'no fixed'} Hz", f"{trained:g} Hz within 2 %, as {self.path} was trained on"
            )


def describe_input(spec: StreamSpec) -> dict[str, Any]:
    """What a header says of the stream that a model takes (`input`)."""
    return {
        "shape": list(spec.shape),
        "channels": list(spec.channels),
        "units": list(spec.units),
        "rate_hz": spec.rate_hz,
    }


def write_model(
    path: Path, kind: str, header: Mapping[str, Any], arrays: Mapping[str, Array], *, compressed: bool = True
) -> None:
    """Write a model; it appears when it is complete. Raises OSError, and TypeError for what is no plain array of numbers."""
    for name, array in arrays.items():
        if np.asarray(array).dtype.kind not in NUMBERS or name == "header":
            raise TypeError(f"array {name!r} of a model must hold numbers, not {np.asarray(array).dtype}")
    made = datetime.now(UTC).isoformat(timespec="seconds")
    text = json.dumps({"kinegraph": "model", "version": VERSION, "kind": kind, "made": made, **header}, allow_nan=False)
    with complete(path) as draft, draft.open("wb") as file:
        entries: dict[str, Any] = {"header": np.frombuffer(text.encode(), np.uint8), **arrays}
        (np.savez_compressed if compressed else np.savez)(file, **entries)


def read_model(path: Path, kind: str, maker: str = "") -> Model:
    """Read a model of this kind, from a place that other users cannot write; `maker` is the command, if not `motion train KIND`.

    Raises ModelError.
    """
    _refuse_planted(path)
    try:
        arrays = bounded.arrays(path)
    except FileNotFoundError:
        raise ModelError(
            f"{path}: there is no such file; make a model with kinegraph {maker or f'motion train {kind}'}"
        ) from None
    except (OSError, *bounded.DAMAGE) as error:
        raise ModelError(f"{path}: not a model that can be read ({error or type(error).__name__})") from None
    header = _header(path, arrays.pop("header", None))
    if header.get("kind") != kind:
        raise ModelError(f"{path}: a model of kind {header.get('kind')!r}; here one of kind {kind!r} is needed")
    if header.get("version") != VERSION:
        raise ModelError(
            f"{path}: version {header.get('version')} of the format; this kinegraph reads {VERSION}: train it again"
        )
    for name, array in arrays.items():
        if array.dtype.kind not in NUMBERS:
            raise ModelError(f"{path}: array {name!r} does not hold numbers")
    return Model(kind, header, arrays, path)


def _refuse_planted(path: Path) -> None:
    """A model decides what a session reports about people: refuse one that other users could have written."""
    for place in (path.absolute().parent, path):
        try:
            if place.exists() and not (place.is_dir() and place.stat().st_mode & stat.S_ISVTX):
                refuse_shared(place, "a model", "results follow from what it holds")
        except KinegraphError as error:
            raise ModelError(str(error)) from None


def _header(path: Path, entry: Array | None) -> dict[str, Any]:
    try:
        if entry is None or entry.dtype != np.uint8 or entry.ndim != 1:
            raise ValueError("no header")
        header = json.loads(entry.tobytes().decode(), parse_constant=_finite, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise ModelError(f"{path}: not a kinegraph model ({error})") from None
    if not isinstance(header, dict) or header.get("kinegraph") != "model":
        raise ModelError(f"{path}: not a kinegraph model")
    return header


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"its header holds {text}, which is not a valid number")
    return value
