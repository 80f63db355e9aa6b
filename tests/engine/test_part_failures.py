"""Whatever a part raises in whichever of its methods: an error that names the node, no traceback, and a recording that is closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.operator import Operator
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.recording import Recording
from kinegraph.stream.source import Feed, Source
from tests.support.command_line import QUIET, Command


class _MuteError(BaseException):
    """One that cannot even be printed."""

    def __str__(self) -> str:
        raise RuntimeError("no words")

    __repr__ = __str__


RAISED = {"own": BaseException("of its own"), "mute": _MuteError(), "none left": MemoryError()}
START = 1_700_000_000 * NS


class Fails:
    """Raises in the method that `where` names."""

    __slots__ = ()
    where: str
    how: str

    def at(self, method: str) -> None:
        if method == self.where:
            raise RAISED[self.how]


@dataclass(slots=True)
class Samples:
    n: int = 0


@dataclass(frozen=True, slots=True)
class FailingOperator(Fails, Operator[Samples]):
    where: str = param("")
    how: str = param("own")

    def __post_init__(self) -> None:
        self.at("__post_init__")

    def open(self, specs: Specs) -> Specs:
        self.at("open")
        self.set_state(Samples())
        return {"out": specs["in"]}

    def check_session(self, session: Mapping[str, Any]) -> None:
        self.at("check_session")

    def process(self, port: str, chunk: Chunk) -> Chunk:
        self.state.n += len(chunk)
        if self.state.n > 100:
            self.at("process")
        return chunk

    def snapshot(self) -> dict[str, Any]:
        self.at("snapshot")
        return Operator.snapshot(self)

    def close(self) -> None:
        if self.state.n > 100:
            self.at("close")

    @property
    def memory_bytes(self) -> int:
        self.at("memory_bytes")
        return 0


@dataclass(frozen=True, slots=True)
class FailingOutlet(Fails, Outlet[Samples]):
    where: str = param("")
    how: str = param("own")

    def open(self, specs: Specs) -> Specs:
        self.set_state(Samples())
        return {}

    def meet(self, graph: Any) -> None:
        self.at("meet")

    def keep_time(self, clock: Any) -> None:
        self.at("keep_time")

    def let_stop(self, stop: Any) -> None:
        self.at("let_stop")

    def begin(self) -> None:
        self.at("begin")

    def process(self, port: str, chunk: Chunk) -> None:
        self.at("process")

    def close(self) -> None:
        self.at("close")

    @property
    def file(self) -> str:
        self.at("file")
        return ""


@dataclass(frozen=True, slots=True)
class FailingSource(Fails, Source):
    where: str = param("")
    how: str = param("own")

    def specs(self) -> Specs:
        self.at("specs")
        return {"out": StreamSpec((1,), rate_hz=100.0)}

    def facts(self) -> Mapping[str, Any]:
        self.at("facts")
        return {}

    @property
    def live(self) -> bool:
        self.at("live")
        return True

    @property
    def chunk_s(self) -> float:
        self.at("chunk_s")
        return 0.0

    def prepare(self) -> None:
        self.at("prepare")

    def present(self) -> bool | None:
        self.at("present")
        return None

    def read(self, feed: Feed) -> None:
        for i in range(3):
            times = START + NS // 100 * np.arange(100 * i, 100 * i + 100)
            feed.emit(Chunk(times, np.zeros((100, 1)), int(times[-1])))
        if self.where == "present":
            raise OSError("away")
        self.at("read")


GRAPH = """
nodes:
  source: {{use: tests.engine.test_part_failures.FailingSource, where: {source}, how: {how}}}
  operator: {{use: tests.engine.test_part_failures.FailingOperator, from: source, where: {operator}, how: {how}}}
  outlet: {{use: tests.engine.test_part_failures.FailingOutlet, from: operator, where: {outlet}, how: {how}}}
"""
BEFORE = {"__post_init__", "open", "check_session", "memory_bytes", "specs", "facts", "live", "chunk_s", "prepare"}
"""In which nothing is recorded yet."""
WHERE = [
    *(("operator", where) for where in ("__post_init__", "open", "check_session", "process", "snapshot", "close", "memory_bytes")),
    *(("outlet", where) for where in ("meet", "keep_time", "let_stop", "begin", "process", "close", "file")),
    *(("source", where) for where in ("specs", "facts", "live", "chunk_s", "prepare", "present", "read")),
]  # fmt: skip


@pytest.mark.parametrize("how", RAISED)
@pytest.mark.parametrize(("node", "where"), WHERE)
def test_whatever_a_part_raises_names_its_node(
    node: str, where: str, how: str, kinegraph: Command, tmp_path: Path
) -> None:
    given = dict.fromkeys(("source", "operator", "outlet"), "none") | {node: where}
    (tmp_path / "g.yaml").write_text(GRAPH.format(how=how, **given))
    code, _, output = kinegraph("run", "g.yaml", *QUIET, "-o", "s", "--for", 2)
    assert code in (2, 3, 4, 5, 7), output
    assert f"node {node!r}" in output or f"node={node}" in output, output
    if where not in BEFORE:
        with Recording.open(tmp_path / "s") as recording:
            assert recording.finished


WHAT: Sequence[str] = ("raise SystemExit(0)", "raise KeyboardInterrupt", "raise BaseException('of its own')")


@pytest.mark.parametrize("raised", WHAT)
def test_a_module_that_raises_as_it_is_imported_is_told(raised: str, kinegraph: Command, tmp_path: Path) -> None:
    """Also one that would end the program without a word, and with the code of success."""
    (tmp_path / "ending.py").write_text(f"{raised}\n")
    (tmp_path / "g.yaml").write_text("nodes:\n  own: {use: ending.Own}\n")
    for command in (("check", "g.yaml"), ("run", "g.yaml", *QUIET), ("dev", "try", "ending.Own")):
        code, _, output = kinegraph(*command)
        assert code == 2 and "ending could not be imported" in output, output
