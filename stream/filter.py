"""A filter, declared once: a kernel, its parameters and its typed state.

    @dataclass(frozen=True, slots=True)
    class Smooth(Filter[SmoothState]):
        tau_s: float = param(above=0.0)
        kernel = smoothed                       # def smoothed(x, share, level, out), under @kernel

        def begin(self, spec):
            return SmoothState(share=1 / (self.tau_s * spec.rate_hz), level=np.zeros(spec.shape))

`process` follows from that. A kernel's arguments are found by their names: what flows (`FLOW`), then fields of the state, then parameters.
They are looked up once, when the operator is opened.

The gap rule. A gap shows as `chunk.lost != 0`. Its length is the time from the last sample before it to the first one after it, less one
period. Up to `reset_gap_s` the state is held, as if the samples on both sides were neighbours; beyond it the state is what `begin` made.
`lost` is passed on at the same place either way, and the output's `settling_s` says for how long values are not settled after it.

The rule for bad samples. NaN in gives NaN out and holds the state, channel by channel; infinity is treated as NaN (`stream.data.finite`).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, ClassVar, TypeAlias, TypeVar

import numpy as np

from kinegraph.stream.chunk import FOREVER, NEVER, NS, STAMP, Array, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.data.require import numeric, width_of
from kinegraph.stream.data.state import pack, unpack
from kinegraph.stream.domain.rotation import rotation_free
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.operator import Input, Operator
from kinegraph.stream.params import param

S = TypeVar("S")
Kernel: TypeAlias = Callable[..., None]
Run: TypeAlias = Callable[[Array, Times, Array, Times], None]
FLOW = ("x", "time", "out", "stamps")
"""What a kernel may be given of a chunk: samples `x` (n, width) and their stamps `time` (n,), and where to write what comes out: samples
`out` (m, width) and their stamps `stamps` (m,). One that has no `stamps` leaves them as they are."""


@dataclass(slots=True, kw_only=True)
class FilterState:
    """What the state of a filter holds beside its own fields.

    delay_s     how much earlier than its newest sample's stamp an output's is
    settling_s  for how long values are not settled, after the start and after a reset
    last        (1,) stamp of the newest sample
    """

    delay_s: float = 0.0
    settling_s: float = 0.0
    last: Times = field(default_factory=lambda: np.array([NEVER]))

    @property
    def delay_ns(self) -> int:
        """What a kernel subtracts from stamps."""
        return round(self.delay_s * NS)


@dataclass(frozen=True, slots=True)
class Bound:
    """What `process` needs, looked up once.

    kernel    what is done
    run       the kernel, to be called with the flow alone
    width     numbers per sample that the kernel takes; `plain`: chunks are rows of these already
    wide      numbers per sample that comes out
    shape     of a sample that comes out, where that is not a row
    last      (1,) where the newest stamp is noted; None: nowhere
    thins     whether some samples are left out
    moves     whether stamps that come out are others than those that came in
    sparse    whether the rate changes: then a chunk of which nothing comes out says nothing
    unusual   whether chunks need more than the kernel, all of them
    nothing   no samples and no stamps
    rest      what the state is at the beginning
    """

    kernel: Kernel
    run: Run
    width: int
    wide: int
    plain: bool
    dtype: np.dtype[Any]
    shape: tuple[int, ...] | None
    last: Times | None
    thins: bool
    moves: bool
    unusual: bool
    sparse: bool
    period_ns: int
    limit_ns: int
    delay_ns: int
    nothing: tuple[Array, Times]
    rest: dict[str, Array]


class SampleWise(Operator[S]):
    """One kernel over a stream of numbers: signals (channels,), and others, such as markers (points, 3), each number for itself.

    What is lost is passed on, and nothing else made of it; what has a memory that a gap resets is a `Filter`.

    kernel       what is done; `begin` may choose another
    keeps_dtype  whether the kernel takes samples of any dtype, and gives out the same; else it is given float64, and gives that
    blends       whether numbers of several samples go into one: rotations are refused then
    """

    __slots__ = ("bound",)
    inputs = {"in": Input(rows=True)}
    contiguous = True
    kernel: ClassVar[Kernel]
    keeps_dtype: ClassVar[bool] = False
    blends: ClassVar[bool] = False
    bound: Bound

    def begin(self, spec: StreamSpec) -> S | tuple[S, Kernel]:
        """Check the input's spec and make the state, a slotted dataclass; with it the kernel, where a parameter chooses one."""
        raise NotImplementedError

    def gives(self, spec: StreamSpec) -> StreamSpec:
        """The spec of what comes out; `spec` is the input's, with the output's dtype and settling."""
        return spec

    def rows(self, n: int) -> int:
        """How many samples come out of the next `n`. Where that is not as many, the kernel writes their stamps."""
        return n

    def gap(self, chunk: Chunk) -> int:
        """Something is lost before this chunk: what becomes of the state. Returns the `lost` that is passed on."""
        return chunk.lost

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        dtype = spec.dtype if self.keeps_dtype else numeric(spec).dtype
        if self.blends:
            rotation_free(spec)
        begun = self.begin(spec)
        state, kernel = begun if isinstance(begun, tuple) else (begun, type(self).kernel)
        self.set_state(state, delay_s=getattr(state, "delay_s", 0.0))
        settling_s = spec.settling_s + getattr(state, "settling_s", 0.0)
        out = self.gives(spec.derive(dtype=dtype, settling_s=settling_s))
        thins = type(self).rows is not SampleWise.rows
        if thins and "stamps" not in arguments(kernel):
            raise KinegraphError(
                f"{type(self).__name__} leaves samples out (`rows`), so its kernel must be given `stamps`"
            )
        wide = width_of(out)
        plain, flat = len(spec.shape) == 1 and spec.dtype == dtype, len(out.shape) == 1
        bound = Bound(
            kernel=kernel,
            run=self._bind(kernel),
            width=width_of(spec),
            wide=wide,
            plain=plain,
            dtype=dtype,
            shape=None if flat else out.shape,
            last=getattr(state, "last", None),
            thins=thins,
            moves="stamps" in arguments(kernel),
            unusual=not plain or not flat or thins,
            sparse=out.rate_hz != spec.rate_hz,
            period_ns=spec.period_ns,
            limit_ns=round(getattr(self, "reset_gap_s", 0.0) * NS),
            delay_ns=round(self.delay_s * NS),
            nothing=(np.empty((0, wide), dtype), np.empty(0, STAMP)),
            rest=pack(state),
        )
        object.__setattr__(self, "bound", bound)
        return {"out": out}

    def _bind(self, kernel: Kernel) -> Run:
        """The kernel with everything but the flow given."""
        given = {name: self._given(kernel, name) for name in arguments(kernel) if name not in FLOW}
        call = f"lambda {', '.join(FLOW)}: kernel({', '.join(arguments(kernel))})"
        return eval(call, {"kernel": kernel, **given})  # type: ignore[no-any-return]

    def _given(self, kernel: Kernel, name: str) -> Any:
        for owner in (self.state, self):
            if hasattr(owner, name):
                return getattr(owner, name)
        known = [n for owner in (self.state, self) for n in getattr(owner, "__dataclass_fields__", ())]
        raise KinegraphError(
            f"the kernel of {type(self).__name__} is to be given {name!r}, which is neither a field of its state nor a parameter:"
            f" {nearest(name, known)}"
        )

    def restore(self, arrays: dict[str, Array]) -> None:
        super().restore(arrays)
        last = getattr(self.state, "last", None)
        object.__setattr__(self, "bound", replace(self.bound, run=self._bind(self.bound.kernel), last=last))

    def process(self, port: str, chunk: Chunk) -> Chunk | None:
        bound, time = self.bound, chunk.time
        n = len(time)
        if chunk.lost or not n or bound.unusual:
            return self._process_any(chunk)
        if bound.last is not None:
            bound.last[0] = time[-1]
        out, stamps = np.empty((n, bound.wide), bound.dtype), np.empty(n, STAMP) if bound.moves else time
        bound.run(chunk.data, time, out, stamps)
        until = chunk.until
        return Chunk(stamps, out, until if until == FOREVER else until - bound.delay_ns)

    def _process_any(self, chunk: Chunk) -> Chunk | None:
        """What `process` does, for a chunk of any kind."""
        bound, time, n = self.bound, chunk.time, len(chunk.time)
        lost = self.gap(chunk) if chunk.lost else 0
        if not n:
            return self._nothing(chunk, lost)
        if bound.last is not None:
            bound.last[0] = time[-1]
        x = chunk.data
        if x.ndim != 2 or x.dtype != bound.dtype:
            x = np.ascontiguousarray(x, bound.dtype).reshape(n, bound.width)
        m = self.rows(n) if bound.thins else n
        if not m:
            out, stamps = bound.nothing
        else:
            out, stamps = np.empty((m, bound.wide), bound.dtype), np.empty(m, STAMP) if bound.moves else time
        bound.run(x, time, out, stamps)
        if not m:
            return None if bound.sparse and not lost else self._nothing(chunk, lost)
        made = out if bound.shape is None else out.reshape(m, *bound.shape)
        return Chunk(stamps, made, before(chunk.until, bound.delay_ns), lost)

    def _nothing(self, chunk: Chunk, lost: int) -> Chunk:
        """Nothing comes out, but time has passed."""
        out, stamps = self.bound.nothing
        made = out if self.bound.shape is None else out.reshape(0, *self.bound.shape)
        return Chunk(stamps, made, before(chunk.until, self.bound.delay_ns), lost)


RESET = "a longer gap resets the state; up to it, samples on both sides are neighbours"


def reset_gap(default: float, help: str = RESET, *, above: float | None = None, most: float | None = None) -> Any:
    """The parameter `reset_gap_s`, by which an operator says after which gaps it forgets what was before; 0 may be given unless `above`."""
    return param(default, above=above, least=0.0 if above is None else None, most=most, help=help)


@dataclass(frozen=True, slots=True, kw_only=True)
class Filter(SampleWise[S]):
    """What has a memory of the samples before: its state is a `FilterState`, and a gap longer than `reset_gap_s` resets it."""

    blends: ClassVar[bool] = True
    reset_gap_s: float = reset_gap(0.1)

    def gap(self, chunk: Chunk) -> int:
        if self.breaks(chunk):
            unpack(self.state, self.bound.rest)
        return chunk.lost

    def gap_ns(self, chunk: Chunk) -> int:
        """How much time is missing before a chunk that holds samples."""
        last = self.bound.last
        assert last is not None
        return chunk.time.item(0) - last.item(0) - self.bound.period_ns

    def breaks(self, chunk: Chunk) -> bool:
        """Whether the gap before this chunk is long enough to reset the state."""
        return len(chunk.time) > 0 and self.gap_ns(chunk) > self.bound.limit_ns

    def missing(self, chunk: Chunk) -> int:
        """How many samples of the regular grid lie in the gap before this chunk, judged by its stamps."""
        return max(0, round(self.gap_ns(chunk) / self.bound.period_ns))


def before(until: int, delay_ns: int) -> int:
    """The input's watermark, moved back by `delay_ns` for the output."""
    return until - delay_ns if NEVER < until < FOREVER else until


@cache
def arguments(kernel: Kernel) -> tuple[str, ...]:
    """The names of what a kernel is given."""
    return tuple(inspect.signature(kernel).parameters)
