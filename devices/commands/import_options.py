"""Options of `kinegraph files import` about streams: NAME=VALUE, or VALUE for every stream."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from math import isfinite
from typing import TYPE_CHECKING, Any

from kinegraph.stream.errors import RecordingError
from kinegraph.stream.graph.reading.yaml_lines import is_identifier

if TYPE_CHECKING:
    from kinegraph.devices.formats.column_table import ImportOptions

Many = list[str] | None


def options_of(given: Mapping[str, Many], start: str, **flags: Any) -> ImportOptions:
    """The options from every option's texts, when time 0 was, and flags as they are. Raises RecordingError that names the option."""
    from kinegraph.devices.formats.column_table import ImportOptions

    return ImportOptions(
        streams={name: list_of(text) for name, text in pairs("stream", given["stream"], named=True).items()},
        events=pairs("events", given["events"], named=True),
        meta=_meta(given["meta"]),
        begin=moment_of(start),
        rate=pairs("rate", given["rate"]),
        time=pairs("time", given["time"]),
        time_unit=pairs("time-unit", given["time_unit"]),
        counter=pairs("counter", given["counter"]),
        names=pairs("names", given["names"]),
        unit=pairs("unit", given["unit"]),
        scale=pairs("scale", given["scale"]),
        **flags,
    )


def pairs(option: str, given: Many, *, named: bool = False) -> dict[str, str]:
    """["a=x", "y"] as {"a": "x", "": "y"}: for one stream, and for all others."""
    made: dict[str, str] = {}
    for text in given or ():
        name, equals, content = text.partition("=")
        if not equals:
            name, content = "", text
        if not content or (named and not name):
            raise RecordingError(f"--{option} {text}: must be NAME=VALUE")
        if name in made:
            raise RecordingError(f"--{option}: given twice{f' for {name}' if name else ''}")
        made[name] = content
    return made


def list_of(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _meta(given: Many) -> dict[str, dict[str, Any]]:
    made: dict[str, dict[str, Any]] = {}
    for text in given or ():
        key, equals, result = text.partition("=")
        name, colon, fact = key.rpartition(":")
        if not (equals and colon and name and fact):
            raise RecordingError(f"--meta {text}: must be STREAM:KEY=VALUE")
        made.setdefault(name, {})[fact] = value(result)
    return made


def value(text: str) -> str | int | float:
    """A finite number where it is one that is spelt as one, else the text: 010 is an identifier."""
    if is_identifier(text):
        return text
    for kind in (int, float):
        try:
            number: int | float = kind(text)
        except ValueError:
            continue
        return number if isfinite(number) else text
    return text


def moment_of(text: str) -> int | None:
    """ns UTC of an ISO time; one without a zone is UTC."""
    if not text:
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise RecordingError(f"--start {text}: must be a time like 2024-05-01T09:30:00+02:00") from None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    if not 1900 <= moment.year <= 2100:
        raise RecordingError(f"--start {text}: must lie between 1900 and 2100")
    whole = moment.replace(microsecond=0)
    return round(whole.timestamp()) * 1_000_000_000 + moment.microsecond * 1000
