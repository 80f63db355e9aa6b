"""Sources and operators for graphs in tests: quick to open, and with every kind of port."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from kinegraph.stream.chunk import Chunk, Specs, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import ANY, Input, Operator
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source


@dataclass(slots=True)
class Nothing:
    held: np.ndarray


@dataclass(frozen=True, slots=True)
class Board(Source):
    """Two channels.

    rate_hz   samples per second
    """

    rate_hz: float = param(1000.0, above=0.0)
    covers_s: float = param(0.0, least=0.0)
    outputs: ClassVar[tuple[str, ...]] = ("emg", "touchdown")

    @property
    def chunk_s(self) -> float:
        return self.covers_s

    def specs(self) -> Specs:
        emg = StreamSpec((2,), rate_hz=self.rate_hz, channels=("left", "right"), units=("uV",))
        return {"emg": emg, "touchdown": StreamSpec((), np.dtype([("onset", "<i8")]), units=("ns",))}

    def read(self, feed: Feed) -> None:
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Port(Source):
    """A source that cannot do without its port."""

    port: str = param(help="where the device is")

    def specs(self) -> Specs:
        if not self.port.startswith("/dev/"):
            raise ParameterError("port", self.port, "a path below /dev")
        return {"out": StreamSpec((3,), rate_hz=100.0, channels=("x", "y", "z"), units=("g",))}

    def read(self, feed: Feed) -> None:
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Low(Operator[Nothing]):
    """A filter in name only: it checks like one."""

    cutoff_hz: float = param(20.0, above=0.0, help="where it cuts")
    order: int = param(4, least=1, most=10)
    kind: Literal["low", "high"] = param("low")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if not spec.is_signal or spec.rate_hz is None:
            raise InputError("in", spec.describe(), "a signal with a rate")
        if self.cutoff_hz >= spec.rate_hz / 2:
            raise ParameterError("cutoff_hz", self.cutoff_hz, f"below {spec.rate_hz / 2:g}")
        self.set_state(Nothing(np.zeros(1000)), delay_s=self.order / 1000)
        return {"out": spec}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        return chunk


@dataclass(frozen=True, slots=True)
class Cycles(Operator[Nothing]):
    """Two inputs that must be there, and one that need not."""

    inputs = {"signal": Input(), "touchdown": Input(), "liftoff": Input(optional=True)}
    outputs: ClassVar[tuple[str, ...]] = ("cycle", "rejected")

    def open(self, specs: Specs) -> Specs:
        if not specs["touchdown"].is_event:
            raise InputError("touchdown", specs["touchdown"].describe(), "events")
        self.set_state(Nothing(np.zeros(10)), delay_s=0.05)
        return {"cycle": specs["signal"], "rejected": specs["touchdown"]}

    def process(self, port: str, chunk: Chunk) -> None:
        return None


@dataclass(frozen=True, slots=True)
class Join(Operator[Nothing]):
    """Any number of inputs."""

    inputs = {ANY: Input()}

    def open(self, specs: Specs) -> Specs:
        names = tuple(f"{port}/{channel}" for port, spec in specs.items() for channel in spec.channels)
        self.set_state(Nothing(np.zeros(1)))
        return {"out": StreamSpec((len(names),), rate_hz=next(iter(specs.values())).rate_hz, channels=names)}

    def process(self, port: str, chunk: Chunk) -> None:
        return None


@dataclass(frozen=True, slots=True)
class Screen(Outlet[Nothing]):
    """Where it ends."""

    def open(self, specs: Specs) -> Specs:
        self.set_state(Nothing(np.zeros(1)))
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        return None


@dataclass(frozen=True, slots=True)
class Broken(Operator[Nothing]):
    """An operator with a fault of its own."""

    fault: Literal["raises", "outputs", "state"] = param("raises")

    def open(self, specs: Specs) -> Specs:
        if self.fault == "raises":
            raise ZeroDivisionError("division by zero")
        if self.fault == "outputs":
            self.set_state(Nothing(np.zeros(1)))
            return {"other": specs["in"]}
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> None:
        return None


@dataclass(frozen=True, slots=True)
class Greedy(Low):
    """Takes for itself the name of a key that every node has."""

    queue: int = param(1)


@dataclass(frozen=True, slots=True)
class Shadow(Low):
    """Takes for itself a name by which the engine asks every operator for something else."""

    outputs: int = param(1)  # type: ignore[assignment,misc]


class NoDataclass(Operator[Nothing]):
    def open(self, specs: Specs) -> Specs:
        return {}
