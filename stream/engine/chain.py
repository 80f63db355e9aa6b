"""A chain of operators as one function, written out for it.

Where an operator is the only reader of a wire and has one input, nothing is left to decide while a graph runs: the calls of all
operators in a row are written one below the other and compiled once. That costs a fraction of a loop that asks each time what comes
next. Only what comes most is written out: a chunk in normal arrays and without `lost`, one chunk given back for it. At anything else the
function is left for `Wire.carry` or `Stage.emit`, which do the same step by step.

Timing reads the clock once per operator. Reading it may cost more than an operator that does little, so a chain that runs without a rest,
as in a replay, times one passage in eight or so: after each that was timed, as many follow untimed as fit into seven times its length.
"""

from __future__ import annotations

from itertools import chain
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any

import numpy as np

from stream.chunk import Chunk
from stream.engine.link import Link, Push, failure
from stream.engine.metrics import add

if TYPE_CHECKING:
    from stream.engine.wire import Wire

REST = 7
"""So many times the length of a passage that was timed pass untimed."""


class Chain:
    """The operators in a row behind a wire.

    wires   before, between and after them
    send    takes a chunk and the time at which the caller ended; returns the time at which the work ended (ns, perf_counter)
    """

    def __init__(self, wire: Wire) -> None:
        self._links, self.wires = _in_a_row(wire)
        self._timed: list[list[tuple[int, ...]]] = [[] for _ in self._links]
        self._at: dict[int, int] = {}
        """By line of the function: the link whose operator is called there."""
        lines = self._written()
        names: dict[str, Any] = {"clock": perf_counter_ns, "Chunk": Chunk, "due": 0, "trouble": self._trouble}
        for i, wire in enumerate(self.wires):
            names |= {f"wire{i}": wire, f"carry{i}": wire.carry}
            names |= {f"tap{i}_{k}": tap for k, tap in enumerate(wire.taps)}
        for i, link in enumerate(self._links):
            names |= {f"process{i}": link.process, f"port{i}": link.port, f"emit{i}": link.emit}
            names |= {f"note{i}": self._timed[i].append}
        names |= {f"push{k}": push for k, push in enumerate(self.wires[-1].readers)}
        exec(compile("\n".join(lines), f"<chain behind {wire.edge}>", "exec"), names)
        self.send: Push = names["send"]

    def fold(self, least: int) -> None:
        """Hand the durations measured so far to the operators' timings, where there are at least so many."""
        for noted in self._timed:
            if len(noted) < max(least, 1):
                continue
            taken = noted[:]
            del noted[: len(taken)]
            times = np.fromiter(chain.from_iterable(taken), np.int64).reshape(len(taken), -1)
            durations = times[:, 1:] - times[:, :-1]
            add(durations.T, [link.timing for link in self._links[: durations.shape[1]]])

    def _written(self) -> list[str]:
        lines = [
            "def send(c0, t0):",
            "    global due",
            "    if c0.lost or wire0.owed or not c0.data.flags.carray:",
            "        return carry0(c0, t0)",
            *self._passed(0, "    "),
            "    try:",
        ]
        if self._links:
            lines.append("        if t0 >= due:")
            self._write_out(lines, " " * 12, timed=True)
        self._write_out(lines, " " * 8, timed=False)
        lines += ["    except (Exception, SystemExit) as error:", "        trouble(error, locals())", "        raise"]
        return lines

    def _write_out(self, lines: list[str], indent: str, *, timed: bool) -> None:
        """All calls, one below the other, and what ends the passage."""
        last = len(self._links)
        for i in range(last):
            end = f"t{i + 1}" if timed else "clock()"
            noted = self._noted(i) if timed else []
            self._at[len(lines) + 1] = i
            lines.append(f"{indent}c{i + 1} = process{i}(port{i}, c{i})")
            lines += [f"{indent}t{i + 1} = clock()"] if timed else []
            untidy = "" if self._links[i].contiguous else f" or not c{i + 1}.data.flags.carray"
            body = [
                f"if c{i + 1}.__class__ is not Chunk:",
                *(f"    {line}" for line in noted),
                f"    return {end} if c{i + 1} is None else emit{i}(c{i + 1}, {end})",
                f"if c{i + 1}.lost or wire{i + 1}.owed{untidy}:",
                *(f"    {line}" for line in noted),
                f"    return carry{i + 1}(c{i + 1}, {end})",
                f"n = len(c{i + 1}.time)",
            ]
            lines.append(f"{indent}if c{i + 1} is not c{i} or wire{i + 1}.owed:")
            lines += [f"{indent}    {line}" for line in body]
            lines += self._passed(i + 1, indent, counted=True)
        if timed:
            lines += [indent + line for line in self._noted(last - 1)]
        lines.append(f"{indent}t = t{last}" if timed else f"{indent}t = clock()")
        lines += [f"{indent}t = push{k}(c{last}, t)" for k in range(len(self.wires[-1].readers))]
        lines.append(f"{indent}return t")

    def _passed(self, i: int, indent: str, *, counted: bool = False) -> list[str]:
        """What a wire does with a chunk that passes it."""
        lines = [] if counted else [f"{indent}n = len(c{i}.time)"]
        lines.append(f"{indent}wire{i}.samples += n")
        return lines + [f"{indent}tap{i}_{k}(c{i})" for k in range(len(self.wires[i].taps))]

    def _noted(self, i: int) -> list[str]:
        """A timed passage ends with link `i`."""
        times = ", ".join(f"t{k}" for k in range(i + 2))
        return [f"note{i}(({times}))", f"due = t{i + 1} + {REST} * (t{i + 1} - t0)"]

    def _trouble(self, error: Exception | SystemExit, found: dict[str, Any]) -> None:
        """Raise what an operator's exception means; nothing, where no operator of this chain raised it."""
        trace = error.__traceback__
        i = self._at.get(trace.tb_lineno) if trace else None
        if i is not None:
            link = self._links[i]
            raise failure(link.name, error, link.port, found[f"c{i}"]) from error


def _in_a_row(wire: Wire) -> tuple[list[Link], list[Wire]]:
    """The links behind a wire up to where it branches or ends, and the wires before, between and after them."""
    links: list[Link] = []
    wires = [wire]
    while len(wire.readers) == 1 and isinstance(link := wire.readers[0], Link) and link.out:
        wire = link.out
        links.append(link)
        wires.append(wire)
    return links, wires
