"""What is done to streams: the operator, its ports, its state, and the cases it is tried on.

An operator is three things: frozen parameters (its dataclass fields), a state, and `process`. It remembers nothing outside the state,
so that a snapshot of the state is a snapshot of the operator. `docs/extend/operator.md` shows how to write one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar, Generic, Self, TypeAlias, TypeVar

import numpy as np

from kinegraph.stream.chunk import FOREVER, Array, Chunk, Specs, StreamSpec, stamps
from kinegraph.stream.chunk import grid as grid
from kinegraph.stream.data.arrays import series
from kinegraph.stream.data.inputs import ANY as ANY
from kinegraph.stream.data.inputs import Input as Input
from kinegraph.stream.data.inputs import input_of as input_of
from kinegraph.stream.data.series import Series
from kinegraph.stream.data.state import pack, size_of, unpack
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.params import check, check_names

S = TypeVar("S")

Emitted: TypeAlias = Chunk | Sequence[tuple[str, Chunk]] | None
"""What `process` gives back: a chunk for the first output, nothing, or (output, chunk) pairs in the order of emission."""


class Operator(Generic[S]):
    """Something done to streams. Subclasses are frozen dataclasses of parameters:

        @dataclass(frozen=True, slots=True)
        class Gain(Operator[GainState]):
            factor: float = param(1.0)

    inputs     the input ports by name, `{"in": Input()}` by default; an operator with several gets its samples in global time order.
               `{ANY: Input()}`: any number of inputs (at least one), named after what they are connected to
    outputs    names of the output ports; the first is the default in a graph
    contiguous whether what it emits always is C-contiguous, aligned and writable, so that the engine need not look (the laws do)
    delays     in words, for the docs: by how much its stamps are earlier than what it has been given
    references what its numbers equal, or where its method is from
    exemptions rules of the laws (stream/laws/violations.py) that do not hold here on purpose, each with the reason, for the docs
    panels     panels of its own for the page: per kind, the name of a JavaScript module beside this one (docs/extend/panel.md)
    """

    __slots__ = ("decision_s", "delay_s", "state")
    inputs: ClassVar[Mapping[str, Input]] = {"in": Input()}
    outputs: ClassVar[tuple[str, ...]] = ("out",)
    is_outlet: ClassVar[bool] = False
    contiguous: ClassVar[bool] = False
    delays: ClassVar[str] = "0"
    references: ClassVar[str] = ""
    exemptions: ClassVar[dict[str, str]] = {}
    panels: ClassVar[Mapping[str, str]] = {}

    state: S
    delay_s: float
    """Delay between an output's stamp and the newest input sample it needed (group delay, windows, look-ahead); set by `set_state`."""
    decision_s: Mapping[str, float]
    """By output of events: the longest time from the `end` (else `onset`) that an event describes to the event, in the operator's own
    input time; the delay of an event that led to it is added. Alarms that are over do not count. An output that is missing here promises
    nothing. Set by `set_state`."""

    def __new__(cls, *values: Any, **named: Any) -> Self:
        check_names(cls, named)
        return super().__new__(cls)

    def __post_init__(self) -> None:
        check(self)

    def open(self, specs: Specs) -> Specs:
        """Check the input specs (by port), allocate the state with `set_state`, and return the output specs (by port).

        Raises ParameterError or InputError for everything that can be wrong, before any device opens.
        """
        raise NotImplementedError

    def check_session(self, session: Mapping[str, Any]) -> None:
        """Raise ParameterError if the operator does not fit the session's facts (subject, side, ...); {} if no fact is known.

        Called before a session or a replay begins, in a replay with the facts of the recording.
        """

    def annotations_understood(self) -> Sequence[str]:
        """What a person may say to it by an annotation, as the page's buttons offer it; one that ends in a blank takes a text behind it."""
        return ()

    def process(self, port: str, chunk: Chunk) -> Emitted:
        """Take a chunk from an input port, and give back what it leads to: a function of the state and the samples alone.

        `chunk.lost` is non-zero only with samples. Every emission must carry an `until`: what it promises about the output.
        Arrays that are emitted are C-contiguous and never written again.
        """
        raise NotImplementedError

    def close(self) -> Emitted:
        """Emit what is still pending; called once, when every input has ended."""
        return None

    @classmethod
    def cases(cls) -> Sequence[Case]:
        """What the laws try this operator on: at least one case, with enough samples that its windows fill and outputs come."""
        return ()

    @classmethod
    def warm_up_cases(cls) -> Sequence[Case]:
        """What it is run on before devices open: cases that call every kernel with arguments of every type that `cases` do, only sooner."""
        return cls.cases()

    def set_state(self, state: S, *, delay_s: float = 0.0, decision_s: Mapping[str, float] | None = None) -> None:
        """Keep the state (a slotted dataclass of arrays, numbers and texts) and declare the delays; called by `open`."""
        object.__setattr__(self, "state", state)
        object.__setattr__(self, "delay_s", delay_s)
        object.__setattr__(self, "decision_s", dict(decision_s or {}))

    def unopened(self) -> Self:
        """The same operator, not opened."""
        return replace(self)  # type: ignore[type-var]

    def snapshot(self) -> dict[str, Array]:
        """The state as plain arrays (copies)."""
        return pack(self.state)

    def restore(self, arrays: dict[str, Array]) -> None:
        """Go on from a snapshot of an operator with the same parameters and input specs; `open` comes first."""
        unpack(self.state, arrays)

    def __call__(
        self,
        data: Any,
        *,
        rate_hz: float | None = None,
        time: Any = None,
        channels: Sequence[str] = (),
        units: Sequence[str] = ("",),
    ) -> Any:
        """What this operator makes of a whole array (n,), (n, channels) or (n, *shape): its output as an array, without stamps.

        `rate_hz`, or `time` (n,) int64 ns, says when the samples were taken. Of an operator with several outputs: a mapping of arrays. For
        stamps, and for operators with several inputs, put it into a `kinegraph.Graph`.
        """
        given = series(data, rate_hz=rate_hz, time=time, channels=channels, units=units)
        made = _applied(self, given)
        flat = np.ndim(data) == 1 and not given.spec.is_event
        out = {name: x[:, 0] if flat and x.ndim == 2 and x.shape[1] == 1 else x for name, x in made.items()}
        return out if len(out) > 1 else next(iter(out.values()), None)

    @property
    def memory_bytes(self) -> int:
        """What the state takes now."""
        return size_of(self.state)


@dataclass(frozen=True, slots=True)
class Case:
    """One set-up that an operator must obey the laws on.

    operator   its parameters
    inputs     per port: the spec and the samples (times (n,) int64 ns, data (n, *shape)); enough to fill every window
    least      how many output samples must come out (over all ports) for the trial to mean anything
    """

    operator: Operator[Any]
    inputs: dict[str, tuple[StreamSpec, Array, Array]]
    least: int = 1

    def __post_init__(self) -> None:
        for port, (_, time, _) in self.inputs.items():
            stamps(time, port)


def _applied(operator: Operator[Any], given: Series) -> dict[str, Array]:
    """What an operator with one input makes of a whole stream: every output's samples, by name."""
    from kinegraph.stream.data.rows import taking  # it has kernels, and numba takes long to import

    fresh = operator.unopened()
    port = _required_input(operator)
    specs = fresh.open({port: given.spec})
    take = taking(fresh, {port: given.spec})
    found: dict[str, list[Array]] = {name: [np.empty((0, *spec.shape), spec.dtype)] for name, spec in specs.items()}

    def keep(emitted: Emitted) -> None:
        if emitted is not None:
            pairs = [(next(iter(specs)), emitted)] if isinstance(emitted, Chunk) else emitted
            for output, chunk in pairs:
                found[output].append(chunk.data)

    starts = [0, *(np.flatnonzero(given.lost[1:]) + 1 if given.lost is not None else ()), len(given.time)]
    for start, stop in pairwise(starts):
        lost = int(given.lost[start]) if given.lost is not None else 0
        until = FOREVER if stop == len(given.time) else int(given.time[stop]) - 1
        chunk = Chunk(given.time[start:stop], np.ascontiguousarray(given.data[start:stop]), until, lost)
        keep(fresh.process(port, take(port, chunk)))
    keep(fresh.close())
    return {name: np.concatenate(parts) for name, parts in found.items()}


def _required_input(operator: Operator[Any]) -> str:
    """The one input that must be connected. Raises KinegraphError where there are several."""
    required = [port for port, declared in operator.inputs.items() if not declared.optional]
    if ANY in required or len(required) > 1:
        takes = "any number of inputs" if ANY in required else f"the inputs {', '.join(map(repr, required))}"
        raise KinegraphError(
            f"{type(operator).__name__} takes {takes}; put it into a kinegraph.Graph and run that on the arrays"
        )
    return (required or list(operator.inputs))[0]
