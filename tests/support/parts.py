"""Sources, operators and outlets that tests build graphs from, named in YAML as `parts.X`."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec, empty
from kinegraph.stream.operator import Emitted, Input, Operator
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

START = 1_700_000_000 * NS
seen: dict[str, list[Chunk]] = {}
"""What each `Collect` outlet has received, by its `name`."""
openings: dict[str, int] = {}
"""How often each `Counting` source was opened, by its `key`."""


@dataclass(frozen=True, slots=True)
class Counting(Source):
    """Two channels: the sample's number, and a wave. What it can be made to do wrong happens at sample `at`, on its first opening."""

    rate_hz: float = param(1000.0)
    samples: int = param(1000)
    chunk: int = param(10)
    realtime: bool = param(False)
    trouble: str = param("")
    at: int = param(500)
    key: str = param("counting")
    offset_ms: float = param(0.0)
    pause_s: float = param(0.0)

    @property
    def live(self) -> bool:
        return self.realtime

    def specs(self) -> Specs:
        return {"out": StreamSpec((2,), rate_hz=self.rate_hz, channels=("number", "wave"), units=("", "V"))}

    def read(self, feed: Feed) -> None:
        openings[self.key] = openings.get(self.key, 0) + 1
        first = openings[self.key] == 1
        start = self.at if not first and self.trouble in ("dies", "hangs") else 0
        anchor = feed.now() - int(start * NS / self.rate_hz) if self.realtime else START
        anchor += int(self.offset_ms * 1e6)
        for i in range(start, self.samples, self.chunk):
            n = min(self.chunk, self.samples - i)
            if first and self.trouble and i <= self.at < i + n:
                self._trouble(feed)
            numbers = np.arange(i, i + n)
            times = anchor + np.round(numbers * (NS / self.rate_hz)).astype(np.int64)
            if first and self.trouble == "backwards" and i <= self.at < i + n:
                times[n // 2 :] -= NS
            if self.realtime and feed.wait(max(0.0, (int(times[-1]) - feed.now()) / NS)):
                return
            data = np.stack([numbers, np.sin(numbers / 50)], axis=1).astype(float)
            feed.emit(Chunk(times, data, int(times[-1])))

    def _trouble(self, feed: Feed) -> None:
        if self.trouble == "dies":
            raise OSError("the cable was pulled out")
        if self.trouble == "hangs":
            feed.wait(60.0)
        if self.trouble == "pauses":
            feed.wait(self.pause_s)


@dataclass(frozen=True, slots=True)
class Silent(Source):
    """A source that never gives anything."""

    def specs(self) -> Specs:
        return {"out": StreamSpec((1,), rate_hz=100.0, channels=("nothing",))}

    def read(self, feed: Feed) -> None:
        while not feed.wait(0.05):
            pass


@dataclass(frozen=True, slots=True)
class Identity(Operator[None]):
    """What comes in goes out."""

    def open(self, specs: Specs) -> Specs:
        self.set_state(None)
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        return chunk


@dataclass(frozen=True, slots=True)
class Misspelt(Identity):
    """A slip that only a sample brings to light."""

    def process(self, port: str, chunk: Chunk) -> Emitted:
        return Chunk(chunk.time, chunk.dat, chunk.until)  # type: ignore[attr-defined]


@dataclass(frozen=True, slots=True)
class Slips(Source):
    """A source of one's own with a slip in it."""

    outputs: ClassVar[tuple[str, ...]] = ("emg",)

    slip: str = param()

    def specs(self) -> Specs:
        return {"emg": StreamSpec((1,), rate_hz=1000.0)}

    def read(self, feed: Feed) -> None:
        if self.slip == "another output":
            feed.emit(Chunk(np.array([feed.now()]), np.zeros((1, 1)), feed.now()), "egm")
        if self.slip == "a type":
            feed.emit(Chunk(np.array([feed.now()]), np.zeros((1, 1)) + "1", 0), "emg")  # type: ignore[operator]
        if self.slip == "local time":
            local = feed.now() + 3600 * NS
            feed.emit(Chunk(np.array([local]), np.zeros((1, 1)), local), "emg")
        feed.emit(Chunk(np.array([feed.now()]), np.zeros((1, 1)), feed.now()), "emg")
        while not feed.wait(0.05):
            second = feed.now() // NS  # seconds, where nanoseconds are wanted
            feed.emit(Chunk(np.array([second]), np.zeros((1, 1)), second), "emg")


@dataclass(slots=True)
class SumState:
    total: Array


@dataclass(frozen=True, slots=True)
class RunningSum(Operator[SumState]):
    """The sum of all samples so far: every sample lost or doubled shows."""

    slow_s: float = param(0.0)
    fails_at: int = param(-1)

    def open(self, specs: Specs) -> Specs:
        self.set_state(SumState(np.zeros(specs["in"].shape)))
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        if self.slow_s and len(chunk.time):
            time.sleep(self.slow_s)
        if self.fails_at >= 0 and (chunk.data[:, 0] == self.fails_at).any():
            raise ValueError("this number is not to my taste")
        out = np.empty_like(chunk.data)
        for i, row in enumerate(chunk.data):
            self.state.total += row
            out[i] = self.state.total
        return Chunk(chunk.time, out, chunk.until, chunk.lost)


@dataclass(slots=True)
class GainState:
    gain: float


@dataclass(frozen=True, slots=True)
class Gain(Operator[GainState]):
    """The signal times the newest value of the other input."""

    inputs = {"signal": Input(), "gain": Input()}

    def open(self, specs: Specs) -> Specs:
        self.set_state(GainState(float("nan")))
        return {"out": specs["signal"]}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        if port == "gain":
            if len(chunk.time):
                self.state.gain = float(chunk.data[-1, 0])
            return None
        return Chunk(chunk.time, chunk.data * self.state.gain, chunk.until, chunk.lost)


@dataclass(frozen=True, slots=True)
class Beside(Operator[None]):
    """Both inputs' samples in the order of time, on one output: shows the order of a merge."""

    inputs = {"a": Input(), "b": Input()}

    def open(self, specs: Specs) -> Specs:
        self.set_state(None)
        return {"out": specs["a"].derive(rate_hz=None)}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        return chunk


@dataclass(frozen=True, slots=True)
class Collect(Outlet[None]):
    """Keeps what it receives in `seen`."""

    name: str = param("out")
    fails_after: int = param(-1)
    slow_s: float = param(0.0)

    def open(self, specs: Specs) -> Specs:
        self.set_state(None)
        return {}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        kept = seen.setdefault(self.name, [])
        if 0 <= self.fails_after <= sum(len(c) for c in kept):
            raise OSError("the network is down")
        if self.slow_s:
            time.sleep(self.slow_s)
        kept.append(chunk)
        return None


def numbers(name: str = "out") -> list[int]:
    """The first channel of what an outlet has received."""
    return [int(v) for chunk in seen.get(name, []) for v in chunk.data[:, 0]]


def lost(name: str = "out") -> list[int]:
    """The gaps in its input."""
    return [chunk.lost for chunk in seen.get(name, []) if chunk.lost]


def threads() -> set[tuple[str, int | None]]:
    """Name and number of every thread of a session that is alive."""
    return {
        (t.name, t.ident)
        for t in threading.enumerate()
        if t.name.startswith(("source", "worker", "recorder", "checkpoint"))
    }


def nothing(spec: StreamSpec, until: int) -> Chunk:
    return empty(spec, until)
