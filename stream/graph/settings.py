"""What a person may set in a graph or a part: within which bounds, and which parameters it feeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

TYPES: Mapping[str, tuple[type, ...]] = {
    "text": (str,),
    "number": (int, float),
    "integer": (int,),
    "boolean": (bool,),
    "list": (list,),
    "mapping": (dict,),
}


@dataclass(frozen=True, slots=True)
class GraphSetting:
    """One thing that a person may set.

    label    how forms and help call it; default: its name
    unit     the unit of the value, for people
    help     one sentence
    type     what a value must be; default: anything that the parameters accept
    default  the value of the parameters that it feeds, where the graph does not give one
    min      lower bound of a number
    max      upper bound of a number
    choices  the only values that are accepted
    feeds    the parameters that get the value ("envelope.cutoff_hz"); a graph's setting without any is a fact of the session
    """

    label: str = ""
    unit: str = ""
    help: str = ""
    type: Literal["", "text", "number", "integer", "boolean", "list", "mapping"] = ""
    default: Any = None
    min: float | None = None
    max: float | None = None
    choices: tuple[str | float | bool, ...] = ()
    feeds: str | tuple[str, ...] = ()

    @property
    def targets(self) -> tuple[str, ...]:
        """The parameters that it feeds."""
        return (self.feeds,) if isinstance(self.feeds, str) else self.feeds

    def accepts(self) -> str:
        """What a value must be, in words: "a number from 1 to 200 Hz"; empty if anything will do."""
        if self.choices:
            return "one of " + ", ".join(map(str, self.choices))
        numeric = self.min is not None or self.max is not None
        kind = self.type or ("number" if numeric else "")
        text = f"{'an' if kind == 'integer' else 'a'} {kind}" if kind else ""
        if self.min is not None and self.max is not None:
            text += f" from {self.min:g} to {self.max:g}"
        elif numeric:
            text += f" of at least {self.min:g}" if self.min is not None else f" of at most {self.max:g}"
        return f"{text} {self.unit}".strip() if kind else ""

    def refusal(self, name: str, value: Any) -> str:
        """Why this value is refused; empty if it is accepted."""
        kinds = TYPES.get(self.type, (int, float) if self.min is not None or self.max is not None else ())
        wrong = bool(kinds) and (not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds))
        if not wrong and isinstance(value, int | float) and not isinstance(value, bool):
            wrong = not (self.min is None or value >= self.min) or not (self.max is None or value <= self.max)
        if wrong or (self.choices and value not in self.choices):
            return f"{name} is {'empty' if value is None else repr(value)}; it must be {self.accepts()}"
        return ""
