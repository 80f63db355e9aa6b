"""What a person says while a graph runs, as recorded streams: annotations, and values that may be changed."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import Chunk, Specs, StreamSpec, empty
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

HEARTBEAT_S = 0.05
"""How often a value says that it was not changed: so long does an operator that reads it wait for it."""
QUIET_S = 0.25
"""How often the annotations say that nothing was typed: hardly anyone waits for them."""

ANNOTATION = np.dtype([("onset", "<i8"), ("text", "U64")])


@dataclass(frozen=True, slots=True)
class Annotations(Source):
    """Marks set by a key or a typed word. Every live session has this source, under the name `annotations`.

    One event per mark: `onset` (ns), when its first key was pressed, and `text`, at most 64 characters. A graph with operators that
    read marks names this source itself with a shorter `input_lag_s`, since they wait that long.
    """

    background: ClassVar[bool] = True

    input_lag_s: float = param(QUIET_S, least=0.01, most=1.0, help="how often it says that nothing was typed")

    def specs(self) -> Specs:
        return {"out": StreamSpec((), ANNOTATION, units=("ns", ""))}

    def read(self, feed: Feed) -> None:
        """A word arrives as "<onset in ns> <text>"."""
        spec = self.specs()["out"]
        feed.ready()
        while not feed.stopped:
            word = feed.listen(self.input_lag_s)
            now = feed.now()
            if word is None:
                feed.emit(empty(spec, now))
            else:
                onset, _, text = word.partition(" ")
                mark = np.array([(int(onset), text)], ANNOTATION)
                feed.emit(Chunk(np.array([now]), mark, now))


@dataclass(frozen=True, slots=True)
class Value(Source):
    """A number that may be changed while the graph runs, by typing `name=number`; connect it to an operator's input port.

    One sample (1,) at the start and one per change, irregular; recorded, and so repeated in replay.
    """

    background: ClassVar[bool] = True

    initial: float = param(help="the number at the start")
    least: float = param(-1e308, help="the smallest number that is accepted")
    most: float = param(1e308, help="the largest number that is accepted")
    unit: str = param("", help="the unit, for people")

    def specs(self) -> Specs:
        if not self.least <= self.initial <= self.most:
            raise ParameterError("initial", self.initial, f"between {self.least:g} and {self.most:g}")
        return {"out": StreamSpec((1,), np.dtype(np.float64), channels=("value",), units=(self.unit,))}

    def accepts(self, text: str) -> float:
        """The number in `text`; raises ParameterError."""
        try:
            number = float(text)
        except ValueError:
            raise ParameterError("value", text, "a number") from None
        if not (isfinite(number) and self.least <= number <= self.most):
            raise ParameterError("value", number, f"between {self.least:g} and {self.most:g}")
        return number

    def read(self, feed: Feed) -> None:
        spec = self.specs()["out"]
        word: str | None = repr(self.initial)
        while not feed.stopped:
            now = feed.now()
            if word is None:
                feed.emit(empty(spec, now))
            else:
                feed.emit(Chunk(np.array([now]), np.array([[self.accepts(word)]]), now))
            word = feed.listen(HEARTBEAT_S)
