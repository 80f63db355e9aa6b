"""The newest value of any stream, in words and units, on the terminal: for graphs whose answer is a number or an event."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from kinegraph.devices.outlets.terminal.view import TerminalView
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Specs, StreamSpec, utc
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import ANY, Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.text.safe_text import one_line, say

MAX_VALUES = 32
"""More numbers than this are no reading but a picture."""


@dataclass(slots=True)
class ReadoutState:
    """By port: the stamp from which on the next line is due, how many events there were, and the newest value as text."""

    ports: list[str]
    due: list[int]
    counts: list[int]
    newest: list[str]


@dataclass(frozen=True, slots=True)
class Readout(Outlet[ReadoutState, Mapping[str, StreamSpec]]):
    """Any number of streams in: signals of up to 32 channels, and events.

    In the live view a table holds the newest value of each. Elsewhere each event is a line, and a signal has one every `every_s`.

    Raises InputError for signals with more channels.
    """

    inputs = {ANY: Input()}

    every_s: float = param(2.0, above=0.0, help="where the output is no terminal: how often a signal has a line")

    def open(self, specs: Specs) -> Specs:
        for port, spec in specs.items():
            if not spec.is_event and int(np.prod(spec.shape, initial=1)) > MAX_VALUES:
                raise InputError(port, spec.describe(), f"events, or a signal of up to {MAX_VALUES} numbers a sample")
        n = len(specs)
        self.set_state(ReadoutState(list(specs), [NEVER] * n, [0] * n, [""] * n), dict(specs))
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        if not len(chunk.time):
            return
        s, spec = self.state, self.runtime[port]
        k = s.ports.index(port)
        if spec.is_event:
            for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
                s.counts[k] += 1
                s.newest[k] = event_text(row, spec)
                onset = int(row["onset"]) if "onset" in (spec.dtype.names or ()) else stamp
                self._show(f"{port} {s.counts[k]}  {utc(onset)}  {s.newest[k]}".rstrip())
            return
        stamp = int(chunk.time[-1])
        s.newest[k] = signal_text(chunk.data[-1], spec)
        is_due = stamp >= s.due[k]
        if is_due:
            s.due[k] = stamp + round(self.every_s * NS)
        self._show(f"{port}  {s.newest[k]}" if is_due else "")

    def _show(self, line: str) -> None:
        if TerminalView.current is not None:
            TerminalView.current.hang_out("readout", self._table(), line)
        elif line:
            with suppress(BrokenPipeError):  # the output was closed
                say(line, flush=True)

    def _table(self) -> Table:
        s = self.state
        table = Table(box=None, pad_edge=False, show_header=False)
        for port, count, text in zip(s.ports, s.counts, s.newest, strict=True):
            table.add_row(port, f"{count}  {text}" if count else text, style="bold")
        return table


def signal_text(sample: Array, spec: StreamSpec) -> str:
    """ "roll 12.3 deg, pitch -4.1 deg"."""
    values = np.ravel(sample).tolist()
    units = spec.units if len(spec.units) == len(values) else (spec.units or ("",))[:1] * len(values)
    names = spec.channels if len(spec.channels) == len(values) else ("",) * len(values)
    return ", ".join(_value(*one) for one in zip(names, values, units, strict=True))


def event_text(row: np.void, spec: StreamSpec) -> str:
    """ "duration 0.84 s, peak 12 uV": an interval's end is shown as its duration, its onset is left to the line's time."""
    names = row.dtype.names or ()
    units = spec.units if len(spec.units) == len(names) else ("",) * len(names)
    parts = []
    for name, unit in zip(names, units, strict=True):
        if name == "onset":
            continue
        if name == "end" and "onset" in names:
            parts.append(_value("duration", (int(row["end"]) - int(row["onset"])) / NS, "s"))
        elif np.ndim(row[name]) == 0:
            parts.append(_value(name, row[name], unit))
    return ", ".join(parts)


def _value(name: str, value: object, unit: str) -> str:
    text = f"{float(value):.4g}" if isinstance(value, float | np.floating) else one_line(str(value))
    return " ".join(part for part in (name, text, unit) if part)
