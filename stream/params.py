"""Parameters: fields of a frozen dataclass with bounds, checked from YAML without coercion, described to editors by JSON Schema.

The unit stands in the name (`cutoff_hz`, `window_s`). Values come from YAML, are checked strictly (a text is no number, a number no
switch), and whatever is wrong is raised as a `ParameterError` that names the parameter, the value and what would be accepted.
"""

from __future__ import annotations

import json
from dataclasses import MISSING, field, fields
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from stream.errors import ParameterError, nearest

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic import TypeAdapter

T = TypeVar("T")


def param(
    default: Any = MISSING,
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    help: str = "",
) -> Any:
    """A parameter of an operator, source or outlet. Without a default it must be given.

    `above`/`below` are exclusive bounds, `least`/`most` inclusive ones; `help` is one line, shown by editors and `kinegraph draw`.
    """
    bounds = {"gt": above, "ge": least, "lt": below, "le": most}
    metadata = {name: bound for name, bound in bounds.items() if bound is not None}
    return field(default=default, metadata={**metadata, "description": help})


def build(cls: type[T], values: Mapping[str, Any]) -> T:
    """An instance of the dataclass `cls` with parameters from YAML; raises ParameterError for the first that is wrong."""
    from pydantic import ValidationError

    known = {f.name for f in fields(cls)}  # type: ignore[arg-type]
    for name in values:
        if name not in known:
            raise ParameterError(name, values[name], f"a parameter of {cls.__name__}; {nearest(name, known)}")
    try:
        text = json.dumps(values, allow_nan=False)
    except (TypeError, ValueError):
        bad = next(name for name, value in values.items() if not _is_plain(value))
        raise ParameterError(bad, values[bad], "a finite number, a text, true or false, or a list of these") from None
    try:
        made: T = adapter(cls).validate_json(text, strict=True)
    except ValidationError as error:
        raise _explain(cls, values, error) from None
    return made


def schema(cls: type[Any]) -> dict[str, Any]:
    """The JSON Schema of a dataclass's parameters, for editors."""
    made: dict[str, Any] = adapter(cls).json_schema()
    made.pop("title", None)
    for entry in made.get("properties", {}).values():
        entry.pop("title", None)
    return made


def adapter(cls: Any) -> TypeAdapter[Any]:
    """Pydantic's validator of a dataclass, made once."""
    return _adapter(cls)


@cache
def _adapter(cls: Any) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(cls)


def _is_plain(value: Any) -> bool:
    try:
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError):
        return False
    return True


def _explain(cls: type[Any], values: Mapping[str, Any], error: Any) -> ParameterError:
    """Pydantic's first complaint, in our words."""
    first = error.errors(include_url=False, include_context=True)[0]
    location = [str(part) for part in first["loc"] if not str(part).startswith(("function-", "list[", "tuple["))]
    name = location[0] if location else cls.__name__
    if first["type"] == "missing":
        return MissingParameter(name, cls.__name__)
    limits = first.get("ctx", {})
    wanted = {
        "greater_than": "above {gt}",
        "greater_than_equal": "at least {ge}",
        "less_than": "below {lt}",
        "less_than_equal": "at most {le}",
        "float_type": "a number",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "bool_type": "true or false",
        "string_type": "a text",
        "literal_error": "one of {expected}",
        "list_type": "a list",
        "tuple_type": "a list",
        "dict_type": "a mapping of names to values",
        "none_required": "left out",
    }.get(first["type"])
    return ParameterError(name, values.get(name), wanted.format(**limits) if wanted else _lower(first["msg"]))


def _lower(message: str) -> str:
    return message.removeprefix("Input should be ").removeprefix("Value error, ")


class MissingParameter(ParameterError):
    """A parameter without a default that was not given."""

    def __init__(self, parameter: str, owner: str) -> None:
        super().__init__(parameter, None, "given")
        self.args = (f"{parameter} is missing; {owner} cannot do without it",)
