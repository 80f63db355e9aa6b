"""A segment: operators in a row as one function, written out for it.

Where an operator is the only reader of an edge and has one input, nothing is left to decide while a graph runs: the calls of all
operators in a row are written one below the other and compiled once. That costs a fraction of a loop that asks each time what comes
next. Only what comes most is written out: a chunk in normal arrays and without `lost`, one chunk given back for it. At anything else the
function is left for `LiveEdge.carry` or `Stage.emit`, which do the same step by step. Neighbours whose work is a kernel each are one call,
of machine code that runs one kernel after the other (`stream.engine.flow.row`), unless an edge between them is observed.

Timing reads the clock once per operator. Reading it may cost more than an operator that does little, so a segment that runs without a rest,
as in a replay, times one passage in eight or so: after each that was timed, as many follow untimed as fit into seven times its length.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain
from time import perf_counter_ns
from typing import Any

import numpy as np

from kinegraph.stream.chunk import FOREVER, STAMP, Array, Chunk, Times
from kinegraph.stream.engine.flow.edge import InputPort, LiveEdge, Push, failure
from kinegraph.stream.engine.flow.metrics import add
from kinegraph.stream.engine.flow.promise import PromiseError
from kinegraph.stream.engine.flow.row import Row, step_of
from kinegraph.stream.errors import asked_to_end
from kinegraph.stream.filter import KernelCall

REST = 7
"""After a passage that was timed, others pass untimed for this many times its length."""
LONGEST = 64
"""A segment has at most this many operators; another one begins behind it."""


@dataclass(slots=True)
class Span:
    """What one call does: an operator, or a row of them.

    before  the number of the edge that it reads
    after   the number of the edge that it feeds
    """

    ports: list[InputPort]
    row: Row | None
    before: int

    @property
    def after(self) -> int:
        return self.before + len(self.ports)


class CompiledSegment:
    """The operators in a row behind an edge.

    edges   before, between and after them
    spans   what is called, in order
    send    takes a chunk and the time at which the caller ended; returns the time at which the work ended (ns, perf_counter)
    """

    def __init__(self, edge: LiveEdge) -> None:
        ports, self.edges = _in_a_row(edge)
        self.spans = list(_spans(ports, self.edges))
        self._timed: list[list[tuple[int, ...]]] = [[] for _ in self.spans]
        self._code = Code(self.edges, self.spans)
        names: dict[str, Any] = {"clock": perf_counter_ns, "Chunk": Chunk, "due": 0, "trouble": self._trouble}
        names |= {"FOREVER": FOREVER, "STAMP": STAMP, "slot0": edge.slot, "empty": np.empty}
        for i, edge in enumerate(self.edges):
            names |= {f"edge{i}": edge, f"carry{i}": edge.carry, f"dtype{i}": edge.spec.dtype}
            names |= {f"observe{i}_{k}": observe for k, observe in enumerate(edge.observers)}
        for i, span in enumerate(self.spans):
            port = span.ports[0]
            names |= {
                f"process{i}": port.operator.process,
                f"port{i}": port.port,
                f"emit{i}": port.emit,
                f"in{i}": port,
            }
            names["slot"] = port.slot
            names |= {f"note{i}": self._timed[i].append}
            if row := span.row:
                names[f"stray{i}"] = partial(self._stray, span)
                names |= {f"row{i}": row, f"run{i}": row.run, f"table{i}": row.table, f"rows{i}": row.rows}
        names |= {f"push{k}": push for k, push in enumerate(self.edges[-1].readers)} | {"taken_back": taken_back}
        exec(compile("\n".join(self._code.lines), f"<segment behind {edge.origin}>", "exec"), names)
        self.send: Push = names["send"]

    def fold(self, least: int) -> None:
        """Hand the durations measured so far to the operators' timings, where there are at least `least`."""
        for noted in self._timed:
            if len(noted) < max(least, 1):
                continue
            taken = noted[:]
            del noted[: len(taken)]
            times = np.fromiter(chain.from_iterable(taken), np.int64).reshape(len(taken), -1)
            for i, span in enumerate(self.spans[: times.shape[1] - 1]):
                if not span.row:
                    add(times, i, span.ports[0].timing)
        for span in self.spans:
            if span.row:
                span.row.fold([port.timing for port in span.ports], least)

    def _stray(self, span: Span, place: int, chunk: Chunk) -> None:
        """A step of a row gave stamps that it must not give."""
        edge = self.edges[span.before + place].origin
        raise PromiseError(edge.node, edge.output, "stamps that run backwards, or ahead of its inputs", chunk)

    def _trouble(self, error: BaseException, found: dict[str, Any]) -> None:
        """Raise what an operator's exception means; nothing, where no operator of this segment raised it."""
        if asked_to_end(error):
            return
        trace = error.__traceback__
        line = trace.tb_lineno if trace else 0
        if (checked := self._code.checks_at.get(line)) is not None:
            self.edges[checked].check(found["given"])
        if (i := self._code.calls_at.get(line)) is not None:
            span = self.spans[i]
            port = span.ports[0]
            raise failure(port.node, error, port.port, found[f"c{span.before}"]) from error


class Code:
    """The text of a segment's function, `send(c0, t0)`.

    lines      of it
    calls_at   by line: the span that is called there
    checks_at  by line: the edge whose promise is checked there
    """

    def __init__(self, edges: list[LiveEdge], spans: list[Span]) -> None:
        self.edges, self.spans = edges, spans
        self.calls_at: dict[int, int] = {}
        self.checks_at: dict[int, int] = {}
        self.lines = self._written()

    def _written(self) -> list[str]:
        lines = [
            "def send(c0, t0):",
            "    global due",
            *self._entry(),
            *self._passed(0, "    "),
            "    try:",
        ]
        if self.spans:
            lines.append("        if t0 >= due:")
            self._write_out(lines, " " * 12, timed=True)
        self._write_out(lines, " " * 8, timed=False)
        lines += ["    except BaseException as error:", "        trouble(error, locals())", "        raise"]
        return lines

    def _write_out(self, lines: list[str], indent: str, *, timed: bool) -> None:
        """All calls, one below the other, and what ends the passage."""
        for i, span in enumerate(self.spans):
            written = (
                self._operator(i, span, timed=timed) if span.row is None else self._row(i, span, span.row, timed=timed)
            )
            for line in written:
                lines.append(indent + line)
                if "given.time" in line and "slot" not in line:
                    self.checks_at[len(lines)] = span.after
                if any(f"{called}{i}(" in line for called in ("process", "run", "rows")):
                    self.calls_at[len(lines)] = i
            lines += self._passed(span.after, indent, counted=True)
        count, last = len(self.spans), len(self.edges) - 1
        if timed:
            lines += [indent + line for line in self._noted(count - 1)]
        lines.append(f"{indent}t = t{count}" if timed else f"{indent}t = clock()")
        lines += [f"{indent}t = push{k}(c{last}, t)" for k in range(len(self.edges[-1].readers))]
        lines.append(f"{indent}return t")

    def _operator(self, i: int, span: Span, *, timed: bool) -> list[str]:
        """The call of an operator."""
        a, b = span.before, span.after
        end, noted = (f"t{i + 1}", self._noted(i)) if timed else ("clock()", [])
        untidy = "" if span.ports[0].contiguous else self._untidy(i + 1, "given")
        carried = [*(f"        {line}" for line in noted), f"        return carry{b}(given, {end})"]
        return [
            f"slot.port = in{i}",
            f"slot.chunk = c{a}",
            *self._called(i, span, a),
            *([f"t{i + 1} = clock()"] if timed else []),
            "if given.__class__ is not Chunk:",
            *(f"    {line}" for line in noted),
            f"    return {end} if given is None else emit{i}(given, {end})",
            f"p{b} = edge{b}.told",
            *self._the_same(i, a, b, carried),
            "    n = len(given.time)",
            f"    if given.lost or edge{b}.pending_gap or given.until < p{b} or {self._broken(b, 'given', f'c{a}.until')}{untidy}:",
            *carried,
            f"c{b} = given",
            f"edge{b}.told = c{b}.until",
        ]

    def _called(self, i: int, span: Span, a: int) -> list[str]:
        """The call itself; an operator from outside is given arrays that it cannot write to: views, or those lent to it."""
        if span.ports[0].is_ours:
            return [f"given = process{i}(port{i}, c{a})"]
        if self._lends(i - 1):
            return [
                f"given = process{i}(port{i}, c{a})",
                "if given.__class__ is Chunk and (given.time is stamps or given.data is out):",
                "    given = taken_back(given, stamps, out)",
            ]
        return [
            f"if c{a}.data is not slot.data or c{a}.time is not slot.time:",
            f"    slot.show(c{a})",
            f"shown = Chunk(slot.seen_time, slot.seen_data, c{a}.until, 0)",
            f"given = process{i}(port{i}, shown)",
            "if given is shown:",
            f"    given = c{a}",
            "elif given.__class__ is Chunk:",
            "    if given.time is slot.seen_time:",
            f"        given.time = c{a}.time",
            "    if given.data is slot.seen_data:",
            f"        given.data = c{a}.data",
        ]

    def _the_same(self, i: int, a: int, b: int, carried: list[str]) -> list[str]:
        """Arrays that the edge before has passed need not be looked at once more; ends with what introduces the other case."""
        before, after = self.edges[a].spec, self.edges[b].spec
        if (before.shape, before.dtype) != (after.shape, after.dtype):
            return ["if True:"]
        behind = f" or p{b} > p{a} and n and given.time.item(0) <= p{b}" if self.edges[b].looks_at_ends else ""
        untidy = " or not given.time.flags.carray" if i + 1 < len(self.spans) and self.spans[i + 1].row else ""
        return [
            f"if given.time is c{a}.time and given.data is c{a}.data:",
            f"    if given.lost or edge{b}.pending_gap or given.until < p{b}{behind}{untidy}:",
            *carried,
            "else:",
        ]

    def _lends(self, i: int) -> bool:
        """Whether the arrays that come out of span `i` are made for an operator from outside alone: a row's, which nobody else sees."""
        row = self.spans[i].row if i >= 0 else None
        next_one = self.spans[i + 1].ports[0] if i + 1 < len(self.spans) else None
        alone = not self.edges[self.spans[i].after].observers
        return row is not None and row.moves and next_one is not None and not next_one.is_ours and alone

    def _row(self, i: int, span: Span, row: Row, *, timed: bool) -> list[str]:
        """The call of a row, unless something about the chunk is unusual: then its first operator is called, and so on from there."""
        a, b = span.before, span.after
        pending_gap = "".join(f" or edge{k}.pending_gap" for k in range(a + 1, b))
        before = self._noted(i - 1) if timed and i else []
        end, noted = (f"t{i + 1}", self._noted(i)) if timed else ("clock()", [])
        kept = b if row.thinning is None else a + 1 + row.thinning
        given = f"c{a}.data, c{a}.time, out, stamps, table{i}"
        out = f"c{a}.until - {row.delay_ns}" if row.delay_ns else f"c{a}.until"
        return [
            f"if not n or c{a}.until == FOREVER or {out} < edge{b}.told{pending_gap}:",
            *(f"    {line}" for line in before),
            f"    return in{i}(c{a}, {f't{i}' if timed else 'clock()'})",
            f"if n > row{i}.room:",
            f"    row{i}.grow(n)",
            *(f"edge{k}.samples += n" for k in range(a + 1, kept)),
            *([f"n = rows{i}(n)"] if row.rows else []),
            *(f"edge{k}.samples += n" for k in range(kept, b)),
            f"out = empty((n, {row.width}))",
            f"stamps = {'empty(n, STAMP)' if row.moves else f'c{a}.time'}",
            f"slot.port = in{i}",
            f"slot.chunk = c{a}",
            f"t{i + 1} = run{i}({given}, {f't{i}' if timed else 0})",
            f"if t{i + 1} < 0:",
            f"    stray{i}(-t{i + 1}, c{a})",
            *(["if not n:", *(f"    {line}" for line in noted), f"    return {end}"] if row.rows else []),
            f"c{b} = Chunk(stamps, out, {out}, 0)",
            f"if edge{b}.pending_gap:",
            *(f"    {line}" for line in noted),
            f"    return carry{b}(c{b}, {end})",
            *(["out.setflags(False)", "stamps.setflags(False)"] if self._lends(i) else []),
            f"p{b} = edge{b}.told",
            f"edge{b}.told = c{b}.until",
        ]

    def _entry(self) -> list[str]:
        """What is unusual at the segment's first edge is carried step by step."""
        edge = self.edges[0]
        lines = ["    n = len(c0.time)"] if edge.slot is not None else []
        broken = f" or c0.until < p0 or {self._broken(0, 'c0', 'slot0.chunk.until')}" if edge.slot is not None else ""
        return [
            *(["    if c0.__class__ is not Chunk:", "        edge0.check(c0)"] if edge.slot is not None else []),
            *lines,
            "    p0 = edge0.told",
            f"    if c0.lost or edge0.pending_gap{broken}{self._untidy(0, 'c0')}:",
            "        return carry0(c0, t0)",
            "    edge0.told = c0.until",
        ]

    def _broken(self, i: int, chunk: str, reached: str) -> str:
        """The condition that a new chunk of `n` stamps may break what edge `i` promises: `LiveEdge.check` decides."""
        edge = self.edges[i]
        shape = "".join(f", {length}" for length in edge.spec.shape)
        says = (
            f"{chunk}.data.shape != (n{shape or ','}) or {chunk}.data.dtype is not dtype{i}"
            f" or {chunk}.time.dtype is not STAMP or {chunk}.time.ndim != 1"
        )
        if edge.looks_at_ends:
            first, last = f"{chunk}.time.item(0)", f"{chunk}.time.item(-1)"
            says += f" or n and not p{i} < {first} <= {last} <= {reached}"
        return says

    def _untidy(self, i: int, chunk: str) -> str:
        """The condition that a chunk's arrays are not what span `i` must be given; at the entry, and before a row, stamps count."""
        minds = i == 0 or (i < len(self.spans) and self.spans[i].row)
        return f" or not {chunk}.data.flags.carray" + (f" or not {chunk}.time.flags.carray" if minds else "")

    def _passed(self, i: int, indent: str, *, counted: bool = False) -> list[str]:
        """What an edge does with a chunk that passes it."""
        lines = [] if counted else [f"{indent}n = len(c{i}.time)"]
        lines.append(f"{indent}edge{i}.samples += n")
        return lines + [f"{indent}observe{i}_{k}(c{i})" for k in range(len(self.edges[i].observers))]

    def _noted(self, i: int) -> list[str]:
        """A timed passage ends with span `i`. What is within a row, the row notes itself."""
        times = ", ".join(f"t{k}" for k in range(i + 2))
        noted = [f"note{i}(({times}))"] if any(span.row is None for span in self.spans[: i + 1]) else []
        return [*noted, f"due = t{i + 1} + {REST} * (t{i + 1} - t0)"]


def taken_back(given: Chunk, time: Times, data: Array) -> Chunk:
    """What an operator has made of arrays that were lent to it, with arrays of its own: it may have kept those."""
    made = data.copy() if given.data is data else given.data
    return Chunk(time.copy() if given.time is time else given.time, made, given.until, given.lost)


def _in_a_row(edge: LiveEdge) -> tuple[list[InputPort], list[LiveEdge]]:
    """The ports behind an edge up to where it branches or ends, and the edges before, between and after them."""
    ports: list[InputPort] = []
    edges = [edge]
    while len(ports) < LONGEST and (port := edge.next) is not None and port.out:
        edge = port.out
        ports.append(port)
        edges.append(edge)
    return ports, edges


def _spans(ports: list[InputPort], edges: list[LiveEdge]) -> Iterator[Span]:
    """Each port by itself; neighbours that have steps, and whose edges nobody listens to, together; one may thin out."""
    i = 0
    while i < len(ports):
        steps: list[KernelCall] = []
        for k, port in enumerate(ports[i:], i):
            step = step_of(port.operator, edges[k].spec, edges[k + 1].spec)
            if step is None or (steps and edges[k].observers) or (step.rows and any(s.rows for s in steps)):
                break
            steps.append(step)
        together = max(1, len(steps))
        widths = [edge.spec.shape[0] for edge in edges[i + 1 : i + together + 1]] if together > 1 else []
        yield Span(ports[i : i + together], Row(steps, widths) if widths else None, i)
        i += together
