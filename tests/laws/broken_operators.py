"""Operators that break one law each, to show that the trial catches them. `Sound` keeps all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, Samples, Specs
from kinegraph.stream.chunk import StreamSpec as Spec
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Emitted, Input, Operator, grid
from kinegraph.stream.params import param

SPEC = Spec((3,), rate_hz=100.0, channels=("a", "b", "c"), units=("uV",))


@dataclass(slots=True)
class SmoothState:
    """y: each channel's last smoothed value (c,); last: the newest stamp."""

    y: Samples
    last: int = -1
    notes: list[Array] = field(default_factory=list)


class Smooth(Operator[SmoothState]):
    """Exponential smoothing that obeys every law; the broken ones change one thing of it."""

    __slots__ = ()

    def open(self, specs: Specs) -> Specs:
        self.set_state(SmoothState(np.zeros(specs["in"].shape)))
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        self.begin_chunk(chunk)
        out = np.empty(chunk.data.shape)
        for i, row in enumerate(chunk.data):
            out[i] = self.step(row)
        if len(chunk):
            self.state.last = int(chunk.time[-1])
        return self.emit(chunk, out)

    def begin_chunk(self, chunk: Chunk) -> None:
        gap = int(chunk.time[0]) - self.state.last if chunk.lost else 0
        if gap > self.reset_after_s * NS:
            self.state.y[:] = 0.0

    @property
    def reset_after_s(self) -> float:
        return 1.0

    def step(self, row: Samples) -> Samples:
        good = np.isfinite(row)
        self.state.y[good] += 0.2 * (row[good] - self.state.y[good])
        return np.where(good, self.state.y, np.nan)

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, out, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(1).normal(size=(200, 3))
        return [Case(cls(), {"in": (SPEC, grid(100.0, 200), data)}, least=200)]


@dataclass(frozen=True, slots=True)
class Sound(Smooth):
    """Breaks nothing."""

    reset_gap_s: float = param(1.0)

    @property
    def reset_after_s(self) -> float:
        return self.reset_gap_s


@dataclass(frozen=True, slots=True)
class NoCases(Smooth):
    """breaks: cases"""

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return ()


@dataclass(frozen=True, slots=True)
class TooFew(Smooth):
    """breaks: cases"""

    @classmethod
    def cases(cls) -> Sequence[Case]:
        case = Smooth.cases.__func__(cls)[0]  # type: ignore[attr-defined]
        return [Case(case.operator, case.inputs, least=201)]


@dataclass(frozen=True, slots=True)
class Raises(Smooth):
    """breaks: runs"""

    def begin_chunk(self, chunk: Chunk) -> None:
        chunk.time[0]


@dataclass(frozen=True, slots=True)
class MeanOfChunk(Smooth):
    """breaks: cuts"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, out - np.nanmean(out, axis=0) if len(out) else out, chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class LosesLostOfEvents(Smooth):
    """breaks: gaps"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, out, chunk.until)

    def open(self, specs: Specs) -> Specs:
        self.set_state(SmoothState(np.zeros(specs["in"].shape)))
        return {"out": specs["in"].derive(rate_hz=None)}


@dataclass(frozen=True, slots=True)
class LosesLost(Smooth):
    """breaks: spacing"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, out, chunk.until)


@dataclass(slots=True)
class OwedState(SmoothState):
    """owed: what was lost before the chunk before."""

    owed: int = 0


@dataclass(frozen=True, slots=True)
class LostAChunkLate(Smooth):
    """breaks: cuts"""

    def open(self, specs: Specs) -> Specs:
        self.set_state(OwedState(np.zeros(specs["in"].shape)))
        return {"out": specs["in"].derive(rate_hz=None)}

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        assert isinstance(self.state, OwedState)
        lost, self.state.owed = self.state.owed, chunk.lost
        return Chunk(chunk.time, out, chunk.until, lost)


_calls = iter(range(10**9))


@dataclass(frozen=True, slots=True)
class Impure(Smooth):
    """breaks: replay"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, out + 1e-9 * (next(_calls) % 1000), chunk.until, chunk.lost)


_secret: dict[int, float] = {}


@dataclass(frozen=True, slots=True)
class ForgetsState(Smooth):
    """breaks: state"""

    def open(self, specs: Specs) -> Specs:
        _secret.clear()
        return Smooth.open(self, specs)

    def step(self, row: Samples) -> Samples:
        _secret[0] = _secret.get(0, 0.0) + 1.0
        return Smooth.step(self, row) + _secret[0]


@dataclass(frozen=True, slots=True)
class Hoards(Smooth):
    """breaks: memory"""

    def step(self, row: Samples) -> Samples:
        self.state.notes.append(row.copy())
        return Smooth.step(self, row)


@dataclass(frozen=True, slots=True)
class ObjectsInState(Smooth):
    """breaks: state"""

    def snapshot(self) -> dict[str, Array]:
        return {**Smooth.snapshot(self), "extra": np.array([{}], dtype=object)}


@dataclass(frozen=True, slots=True)
class WrongDtype(Smooth):
    """breaks: spec"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, out.astype(np.float32), chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class WrongShape(Smooth):
    """breaks: spec"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, np.ascontiguousarray(out[:, :2]), chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class FloatStamps(Smooth):
    """breaks: spec"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time.astype(float), out, chunk.until, chunk.lost)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class UnknownOutput(Smooth):
    """breaks: spec"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return [("other", Chunk(chunk.time, out, chunk.until, chunk.lost))]


@dataclass(frozen=True, slots=True)
class WrongSpacing(Smooth):
    """breaks: spacing"""

    def open(self, specs: Specs) -> Specs:
        return {"out": Smooth.open(self, specs)["out"].derive(rate_hz=50.0)}


@dataclass(frozen=True, slots=True)
class Backwards(Smooth):
    """breaks: order"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time[::-1].copy(), out, chunk.until - NS * 100, chunk.lost)


@dataclass(frozen=True, slots=True)
class PromisesTooMuch(Smooth):
    """breaks: until"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, out, min(chunk.until, FOREVER - NS) + 20_000_000, chunk.lost)


@dataclass(frozen=True, slots=True)
class TakesPromiseBack(Smooth):
    """breaks: until"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, out, chunk.until if len(out) else 0, chunk.lost)


@dataclass(frozen=True, slots=True)
class LaterThanDeclared(Smooth):
    """breaks: delay"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time - 50_000_000, out, chunk.until - 50_000_000, chunk.lost)


@dataclass(frozen=True, slots=True)
class Prophet(Smooth):
    """breaks: delay"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time + NS, out, chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class StopsTime(Smooth):
    """breaks: time"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, out, chunk.until, chunk.lost) if len(out) else None


@dataclass(frozen=True, slots=True)
class MixesChannels(Smooth):
    """breaks: channels"""

    def step(self, row: Samples) -> Samples:
        return Smooth.step(self, row + np.roll(row, 1))


@dataclass(frozen=True, slots=True)
class HidesNaN(Smooth):
    """breaks: nan"""

    def step(self, row: Samples) -> Samples:
        Smooth.step(self, row)
        return self.state.y


@dataclass(frozen=True, slots=True)
class Poisoned(Smooth):
    """breaks: poison"""

    def step(self, row: Samples) -> Samples:
        row = np.where(np.isfinite(row), row, np.nan)
        self.state.y += 0.2 * (row - self.state.y)
        return self.state.y


@dataclass(frozen=True, slots=True)
class LikesInfinity(Smooth):
    """breaks: infinity"""

    def step(self, row: Samples) -> Samples:
        out = Smooth.step(self, row)
        return np.where(np.isinf(row), row, out)


@dataclass(frozen=True, slots=True)
class NeverResets(Smooth):
    """breaks: reset"""

    reset_gap_s: float = param(1.0)

    @property
    def reset_after_s(self) -> float:
        return 1e9


@dataclass(frozen=True, slots=True)
class Strided(Smooth):
    """breaks: arrays"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        return Chunk(chunk.time, np.asfortranarray(out), chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class Readonly(Smooth):
    """breaks: arrays"""

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        out.flags.writeable = False
        return Chunk(chunk.time, out, chunk.until, chunk.lost)


@dataclass(slots=True)
class ReuseState(SmoothState):
    """buffer: what is emitted, again and again."""

    buffer: Samples = field(default_factory=lambda: np.zeros((1000, 3)))


@dataclass(frozen=True, slots=True)
class WritesEmitted(Smooth):
    """breaks: emitted"""

    def open(self, specs: Specs) -> Specs:
        self.set_state(ReuseState(np.zeros(specs["in"].shape)))
        return {"out": specs["in"]}

    def emit(self, chunk: Chunk, out: Samples) -> Emitted:
        assert isinstance(self.state, ReuseState)
        part = self.state.buffer[: len(out)]
        part[:] = out
        return Chunk(chunk.time, part, chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class WritesInputs(Smooth):
    """breaks: inputs"""

    def begin_chunk(self, chunk: Chunk) -> None:
        chunk.data[:] = np.abs(chunk.data)


@kernel
def _sum(x: Array) -> float:
    total = 0.0
    for v in x:
        total += v
    return total


@dataclass(frozen=True, slots=True)
class WritesSpecs(Smooth):
    """breaks: inputs"""

    def open(self, specs: Specs) -> Specs:
        specs["in"].meta["smoothed"] = True
        return Smooth.open(self, specs)


@dataclass(frozen=True, slots=True)
class SettlesAtOnce(Smooth):
    """breaks: settling"""

    def open(self, specs: Specs) -> Specs:
        return {"out": Smooth.open(self, specs)["out"].derive(settling_s=0.1)}


@dataclass(frozen=True, slots=True)
class CompilesLate(Smooth):
    """breaks: compile"""

    def begin_chunk(self, chunk: Chunk) -> None:
        if chunk.lost:
            _sum(np.ones(3))


@dataclass(frozen=True, slots=True)
class Excused(HidesNaN):
    """Breaks a rule, and says so."""

    exemptions: ClassVar[dict[str, str]] = {"nan": "holds the last value in place of a missing one"}


@dataclass(frozen=True, slots=True)
class AnswersByOrder(Smooth):
    """breaks: ties"""

    inputs = {"level": Input(), "in": Input()}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        if port == "in":
            data = np.where(np.isfinite(chunk.data), chunk.data + self.state.y, np.nan)
            return Chunk(chunk.time, data, chunk.until, chunk.lost)
        for row in chunk.data:
            good = np.isfinite(row)
            self.state.y[good] = row[good]
        return []

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(1)
        level = (Spec((3,), rate_hz=10.0), grid(10.0, 20), random.normal(size=(20, 3)))
        return [Case(cls(), {"level": level, "in": (SPEC, grid(100.0, 200), random.normal(size=(200, 3)))}, least=200)]


def all_broken() -> dict[type[Operator[Any]], str]:
    """Every broken operator here, with the rule that it must be caught for."""
    found = [c for c in globals().values() if isinstance(c, type) and issubclass(c, Operator)]
    return {c: (c.__doc__ or "").removeprefix("breaks: ") for c in found if (c.__doc__ or "").startswith("breaks: ")}
