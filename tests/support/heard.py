"""A feed that keeps what a source gives, and says words to it."""

from __future__ import annotations

from kinegraph.stream.chunk import NS, Array, Chunk, Samples


class Heard:
    """A feed of synthesis that keeps its poses and nodes, and says `words` at the poses given; stops after `most` poses."""

    def __init__(self, words: dict[int, str], most: int = 900) -> None:
        self.words, self.most = words, most
        self.poses: list[Samples] = []
        self.nodes: list[Array] = []
        self.reports: list[str] = []

    @property
    def stopped(self) -> bool:
        return len(self.poses) >= self.most

    def now(self) -> int:
        return 1000 * NS

    def wait(self, seconds: float) -> bool:
        return False

    def listen(self, timeout_s: float) -> str | None:
        return self.words.pop(len(self.poses), None)

    def emit(self, chunk: Chunk, output: str) -> None:
        (self.poses if output == "pose" else self.nodes).extend(chunk.data)

    def problem(self, kind: str, count: int = 1) -> None:
        self.reports.append(kind)

    def tell(self, kind: str, **facts: object) -> None:
        self.reports.append(f"{kind} {facts}")
