"""State as plain arrays: a dataclass of arrays, numbers, texts, and lists or dataclasses of these, packed and unpacked by name."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from kinegraph.stream.chunk import Array
from kinegraph.stream.errors import KinegraphError


class StateError(KinegraphError):
    """A snapshot that does not belong to this state: made by another version, or with other parameters."""


def pack(state: Any) -> dict[str, Array]:
    """Copies of everything in `state`, named by its path: {"z": ..., "window.head": ...}. None packs as an empty array of bytes.

    Raises TypeError for what is no array of numbers, number or text.
    """
    packed: dict[str, Array] = {}
    if state is not None:
        for name, value in _entries(state):
            _pack(name, value, packed)
    return packed


def unpack(state: Any, arrays: dict[str, Array]) -> None:
    """Fill `state` in place with copies of what `pack` gave; arrays of the same shape keep their memory. Raises StateError."""
    if state is not None:
        for name, value in _entries(state):
            setattr(state, name, _unpack(name, value, _hint(type(state), name), arrays))


def _copied(array: Array) -> Array:
    """A copy; padding between the fields of structured elements, which holds whatever memory held, is zero in it."""
    names = array.dtype.names
    if names is None or array.dtype.itemsize == sum(array.dtype[name].itemsize for name in names):
        return array.copy()
    made = np.zeros(array.shape, array.dtype)
    for name in names:
        made[name] = array[name]
    return made


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
        packed[name] = _copied(value)
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
    if name in packed and packed[name].dtype.hasobject:
        raise TypeError(f"state field {name!r} holds what is not a plain number: {value!r:.60}")


def _unpack(name: str, old: Any, hint: Any, arrays: dict[str, Array]) -> Any:
    """The value called `name`. `old` stands there now; `hint` is its annotated type, for what has to be made again."""
    if f"{name}[]" in arrays:
        items = old if isinstance(old, list) else []
        hint = _item(hint)
        count = int(arrays[f"{name}[]"])
        return [_unpack(f"{name}[{i}]", items[i] if i < len(items) else None, hint, arrays) for i in range(count)]
    if name in arrays:
        return _leaf(old, arrays[name])
    made = old if is_dataclass(old) else _blank(hint)
    if made is None or not any(key.startswith(f"{name}.") for key in arrays):
        raise StateError(
            f"the snapshot has no {name!r}: it was made by another version, or with other parameters; start a new session"
        )
    for part in fields(made):
        value = _unpack(f"{name}.{part.name}", getattr(old, part.name, None), _hint(type(made), part.name), arrays)
        object.__setattr__(made, part.name, value)
    return made


def _leaf(old: Any, found: Array) -> Any:
    if isinstance(old, np.ndarray):
        if old.shape == found.shape and old.dtype == found.dtype and old.flags.writeable:
            old[...] = found
            return old
        return found.copy()
    if found.dtype == np.uint8 and found.shape == (0,):
        return None
    if found.ndim:
        return found.copy()
    return found[()] if isinstance(old, np.generic) else found.item()


@cache
def _hints(cls: Any) -> dict[str, Any]:
    return get_type_hints(cls)


def _hint(cls: Any, name: str) -> Any:
    """The annotated type of a field; None where it cannot be resolved at run time (a name imported for type checkers only)."""
    try:
        return _hints(cls).get(name)
    except NameError:
        return None


def _item(hint: Any) -> Any:
    """What a list of this type holds: `X` of `list[X]` or of `list[X] | None`."""
    for choice in (hint, *get_args(hint)):
        if get_origin(choice) is list:
            return get_args(choice)[0]
    return None


def _blank(hint: Any) -> Any:
    """An empty instance of the dataclass in a type; None for other types."""
    for choice in (hint, *get_args(hint)):
        if isinstance(choice, type) and is_dataclass(choice):
            return object.__new__(choice)
    return None
