"""Operators in a row as one piece of machine code: the kernels that they name as their steps, called one below the other.

Most operators do less work on a chunk than it takes to call them, to make the chunk that they give back, and to slot a kernel its arrays.
So the steps of operators in a row are written down as one function of a chunk's arrays, and compiled. Where the steps' memory lies is
looked up once, and stands in a table; the function is the same for every graph with such a row, and is kept with the other kernels.

The function reads the clock after each step, where it is to be timed, so that every operator's time is known as elsewhere. For that it
asks the C library, which is why there are rows on Linux only; on other systems operators are called one by one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kinegraph.stream.chunk import NEVER, STAMP, Array, Chunk, StreamSpec
from kinegraph.stream.engine.flow.metrics import Timing, add
from kinegraph.stream.filter import FLOW, KernelCall, SampleWise, arguments
from kinegraph.stream.kernel import compile_written, is_kernel
from kinegraph.stream.operator import Operator

POSSIBLE = sys.platform == "linux"
TIMED = 1024
"""This many passages are timed between two readings of their times; further ones are not."""
COUNT, TIMES, RUNTIME, SAMPLES, STAMPS = 0, 1, 2, 3, 5
"""The table's first places: passages timed; the addresses of their times, of the clock's desk, and of two buffers each for samples and
stamps between steps."""
FIRST = 7
SIGNATURE = "int64(float64[:, ::1], int64[::1], float64[:, ::1], int64[::1], int64[::1], int64)"
HEAD = """\
from numba import carray
from kinegraph.stream.engine.flow.machine import clock, floats_at, longs_at
"""


def step_of(operator: Operator[Any], taken: StreamSpec, given: StreamSpec) -> KernelCall | None:
    """What an operator that takes and gives such streams can contribute to a row; None if it cannot."""
    plain = all(spec.is_signal and spec.dtype == np.float64 for spec in (taken, given))
    step = operator.kernel_call() if POSSIBLE and plain and isinstance(operator, SampleWise) else None
    if step is None or not is_kernel(step.kernel):
        return None
    return step if all(map(_has_a_place, step.given.values())) else None


def _has_a_place(value: object) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype in (np.float64, np.int64) and value.flags.carray
    return isinstance(value, int | float) and not isinstance(value, bool)


class Row:
    """The steps of several operators.

    run       the compiled function: given a chunk's samples (n, c) and stamps (n,), arrays for what comes out (m, width) and (m,), the
              table, and the time now (ns, perf_counter; 0: not to be timed), it returns the time at which it ended, or 0; of a step whose
              stamps cannot be, the negative of its place, which is counted from 1
    table     what it is to be given
    room      samples that a chunk may have; `grow` makes more room
    thinning  the place of the one step that keeps only some samples; None if there is none
    rows      given n, how many of n samples it keeps
    moves     whether stamps that come out are others than those that came in
    delay_ns  by how much they are earlier
    width     numbers in a sample that comes out
    """

    def __init__(self, steps: Sequence[KernelCall], widths: Sequence[int]) -> None:
        """`widths`: how many numbers a sample has that each step gives out."""
        self._steps, self._widths = steps, widths
        self._times = np.zeros((TIMED, len(steps) + 1), np.int64)
        self._kept: list[Array] = [np.zeros(2, np.int64)]  # whatever the table has the address of
        self._cells = [0] * FIRST
        self._cells[TIMES], self._cells[RUNTIME] = self._times.ctypes.data, self._kept[0].ctypes.data
        self.thinning = next((i for i, step in enumerate(steps) if step.rows), None)
        self.rows = None if self.thinning is None else steps[self.thinning].rows
        self.moves = any("stamps" in arguments(step.kernel) for step in steps)
        self.delay_ns = sum(step.delay_ns for step in steps)
        self.width = widths[-1]
        source = HEAD + "\n".join(self._written()) + "\n"
        self.run: Callable[..., int] = compile_written("run", SIGNATURE, source, [step.kernel for step in steps])
        self.table = np.array(self._cells, np.int64)
        self.room = 0
        self.grow(64)

    def through(self, chunk: Chunk) -> Chunk | None:
        """A chunk of which nothing is unusual passes the steps, untimed: what a chain writes out. None where nothing comes out of it."""
        n = len(chunk.time)
        if n > self.room:
            self.grow(n)
        m = self.rows(n) if self.rows else n
        out, stamps = np.empty((m, self.width)), np.empty(m, STAMP) if self.moves else chunk.time
        if self.run(chunk.data, chunk.time, out, stamps, self.table, 0) < 0:
            raise ValueError("its step gives stamps that run backwards, or ahead of what it is given")
        if not len(out):
            return None
        return Chunk(stamps, out, chunk.until - self.delay_ns)

    def grow(self, n: int) -> None:
        """Make room for chunks of `n` samples."""
        most = max(self._widths)
        self._buffers = [np.zeros((n, most)) for _ in range(2)] + [np.zeros(n, np.int64) for _ in range(2)]
        self.table[SAMPLES:FIRST] = [buffer.ctypes.data for buffer in self._buffers]
        self.room = n

    def fold(self, timings: Sequence[Timing], least: int) -> None:
        """Hand the times measured so far to the operators' timings, where there are at least `least`."""
        count = self.table.item(COUNT)
        if count < max(least, 1):
            return
        times = self._times[:count].copy()
        self.table[COUNT] = 0
        for k, timing in enumerate(timings):
            add(times, k, timing)

    # what is written ---------------------------------------------------------------------------------------------------

    def _written(self) -> list[str]:
        lines = ["", "", "def run(x, time, out, stamps, table, t0):", "    n = x.shape[0]"]
        last = len(self._steps) - 1
        flow = {"x": "x", "time": "time"}
        rows, moved = "n", 0
        for i, step in enumerate(self._steps):
            newest = f"{flow['time']}[{rows} - 1]"
            if i == self.thinning:
                rows = "m"
                lines.append("    m = stamps.shape[0]")
            flow["out"], flow["stamps"] = "out", "stamps"
            moves = "stamps" in arguments(step.kernel)
            if i < last:
                flow["out"], flow["stamps"] = f"x{i + 1}", f"time{i + 1}"
                shape = f"({rows}, table[{self._cell(self._widths[i])}])"
                lines.append(f"    x{i + 1} = carray(floats_at(table[{SAMPLES + i % 2}]), {shape})")
                if moves:
                    lines.append(f"    time{i + 1} = carray(longs_at(table[{STAMPS + moved % 2}]), ({rows},))")
                    moved += 1
            given = ", ".join(flow[n] if n in FLOW else self._place(step.given[n]) for n in arguments(step.kernel))
            lines.append(f"    step{i}({given})")
            if step.last is not None:
                lines.append(f"    {self._place(step.last)}[0] = {newest}")
            if moves:
                lines += self._checked(i, flow["stamps"], rows)
            flow["x"], flow["time"] = flow["out"], flow["stamps"] if moves else flow["time"]
            lines.append(f"    t{i + 1} = clock(table[{RUNTIME}]) if t0 else 0")
            if i == self.thinning and i < last:
                lines += ["    if m == 0:", *self._noted(i + 1, "        ")]
        if self.moves and flow["time"] != "stamps":
            lines += ["    for i in range(stamps.shape[0]):", f"        stamps[i] = {flow['time']}[i]"]
        return lines + self._noted(last + 1, "    ")

    def _checked(self, i: int, stamps: str, rows: str) -> list[str]:
        """The ends of a step's stamps, not before its last ones and not ahead of what came in; else the function returns -(i + 1)."""
        last, given = f"table[{self._cell(NEVER)}]", f"{stamps}[{rows} - 1]"
        return [
            f"    if {rows} > 0:",
            f"        if {stamps}[0] < {last} or {given} < {stamps}[0] or {given} > time[n - 1]:",
            f"            return -{i + 1}",
            f"        {last} = {given}",
        ]

    def _noted(self, ended: int, indent: str) -> list[str]:
        """A passage ends after its last step: its times are kept, if there is room."""
        places = len(self._steps) + 1
        lines = [f"if t0 and table[{COUNT}] < {TIMED}:"]
        lines.append(f"    times = carray(longs_at(table[{TIMES}]), ({TIMED}, {places}))")
        lines += [f"    times[table[{COUNT}], {i}] = {f't{i}' if i <= ended else 0}" for i in range(places)]
        lines += [f"    table[{COUNT}] += 1", f"return t{ended}"]
        return [indent + line for line in lines]

    def _cell(self, value: int) -> int:
        self._cells.append(value)
        return len(self._cells) - 1

    def _place(self, value: Array | float) -> str:
        """How the function gets at a field of a step's state."""
        if isinstance(value, float):
            return f"{self._place(np.array([value]))}[0]"
        if not isinstance(value, np.ndarray):
            return f"table[{self._cell(int(value))}]"
        self._kept.append(value)
        kind = "floats_at" if value.dtype == np.float64 else "longs_at"
        address = self._cell(value.ctypes.data)
        shape = "".join(f"table[{self._cell(length)}], " for length in value.shape)
        return f"carray({kind}(table[{address}]), ({shape}))"
