"""streamz: maps, and a filter for chunks that came to nothing; it keeps no metrics."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

from streamz import Stream

from bench.work import EVERY, Feed, Sink, Step
from bench.worker import serve


def same(x: object) -> object:
    return x


class Streamz:
    def versions(self) -> dict[str, str]:
        return {"streamz": version("streamz")}

    def drive(self, style: str, steps: Sequence[Step | None], feed: Feed, sink: Sink) -> tuple[int, int]:
        source = Stream()
        node = source
        for step in steps:
            node = node.map(step or same)
            if step is not None and step.__name__ == "thin":
                node = node.filter(len)
        node.sink(sink)
        for x in feed:
            source.emit(x)
        return EVERY, 0


if __name__ == "__main__":
    serve(Streamz())
