"""Alarms on the screen and in the log, with what to do, for as long as they last."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import structlog
from rich.table import Table

from kinegraph.devices.outlets.terminal.view import TerminalView
from kinegraph.stream.chunk import NS, Chunk, Specs, utc
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import ANY, Input
from kinegraph.stream.outlet import Outlet

FIELDS = ("onset", "subject", "state", "what", "advice")

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class AlarmsState:
    """The alarms that there are now: from which input, with whom, what, and what to do; and how many there have been."""

    ports: list[str]
    subjects: list[str]
    what: list[str]
    advice: list[str]
    count: int


@dataclass(frozen=True, slots=True)
class Alarms(Outlet[AlarmsState]):
    """Any number of alarm streams (`operators.monitors.cycle_watch`, `operators.monitors.electrode_watch`) in.

    Each alarm is a warning in the log; those that last are a red table in the live view, and without a live view, a line each. An
    input has one alarm about a subject at a time; two inputs may have one each.
    """

    inputs = {ANY: Input()}
    in_order: ClassVar[bool] = False

    def open(self, specs: Specs) -> Specs:
        for port, spec in specs.items():
            if not set(FIELDS) <= set(spec.dtype.names or ()):
                raise InputError(port, spec.describe(), f"alarms: events with the fields {', '.join(FIELDS)}")
        self.set_state(AlarmsState([], [], [], [], 0))
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
            subject, what, advice = str(row["subject"]), str(row["what"]), str(row["advice"])
            since_s = (stamp - int(row["onset"])) / NS
            if row["state"] == "on":
                log.warning("alarm", who=subject, what=what, do=advice, at=utc(stamp))
                self._show(port, subject, what, advice, f"ALARM {subject}: {what}. {advice}")
            else:
                log.info("alarm is over", who=subject, what=what, at=utc(stamp))
                self._show(port, subject, "", "", f"over: {subject}: {what} ({since_s:.0f} s)")

    def _show(self, port: str, subject: str, what: str, advice: str, line: str) -> None:
        s = self.state
        kept = [
            k for k, shown_name in enumerate(zip(s.ports, s.subjects, strict=True)) if shown_name != (port, subject)
        ]
        s.ports, s.subjects, s.what, s.advice = (
            [text[k] for k in kept] for text in (s.ports, s.subjects, s.what, s.advice)
        )
        if what:
            s.ports.append(port)
            s.subjects.append(subject)
            s.what.append(what)
            s.advice.append(advice)
            s.count += 1
        if TerminalView.current is None:
            with suppress(BrokenPipeError):
                print(line, flush=True)
        else:
            TerminalView.current.hang_out("alarms", self._table(), line)

    def _table(self) -> Table:
        s = self.state
        table = Table(title="ALARM" if s.subjects else "all clear", title_justify="left", box=None, pad_edge=False)
        table.title_style = "bold white on red" if s.subjects else "bold green"
        table.add_column("", style="bold red")
        table.add_column("")
        for subject, what, advice in zip(s.subjects, s.what, s.advice, strict=True):
            table.add_row(subject, f"{what}\n{advice}")
        return table
