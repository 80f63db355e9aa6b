"""Where streams begin: the source, and the feed through which it hands over what it reads.

A source reads in a thread of its own, which may block. It is reopened with growing pauses when it raises or falls silent, while the rest
of the graph goes on; so `read` opens the device, reads until it is stopped, and closes it again, whatever happens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self

from kinegraph.stream.chunk import Chunk, Specs
from kinegraph.stream.params import check, check_names

if TYPE_CHECKING:
    from kinegraph.stream.domain.impedance import Impedance


class outputs_by_parameters:
    """For a source with outputs that depend on its parameters: `outputs` is then a method.

        @outputs_by_parameters("depth", "timing")
        def outputs(self) -> tuple[str, ...]: ...

    The class itself has those that are named here.
    """

    def __init__(self, *usual: str) -> None:
        self.usual = usual

    def __call__(self, those_of: Callable[[Any], tuple[str, ...]]) -> Self:
        self.those_of = those_of
        return self

    def __get__(self, instance: Any, owner: type) -> tuple[str, ...]:
        return self.usual if instance is None else self.those_of(instance)


class Feed(Protocol):
    """A source's way into the graph."""

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        """Hand over a chunk. With the policy `block` this waits while the queue is full."""

    def now(self) -> int:
        """Session time: nanoseconds UTC that never run backwards."""

    def wait(self, seconds: float) -> bool:
        """Sleep, but wake at once when the source must stop; returns whether it must."""

    @property
    def stopped(self) -> bool:
        """Whether `read` must return as soon as it can."""

    def ready(self) -> None:
        """The device is there and set up, though no sample has come yet (the first sample says the same)."""

    def listen(self, timeout_s: float) -> str | None:
        """Wait for a word that a person types for this source; None after the timeout."""

    def identify(self, device: str, **facts: str | float) -> None:
        """Say what was found at the other end: its kind, serial number, firmware, battery. It goes into the log and the recording."""

    def problem(self, kind: str, count: int = 1) -> None:
        """Count something that went wrong without ending the stream: 'bad packet', 'lost packet', 'resync'."""

    def tell(self, kind: str, **facts: str | float) -> None:
        """Something rare that whoever reads the recording must know, with its size: into the log and the recording.

        `tell(REPORT, **Finding(...).facts())` is a claim that does not hold: an alarm, or as the node's `claims` has it the end.
        """

    def device_clock(self, **facts: float) -> None:
        """What is known of the device's clock now (`offset_s`, `drift_ppm`, `uncertainty_s`, ...): into the metrics."""

    @property
    def again(self) -> bool:
        """Whether the source was open before in this session."""

    def position(self, output: str = "out") -> int:
        """Up to when (ns) the session has this output's stream, also from before it was resumed: later samples enter. NEVER: nothing."""

    def saved(self) -> int:
        """Up to which arrival (ns of session time) the recording is on the disk; FOREVER where nothing is recorded."""


class Source:
    """A device, file or simulator. Subclasses are frozen dataclasses of parameters.

    `read` returning means that the stream has ended; raising means that the device failed and will be opened again.
    """

    __slots__ = ()
    outputs: ClassVar[tuple[str, ...]] = ("out",)
    background: ClassVar[bool] = False
    """Whether a session may start and end without this source (a person's annotations)."""
    rate_tolerance: ClassVar[float] = 0.03
    """By which share samples may come at another rate than declared before that is a finding."""
    continues: ClassVar[bool] = False
    """Whether it goes on where the session's stream ends (`Feed.position`) whenever it is opened: then nothing is missing after an outage,
    and nothing is assumed to have happened meanwhile."""

    def __new__(cls, *values: Any, **named: Any) -> Self:
        check_names(cls, named)
        return super().__new__(cls)

    def __post_init__(self) -> None:
        check(self)

    @property
    def live(self) -> bool:
        """Whether what is not read is gone: then samples from before the common start are left out. A file waits instead."""
        return True

    @property
    def may_appear(self) -> bool:
        """Whether what is `missing` before a session may well come by itself (a stream of another program): it is named and waited for."""
        return False

    @property
    def refuses(self) -> frozenset[str]:
        """The kinds of findings that end the session, whatever the node's `claims` says."""
        return frozenset()

    @property
    def chunk_s(self) -> float:
        """About how much time one chunk covers: part of every path's delay."""
        return 0.0

    def specs(self) -> Specs:
        """The specs of the outputs, by name, known from the parameters before anything is opened. Raises ParameterError."""
        raise NotImplementedError

    def facts(self) -> Mapping[str, Any]:
        """What this source knows of the session before it begins: a recording's subject. It goes before what the graph says."""
        return {}

    def prepare(self) -> None:
        """Compile what reading takes (or have it taken from the cache). It is called before a session's devices open."""

    def present(self) -> bool | None:
        """Whether what this source opens is there now (its port, its file); None: only opening it can tell.

        While it is not there, a source that failed is not opened; it is as soon as it is there again.
        """
        return None

    def missing(self) -> str:
        """What this source opens and cannot find, with the nearest: "serial port /dev/ttyUSB0 does not exist; did you mean ...?".

        "": it is there, or only opening it can tell. Asked before a session compiles; opens nothing, and takes two seconds at most.
        Raises DeviceError where a library is missing.
        """
        return ""

    def read(self, feed: Feed) -> None:
        """Open, read and emit until `feed.stopped`, close. Runs in its own thread."""
        raise NotImplementedError

    def impedances(self, feed: Feed) -> Iterator[Impedance] | None:
        """Open the device, have it measure its electrodes one after the other, close it; None: it cannot. Before a session only."""
        return None

    def simulated(self) -> AbstractContextManager[Source] | None:
        """This source as it reads a simulated device, which exists as long as the context lasts; None: there is no simulator.

        `kinegraph run --simulate` puts it in the source's place. The simulated device speaks the real protocol through the real transport.
        It comes from the entry-point group `kinegraph.simulators`, under the class's dotted path: a function of the source.
        """
        from importlib.metadata import entry_points

        from kinegraph.stream.system.names import use_of

        known = entry_points(group="kinegraph.simulators")
        for cls in type(self).__mro__:
            for entry in known.select(name=use_of(cls)):
                device: AbstractContextManager[Source] = entry.load()(self)
                return device
        return None

    def unopened(self) -> Self:
        return replace(self)  # type: ignore[type-var]
