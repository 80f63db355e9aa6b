"""Streams on the Lab Streaming Layer, found by what they say of themselves."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from kinegraph.stream.errors import DeviceError, nearest

STEP_S = 0.02
SETTLE_S = 0.75
"""How long a second stream that also fits may take to answer: LSL asks one address after the other from half a second on."""
LISTED_S = 1.0
"""How long streams may take to answer when all there are get listed."""
PROBE_S = 1.5
"""How long a stream may take to answer before a session compiles anything."""

Wait = Callable[[float], bool]
"""Sleeps for the given seconds, or less where it must stop; returns whether it must."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a stream must say of itself; empty: anything."""

    name: str = ""
    type: str = ""
    source_id: str = ""
    host: str = ""

    def __str__(self) -> str:
        return " and ".join(f"{key} {value!r}" for key, value in self._facts().items())

    @property
    def predicate(self) -> str:
        """The same in XPath, which LSL asks its network with."""
        names = {"host": "hostname"}
        return " and ".join(f"{names.get(key, key)}={_quoted(value)}" for key, value in self._facts().items())

    def fits(self, info: Any) -> bool:
        """Whether this is what a stream says of itself."""
        facts = {"name": info.name(), "type": info.type(), "source_id": info.source_id(), "host": info.hostname()}
        return all(facts[key] == value for key, value in self._facts().items())

    def _facts(self) -> dict[str, str]:
        facts = {"name": self.name, "type": self.type, "source_id": self.source_id, "host": self.host}
        return {key: value for key, value in facts.items() if value}


def find(lsl: Any, wanted: Wanted, within_s: float, wait: Wait) -> Any:
    """The one stream that fits (a StreamInfo without its description), or None if stopped.

    Of several from one source (an outlet that was restarted) the newest is taken. Raises DeviceError if no stream comes in time, or if
    several fit.
    """
    resolver = lsl.ContinuousResolver(pred=wanted.predicate)
    deadline = time.monotonic() + within_s
    while not (found := resolver.results()):
        if wait(STEP_S):
            return None
        if time.monotonic() > deadline:
            raise DeviceError(_absent(lsl, wanted, within_s))
    if not wanted.source_id:
        if wait(SETTLE_S):
            return None
        found = resolver.results() or found
    sources = {(info.name(), info.source_id(), info.hostname()) for info in found}
    if len(sources) > 1:
        raise DeviceError(
            f"{len(sources)} LSL streams have {wanted}: {_listed(found)}; name one by its source_id or host"
        )
    return max(found, key=lambda info: info.created_at())


def missing(lsl: Any, wanted: Wanted) -> str:
    """What to say of a stream that does not answer, with the nearest of those that do; "" where it does."""
    resolver = lsl.ContinuousResolver()
    deadline = time.monotonic() + PROBE_S
    while not any(map(wanted.fits, found := resolver.results())):
        if time.monotonic() > deadline:
            hint = f"{nearest(wanted.name, {info.name() for info in found})} " if found and wanted.name else ""
            return f"no LSL stream with {wanted}; {hint}{_those(found)}"
        time.sleep(STEP_S)
    return ""


def is_there(lsl: Any, wanted: Wanted, within_s: float, wait: Wait) -> bool:
    """Whether a stream that fits answers."""
    resolver = lsl.ContinuousResolver(pred=wanted.predicate)
    deadline = time.monotonic() + within_s
    while not resolver.results():
        if wait(STEP_S) or time.monotonic() > deadline:
            return False
    return True


def everything(lsl: Any, within_s: float = LISTED_S) -> list[Any]:
    """All streams that answer in time, in the order of their names."""
    return sorted(lsl.resolve_streams(within_s), key=lambda info: (info.name(), info.source_id(), info.uid()))


def _absent(lsl: Any, wanted: Wanted, within_s: float) -> str:
    return f"no LSL stream with {wanted} within {within_s:g} s; {_those(everything(lsl))}"


def _those(infos: Sequence[Any]) -> str:
    if not infos:
        return "no stream was found; is its program running, on this network?"
    return f"there are {_listed(infos)}"


def _listed(infos: Sequence[Any], most: int = 8) -> str:
    texts = [f"{i.name()!r} (type {i.type()!r}, source_id {i.source_id()!r}, on {i.hostname()})" for i in infos[:most]]
    return ", ".join(texts) + (f" and {len(infos) - most} more" if len(infos) > most else "")


def _quoted(text: str) -> str:
    """A text as XPath 1.0 writes it, which knows no escapes."""
    if "'" not in text:
        return f"'{text}'"
    if '"' not in text:
        return f'"{text}"'
    return "concat(" + ', "\'", '.join(f"'{part}'" for part in text.split("'")) + ")"
