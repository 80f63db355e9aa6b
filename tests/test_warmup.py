"""Before a graph runs every operator has met all that its cases hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from parts import Counting

from stream.chunk import Chunk, Specs, StreamSpec
from stream.engine.warmup import warm_up
from stream.graph.load import load_text
from stream.operator import Case, Operator, grid
from stream.params import param

MET: dict[str, int] = {}


@dataclass(slots=True)
class Nothing:
    """No state."""


@dataclass(frozen=True, slots=True)
class TwoInputs(Operator[Nothing]):
    """Notes how many samples of each input it has met."""

    inputs: ClassVar[tuple[str, ...]] = ("in", "mark")
    optional: ClassVar[tuple[str, ...]] = ("mark",)
    factor: float = param(1.0)

    def open(self, specs: Specs) -> Specs:
        self.hold(Nothing())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Chunk | None:
        if self.factor > 1.0:
            MET[port] = MET.get(port, 0) + len(chunk)
        return chunk if port == "in" else None

    @classmethod
    def cases(cls) -> Sequence[Case]:
        mark = StreamSpec((), np.dtype([("onset", np.int64)]))
        events = np.array([(0,), (1,)], mark.dtype)
        signal = (StreamSpec((1,), rate_hz=100.0), grid(100.0, 200), np.ones((200, 1)))
        return [Case(cls(factor=2.0), {"in": signal, "mark": (mark, grid(100.0, 2), events)}, least=200)]


def test_samples_after_the_last_event_are_met_too() -> None:
    MET.clear()
    graph = load_text(f"nodes:\n  a: {{use: parts.{Counting.__name__}}}\n  b: {{use: test_warmup.TwoInputs, from: a}}")
    warm_up(graph)
    assert MET == {"in": 200, "mark": 2}
