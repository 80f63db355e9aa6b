"""State as plain arrays: a dataclass of arrays, numbers, texts, and lists or dataclasses of these, packed and unpacked by name."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from stream.chunk import Array


def pack(state: Any) -> dict[str, Array]:
    """Copies of everything in `state`, named by its path: {"z": ..., "window.head": ...}. None packs as an empty array of bytes."""
    packed: dict[str, Array] = {}
    if state is not None:
        for name, value in _entries(state):
            _pack(name, value, packed)
    return packed


def unpack(state: Any, arrays: dict[str, Array]) -> None:
    """Fill `state` in place with what `pack` gave; arrays of the same shape keep their memory."""
    if state is None:
        return
    for name, value in _entries(state):
        setattr(state, name, _unpack(name, value, arrays))


def size_of(state: Any) -> int:
    """Bytes held by the arrays in `state`."""
    return sum(a.nbytes for a in pack(state).values())


def _entries(state: Any) -> list[tuple[str, Any]]:
    if not is_dataclass(state):
        raise TypeError(f"a state is a dataclass of arrays, numbers and texts, not {type(state).__name__}")
    return [(f.name, getattr(state, f.name)) for f in fields(state)]


def _pack(name: str, value: Any, packed: dict[str, Array]) -> None:
    if value is None:
        packed[name] = np.empty(0, np.uint8)
    elif isinstance(value, np.ndarray):
        packed[name] = value.copy()
    elif isinstance(value, list):
        packed[f"{name}[]"] = np.array(len(value))
        for i, item in enumerate(value):
            _pack(f"{name}[{i}]", item, packed)
    elif is_dataclass(value):
        for part, item in _entries(value):
            _pack(f"{name}.{part}", item, packed)
    elif isinstance(value, bool | int | float | str | np.generic):
        packed[name] = np.array(value)
    else:
        raise TypeError(f"state field {name!r} holds a {type(value).__name__}, which cannot be packed into arrays")


def _unpack(name: str, old: Any, arrays: dict[str, Array]) -> Any:
    if f"{name}[]" in arrays:
        return [_unpack(f"{name}[{i}]", None, arrays) for i in range(int(arrays[f"{name}[]"]))]
    if is_dataclass(old):
        for part, item in _entries(old):
            setattr(old, part, _unpack(f"{name}.{part}", item, arrays))
        return old
    found = arrays[name]
    if isinstance(old, np.ndarray):
        if old.shape == found.shape and old.dtype == found.dtype:
            old[...] = found
            return old
        return found.copy()
    if found.dtype == np.uint8 and found.shape == (0,):
        return None
    return found.copy() if found.ndim else found.item()
