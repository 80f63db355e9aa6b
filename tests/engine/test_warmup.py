"""Before a graph runs every operator has met all that its cases hold."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import structlog
from parts import Counting

from kinegraph.stream.chunk import Chunk, Specs, StreamSpec
from kinegraph.stream.cli.commands import logs
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.warmup import warm_up
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

MET: dict[str, int] = {}
ROOT = Path(__file__).resolve().parents[2]


@dataclass(slots=True)
class Nothing:
    """No state."""


@dataclass(frozen=True, slots=True)
class TwoInputs(Operator[Nothing]):
    """Notes how many samples of each input it has met."""

    inputs = {"in": Input(), "mark": Input(optional=True)}
    factor: float = param(1.0)

    def open(self, specs: Specs) -> Specs:
        self.set_state(Nothing())
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


@dataclass(frozen=True, slots=True)
class Alarming(TwoInputs):
    """Warns of everything."""

    def process(self, port: str, chunk: Chunk) -> Chunk | None:
        structlog.get_logger("x").warning("the camera was moved")
        return chunk if port == "in" else None


@pytest.mark.parametrize("set_up", [True, False], ids=["by a command", "from Python"])
def test_what_is_said_of_made_up_samples_is_not_shown(set_up: bool, capsys: pytest.CaptureFixture[str]) -> None:
    graph = load_text(
        f"nodes:\n  a: {{use: parts.{Counting.__name__}}}\n  b: {{use: tests.engine.test_warmup.Alarming, from: a}}"
    )
    if set_up:
        logs.set_up()
    try:
        warm_up(Pipeline(graph))
        output = capsys.readouterr()
        assert "the camera was moved" not in output.out + output.err
        structlog.get_logger("x").warning("the camera was moved")
        output = capsys.readouterr()
        assert "the camera was moved" in output.out + output.err
    finally:
        structlog.reset_defaults()


def test_what_compiles_ahead_needs_no_library_of_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "bleak", None)
    text = "nodes:\n  a: {use: devices.polar.Polar}\n  b: {use: tests.engine.test_warmup.TwoInputs, from: a.ecg}"
    MET.clear()
    with pytest.raises(DeviceError, match="bleak"):
        warm_up(Pipeline(load_text(text)))
    assert not MET
    warm_up(Pipeline(load_text(text)), compiles_only=True)
    assert MET["in"] >= 200


def test_samples_after_the_last_event_are_met_too() -> None:
    MET.clear()
    graph = load_text(
        f"nodes:\n  a: {{use: parts.{Counting.__name__}}}\n  b: {{use: tests.engine.test_warmup.TwoInputs, from: a}}"
    )
    warm_up(Pipeline(graph))
    assert MET == {"in": 200, "mark": 2}


@dataclass(slots=True)
class Newest:
    """The newest stamp."""

    stamp: int


@dataclass(frozen=True, slots=True)
class InOrder(Operator[Newest]):
    """Two signals with samples in the order of time: an operator may rely on it, and index its memory by it."""

    inputs = {"in": Input(), "other": Input()}

    def open(self, specs: Specs) -> Specs:
        self.set_state(Newest(0))
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Chunk | None:
        if len(chunk):
            assert int(chunk.time[0]) >= self.state.stamp, f"{port} goes back in time"
            self.state.stamp = int(chunk.time[-1])
        return chunk if port == "in" else None

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return []


def test_made_up_samples_of_several_inputs_come_in_the_order_of_time() -> None:
    counting = f"parts.{Counting.__name__}"
    order = "tests.engine.test_warmup.InOrder, from: {in: a, other: b}"
    text = f"nodes:\n  a: {{use: {counting}}}\n  b: {{use: {counting}}}\n  c: {{use: {order}}}"
    warm_up(Pipeline(load_text(text)))


@pytest.mark.parametrize(
    "use",
    [
        "operators.emg.mixtures.PeakMixtures",
        "operators.emg.mixtures.drift.MixtureDrift",
        "operators.body.extrema.Extrema",
    ],
)
def test_shorter_cases_for_the_warm_up_compile_all_that_the_cases_do(use: str) -> None:
    command = [sys.executable, "-m", "tests.warm_up_kernels", use]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == ""


def test_every_operator_with_shorter_cases_for_the_warm_up_is_tried() -> None:
    sources = {path: path.read_text(encoding="utf-8") for path in (ROOT / "operators").rglob("*.py")}
    assert {path.name for path, source in sources.items() if "def warm_up_cases" in source} == {
        "operator.py",
        "drift.py",
        "extrema.py",
    }
