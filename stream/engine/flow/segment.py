"""A segment: operators in a row as one function, written out for it.

Where an operator is the only reader of an edge and has one input, nothing is left to decide while a graph runs: the calls of all
operators in a row are written one below the other and compiled once. That costs a fraction of a loop that asks each time what comes
next. Only what comes most is written out: a chunk in normal arrays and without `lost`, one chunk given back for it. At anything else the
function is left for `LiveEdge.carry` or `Stage.emit`, which do the same step by step.

Timing reads the clock once per operator. Reading it may cost more than an operator that does little, so a segment that runs without a rest,
as in a replay, times one passage in eight or so: after each that was timed, as many follow untimed as fit into seven times its length.
"""

from __future__ import annotations

from itertools import chain
from time import perf_counter_ns
from typing import Any

import numpy as np

from kinegraph.stream.chunk import STAMP, Chunk
from kinegraph.stream.engine.flow.edge import InputPort, LiveEdge, Push, failure
from kinegraph.stream.engine.flow.metrics import add
from kinegraph.stream.errors import asked_to_end

REST = 7
"""After a passage that was timed, others pass untimed for this many times its length."""
LONGEST = 64
"""A segment has at most this many operators; another one begins behind it."""


class CompiledSegment:
    """The operators in a row behind an edge.

    ports   what is called, in order
    edges   before, between and after them: port i reads edge i and feeds edge i + 1
    send    takes a chunk and the time at which the caller ended; returns the time at which the work ended (ns, perf_counter)
    """

    def __init__(self, edge: LiveEdge) -> None:
        self.ports, self.edges = _in_a_row(edge)
        self._timed: list[list[tuple[int, ...]]] = [[] for _ in self.ports]
        self._code = Code(self.edges, self.ports)
        names: dict[str, Any] = {"clock": perf_counter_ns, "Chunk": Chunk, "due": 0, "trouble": self._trouble}
        names |= {"STAMP": STAMP, "slot0": edge.slot}
        for i, edge in enumerate(self.edges):
            names |= {f"edge{i}": edge, f"carry{i}": edge.carry, f"dtype{i}": edge.spec.dtype}
            names |= {f"observe{i}_{k}": observe for k, observe in enumerate(edge.observers)}
        for i, port in enumerate(self.ports):
            names |= {
                f"process{i}": port.operator.process,
                f"port{i}": port.port,
                f"emit{i}": port.emit,
                f"in{i}": port,
            }
            names |= {f"note{i}": self._timed[i].append, "slot": port.slot}
        names |= {f"push{k}": push for k, push in enumerate(self.edges[-1].readers)}
        # straight-line code for this row of operators: a loop with its look-ups took as long as light operators themselves
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
            for i, port in enumerate(self.ports[: times.shape[1] - 1]):
                add(times, i, port.timing)

    def _trouble(self, error: BaseException, found: dict[str, Any]) -> None:
        """Raise what an operator's exception means; nothing, where no operator of this segment raised it."""
        if asked_to_end(error):
            return
        trace = error.__traceback__
        line = trace.tb_lineno if trace else 0
        if (checked := self._code.checks_at.get(line)) is not None:
            self.edges[checked].check(found["given"])
        if (i := self._code.calls_at.get(line)) is not None:
            port = self.ports[i]
            raise failure(port.node, error, port.port, found[f"c{i}"]) from error


class Code:
    """The text of a segment's function, `send(c0, t0)`.

    lines      of it
    calls_at   by line: the port that is called there
    checks_at  by line: the edge whose promise is checked there
    """

    def __init__(self, edges: list[LiveEdge], ports: list[InputPort]) -> None:
        self.edges, self.ports = edges, ports
        self.lines: list[str] = []
        self.calls_at: dict[int, int] = {}
        self.checks_at: dict[int, int] = {}
        self._write("def send(c0, t0):", "    global due", *self._entry(), *self._passed(0, "    "), "    try:")
        if ports:
            # clocks are read in one passage of several, as reading them costs about as much as a light operator
            self._write("        if t0 >= due:")
            self._passage(" " * 12, timed=True)
        self._passage(" " * 8, timed=False)
        self._write("    except BaseException as error:", "        trouble(error, locals())", "        raise")

    def _write(self, *lines: str, indent: str = "") -> None:
        self.lines += [indent + line for line in lines]

    def _call(self, i: int, line: str, indent: str) -> None:
        self._write(line, indent=indent)
        self.calls_at[len(self.lines)] = i

    def _check(self, i: int, line: str, indent: str) -> None:
        self._write(line, indent=indent)
        self.checks_at[len(self.lines)] = i

    def _passage(self, indent: str, *, timed: bool) -> None:
        """All calls, one below the other, and what ends the passage."""
        for i in range(len(self.ports)):
            self._operator(i, indent, timed=timed)
            self._write(*self._passed(i + 1, indent, counted=True))
        last = len(self.ports)
        self._write(*(self._noted(last - 1) if timed else []), indent=indent)
        self._write(f"t = t{last}" if timed else "t = clock()", indent=indent)
        self._write(*(f"t = push{k}(c{last}, t)" for k in range(len(self.edges[-1].readers))), indent=indent)
        self._write("return t", indent=indent)

    def _operator(self, i: int, indent: str, *, timed: bool) -> None:
        """The call of an operator, and the check of what it gives back."""
        b = i + 1
        end, noted = (f"t{b}", self._noted(i)) if timed else ("clock()", [])
        self._write(f"slot.port = in{i}", f"slot.chunk = c{i}", indent=indent)
        self._process(i, indent)
        self._write(
            *([f"t{b} = clock()"] if timed else []),
            "if given.__class__ is not Chunk:",
            *(f"    {line}" for line in noted),
            f"    return {end} if given is None else emit{i}(given, {end})",
            f"p{b} = edge{b}.promised",
            indent=indent,
        )
        carried = [*(f"        {line}" for line in noted), f"        return carry{b}(given, {end})"]
        self._same_arrays(i, carried, indent)
        # operators that declare contiguous outputs are spared the look at the flags
        untidy = "" if self.ports[i].contiguous else " or not given.data.flags.carray"
        broken = self._broken(b, "given", f"c{i}.until")
        self._check(b, "    n = len(given.time)", indent)
        self._check(b, f"    if given.lost or edge{b}.pending_gap or given.until < p{b} or {broken}{untidy}:", indent)
        self._write(*carried, f"c{b} = given", f"edge{b}.promised = c{b}.until", indent=indent)

    def _process(self, i: int, indent: str) -> None:
        """The call itself; an operator from outside is given views that it cannot write to."""
        if self.ports[i].is_ours:
            self._call(i, f"given = process{i}(port{i}, c{i})", indent)
            return
        self._write(
            f"if c{i}.data is not slot.data or c{i}.time is not slot.time:",
            f"    slot.show(c{i})",
            f"shown = Chunk(slot.seen_time, slot.seen_data, c{i}.until, 0)",
            indent=indent,
        )
        self._call(i, f"given = process{i}(port{i}, shown)", indent)
        self._write(
            "if given is shown:",
            f"    given = c{i}",
            "elif given.__class__ is Chunk:",
            "    if given.time is slot.seen_time:",
            f"        given.time = c{i}.time",
            "    if given.data is slot.seen_data:",
            f"        given.data = c{i}.data",
            indent=indent,
        )

    def _same_arrays(self, i: int, carried: list[str], indent: str) -> None:
        """Arrays that the edge before has passed need not be looked at once more; ends with what introduces the other case."""
        b = i + 1
        before, after = self.edges[i].spec, self.edges[b].spec
        if (before.shape, before.dtype) != (after.shape, after.dtype):
            self._write("if True:", indent=indent)
            return
        # an edge may have promised more than the one before; only then can stamps that passed there be too old here
        behind = f" or p{b} > p{i} and n and given.time.item(0) <= p{b}" if self.edges[b].looks_at_ends else ""
        self._check(b, f"if given.time is c{i}.time and given.data is c{i}.data:", indent)
        self._check(b, f"    if given.lost or edge{b}.pending_gap or given.until < p{b}{behind}:", indent)
        self._write(*carried, "else:", indent=indent)

    def _entry(self) -> list[str]:
        """What is unusual at the segment's first edge is carried step by step."""
        edge = self.edges[0]
        lines = ["    n = len(c0.time)"] if edge.slot is not None else []
        broken = f" or c0.until < p0 or {self._broken(0, 'c0', 'slot0.chunk.until')}" if edge.slot is not None else ""
        untidy = " or not c0.data.flags.carray or not c0.time.flags.carray"
        return [
            *(["    if c0.__class__ is not Chunk:", "        edge0.check(c0)"] if edge.slot is not None else []),
            *lines,
            "    p0 = edge0.promised",
            f"    if c0.lost or edge0.pending_gap{broken}{untidy}:",
            "        return carry0(c0, t0)",
            "    edge0.promised = c0.until",
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

    def _passed(self, i: int, indent: str, *, counted: bool = False) -> list[str]:
        """What an edge does with a chunk that passes it."""
        lines = [] if counted else [f"{indent}n = len(c{i}.time)"]
        lines.append(f"{indent}edge{i}.samples += n")
        return lines + [f"{indent}observe{i}_{k}(c{i})" for k in range(len(self.edges[i].observers))]

    def _noted(self, i: int) -> list[str]:
        """A timed passage ends with operator `i`."""
        times = ", ".join(f"t{k}" for k in range(i + 2))
        return [f"note{i}(({times}))", f"due = t{i + 1} + {REST} * (t{i + 1} - t0)"]


def _in_a_row(edge: LiveEdge) -> tuple[list[InputPort], list[LiveEdge]]:
    """The ports behind an edge up to where it branches or ends, and the edges before, between and after them."""
    ports: list[InputPort] = []
    edges = [edge]
    while len(ports) < LONGEST and (port := edge.next) is not None and port.out:
        edge = port.out
        ports.append(port)
        edges.append(edge)
    return ports, edges
