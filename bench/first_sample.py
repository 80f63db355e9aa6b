"""What `bench.start` puts into a graph. It imports nothing that kinegraph itself has not: scipy would be part of every start measured."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar

from kinegraph.stream.chunk import NS, Chunk, Specs
from kinegraph.stream.operator import Operator
from kinegraph.stream.params import param


@dataclass(slots=True)
class Nothing:
    """No state."""


@dataclass(frozen=True, slots=True)
class FirstSample(Operator[Nothing]):
    """Notes in a file when the first sample came (ns, monotonic clock of the machine)."""

    path: str = param()
    noted: ClassVar[bool] = False

    def open(self, specs: Specs) -> Specs:
        self.set_state(Nothing())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> None:
        if len(chunk.time) and chunk.until > NS * 10**6 and not FirstSample.noted:
            FirstSample.noted = True
            with open(self.path, "w") as file:  # noqa: PTH123
                file.write(str(time.monotonic_ns()))
