"""Parameters: fields of a frozen dataclass with bounds, checked without coercion, described to editors by JSON Schema.

The unit stands in the name (`cutoff_hz`, `window_s`). Values come from YAML or from Python and are checked alike where they are given,
strictly (a text is no number, a number no switch); whatever is wrong is raised as a `ParameterError` that names the parameter, the value
and what would be accepted.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, Field, field, fields, is_dataclass
from functools import cache
from operator import ge, gt, le, lt
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

import numpy as np

from kinegraph.stream.errors import ParameterError, nearest
from kinegraph.stream.text.units import known_unit

if TYPE_CHECKING:
    from pydantic import TypeAdapter

T = TypeVar("T")


def param(
    default: Any = MISSING,
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    unit: bool = False,
    help: str = "",
) -> Any:
    """A parameter of an operator, source or outlet. Without a default it must be given (and stands before those that have one).

    `above`/`below` are exclusive bounds, `least`/`most` inclusive ones, of a number or of each number in a list; `unit`: the texts are
    units, of which a known one is refused in another spelling; `help` is one line, shown by editors and `kinegraph draw`.
    """
    bounds = {"above": above, "least": least, "below": below, "most": most, "unit": unit or None}
    metadata = {"description": help, **{name: bound for name, bound in bounds.items() if bound is not None}}
    return field(default=default, metadata={"kinegraph": metadata})


def build(cls: type[T], values: Mapping[str, Any]) -> T:
    """An instance of the dataclass `cls` with parameters from YAML; raises ParameterError for the first that is wrong."""
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    for name in values:
        if name not in known:
            raise UnknownParameter(name, nearest(name, known))
    for name, f in known.items():
        if name not in values and f.default is MISSING and f.default_factory is MISSING:
            raise MissingParameter(name, cls.__name__)
    return cls(**_checked(cls, values))


def check(part: Any) -> None:
    """Check the parameters of an instance, given in Python, as `build` checks those from YAML; raises the same ParameterErrors.

    What passes is kept as YAML would have given it: a whole number for a float becomes one, a list for a tuple a tuple, numpy's numbers
    plain ones. Fields of types that YAML cannot write (an array, a function) are left alone.
    """
    given = {f.name: getattr(part, f.name) for f in fields(part) if f.init}
    for name, value in _checked(type(part), given).items():
        if repr(value) != repr(given[name]):
            object.__setattr__(part, name, value)


def check_names(cls: Any, given: Iterable[str]) -> None:
    """Raise UnknownParameter for a name given in Python that is none, with the nearest: `__init__` would refuse it without a hint."""
    known = [f.name for f in vars(cls).get("__dataclass_fields__", {}).values() if f.init]
    for name in given if known else ():
        if name not in known:
            raise UnknownParameter(name, nearest(name, known))


def plain(value: Any) -> Any:
    """A parameter's value as YAML writes it: a tuple is a list, numpy's numbers and arrays are plain ones, a dataclass is a mapping.

    Raises TypeError for what YAML cannot write.
    """
    if value is None or value.__class__ in (bool, int, float, str):
        return value
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.generic | np.ndarray) and value.dtype.kind in "biufU":
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value) if f.init}
    if isinstance(value, PurePath):
        return str(value)
    raise TypeError(f"{type(value).__name__} cannot be written as YAML")


def _checked(cls: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """These parameters with the types that `cls` declares; raises ParameterError for the first that is wrong."""
    made = dict(values)
    hints = _hints(cls)
    for name, value in values.items():
        if _checkable(hints[name]):
            made[name] = _typed(name, value, hints[name])
    for f in fields(cls):
        if f.name in values and _checkable(hints[f.name]):
            written = plain(values[f.name])
            _check_bounds(f.name, written, _facts(f))
            _check_parts(f.name, written, made[f.name])
    return made


def _typed(name: str, value: Any, hint: Any) -> Any:
    """A parameter's value with its declared type; raises ParameterError."""
    from pydantic import ValidationError

    try:
        written = plain(value)
        text = json.dumps(written, allow_nan=False)
    except (TypeError, ValueError):
        accepts = "a finite number, a text, true or false, or a list of these"
        raise ParameterError(name, value, accepts) from None
    try:
        return adapter(hint).validate_json(text, strict=True)
    except ValidationError as error:
        raise _explain(name, written, error) from None


@cache
def _hints(cls: Any) -> dict[str, Any]:
    """The declared type of every field; Any where it is known to type checkers only."""
    try:
        return get_type_hints(cls)
    except NameError:
        return {f.name: Any for f in fields(cls)}


def _checkable(hint: Any) -> bool:
    """Whether a field of this type takes what YAML can write, and only that."""
    from pydantic import PydanticUserError

    if hint is Any:
        return False
    try:
        adapter(hint)
    except PydanticUserError:
        return False
    return True


def schema(cls: type[Any]) -> dict[str, Any]:
    """The JSON Schema of a dataclass's parameters, for editors."""
    made: dict[str, Any] = adapter(cls).json_schema()
    made.pop("title", None)
    for inner in made.get("$defs", {}).values():
        if "properties" in inner:
            inner.setdefault("additionalProperties", False)
    entries = made.get("properties", {})
    for f in fields(cls):
        entry, facts = entries[f.name], _facts(f)
        entry.pop("title", None)
        entry["description"] = facts.get("description", "")
        _add_bounds(entry, facts)
    return made


def help_of(cls: type[Any], name: str) -> str:
    """The line that explains a parameter, or ""."""
    return next((str(_facts(f).get("description", "")) for f in fields(cls) if f.name == name), "")


def adapter(hint: Any) -> TypeAdapter[Any]:
    """Pydantic's validator of a type, made once."""
    return _adapter(hint)


@cache
def _adapter(hint: Any) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(hint)


def _facts(f: Field[Any]) -> Mapping[str, Any]:
    """The arguments that `param` got for a field."""
    facts: Mapping[str, Any] = f.metadata.get("kinegraph", {})
    return facts


BOUNDS: dict[str, tuple[Callable[[float, float], bool], str, str]] = {
    "above": (gt, "above", "exclusiveMinimum"),
    "least": (ge, "at least", "minimum"),
    "below": (lt, "below", "exclusiveMaximum"),
    "most": (le, "at most", "maximum"),
}
"""By the name of a bound: when it holds, how it reads, and what JSON Schema calls it."""


def _check_bounds(name: str, value: Any, facts: Mapping[str, Any]) -> None:
    """Raise ParameterError if a number, or one in a list or mapping, is out of bounds."""
    if isinstance(value, tuple | list):
        for i, item in enumerate(value):
            _check_bounds(f"{name}[{i}]", item, facts)
    elif isinstance(value, dict):
        for key, item in value.items():
            _check_bounds(f"{name}.{key}", item, facts)
    elif isinstance(value, str) and "unit" in facts and (known := known_unit(value)):
        raise _within(name, ParameterError(name, value, f"a unit as it is written here; did you mean {known!r}?"))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        lines = [f"{text} {facts[bound]:g}" for bound, (_, text, _) in BOUNDS.items() if bound in facts]
        if not all(holds(value, facts[bound]) for bound, (holds, _, _) in BOUNDS.items() if bound in facts):
            raise _within(name, ParameterError(name, value, " and ".join(lines)))


def _check_parts(name: str, given: Any, made: Any) -> None:
    """Raise ParameterError if a mapping that has become a dataclass, at any depth, has an unknown name or a number out of its bounds."""
    if is_dataclass(made) and isinstance(given, dict):
        known = {f.name: f for f in fields(made)}
        for key, value in given.items():
            path = f"{name}.{key}"
            if key not in known:
                raise _within(path, UnknownParameter(path, nearest(key, known)))
            _check_bounds(path, value, _facts(known[key]))
            _check_parts(path, value, getattr(made, key))
    elif isinstance(given, list) and isinstance(made, tuple | list):
        for i, (item, part) in enumerate(zip(given, made, strict=False)):
            _check_parts(f"{name}[{i}]", item, part)
    elif isinstance(given, dict) and isinstance(made, dict):
        for key, item in given.items():
            _check_parts(f"{name}.{key}", item, made.get(key))


def _add_bounds(entry: Any, facts: Mapping[str, Any]) -> None:
    """Write the bounds into every place of a JSON Schema where a number may stand."""
    if isinstance(entry, dict):
        if entry.get("type") in ("number", "integer"):
            entry.update({key: facts[bound] for bound, (_, _, key) in BOUNDS.items() if bound in facts})
        for key in ("items", "additionalProperties"):
            _add_bounds(entry.get(key), facts)
        for key in ("anyOf", "prefixItems"):
            for inner in entry.get(key, ()):
                _add_bounds(inner, facts)


WANTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "a text (in quotes where it looks like a number)",
    "literal_error": "{expected}",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a mapping of names to values",
    "dataclass_type": "a mapping of names to values",
    "dataclass_exact_type": "a mapping of names to values",
    "none_required": "left out",
    "too_long": "a list of {max_length}",
}
"""Pydantic's kinds of complaint, in our words."""


def _explain(name: str, value: Any, error: Any) -> ParameterError:
    """Pydantic's first complaint, and the others about the same value (a parameter may accept several types), in our words."""
    errors = error.errors(include_url=False, include_context=True)
    where = [_locate({name: value}, (name, *e["loc"])) for e in errors]
    place, given = where[0]
    if errors[0]["type"] == "missing":
        return _within(place, ParameterError(place, given, f"complete; {errors[0]['loc'][-1]!r} is missing"))
    wanted = [
        WANTED[e["type"]].format(**e.get("ctx", {})) if e["type"] in WANTED else _lower(e["msg"])
        for e, (other, _) in zip(errors, where, strict=True)
        if other == place
    ]
    return _within(place, ParameterError(place, given, " or ".join(dict.fromkeys(wanted))))


def _within(path: str, error: ParameterError) -> ParameterError:
    """The error about a part of a parameter, known by the parameter's own name."""
    error.parameter = path.partition("[")[0].partition(".")[0]
    return error


def _locate(values: Mapping[str, Any], location: tuple[str | int, ...]) -> tuple[str, Any]:
    """The path and value that a complaint is about: ("pairs[0].name", 3). Pydantic's path also names the types it tried."""
    name, value = str(location[0]), values.get(str(location[0]))
    for step in location[1:]:
        if isinstance(step, int) and isinstance(value, list | tuple):
            name, value = f"{name}[{step}]", value[step] if step < len(value) else None
        elif isinstance(value, dict) and step in value:
            name, value = f"{name}.{step}", value[step]
    return name, value


def _lower(message: str) -> str:
    return message.removeprefix("Input should be ").removeprefix("Value error, ")


class UnknownParameter(ParameterError):
    """Unknown parameter. Its value is not shown: it may be a password."""

    def __init__(self, parameter: str, hint: str) -> None:
        super().__init__(parameter, None, hint)
        self.args = (f"{parameter} is no parameter; {hint}",)


class MissingParameter(ParameterError):
    """A parameter without a default that was not given."""

    def __init__(self, parameter: str, owner: str) -> None:
        super().__init__(parameter, None, "given")
        self.args = (f"{parameter} is missing; {owner} requires it",)
