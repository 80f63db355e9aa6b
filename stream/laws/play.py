"""An operator at work under watch: fed as the engine feeds it, everything that it emits checked and kept."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kinegraph.stream.chunk import NEVER, Array, Chunk, Specs, StreamSpec, add_lost, utc
from kinegraph.stream.data.rows import taking
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.laws.chunking import Delivery
from kinegraph.stream.laws.violations import Broken
from kinegraph.stream.operator import Case, Emitted, Operator
from kinegraph.stream.outlet import Outlet

TOLERANCE = 0.01
"""How far two stamps of a regular stream may be from one period apart, in periods (and as far again as the inputs' are)."""


@dataclass(slots=True)
class Output:
    """All that came out of one output."""

    spec: StreamSpec
    kept: list[tuple[Chunk, Array, Array, bool]] = field(default_factory=list)
    """Every chunk, copies of its stamps and samples at that time, and whether it came at close."""
    until: int = NEVER
    last: int = NEVER
    pending_gap: int = 0
    lost: list[int] = field(default_factory=list)
    lag_ns: int = NEVER
    """The longest that a sample lagged behind the newest input sample, where these came one by one."""

    @property
    def time(self) -> Array:
        return np.concatenate([np.empty(0, np.int64), *(time for _, time, _, _ in self.kept)])

    @property
    def data(self) -> Array:
        return np.concatenate(
            [np.empty((0, *self.spec.shape), self.spec.dtype), *(data for _, _, data, _ in self.kept)]
        )

    def __len__(self) -> int:
        return len(self.lost)


class Player:
    """One run of an operator."""

    def __init__(self, case: Case, jitter_ns: int = 0, excused: frozenset[str] = frozenset()) -> None:
        """`jitter_ns`: how far the inputs' stamps are from their own grid; `excused`: rules that need not hold."""
        self._fresh, self._jitter_ns, self._excused = case.operator, jitter_ns, excused
        self.specs: Specs = {port: spec for port, (spec, _, _) in case.inputs.items()}
        self.operator, outputs = self._open()
        self.merge = Merge(self.specs, self.operator.inputs) if len(self.specs) > 1 else None
        self.outputs = {name: Output(spec) for name, spec in outputs.items()}
        self.newest = self.reached = NEVER
        self._singly = False
        self.log: list[tuple[Any, ...]] = []
        """Every emission in order, as bytes: for comparing runs chunk for chunk."""

    def name_ports(self, order: Sequence[str]) -> None:
        """Merge the inputs as if the operator named its ports in this order; before anything is fed."""
        operator = self.operator
        self.merge = Merge({port: self.specs[port] for port in order}, operator.inputs)

    def _open(self) -> tuple[Operator[Any], Specs]:
        operator = self._fresh.unopened()
        opened = operator.open(dict(self.specs))
        if tuple(opened) != type(operator).outputs:
            raise Broken(
                "spec", f"`open` returned specs of {[*opened]}, the class declares outputs {[*type(operator).outputs]}"
            )
        if isinstance(operator, Outlet):
            operator.begin()
        self._take = taking(operator, self.specs)
        return operator, opened

    def play(self, delivery: Delivery) -> Player:
        """Everything in order, then close."""
        for port, chunk in delivery:
            self.feed(port, chunk)
        self.close()
        return self

    def feed(self, port: str, chunk: Chunk) -> None:
        """One chunk arrives; inputs are merged as in a graph."""
        for name, piece in self.merge.push(port, chunk) if self.merge else [(port, chunk)]:
            if len(piece):
                self.newest = max(self.newest, int(piece.time[-1]))
            self.reached = max(self.reached, self.newest, piece.until)
            try:
                emitted = self._process(name, piece)
            except Exception as error:
                where = utc(int(piece.time[0])) if len(piece) else f"until {utc(piece.until)}"
                raise _raised(f"process('{name}', {piece}) at {where}", error) from error
            self._singly = len(piece) == 1
            self._accept(emitted, at_close=False)

    def _process(self, port: str, chunk: Chunk) -> Emitted:
        return self.operator.process(port, self._take(port, chunk))

    def close(self) -> None:
        try:
            emitted = self.operator.close()
        except Exception as error:
            raise _raised("close()", error) from error
        self._accept(emitted, at_close=True)
        for name, output in self.outputs.items():
            for chunk, time, data, _ in output.kept:
                if chunk.time.tobytes() != time.tobytes() or chunk.data.tobytes() != data.tobytes():
                    raise Broken("emitted", f"{_place(name, time)} was changed after it had been emitted")

    def hand_over(self, *, by_file: bool) -> None:
        """Go on with a new instance that was given this one's snapshot, `by_file` after a trip through a file."""
        arrays = self._snapshot()
        if by_file:
            arrays = through_file(arrays)
        operator, _ = self._open()
        try:
            operator.restore(arrays)
        except Exception as error:
            raise Broken("state", f"restore() raised {_text(error)}") from error
        self.operator = operator
        if self.merge:
            held = self.merge.snapshot()
            self.merge = Merge(self.specs, operator.inputs)
            self.merge.restore(through_file(held) if by_file else held)

    def _snapshot(self) -> dict[str, Array]:
        try:
            arrays = self.operator.snapshot()
        except Exception as error:
            raise Broken("state", f"snapshot() raised {_text(error)}") from error
        for name, array in arrays.items():
            if not isinstance(array, np.ndarray) or array.dtype.hasobject:
                raise Broken("state", f"snapshot()[{name!r}] is not a plain array: {array!r:.80}")
        return arrays

    @property
    def state_bytes(self) -> int:
        return sum(array.nbytes for array in self._snapshot().values())

    def _accept(self, emitted: Emitted, *, at_close: bool) -> None:
        if emitted is None:
            return
        if isinstance(emitted, Chunk):
            emitted = [(next(iter(self.outputs), ""), emitted)]
        for name, chunk in emitted:
            if name not in self.outputs:
                raise Broken(
                    "spec", f"a chunk for output {name!r}; there {'are' if self.outputs else 'is'} {[*self.outputs]}"
                )
            self._check(name, self.outputs[name], chunk)
            self._keep(name, self.outputs[name], chunk, at_close)

    def _check(self, name: str, output: Output, chunk: Chunk) -> None:
        spec, time, data = output.spec, chunk.time, chunk.data
        where = _place(name, time)
        if not isinstance(time, np.ndarray) or time.dtype != np.int64 or time.ndim != 1:
            raise Broken("spec", f"{where} has stamps of {_kind(time)}, not (n,) int64")
        if not isinstance(data, np.ndarray) or data.dtype != spec.dtype or data.shape != (len(time), *spec.shape):
            raise Broken("spec", f"{where} is {_kind(data)}; its spec says {(len(time), *spec.shape)} {spec.dtype}")
        if not data.flags.carray or not time.flags.carray:
            raise Broken("arrays", f"{where} is {'not writable' if data.flags.c_contiguous else 'not C-contiguous'}")
        if (
            not isinstance(chunk.until, int | np.integer)
            or not isinstance(chunk.lost, int | np.integer)
            or chunk.lost < -1
        ):
            raise Broken(
                "spec",
                f"{where} has until={chunk.until!r} and lost={chunk.lost!r}; both are whole numbers, lost at least -1",
            )
        if chunk.until < output.until:
            raise Broken("until", f"{where} has until {utc(chunk.until)}, after {utc(output.until)} had been promised")
        if not len(time):
            return
        if time[0] <= output.until:
            raise Broken(
                "until",
                f"{where} holds a sample of {utc(int(time[0]))}; complete until {utc(output.until)} had been promised",
            )
        steps = np.diff(time, prepend=output.last) if output.last != NEVER else np.diff(time)
        if (steps < 0).any():
            raise Broken("order", f"{where} steps back in time by {-int(steps.min())} ns")
        if time[-1] > self.reached:
            raise Broken(
                "delay",
                f"{where} holds a sample of {utc(int(time[-1]))}; the inputs are no further than {utc(self.reached)}",
            )
        self._check_spacing(where, output, chunk, steps)

    def _check_spacing(self, where: str, output: Output, chunk: Chunk, steps: Array) -> None:
        period = output.spec.period_ns
        if not period or "spacing" in self._excused:
            return
        if output.last != NEVER and add_lost(output.pending_gap, chunk.lost):
            steps = steps[1:]
        off = np.abs(steps - period)
        allowed = TOLERANCE * period + 2 + 2 * self._jitter_ns
        if (off > allowed).any():
            k = int(off.argmax())
            raise Broken(
                "spacing", f"{where} has stamps {int(steps[k])} ns apart, with nothing lost; the period is {period} ns"
            )

    def _keep(self, name: str, output: Output, chunk: Chunk, at_close: bool) -> None:
        time, data = chunk.time.copy(), chunk.data.copy()
        self.log.append((name, time.tobytes(), data.tobytes(), int(chunk.until), int(chunk.lost)))
        output.kept.append((chunk, time, data, at_close))
        output.until = int(chunk.until)
        output.pending_gap = add_lost(output.pending_gap, int(chunk.lost))
        if len(time):
            output.lost += [output.pending_gap, *[0] * (len(time) - 1)]
            output.pending_gap = 0
            output.last = int(time[-1])
            if self._singly and not at_close:
                output.lag_ns = max(output.lag_ns, self.newest - int(time[0]))


def through_file(arrays: dict[str, Array]) -> dict[str, Array]:
    """Written to a file and read again."""
    file = io.BytesIO()
    np.savez(file, **{f"a/{name}": array for name, array in arrays.items()})  # type: ignore[arg-type]
    file.seek(0)
    with np.load(file, allow_pickle=False) as found:
        return {name.removeprefix("a/"): found[name] for name in found.files}


def differ(one: Player, other: Player) -> str:
    """Where two runs give different samples, stamps or gap positions first; "" if nowhere."""
    for name, first in one.outputs.items():
        second = other.outputs[name]
        n = min(len(first), len(second))
        for what, a, b in (
            ("stamp", first.time, second.time),
            ("sample", first.data, second.data),
            ("lost", first.lost, second.lost),
        ):
            a, b = np.asarray(a), np.asarray(b)
            if a[:n].tobytes() != b[:n].tobytes():
                k = next(k for k in range(n) if a[k].tobytes() != b[k].tobytes())
                return f"output '{name}', sample {k} at {utc(int(first.time[k]))}: {what} {_short(b[k])} instead of {_short(a[k])}"
        if len(first) != len(second):
            longer = first if len(first) > n else second
            return f"output '{name}' gives {len(second)} samples instead of {len(first)} (sample {n} is at {utc(int(longer.time[n]))})"
        if first.pending_gap != second.pending_gap:
            return f"output '{name}' ends with lost={second.pending_gap} instead of {first.pending_gap}"
    return ""


def _short(value: Array) -> str:
    return " ".join(np.array2string(np.asarray(value), precision=17, threshold=6, edgeitems=3).split())


def _place(name: str, time: Array) -> str:
    return (
        f"output '{name}', chunk of {len(time)} at {utc(int(time[0]))}"
        if len(time)
        else f"output '{name}', empty chunk"
    )


def _kind(array: object) -> str:
    return f"{array.shape} {array.dtype}" if isinstance(array, np.ndarray) else type(array).__name__


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _raised(doing: str, error: Exception) -> Broken | KinegraphError:
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    at = f" (line {frame.tb_lineno} of {frame.tb_frame.f_code.co_filename})" if frame else ""
    return Broken("runs", f"{doing} raised {_text(error)}{at}")
